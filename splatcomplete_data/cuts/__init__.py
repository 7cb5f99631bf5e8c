"""Rules that cut a part out of a complete object: by name, at random, by boxes, by visibility."""
