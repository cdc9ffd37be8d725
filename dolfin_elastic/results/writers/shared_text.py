"""Text files to which each rank adds its part; no rank holds the part of another one."""

from __future__ import annotations

import os
from pathlib import Path
from typing import cast

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.files.regular import fresh, open_regular
from dolfin_elastic.core.parallel import agree, on_root, total
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.results.files import open_together, write_at, writing


def add_text(comm: MPI.Comm, path: Path, text: str, start: int) -> int:
    """Adds the ranks' texts to a file, one behind the other. Collective.

    The first byte of all is written last: until then readers find a byte 0 in its place.

    Args:
        comm: The ranks.
        path: The file; what it holds behind `start` is lost.
        text: This rank's part.
        start: Size of the file before [bytes]; 0: it is made.

    Returns:
        Its size then.

    Raises:
        OutputError: On all ranks, when one of them could not write its part.
    """
    own = np.frombuffer(text.encode(), dtype=np.uint8)
    before = int(cast(MPI.Intracomm, comm).exscan(len(own)) or 0)
    size = total(comm, len(own))
    on_root(comm, lambda: _cut(path, start))
    if not size:
        return start
    file = open_together(comm, path)
    held = 1 if before == 0 and len(own) else 0
    error = write_at(file, path, start + before + held, own[held:])
    errors = comm.allgather(error is not None)
    if held and not any(errors):
        error = write_at(file, path, start, own[:1])
    file.Close()
    agree(comm, error)
    return start + size


def _cut(path: Path, size: int) -> None:
    with writing(path):
        descriptor = open_regular(path if size else fresh(path), os.O_RDWR)
        try:
            os.ftruncate(descriptor, size)
        finally:
            os.close(descriptor)


def lines_of(table: FloatArray, first: IntArray, between: str = " ") -> str:
    """Rows of numbers as lines of text, with all digits.

    Args:
        table: Shape (rows, columns).
        first: A whole number for the beginning of each line, shape (rows,).
        between: What stands between two numbers.
    """
    line = between.join(["%d", *["%.17g"] * table.shape[1]]) + "\n"
    rows = zip(
        cast("list[int]", first.tolist()), cast("list[list[float]]", table.tolist()), strict=True
    )
    return "".join([line % (number, *row) for number, row in rows])
