"""The CPU renderer: projection, tile lists and compositing as Numba kernels.

Kernels whose first arguments are ``first`` and ``last`` do the tasks from the one up to the other,
which do not depend on each other; ``util.kernels.run_kernel`` shares out all of them.
"""
