"""Results of other systems: which files each writes, and how they enter our tables."""
