"""Train the embedded four-view prior on procedural objects."""
