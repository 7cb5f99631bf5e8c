"""What the networks are trained on: generated objects and meshes, cut as parts of users are."""
