"""HDF5 files whose arrays are written by all ranks at once, each its own rows.

Rank 0 lays the file out with h5py: every array is contiguous and has its place from the start
(`H5Dget_offset`).  It closes the file, and then each rank puts its rows there with one MPI-IO call
an array.  Against h5py's own MPI driver this

* needs no h5py built with MPI: Debian's two builds and the one from PyPI do equally well,
* is two to four times faster, for no metadata are agreed on by all ranks,
* cannot hang: an HDF5 call that fails on one rank leaves the others waiting in the next one.

The calls are independent ones (`Write_at`): each rank has one long run of bytes, so there is
nothing to collect, and Open MPI 5's collective write loses errors, a full disk among them, that
only some ranks meet.

No rank ever holds the rows of another one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.errors import OutputError
from dolfin_elastic.core.parallel import agree, on_root
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.results.files import need_space, writing


@dataclass(frozen=True)
class Rows:
    """This rank's rows of an array that is spread over the ranks.

    Attributes:
        values: Shape (own rows, columns), float64, int32 or int64.
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
        durable: On return it is on the disk itself, and outlasts a loss of power.

    Raises:
        OutputError: On all ranks, when the file cannot be written on any.
    """
    places = on_root(comm, lambda: _lay_out(path, arrays))
    file = _open(comm, path)
    errors = [_put(file, path, places[name], rows) for name, rows in arrays.items()]
    if durable:
        errors.append(_sync(file, path))
    file.Close()
    agree(comm, next((error for error in errors if error), None))


def _lay_out(path: Path, arrays: Mapping[str, Rows]) -> dict[str, int]:
    """Makes the file with every array in its place but unwritten: name to byte offset."""
    import h5py

    need_space(path.parent, sum(rows.size for rows in arrays.values()))
    try:
        with writing(path), h5py.File(path, "w") as file:
            return {name: _reserve(h5py, file, name, rows) for name, rows in arrays.items()}
    except RuntimeError as error:  # h5py's way to say that closing failed
        raise OutputError(f"cannot write {path}: {error}") from error


def _reserve(h5py: Any, file: Any, name: str, rows: Rows) -> int:
    how = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    how.set_layout(h5py.h5d.CONTIGUOUS)
    how.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    how.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    kind = h5py.h5t.py_create(rows.values.dtype)
    space = h5py.h5s.create_simple(rows.shape)
    return int(h5py.h5d.create(file.id, name.encode(), kind, space, dcpl=how).get_offset() or 0)


def _open(comm: MPI.Comm, path: Path) -> MPI.File:
    error, file = None, MPI.FILE_NULL
    try:
        with writing(path):
            file = MPI.File.Open(cast(MPI.Intracomm, comm), str(path), MPI.MODE_WRONLY)
    except OutputError as caught:
        error = caught
    agree(comm, error)
    return file


def _put(file: MPI.File, path: Path, start: int, rows: Rows) -> OutputError | None:
    """Writes this rank's rows; an error is returned, to be agreed on. Not collective."""
    values = np.ascontiguousarray(rows.values)
    place = start + rows.first * values.shape[1] * values.itemsize
    status = MPI.Status()
    try:
        with writing(path):
            file.Write_at(place, values, status)
    except OutputError as caught:
        return caught
    if status.Get_count(MPI.BYTE) != values.nbytes:
        return OutputError(f"cannot write {path}: only a part was written; is the disk full?")
    return None


def _sync(file: MPI.File, path: Path) -> OutputError | None:
    """Waits until what was written is on disk; an error is returned. Collective."""
    try:
        with writing(path):
            file.Sync()
    except OutputError as caught:
        return caught
    return None


def names(path: Path) -> dict[str, tuple[int, int]]:
    """Name to rows and columns of the arrays in a file. Not collective.

    Raises:
        OSError: The file is missing, or no HDF5 file.
    """
    import h5py

    with h5py.File(path, "r") as file:
        return {name: (int(data.shape[0]), int(data.shape[1])) for name, data in file.items()}


def read(path: Path, name: str, first: int, count: int) -> AnyArray:
    """Some rows of an array. Not collective.

    Raises:
        OSError: The file is missing, damaged, or has fewer rows.
    """
    import h5py

    with h5py.File(path, "r") as file:
        if name not in file or file[name].shape[0] < first + count:
            raise OSError(f"{path} has no such rows")
        return np.asarray(file[name][first : first + count])
