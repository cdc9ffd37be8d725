"""PETSc functions that petsc4py 3.22 does not wrap, called through ctypes.

They are in the library that petsc4py itself has loaded:

| function | for |
|---|---|
| PetscOptionsUsed | the report of options that nothing asked for |
| SNESSetLagPreconditioner | preconditioners that others than SNES set up |
| MatMPIAIJGetSeqAIJ, MatSeqAIJGetArray, MatSeqAIJRestoreArray | assembly without MatSetValues |
| TSGetAdapt, TSAdaptCandidatesClear, TSAdaptCandidateAdd, TSAdaptChoose | the next time step |
"""

from __future__ import annotations

import ctypes
from functools import lru_cache

from petsc4py import PETSc

from dolfin_elastic.core.types import FloatArray


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    """PETSc's functions, opened once: each opening makes types that only cycles hold."""
    return ctypes.CDLL(PETSc.__file__)


def _check(error: int) -> None:
    """Raises what a PETSc function returned unless it is 0."""
    if error:
        raise PETSc.Error(error)


def option_used(name: str) -> bool:
    """Whether an option in PETSc's database has been asked for; True where PETSc cannot tell.

    Args:
        name: With its prefix, without dash.
    """
    try:
        ask = _library().PetscOptionsUsed
    except (OSError, AttributeError):
        return True
    used = ctypes.c_int(1)
    ask(None, ctypes.c_char_p(name.encode()), ctypes.byref(used))
    return bool(used.value)


def leave_preconditioner(snes: PETSc.SNES) -> None:
    """Makes a SNES use its preconditioner as it is, for all tangents; no option can. Collective.

    Args:
        snes: The solver.
    """
    integer = ctypes.c_int if PETSc.IntType().itemsize == 4 else ctypes.c_int64
    _check(_library().SNESSetLagPreconditioner(ctypes.c_void_p(snes.handle), integer(-1)))


def overwrite_aij(matrix: PETSc.Mat, own: FloatArray, others: FloatArray) -> None:
    """Overwrites all values of an AIJ matrix, in the order in which PETSc stores them. Collective.

    Args:
        matrix: Assembled, so that its pattern is fixed.
        own: Values in the columns that this rank owns, row by row.
        others: Values in all other columns; empty on one rank.
    """
    if matrix.getType() == "seqaij":
        _overwrite(matrix.handle, own)
    else:
        diagonal, off_diagonal = ctypes.c_void_p(), ctypes.c_void_p()
        handle = ctypes.c_void_p(matrix.handle)
        _check(
            _library().MatMPIAIJGetSeqAIJ(
                handle, ctypes.byref(diagonal), ctypes.byref(off_diagonal), None
            )
        )
        assert diagonal.value is not None
        assert off_diagonal.value is not None
        _overwrite(diagonal.value, own)
        _overwrite(off_diagonal.value, others)
    matrix.stateIncrease()
    matrix.assemble()


def _overwrite(handle: int, values: FloatArray) -> None:
    """Copies contiguous values into a sequential AIJ matrix. Not collective."""
    matrix, pointer = ctypes.c_void_p(handle), ctypes.c_void_p()
    _check(_library().MatSeqAIJGetArray(matrix, ctypes.byref(pointer)))
    if len(values):
        ctypes.memmove(pointer, values.ctypes.data, values.nbytes)
    _check(_library().MatSeqAIJRestoreArray(matrix, ctypes.byref(pointer)))


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
    petsc, last = _library(), ts.getMaxTime()
    ts.setMaxTime(float("inf"))
    handle, adapt = ctypes.c_void_p(ts.handle), ctypes.c_void_p()
    integer = ctypes.c_int if PETSc.IntType().itemsize == 4 else ctypes.c_int64
    scheme, accepted, h = integer(), ctypes.c_int(1), ctypes.c_double()
    _check(petsc.TSGetAdapt(handle, ctypes.byref(adapt)))
    _check(petsc.TSAdaptCandidatesClear(adapt))
    _check(
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
    _check(
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
