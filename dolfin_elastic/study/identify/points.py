"""Displacements of states at many points of the undeformed body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic.core.errors import CaseError
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.si_text import counted
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.core.units import coordinates
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.geometry.locate import OUTSIDE_TOLERANCE, in_reference_cells
from dolfin_elastic.study.identify.measured import MeasuredField

_AT_ONCE = 1 << 22
"""Pairs of a point and a cell that are compared at once."""
_MOST_NAMED = 3


class LocatedPoints:
    """The cell of each of many points. Collective to make.

    Args:
        points: [m], reference configuration, the same on every rank, shape (n, dim).

    Attributes:
        inside: Whether a point is in the body, but for as little as cells cut corners of round
            surfaces, shape (n,), the same on every rank.
        mine: Numbers of those whose cell this rank owns, shape (m,).
        cells: Local cells of these, shape (m,).
        local: Their coordinates in the reference cell, shape (m, dim).
        count: Of all points, n.
    """

    def __init__(self, body: Body, points: FloatArray) -> None:
        cells, local, off = _in_own_cells(body, points)
        everywhere = np.array(body.comm.allgather(off))
        owner = np.argmin(everywhere, axis=0)
        self.inside: BoolArray = everywhere.min(axis=0, initial=np.inf) <= OUTSIDE_TOLERANCE
        self.mine: IntArray = np.flatnonzero(self.inside & (owner == body.comm.rank))
        self.cells, self.local, self.count = cells[self.mine], local[self.mine], len(points)

    def displacements(self, u: fem.Function) -> FloatArray:
        """At all points [m], 0 outside, shape (n, dim), the same on every rank. Collective."""
        V = u.function_space
        dim = V.dofmap.index_map_bs
        result, (nodes, shapes) = np.zeros((self.count, dim)), self.shapes(V)
        values = u.x.array.reshape(-1, dim)[nodes]
        result[self.mine] = np.einsum("pn,pnj->pj", shapes, values)
        return np.asarray(total(V.mesh.comm, result))

    def of_cells(self, values: FloatArray, comm: MPI.Comm) -> FloatArray:
        """What a field of owned cells has at all points, shape (n,). Collective."""
        result = np.zeros(self.count)
        result[self.mine] = values[self.cells]
        return np.asarray(total(comm, result))

    def shapes(self, V: fem.FunctionSpace) -> tuple[IndexArray, FloatArray]:
        """Local nodes around the points of this rank, and their shape functions there. Local.

        Returns:
            Shapes (m, nodes of a cell).
        """
        nodes: IndexArray = V.dofmap.list[self.cells]
        if not len(self.mine):
            return nodes, np.zeros(nodes.shape)
        table = V.element.basix_element.tabulate(0, self.local)[0, :, :, 0]
        return nodes, np.asarray(table, dtype=np.float64)


def located_field(body: Body, one: MeasuredField) -> tuple[MeasuredField, LocatedPoints, str]:
    """The points of a field that are in a body. Collective.

    Returns:
        The field with these in metres, where they are, and a sentence about those that are left
        out; empty: none are.

    Raises:
        InputError: They have other coordinates than the body, or most of them are outside.
    """
    dim = body.dim
    if one.points.shape[1] != dim or max(one.components) >= dim:
        raise CaseError(
            f"its points have {counted(one.points.shape[1], 'coordinate')}, the body has {dim}",
            where=one.source or one.label,
            expected=f"columns {', '.join('xyz'[:dim])}",
        )
    points = one.points * (body.unit.metres if one.in_mesh_unit else 1.0)
    located, note = LocatedPoints(body, points), ""
    if not located.inside.all():
        note = _outside(body, one, points, np.flatnonzero(~located.inside))
        one, points = one.only(np.flatnonzero(located.inside)), points[located.inside]
        located = LocatedPoints(body, points)
    return replace(one, points=points, in_mesh_unit=False), located, note


def _outside(body: Body, one: MeasuredField, points: FloatArray, lost: IntArray) -> str:
    """A sentence about points that are left out."""
    unit = body.unit
    named = [
        f"line {one.lines[i]} {coordinates(points[i] / unit.metres)} {unit.name}"
        for i in lost[:_MOST_NAMED]
    ]
    more = f" and {len(lost) - _MOST_NAMED} more" if len(lost) > _MOST_NAMED else ""
    what = f"outside of the body: {', '.join(named)}{more}"
    where = one.source or one.label
    if 2 * len(lost) > len(points):
        raise CaseError(
            f"most points ({len(lost)} of {len(points)}) are {what}",
            where=where,
            expected=f"places in the undeformed body; bare numbers are in {unit.name}, "
            'others have a unit, "x [mm]"',
        )
    return f"{where}: {len(lost)} of {counted(len(points), 'point')} left out, {what}"


def _in_own_cells(body: Body, points: FloatArray) -> tuple[IndexArray, FloatArray, FloatArray]:
    """Of each point the best owned cell, its coordinates in it, and how far it is outside.

    Returns:
        Shapes (n,), (n, dim) and (n,), the last infinite where no cell is near.
    """
    mesh, d = body.mesh, body.dim
    own = mesh.topology.index_map(d).size_local
    nodes = mesh.geometry.x[mesh.geometry.dofmap[:own], :d]
    low, high = nodes.min(axis=1), nodes.max(axis=1)
    # Curved edges may bulge a little over their nodes.
    margin = 4 * OUTSIDE_TOLERANCE * (high - low).max(axis=1, initial=0.0)[:, None]
    low, high = low - margin, high + margin
    cells = np.full(len(points), -1, dtype=np.int32)
    local, best = np.zeros((len(points), d)), np.full(len(points), np.inf)
    step = max(1, _AT_ONCE // max(own, 1))
    for first in range(0, len(points), step):
        part = points[first : first + step]
        near = np.ones((len(part), own), dtype=bool)
        for axis in range(d):
            x = part[:, axis, None]
            near &= (x >= low[:, axis]) & (x <= high[:, axis])
        which, cell = np.nonzero(near)
        places, off = in_reference_cells(mesh, nodes[cell], part[which])
        order = np.lexsort((cell, off, which))
        which, cell, places, off = which[order], cell[order], places[order], off[order]
        begin = np.flatnonzero(np.diff(which, prepend=-1))
        rows = first + which[begin]
        cells[rows], local[rows], best[rows] = cell[begin], places[begin], off[begin]
    return cells, local, best
