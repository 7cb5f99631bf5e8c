"""Feed the readers mutated files."""
