"""Photos and their cameras: COLMAP models, transforms.json, lenses, training views."""
