"""Families of objects that are used or worn at home."""
