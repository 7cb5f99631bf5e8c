"""What a cloud of points says of its surface: normals, where it ends, what it turns about."""
