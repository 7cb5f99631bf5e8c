"""Extreme inputs for the renderer, the files and the completion: ``python -m`` runs every row.

A row feeds something extreme and makes checks; a check is a measured number and the largest that
passes. Where the float64 twin can be computed, the number is the distance to it.
"""
