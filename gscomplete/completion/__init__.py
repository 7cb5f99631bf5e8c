"""The method: P frozen, new splats moved by a prior and the input preservation loss."""
