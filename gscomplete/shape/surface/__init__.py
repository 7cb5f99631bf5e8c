"""The surface of what P lacks, as splats: predicted, or P turned about its axis."""
