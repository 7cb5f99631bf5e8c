"""Real partial objects for tests and benchmarks, made from the data next to the repository."""
