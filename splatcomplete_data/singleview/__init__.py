"""One picture and its depth turned into coloured points."""
