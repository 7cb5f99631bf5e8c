"""Families of what is found elsewhere: creatures, nature, buildings, vehicles, toys, shapes."""
