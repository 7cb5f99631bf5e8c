"""Where the complete object is, and from where P is seen."""
