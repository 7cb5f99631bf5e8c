"""Kill long jobs at random moments."""
