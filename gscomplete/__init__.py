"""GSComplete: complete partial 3D objects made of Gaussian splats."""

__version__ = "0.1.0"
