"""Colours of new splats: by the network's sources, by P's rim, by the prompt."""
