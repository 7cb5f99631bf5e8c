"""Splat files other than plain PLY, one module a format; ``any_file`` reads and writes them all."""
