"""Splat files through readers and writers that others wrote."""
