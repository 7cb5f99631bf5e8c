"""Datasets: folders of object folders, built from a recipe, checked, and counted."""
