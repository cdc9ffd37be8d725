"""Bodies of several boxes that share no nodes, each bent by a formula, with named sides."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from helpers.stacked import grid
from mpi4py import MPI

from dolfin_elastic.mesh import Body, Selector, name_parts
from dolfin_elastic.mesh.distribute import make_mesh

Map = Callable[[np.ndarray], np.ndarray]


class Box(NamedTuple):
    """A box of a mesh of its own.

    Attributes:
        corner: Its lowest one.
        size: Along each axis.
        cells: Along each axis.
        bent: Where its points go, from and to shape (n, dim).
    """

    corner: tuple[float, ...]
    size: tuple[float, ...]
    cells: tuple[int, ...]
    bent: Map = np.asarray


def boxes(**parts: Box) -> Body:
    """A region for each, and its surfaces "NAME_bottom", "_top", "_left", "_right" and "_skin"."""
    comm, names, points, cells, n = MPI.COMM_WORLD, list(parts), [], [], 0
    span = 10 * max(sum(map(abs, [*box.corner, *box.size])) for box in parts.values())
    dim = len(next(iter(parts.values())).size)
    for k, box in enumerate(parts.values()):  # far apart as long as they are named
        x, rows = grid(box.size, box.cells)
        points.append(x + np.array(box.corner) + span * k * np.eye(dim)[0])
        cells.append(rows + n)
        n += len(x)
    every, rows = np.concatenate(points), np.concatenate(cells).astype(np.int64)
    if comm.rank:
        every, rows = every[:0], rows[:0]
    body = Body(make_mesh(comm, rows, every, 1))
    x = body.mesh.geometry.x
    middles = x[body.mesh.geometry.dofmap].mean(axis=1)[:, 0]
    of_cells, of_points = (np.round(one / span).astype(int) for one in (middles, x[:, 0]))
    body = body.named(
        regions={n: np.flatnonzero(of_cells == k).astype(np.int32) for k, n in enumerate(names)}
    )
    sides = {"left": (0, -1), "right": (0, 1), "bottom": (dim - 1, -1), "top": (dim - 1, 1)}
    surfaces = {
        f"{name}_{side}": Selector(normal=(sign * np.eye(dim)[axis]).tolist(), of=name, angle=5)
        for name in names
        for side, (axis, sign) in sides.items()
    }
    for name in names:
        surfaces[f"{name}_skin"] = Selector(normal=np.eye(dim)[0].tolist(), of=name, angle=180)
    body = name_parts(body, surfaces=surfaces)
    for k, box in enumerate(parts.values()):
        here = of_points == k
        x[here, :dim] = box.bent(x[here, :dim] - span * k * np.eye(dim)[0])
    return body
