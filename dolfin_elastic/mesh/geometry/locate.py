"""Points inside a body: the cell that holds each of them, found in parallel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from dolfinx.mesh import Mesh

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body, span
from dolfin_elastic.mesh.geometry.curved import shape_functions, shape_gradients

OUTSIDE_TOLERANCE = 0.05
"""Reference coordinate by which a point may lie outside: cells cut corners of round surfaces."""
ROUND_OFF = 1e-9
"""Reference coordinates, and lengths over the body's diagonal, closer than this are equal."""
_NEWTON = 20

Key = tuple[float, ...]


@dataclass(frozen=True)
class LocatedPoint:
    """A point and the cell that contains it.

    Attributes:
        point: The point [m], reference configuration, as many components as the body has.
        rank: The one rank that has the cell.
        cell: Its local number there; -1 on all other ranks.
        local: The point's coordinates in the reference cell, on that rank.
    """

    point: FloatArray
    rank: int
    cell: int
    local: FloatArray


def locate(
    body: Body, points: Mapping[str, Sequence[float]], order: IndexArray | None = None
) -> dict[str, LocatedPoint]:
    """Finds the owned cell of each point. Collective.

    Where several share it, one of the lowest number in `order` is taken, and of these the one whose
    midpoint comes first along x, then y, then z: the same on any ranks.

    Args:
        points: Name to coordinates [m] in the reference configuration.
        order: Rank of each owned cell, for example the number of its material; None: all equal.

    Raises:
        MeshError: Points have the wrong number of coordinates or lie outside.
    """
    for name, point in points.items():
        if len(point) != body.dim or not np.isfinite(point).all():
            raise MeshError(
                f"{list(point)} is no point of the body",
                where=name,
                expected=f"the body is {body.dim}-dimensional, expected {body.dim} numbers",
            )
    wanted = {name: np.asarray(point, dtype=np.float64) for name, point in points.items()}
    ranking = _CellOrder(body, order)
    located = {name: _in_own_cells(body.mesh, point, ranking) for name, point in wanted.items()}
    everywhere = body.comm.allgather([key for key, _, _ in located.values()])
    best = [
        min((keys[k], rank) for rank, keys in enumerate(everywhere)) for k in range(len(located))
    ]
    _refuse_outside(body, wanted, [key[0] for key, _ in best])
    return {
        name: LocatedPoint(point, rank, located[name][1] if rank == body.comm.rank else -1, local)
        for (name, point), (_, rank) in zip(wanted.items(), best, strict=True)
        for local in [located[name][2]]
    }


class _CellOrder:
    """Keys by which cells that share a point are ordered, free of round-off.

    The constructor is collective.
    """

    def __init__(self, body: Body, order: IndexArray | None) -> None:
        self._order, self._step = order, ROUND_OFF * span(body)

    def keys(self, off: FloatArray, cells: IndexArray, nodes: FloatArray) -> list[Key]:
        """Key of each cell: distance of the point, rank of the cell, midpoint.

        Args:
            off: Reference coordinate by which the point lies outside of each cell.
            cells: Local cells.
            nodes: Their nodes [m], shape (cells, nodes, d).
        """
        numbers = np.zeros(len(cells)) if self._order is None else self._order[cells]
        middles = np.round(nodes.mean(axis=1) / self._step)
        rows = np.column_stack([np.round(off / ROUND_OFF) * ROUND_OFF, numbers, middles])
        return [tuple(map(float, row)) for row in rows]


def _in_own_cells(
    mesh: Mesh, point: FloatArray, ranking: _CellOrder
) -> tuple[Key, int, FloatArray]:
    """Key of the best owned cell, the cell, and the point's reference coordinates in it."""
    d = mesh.topology.dim
    own = mesh.topology.index_map(d).size_local
    nodes = mesh.geometry.x[mesh.geometry.dofmap[:own], :d]
    low, high = nodes.min(axis=1), nodes.max(axis=1)
    # Curved edges may bulge a little over their nodes.
    margin = 4 * OUTSIDE_TOLERANCE * (high - low).max(axis=1, initial=0.0)[:, None]
    inside = ((point >= low - margin) & (point <= high + margin)).all(axis=1)
    near = np.flatnonzero(inside).astype(np.int32)
    if not len(near):
        return (np.inf,), -1, np.zeros(d)
    local, off = in_reference_cells(mesh, nodes[near], np.tile(point, (len(near), 1)))
    keys = ranking.keys(off, near, nodes[near])
    best = min(range(len(near)), key=keys.__getitem__)
    return keys[best], int(near[best]), local[best]


def in_reference_cells(
    mesh: Mesh, nodes: FloatArray, places: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Places in reference cells, and by how much they are outside. Local.

    By Newton, which is exact after one step in straight cells.

    Args:
        nodes: Those of the cell of each place [m], shape (n, nodes, dim).
        places: Shape (n, dim) [m].

    Returns:
        Reference coordinates, shape (n, dim), and the largest one outside, shape (n,).
    """
    n, _, d = nodes.shape
    local = np.full((n, d), 1 / (d + 1))
    for _ in range(_NEWTON if mesh.geometry.cmap.degree > 1 and n else min(n, 1)):
        gap = places - np.einsum("pn,pnj->pj", shape_functions(mesh, local), nodes)
        slopes = np.einsum("pnk,pnj->pjk", shape_gradients(mesh, local), nodes)
        # An iterate may have a singular slope: no rank may fail alone.
        step = np.einsum("pij,pj->pi", np.linalg.pinv(slopes), gap)
        local = np.clip(local + step, -3.0, 4.0)  # far cells must not send the iteration astray
    off = np.maximum(-local.min(axis=1, initial=0.0), local.sum(axis=1) - 1)
    return local, np.where(np.isfinite(off), np.maximum(off, 0.0), np.inf)


def _refuse_outside(body: Body, points: Mapping[str, FloatArray], off: Sequence[float]) -> None:
    """Refuses points outside of the body, with the nearest node of each. Collective."""
    texts = [
        f"{name} {_in_its_unit(body, point)}, {_nearest(body, point)}"
        for (name, point), far in zip(points.items(), off, strict=True)
        if far > OUTSIDE_TOLERANCE
    ]
    if texts:
        raise MeshError(
            f"outside of the body: {'; '.join(texts)}",
            expected="points inside the undeformed body",
        )


def _nearest(body: Body, point: FloatArray) -> str:
    """The node of the mesh nearest to a point. Collective."""
    x = body.mesh.geometry.x[:, : body.dim]
    far = np.linalg.norm(x - point, axis=1)
    best = int(np.argmin(far)) if len(far) else -1
    own = (float(far[best]), *map(float, x[best])) if best >= 0 else (np.inf,)
    distance, *place = min(body.comm.allgather(own))
    far_off = f"{distance / body.unit.metres:.3g} {body.unit.name}"
    return f"{far_off} from the nearest node {_in_its_unit(body, place)}"


def _in_its_unit(body: Body, place: Sequence[float] | FloatArray) -> str:
    """A place in the unit of the user's mesh."""
    unit = body.unit
    return f"({', '.join(f'{c / unit.metres:.6g}' for c in place)}) {unit.name}"
