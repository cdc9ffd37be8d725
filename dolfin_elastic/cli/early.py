"""What a command that computes imports first, while a library of MPI's sleeps.

Debian's Open MPI is linked with libpsm2, for Omni-Path.  As that is loaded it measures the clock,
with 400 short sleeps: a tenth of a second of each start, on every machine.  A thread loads it while
Python imports what needs neither MPI nor another library.  (MPI's library itself is not to be
loaded so: UCX moves the end of the heap as it is loaded, while Python allocates.)
"""

from __future__ import annotations

import ctypes
import os
import threading
from importlib import import_module

_SLEEPS = b"libpsm2.so.2"
_FIRST = ("hashlib", "numpy", "pydantic_core", "uuid", "zoneinfo")
"""Modules with libraries: to load one waits for any that is being loaded."""
_MEANWHILE = ("dolfin_elastic.core.schema", "ufl")
"""Modules of Python alone, once the first are there."""


def import_beside_mpi() -> None:
    """Imports Python's part of what every computation needs. Not collective.

    Without that library nothing is loaded beside, and without the modules nothing is changed.
    """
    for name in _FIRST:
        import_module(name)
    load = ctypes.CDLL(None).dlopen  # which lets other threads go on, as ctypes.CDLL does not
    load.argtypes, load.restype = (ctypes.c_char_p, ctypes.c_int), ctypes.c_void_p
    loading = threading.Thread(target=load, args=(_SLEEPS, os.RTLD_NOW), daemon=True)
    loading.start()
    for name in _MEANWHILE:
        import_module(name)
    loading.join()
