"""The embedded prior's first guess of the whole: one pass of a three-dimensional network."""
