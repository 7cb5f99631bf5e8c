"""Recipes: scripts that train, benchmark and check what the packages ship."""
