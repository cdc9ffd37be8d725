"""HDF5 files into which all ranks write at once, each its own rows of the arrays.

Rank 0 creates the file with h5py and allocates every array contiguously; `H5Dget_offset` gives the
position in the file.  After rank 0 has closed the file, each rank writes its rows of an array by
one MPI-IO call.  In comparison with h5py's own MPI driver this

* needs no h5py built with MPI: Debian's two builds and the one from PyPI serve equally well,
* is two to four times faster, for ranks need not agree on metadata,
* cannot hang: after an HDF5 call that fails on one rank the others would wait in the next one.

The writes are independent (`Write_at`): the rows of a rank are one run of bytes, so that a
collective write has nothing to gather, and Open MPI 5's loses errors that occur on some ranks
only, a full disk among them.

No rank holds the rows of another one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.errors import OutputError
from dolfin_elastic.core.files import hdf5 as guarded
from dolfin_elastic.core.files.regular import fresh
from dolfin_elastic.core.parallel import agree, on_root
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.results.files import need_space, open_together, write_at, writing

if TYPE_CHECKING:
    import h5py


@dataclass(frozen=True)
class Rows:
    """This rank's rows of an array that is spread over the ranks.

    Attributes:
        values: Shape (own rows, columns), float64, int32, int64 or uint8.
        first: Number of the first of them in the whole array.
        count: Rows of the whole array.
    """

    values: AnyArray
    first: int
    count: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the whole array."""
        return self.count, self.values.shape[1]

    @property
    def size(self) -> int:
        """Bytes of the whole array."""
        return self.shape[0] * self.shape[1] * self.values.itemsize


def write(comm: MPI.Comm, path: Path, arrays: Mapping[str, Rows], *, durable: bool = False) -> None:
    """Writes a new HDF5 file that is complete and closed on return. Collective.

    Args:
        comm: The ranks that hold the rows.
        path: The file, on a file system all ranks see; it is overwritten.
        arrays: Name in the file to this rank's rows; same names and types on all ranks.
        durable: Brings the file to the disk before returning, so that it outlasts a loss of power.

    Raises:
        OutputError: On all ranks, when the file cannot be written on any.
    """
    offsets = on_root(comm, lambda: _allocate(path, arrays))
    file = open_together(comm, path)
    errors = [_write_rows(file, path, offsets[name], rows) for name, rows in arrays.items()]
    if durable:
        errors.append(_sync(file, path))
    file.Close()
    agree(comm, next((error for error in errors if error), None))


def _allocate(path: Path, arrays: Mapping[str, Rows]) -> dict[str, int]:
    """Creates the file with all arrays allocated: name to byte offset. On rank 0."""
    import h5py

    need_space(path.parent, sum(rows.size for rows in arrays.values()))
    try:
        with writing(path), h5py.File(fresh(path), "w") as file:
            return {name: _create_array(h5py, file, name, rows) for name, rows in arrays.items()}
    except RuntimeError as error:  # what h5py raises where closing fails
        raise OutputError(f"cannot write {path}: {error}") from error


def _create_array(h5py: ModuleType, file: h5py.File, name: str, rows: Rows) -> int:
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_layout(h5py.h5d.CONTIGUOUS)
    properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    properties.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    kind = h5py.h5t.py_create(rows.values.dtype)
    space = h5py.h5s.create_simple(rows.shape)
    return int(
        h5py.h5d.create(file.id, name.encode(), kind, space, dcpl=properties).get_offset() or 0
    )


def _write_rows(file: MPI.File, path: Path, offset: int, rows: Rows) -> OutputError | None:
    """Writes this rank's rows; returns an error, which all ranks then raise. Not collective."""
    values = np.ascontiguousarray(rows.values)
    offsets = offset + rows.first * values.shape[1] * values.itemsize
    return write_at(file, path, offsets, values)


def _sync(file: MPI.File, path: Path) -> OutputError | None:
    """Brings the written data to the disk; returns an error. Collective."""
    try:
        with writing(path):
            file.Sync()
    except OutputError as caught:
        return caught
    return None


def shapes(path: Path) -> dict[str, tuple[int, int]]:
    """Name to (rows, columns) of the arrays in a file. Not collective.

    Raises:
        OSError: The file is missing, no HDF5 file, or holds something else.
    """
    with guarded.opened(path) as file:
        result = {name: guarded.shape_in(file, name) for name in file}
    if any(len(shape) != 2 for shape in result.values()):
        raise OSError(f"{path} has arrays of other shapes")
    return {name: (shape[0], shape[1]) for name, shape in result.items()}


def read(path: Path, name: str, first: int, count: int) -> AnyArray:
    """Some rows of an array. Not collective.

    Args:
        path: The file.

    Returns:
        Shape (count, columns).

    Raises:
        OSError: The file is missing, damaged, or has fewer rows.
    """
    return guarded.read_rows(path, name, first, first + count)
