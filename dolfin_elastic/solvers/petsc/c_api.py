"""PETSc functions that petsc4py 3.22 does not wrap, called through ctypes.

They are in the library that petsc4py itself has loaded:

| function | for |
|---|---|
| PetscOptionsUsed | the report of options that nothing asked for |
| SNESSetLagPreconditioner | preconditioners that others than SNES set up |
| MatMPIAIJGetSeqAIJ, MatSeqAIJGetArray, MatSeqAIJRestoreArray | assembly without MatSetValues |
| MatSeqAIJGetCSRAndMemType | entries of a matrix without a copy |
| MatSetPreallocationCOO, MatSetValuesCOO | sums of entries that any rank has |
| TSGetAdapt, TSAdaptCandidatesClear, TSAdaptCandidateAdd, TSAdaptChoose | the next time step |
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray, IntArray


@cache
def _trim() -> Any:
    """glibc's `malloc_trim`; None with another C library."""
    try:
        return ctypes.CDLL(None).malloc_trim
    except (OSError, AttributeError):
        return None


def give_back() -> None:
    """Gives whole pages that nothing uses back to the system. Local.

    SuperLU_DIST, which PETSc is linked with, tells the C library as soon as it is loaded never to
    give memory back by itself: a process keeps all that it ever had, and large arrays lie behind
    the gaps that smaller ones left. `malloc_trim` gives the gaps back all the same.

    That costs little, but pages that are used again are fetched anew, which takes 0.1 ms and more
    for each MB: to be called where much was needed for the moment, not in loops.
    """
    trim = _trim()
    if trim is not None:
        trim(ctypes.c_size_t(0))


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
    """Makes a SNES use its preconditioner as it is, for all tangents; no option can. Collective."""
    integer = ctypes.c_int if PETSc.IntType().itemsize == 4 else ctypes.c_int64
    _check(_library().SNESSetLagPreconditioner(ctypes.c_void_p(snes.handle), integer(-1)))


@dataclass(frozen=True)
class Compressed:
    """A matrix on one rank by compressed rows, as PETSc stores it: valid while that matrix is.

    Attributes:
        start: Where each row begins, and the last one ends.
        columns: Of each entry.
        values: The entries.
    """

    start: IntArray
    columns: IndexArray | IntArray
    values: FloatArray


def parts_of_aij(matrix: PETSc.Mat) -> tuple[Compressed, Compressed, IntArray]:
    """The entries of an AIJ matrix in columns that this rank owns, and those in others. Collective.

    Returns:
        Both, by columns counted from the first of each, and the global columns of the others.
    """
    rows = matrix.getLocalSize()[0]
    if matrix.getType() == "seqaij":
        none = np.empty(0)
        empty = Compressed(np.zeros(rows + 1, np.int64), none.astype(np.int32), none)
        return _compressed(matrix.handle, rows), empty, none.astype(np.int64)
    own, others, numbers = _sequential(matrix)
    far = _compressed(others, rows)
    count = int(far.columns.max(initial=-1)) + 1
    columns = _view(numbers, count, PETSc.IntType).astype(np.int64)
    return _compressed(own, rows), far, columns


def _sequential(matrix: PETSc.Mat) -> tuple[int, int, ctypes.c_void_p]:
    """Handles of the two matrices of which one of several ranks consists; see `parts_of_aij`.

    Not collective.

    Returns:
        That of owned columns, that of others, and where the global numbers of the latter stand.
    """
    own, others, numbers = (ctypes.c_void_p() for _ in range(3))
    handle, offsets = ctypes.c_void_p(matrix.handle), (own, others, numbers)
    _check(_library().MatMPIAIJGetSeqAIJ(handle, *(ctypes.byref(offset) for offset in offsets)))
    assert own.value is not None
    assert others.value is not None
    return own.value, others.value, numbers


def _compressed(handle: int, rows: int) -> Compressed:
    start, columns, values = (ctypes.c_void_p() for _ in range(3))
    _check(
        _library().MatSeqAIJGetCSRAndMemType(
            ctypes.c_void_p(handle),
            *(ctypes.byref(pointer) for pointer in (start, columns, values)),
            None,
        )
    )
    begins = _view(start, rows + 1, PETSc.IntType).astype(np.int64)
    entries = int(begins[-1])
    return Compressed(
        begins,
        _view(columns, entries, PETSc.IntType).astype(np.int32, copy=False),
        _view(values, entries, np.float64),
    )


def _view(pointer: ctypes.c_void_p, count: int, kind: type) -> AnyArray:
    """An array in memory of PETSc."""
    if not count:
        return np.empty(0, dtype=kind)
    kinds = {4: ctypes.c_int32, 8: ctypes.c_int64}
    c_type = ctypes.c_double if kind is np.float64 else kinds[np.dtype(kind).itemsize]
    return np.ctypeslib.as_array(ctypes.cast(pointer, ctypes.POINTER(c_type)), (count,))


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
        owned, further, _ = _sequential(matrix)
        _overwrite(owned, own)
        _overwrite(further, others)
    matrix.stateIncrease()
    matrix.assemble()


def _overwrite(handle: int, values: FloatArray) -> None:
    """Copies contiguous values into a sequential AIJ matrix. Not collective."""
    matrix, pointer = ctypes.c_void_p(handle), ctypes.c_void_p()
    _check(_library().MatSeqAIJGetArray(matrix, ctypes.byref(pointer)))
    if len(values):
        ctypes.memmove(pointer, values.ctypes.data, values.nbytes)
    _check(_library().MatSeqAIJRestoreArray(matrix, ctypes.byref(pointer)))


def room_for_entries(matrix: PETSc.Mat, rows: IntArray, columns: IntArray) -> None:
    """Gives an AIJ matrix the pattern of entries that may be of any rank. Collective.

    Args:
        rows: Global row of each entry of this rank; the same one may be there again.
        columns: Global column of each.
    """
    offsets = [np.array(numbers, dtype=PETSc.IntType) for numbers in (rows, columns)]  # are changed
    pointers = (ctypes.c_void_p(numbers.ctypes.data) for numbers in offsets)
    count = ctypes.c_ssize_t(len(rows))
    _check(_library().MatSetPreallocationCOO(ctypes.c_void_p(matrix.handle), count, *pointers))


def sum_entries(matrix: PETSc.Mat, values: FloatArray) -> None:
    """Makes a matrix the sum of entries, those of `room_for_entries`. Collective."""
    values = np.ascontiguousarray(values)
    pointer, mode = (
        ctypes.c_void_p(values.ctypes.data),
        ctypes.c_int(PETSc.InsertMode.INSERT_VALUES),
    )
    _check(_library().MatSetValuesCOO(ctypes.c_void_p(matrix.handle), pointer, mode))
    matrix.stateIncrease()


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
