"""Splats as optimiser parameters: row Adam, densification, random numbers, checkpoints."""
