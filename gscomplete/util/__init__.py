"""What all parts use: atomic writes, digests, JSON values, devices."""
