"""What of PETSc petsc4py does not hand on, called in the library petsc4py itself has loaded."""

from __future__ import annotations

import ctypes
from functools import lru_cache

from petsc4py import PETSc


@lru_cache(maxsize=1)
def library() -> ctypes.CDLL:
    """PETSc's functions, opened once: each opening makes types that only cycles hold."""
    return ctypes.CDLL(PETSc.__file__)


def check(error: int) -> None:
    """Raises what PETSc reports.

    Args:
        error: What one of its functions returned.

    Raises:
        PETSc.Error: It is not 0.
    """
    if error:
        raise PETSc.Error(error)
