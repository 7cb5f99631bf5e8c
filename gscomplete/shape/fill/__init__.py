"""Close the gaps of a complete object by a smooth surface through their rims, without a network."""
