"""Bodies as plain arrays, and mesh files written by hand."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import permutations
from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.types import AnyArray

COMM = MPI.COMM_WORLD


@contextmanager
def shared_folder() -> Iterator[Path]:
    """A folder that all ranks see."""
    path = Path(on_root(COMM, tempfile.mkdtemp))
    try:
        yield path
    finally:
        COMM.barrier()
        if COMM.rank == 0:
            shutil.rmtree(path)


def made(action: Callable[[], object]) -> None:
    """Makes a file on rank 0 while the others wait."""
    on_root(COMM, lambda: action() and None)


def box(size: tuple[float, ...], cells: tuple[int, ...]) -> tuple[AnyArray, AnyArray]:
    """A box of little cubes of six tetrahedra each.

    Args:
        size: Its edges.
        cells: Number of cubes along each.

    Returns:
        Points, shape (n, 3), x running fastest, and rows of them for each cell, shape (m, 4).
    """
    counts = [n + 1 for n in cells]
    grid = np.stack(np.meshgrid(*[np.arange(n) for n in counts], indexing="ij"), axis=-1)
    order = grid.transpose(2, 1, 0, 3).reshape(-1, 3)
    points = order * (np.array(size) / cells)
    steps = np.array([1, counts[0], counts[0] * counts[1]])
    corner = order[(order < np.array(cells)).all(axis=1)] @ steps
    paths = [np.cumsum([0, *steps[list(p)]]) for p in permutations(range(3))]
    return points, np.concatenate([corner[:, None] + path for path in paths])


def quadratic(points: AnyArray, cells: AnyArray) -> tuple[AnyArray, AnyArray]:
    """The same body with midside nodes, behind the corners in the order of VTK and Abaqus."""
    pairs = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
    edges = np.sort(np.stack([cells[:, p] for p in pairs], axis=1), axis=2)
    unique, rows = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True)
    middle = points[unique].mean(axis=1)
    return (
        np.concatenate([points, middle]),
        np.concatenate([cells, len(points) + rows.reshape(len(cells), 6)], axis=1),
    )


def inp_text(points: AnyArray, cells: AnyArray, more: str = "") -> str:
    """An Abaqus input file; numbers are those of the rows from 1.

    Args:
        points: Coordinates.
        cells: Rows of points, of 4 or 10 nodes.
        more: Sets and surfaces below.
    """
    nodes = "\n".join(f"{i}, {x:.12g}, {y:.12g}, {z:.12g}" for i, (x, y, z) in enumerate(points, 1))
    rows = "\n".join(f"{i}, {', '.join(map(str, c + 1))}" for i, c in enumerate(cells, 1))
    kind = f"C3D{cells.shape[1]}"
    return f"*NODE\n{nodes}\n*ELEMENT, TYPE={kind}, ELSET=ALL\n{rows}\n{more}"


def numbers(rows: AnyArray) -> str:
    """Numbers of rows as data lines of eight."""
    words = [str(i + 1) for i in rows]
    return "\n".join(", ".join(words[i : i + 8]) for i in range(0, len(words), 8))
