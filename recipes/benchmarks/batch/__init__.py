"""Batches: bytes, kills, throughput, and what many objects take."""
