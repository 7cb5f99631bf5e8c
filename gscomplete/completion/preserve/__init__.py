"""Bounds on what new splats change of P's appearance from V: fits, fades and removals."""
