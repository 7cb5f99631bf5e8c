"""Training of what chooses P's mirror images: scorers of planes, and of the answers to them."""
