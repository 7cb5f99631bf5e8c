"""A disk that takes no more: files of this process cannot grow beyond a limit."""

import contextlib
import resource
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def files_end_at(size_bytes: int) -> Iterator[None]:
    """Let writing beyond ``size_bytes`` in a file fail, as it does on a full disk.

    What is imported meanwhile leaves no bytecode: Python 3.11 keeps what a full disk cut off, and
    every later import of it fails.
    """
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    writes_bytecode = not sys.dont_write_bytecode
    sys.dont_write_bytecode = True
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        sys.dont_write_bytecode = not writes_bytecode
