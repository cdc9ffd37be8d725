"""Points inside a body: the cell that holds each of them, found in parallel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from dolfinx.mesh import Mesh

from dolfin_elastic.errors import MeshError
from dolfin_elastic.meshes.body import Body
from dolfin_elastic.meshes.curved import cell_gradients, tabulated
from dolfin_elastic.meshes.shapes import Floats

SLACK = 0.05
"""Share of a cell by which a point may lie outside: round surfaces are flat between nodes."""
_NEWTON = 20


@dataclass(frozen=True)
class Place:
    """Where a point lies.

    Attributes:
        point: The point [m], reference configuration, as many components as the body has.
        rank: The one rank that has the cell.
        cell: Its local number there; -1 on all other ranks.
        local: The point's coordinates in the reference cell, on that rank.
    """

    point: Floats
    rank: int
    cell: int
    local: Floats


def locate(body: Body, points: Mapping[str, Sequence[float]]) -> dict[str, Place]:
    """Finds the owned cell of each point; the lowest rank where several share it. Collective.

    Args:
        body: The body.
        points: Name to coordinates [m] in the reference configuration.

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
    found = {name: _in_own_cells(body.mesh, point) for name, point in wanted.items()}
    off = np.array([found[name][0] for name in wanted])
    # Round-off must not decide which rank has a point that several hold.
    everywhere = np.round(np.array(body.comm.allgather(off)).reshape(body.comm.size, -1), 9)
    ranks = np.argmin(everywhere, axis=0) if wanted else ()
    _refuse(body, wanted, everywhere.min(axis=0))
    return {
        name: Place(point, int(rank), found[name][1] if rank == body.comm.rank else -1, local)
        for (name, point), rank in zip(wanted.items(), ranks, strict=True)
        for local in [found[name][2]]
    }


def _in_own_cells(mesh: Mesh, point: Floats) -> tuple[float, int, Floats]:
    """How far outside of its best owned cell a point is, that cell, and the coordinates in it."""
    d = mesh.topology.dim
    own = mesh.topology.index_map(d).size_local
    nodes = mesh.geometry.x[mesh.geometry.dofmap[:own], :d]
    low, high = nodes.min(axis=1), nodes.max(axis=1)
    # Curved edges may bulge a little over their nodes.
    margin = 4 * SLACK * (high - low).max(axis=1, initial=0.0)[:, None]
    near = np.flatnonzero(((point >= low - margin) & (point <= high + margin)).all(axis=1))
    if not len(near):
        return np.inf, -1, np.zeros(d)
    local = _pulled_back(mesh, nodes[near], point)
    off = np.maximum(-local.min(axis=1), local.sum(axis=1) - 1)
    off = np.where(np.isfinite(off), np.maximum(off, 0.0), np.inf)
    best = int(np.argmin(off))
    return float(off[best]), int(near[best]), local[best]


def _pulled_back(mesh: Mesh, nodes: Floats, point: Floats) -> Floats:
    """Coordinates of a point in the reference cells of cells with these nodes, by Newton's method.

    One iteration where cells are straight.

    Args:
        mesh: Their mesh.
        nodes: Shape (cells, nodes, d).
        point: Shape (d,).

    Returns:
        Shape (cells, d); not finite where the iteration fails.
    """
    d = nodes.shape[2]
    local = np.full((len(nodes), d), 1 / (d + 1))
    degree = mesh.geometry.cmap.degree
    for _ in range(_NEWTON if degree > 1 else 1):
        for i, (corner, at) in enumerate(zip(nodes, local, strict=True)):
            gap = point - tabulated(mesh, at[None])[0] @ corner
            slope = cell_gradients(corner[None], degree, at[None])[0, 0]
            local[i] = at + np.linalg.lstsq(slope, gap, rcond=None)[0]
        np.clip(local, -3.0, 4.0, out=local)  # far cells must not send the iteration astray
    return local


def _refuse(body: Body, points: Mapping[str, Floats], off: Floats) -> None:
    """Names all points that lie outside, with the nearest node. Collective."""
    texts = [
        f"{name} ({', '.join(f'{x:.6g}' for x in point)}), {_nearest(body, point)}"
        for (name, point), far in zip(points.items(), off, strict=True)
        if far > SLACK
    ]
    if texts:
        raise MeshError(
            f"outside of the body: {'; '.join(texts)}",
            expected="points inside the undeformed body",
        )


def _nearest(body: Body, point: Floats) -> str:
    """The node of the mesh nearest to a point. Collective."""
    x = body.mesh.geometry.x[:, : body.dim]
    far = np.linalg.norm(x - point, axis=1)
    best = int(np.argmin(far)) if len(far) else -1
    own = (float(far[best]), *map(float, x[best])) if best >= 0 else (np.inf,)
    distance, *place = min(body.comm.allgather(own))
    return f"{distance:.3g} m from the nearest node ({', '.join(f'{c:.6g}' for c in place)})"
