"""Meshes turned into splats."""
