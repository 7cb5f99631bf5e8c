"""The CPU renderer: projection, tile lists and compositing as Numba kernels."""
