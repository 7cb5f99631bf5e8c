"""Mesh files to coloured triangles: loading, textures, side files, numbers, up axis."""
