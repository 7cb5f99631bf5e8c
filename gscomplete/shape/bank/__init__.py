"""Known shapes: voxels of free meshes, found by the prompt's noun and fitted to P."""
