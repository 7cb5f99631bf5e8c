"""Families to come."""

FAMILIES = ()
