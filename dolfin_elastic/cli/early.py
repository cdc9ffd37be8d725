"""What a command that computes imports first, to start sooner.

Debian's Open MPI is linked with libpsm2, for Omni-Path.  As that is loaded it measures the clock,
with 400 short sleeps: a tenth of a second of each start, on every machine.  A thread loads it while
Python imports what needs neither MPI nor another library.  (MPI's library itself is not to be
loaded so: UCX moves the end of the heap as it is loaded, while Python allocates.)

DOLFINx makes functions of PETSc callable from Numba, whether there is Numba or not: it parses their
declarations and loads the library once more, 25 ms of each start.  Nothing here calls them.
"""

from __future__ import annotations

import ctypes
import os
import sys
import threading
from collections.abc import Sequence
from importlib import import_module
from types import ModuleType

from dolfin_elastic.core.petsc_options import start_petsc

_SLEEPS = b"libpsm2.so.2"
_FIRST = ("hashlib", "numpy", "pydantic_core", "uuid", "zoneinfo")
"""Modules with libraries: to load one waits for any that is being loaded."""
_MEANWHILE = ("dolfin_elastic.core.schema", "ufl")
"""Modules of Python alone, once the first are there."""
_FOR_NUMBA = "dolfinx.utils"


def import_early(at_start: Sequence[str] = ()) -> None:
    """Imports what every computation needs, and starts MPI and PETSc. Collective.

    Args:
        at_start: Options that PETSc reads as it starts.
    """
    if "dolfinx" in sys.modules:
        return
    _import_beside_psm2()
    start_petsc(list(at_start))
    _import_dolfinx()


def _import_beside_psm2() -> None:
    """Imports what needs no MPI while libpsm2 sleeps; without that library, too."""
    for name in _FIRST:
        import_module(name)
    load = ctypes.CDLL(None).dlopen  # which lets other threads go on, as ctypes.CDLL does not
    load.argtypes, load.restype = (ctypes.c_char_p, ctypes.c_int), ctypes.c_void_p
    loading = threading.Thread(target=load, args=(_SLEEPS, os.RTLD_NOW), daemon=True)
    loading.start()
    for name in _MEANWHILE:
        import_module(name)
    loading.join()


def _import_dolfinx() -> None:
    """Without its utilities for Numba; who imports them later gets them."""
    sys.modules[_FOR_NUMBA] = ModuleType(_FOR_NUMBA)
    try:
        dolfinx = import_module("dolfinx")
        vars(dolfinx).pop("utils", None)
    finally:
        del sys.modules[_FOR_NUMBA]
