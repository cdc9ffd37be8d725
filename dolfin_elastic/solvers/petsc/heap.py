"""Memory that was freed, back to the system.

SuperLU_DIST, which PETSc is linked with, tells the C library as soon as it is loaded never to give
memory back by itself: a process keeps all that it ever had, and large arrays lie behind the gaps
that smaller ones left.  `malloc_trim` gives the gaps back all the same.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any


@cache
def _trim() -> Any:
    """glibc's `malloc_trim`; None with another C library."""
    try:
        return ctypes.CDLL(None).malloc_trim
    except (OSError, AttributeError):
        return None


def give_back() -> None:
    """Gives whole pages that nothing uses back to the system. Local.

    That costs little, but pages that are used again are fetched anew, which takes 0.1 ms and more
    for each MB: to be called where much was needed for the moment, not in loops.
    """
    trim = _trim()
    if trim is not None:
        trim(ctypes.c_size_t(0))
