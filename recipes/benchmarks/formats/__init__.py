"""Splat files: speed of reading and writing, and what other programs read of them."""
