"""The parts of the PLY reader and writer (``splats.ply``): header, layout, records, threads."""
