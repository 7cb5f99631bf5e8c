"""Planes of symmetry: all ranked, the likely ones scored, and the network's answers to them."""
