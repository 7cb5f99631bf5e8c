"""Planes of symmetry that P suggests: all of them ranked, the likely ones scored."""
