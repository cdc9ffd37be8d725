"""PETSc's control of the time step (TSAdapt) for a scheme of our own; petsc4py does not have it."""

from __future__ import annotations

import ctypes
from functools import lru_cache

from petsc4py import PETSc


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    return ctypes.CDLL(PETSc.__file__)


def _check(error: int) -> None:
    if error:
        raise PETSc.Error(error)


def choose(ts: PETSc.TS, order: int) -> tuple[float, bool]:
    """Asks TSAdapt whether a step was good enough, and for the next one. Collective.

    TS calls back for the solution that the one at hand is compared with, `evaluatestep`.

    Args:
        ts: Holds the new solution; its time is still that of the old one.
        order: Power of the step that the error grows with.

    Returns:
        The next step [s], and whether the present one is accepted.
    """
    library = _library()
    handle, adapt = ctypes.c_void_p(ts.handle), ctypes.c_void_p()
    integer = ctypes.c_int if PETSc.IntType().itemsize == 4 else ctypes.c_int64
    scheme, accepted, h = integer(), ctypes.c_int(1), ctypes.c_double()
    _check(library.TSGetAdapt(handle, ctypes.byref(adapt)))
    _check(library.TSAdaptCandidatesClear(adapt))
    _check(
        library.TSAdaptCandidateAdd(
            adapt,
            b"",
            integer(order),
            integer(1),
            ctypes.c_double(1.0),
            ctypes.c_double(1.0),
            ctypes.c_int(1),
        )
    )
    _check(
        library.TSAdaptChoose(
            adapt,
            handle,
            ctypes.c_double(ts.getTimeStep()),
            ctypes.byref(scheme),
            ctypes.byref(h),
            ctypes.byref(accepted),
        )
    )
    return h.value, bool(accepted.value)
