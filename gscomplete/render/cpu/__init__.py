"""The CPU renderer: projection, tile lists and compositing as Numba kernels.

A kernel whose first arguments are ``first`` and ``last`` does the tasks numbered first to last - 1,
which are independent; ``util.kernels.run_kernel`` divides all tasks among threads.
"""
