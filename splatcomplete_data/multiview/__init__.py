"""From photos to splats: poses, training, and cropping to the object."""
