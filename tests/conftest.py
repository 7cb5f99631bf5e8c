"""Settings of the test process, made before anything loads the OpenMP runtime."""

import os

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("GOMP_SPINCOUNT", "3000")
"""As in the command line: pools of threads that spin while waiting slow each other down."""
