"""Lazy imports of the heavy optional packages, each with one clear line when it is missing.

Conventions
-----------
* This is the only place in the packages that imports Open3D, laspy, OpenImageIO, gsply, pymeshlab,
  usd-core (its package is ``pxr``) and yaml; recipes do, too.
* ``import open3d`` needs the system library libusb-1.0, which a fresh machine lacks; the package
  ``libusb-package`` carries it, and loading it first is all that is needed.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
from types import ModuleType

from gscomplete.errors import UserError

EXTRA = "make setup EXTRAS=dev,bench, or pip install 'gscomplete[data,bench,usd]'"
"""How to get everything this module imports."""


def import_optional(module: str, purpose: str) -> ModuleType:
    """Import a module of the ``data`` or ``bench`` extra.

    Args:
        module: what to import.
        purpose: what it is needed for, for the message.

    Raises:
        UserError: it is not installed, or cannot be loaded on this machine.
    """
    try:
        return importlib.import_module(module)
    except (ImportError, OSError) as error:
        raise UserError(f"{purpose} needs {module.split('.')[0]} ({error}); {EXTRA}") from error


def import_open3d(purpose: str) -> ModuleType:
    """Import Open3D, giving it the libusb of ``libusb-package`` if the system has none.

    Raises:
        UserError: as ``import_optional``.
    """
    with contextlib.suppress(ImportError, OSError):
        path = importlib.import_module("libusb_package").get_library_path()
        if path is not None:
            ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
    open3d = import_optional("open3d", purpose)
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    return open3d
