"""Looking at splats in a browser."""
