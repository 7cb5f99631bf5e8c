"""What every room uses: atomic writes, digests, JSON values, devices."""
