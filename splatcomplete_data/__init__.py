"""Build partial and complete splat objects from meshes, scans and photos."""
