"""Splats as optimiser parameters: row Adam, densification, checkpoints, the step loop."""
