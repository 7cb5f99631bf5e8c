"""Training of the shape network on one GPU beside as many processors as there are."""
