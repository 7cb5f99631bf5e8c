"""Training of splats from posed photos: start, loss, growth, steps."""
