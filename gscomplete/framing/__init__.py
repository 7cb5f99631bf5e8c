"""Where the complete object is and from where P is seen: guessed, given, checked, refined."""
