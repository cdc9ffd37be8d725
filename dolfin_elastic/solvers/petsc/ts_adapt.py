"""PETSc's control of the time step (TSAdapt) for a scheme of our own; petsc4py does not have it."""

from __future__ import annotations

import ctypes

from petsc4py import PETSc

from dolfin_elastic.solvers.petsc.c_api import check, library


def choose(ts: PETSc.TS, order: int) -> tuple[float, bool]:
    """Asks TSAdapt whether a step was good enough, and for the next one. Collective.

    TS calls back for the solution that the one at hand is compared with, `evaluatestep`.  Where
    steps are cut short, for a time that must be met, is for the caller to say: it would be
    forgotten how long they might have been.

    Args:
        ts: Holds the new solution; its time is still that of the old one.
        order: Power of the step that the error grows with.

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
