"""Views that show the whole outline of an object of which P is a part."""
