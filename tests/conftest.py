"""Settings of the test process, made before anything loads the OpenMP runtime; order of tests."""

import os
import signal

import pytest
from hypothesis import settings

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("GOMP_SPINCOUNT", "3000")
"""As in the command line: pools of threads that spin while waiting slow each other down."""
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OMP_NUM_THREADS", "1")
"""Processes of tests share the cores; tests of threads set their numbers themselves."""

import torch  # noqa: E402

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
"""A shell starts background jobs with interrupts ignored; tests interrupt what they start."""

settings.register_profile("explore", deadline=None)
settings.register_profile("same examples", deadline=None, derandomize=True)
settings.load_profile("same examples")
"""A suite of the same code gives the same result; ``--hypothesis-profile explore`` draws new
examples. How long an example takes says more about what else runs than about the code."""


@pytest.fixture(autouse=True)
def seeded() -> None:
    """Let what tests draw with PyTorch's own generator be the same every time."""
    torch.manual_seed(0)


_LONGEST = ("end_to_end", "recipes", "batch", "completion", "priors")
"""Folders of the files that take longest, longest first."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that take longest, so that none is left to one process at the end."""
    items.sort(key=lambda item: [folder not in item.path.parts for folder in _LONGEST])
