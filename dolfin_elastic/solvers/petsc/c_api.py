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


def choose_step(ts: PETSc.TS, order: int) -> tuple[float, bool]:
    """Asks TSAdapt whether the error of a step is small enough, and for the next step. Collective.

    TSAdapt calls `evaluatestep` of a scheme in Python for the solution to compare with.  It is not
    to cut steps short for a time that must be met, for it would forget how long they might have
    been: the caller does.

    Args:
        ts: Holds the new solution; its time is still that of the old one.
        order: Power of the step with which the error of one step grows.

    Returns:
        The next step [s], and whether the present one is accepted.
    """
    petsc, last = library(), ts.getMaxTime()
    ts.setMaxTime(float("inf"))
    handle, adapt = ctypes.c_void_p(ts.handle), ctypes.c_void_p()
    integer = ctypes.c_int if PETSc.IntType().itemsize == 4 else ctypes.c_int64
    scheme, accepted, h = integer(), ctypes.c_int(1), ctypes.c_double()
    check(petsc.TSGetAdapt(handle, ctypes.byref(adapt)))
    check(petsc.TSAdaptCandidatesClear(adapt))
    check(
        petsc.TSAdaptCandidateAdd(
            adapt,
            b"",
            integer(order),
            integer(1),
            ctypes.c_double(1.0),
            ctypes.c_double(1.0),
            ctypes.c_int(1),
        )
    )
    check(
        petsc.TSAdaptChoose(
            adapt,
            handle,
            ctypes.c_double(ts.getTimeStep()),
            ctypes.byref(scheme),
            ctypes.byref(h),
            ctypes.byref(accepted),
        )
    )
    ts.setMaxTime(last)
    return h.value, bool(accepted.value)
