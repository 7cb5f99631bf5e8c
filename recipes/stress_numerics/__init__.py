"""Extreme inputs for the renderer, the files and the completion: ``python -m`` runs every row.

A row feeds one kind of extreme input and makes checks. A check is a measured number with the
largest value that passes; where the float64 twin can be computed, the number is the distance to it.
"""
