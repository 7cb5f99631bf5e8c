"""Structure from motion with pycolmap: its process, its folder, its poses."""
