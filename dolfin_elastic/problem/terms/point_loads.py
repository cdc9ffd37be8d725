"""Forces at points and along lines as nodal forces: they are no integrals over cells or facets.

The virtual work of a force f at a point X is f . v(X) = sum_a N_a(X) f . v_a over the nodes of its
cell, so the nodal forces N_a f have its resultant and its moment exactly.  A line is cut into parts
much shorter than a cell with two Gauss points each, a named edge has Gauss points in each mesh
edge.  A point counts on one rank.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from dolfinx import fem, geometry
from mpi4py import MPI

from dolfin_elastic.core.errors import InputError, MeshError, keyed
from dolfin_elastic.core.parallel import agree, total
from dolfin_elastic.core.shapes.directions import check_components
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body, cell_size, span
from dolfin_elastic.model.amplitude import Amplitude
from dolfin_elastic.model.loads import ConcentratedLoad, Load
from dolfin_elastic.model.values import (
    FieldsAt,
    amplitude_of,
    depends_on_time,
    fields_of,
    number_at,
    sized,
    vector_at,
)
from dolfin_elastic.problem.mesh_fields import check_fields, check_finite
from dolfin_elastic.problem.term import Term
from dolfin_elastic.problem.terms.edges_points import points_of

PARTS = 8
"""Parts of a line to the mean length of a cell."""
EDGE_DEGREE = 8
"""Degree of polynomials along a mesh edge that the forces on it are integrated exactly for."""
NEAR = 1e-3
"""Distance over the body's diagonal that a point may be off the body."""


@dataclass(frozen=True)
class _Spread:
    """A load on the cells of this rank.

    Attributes:
        load: The load.
        x: Its points in owned cells, shape (points, 3) [m].
        weights: What the force at each is multiplied by: 1, or a length [m].
        nodes: Local nodes of each point's cell, shape (points, nodes).
        shapes: Their shape functions at the point, the same shape.
        fields: Gives the fields of the mesh at the points.
    """

    load: ConcentratedLoad
    x: FloatArray
    weights: FloatArray
    nodes: IndexArray
    shapes: FloatArray
    fields: FieldsAt


class NodalLoads(Term):
    """All loads at points and lines of a body. Collective to make.

    Args:
        loads: All loads; those that are not `nodal` are left to others.

    Raises:
        InputError: A point too far off the body, or with the wrong number of coordinates.
    """

    label, nodal = "loads at points", True

    def __init__(self, body: Body, V: fem.FunctionSpace, loads: Sequence[Load]) -> None:
        self._body, self._V, self._dim = body, V, body.dim
        self._spread = []
        for index, load in enumerate(loads):
            if isinstance(load, ConcentratedLoad):
                try:
                    self._spread.append(self._spread_out(load))
                except InputError as error:
                    raise error.at(f"load[{index}]") from None
        self.changes = any(
            s.load.curve is not None or depends_on_time(s.load.values) for s in self._spread
        )
        self._forces = [np.zeros((len(s.x), self._dim)) for s in self._spread]

    def __bool__(self) -> bool:
        return bool(self._spread)

    def set_time(self, t: float, default: Amplitude) -> None:
        """See `Term`."""
        for spread, forces in zip(self._spread, self._forces, strict=True):
            for i, value in enumerate(sized(spread.load.values, self._dim)):
                amplitude = amplitude_of(value, spread.load.curve) or default
                factor = amplitude.at(t) * spread.weights
                forces[:, i] = factor * number_at(value, spread.x, t, spread.fields)

    def nodal_forces(self) -> FloatArray:
        """This rank's share of the nodal forces on all its nodes, shape (nodes * dim).

        Ghosts have theirs too: add all of it up over the ranks.
        """
        index_map = self._V.dofmap.index_map
        sums = np.zeros((index_map.size_local + index_map.num_ghosts, self._dim))
        for spread, forces in zip(self._spread, self._forces, strict=True):
            np.add.at(sums, spread.nodes, spread.shapes[:, :, None] * forces[:, None, :])
        return sums.ravel()

    def add_forces(self, forces: FloatArray) -> None:
        """See `Term`."""
        forces += self.nodal_forces()

    # --- where they act ---

    def _spread_out(self, load: ConcentratedLoad) -> _Spread:
        for key, vector in load.vectors.items():
            check_components(sized(vector, self._dim), self._dim, key)
        spread = self._at_places(load) if load.on is None else self._on_parts(load)
        with keyed("value"):
            check_fields(self._body, load.values)
            values = fields_of(sized(load.values, self._dim))
            given = [one.of(spread.fields(one.field)) for one in values]
            check_finite(self._body, load.values, np.array(given))
        return spread

    def _at_places(self, load: ConcentratedLoad) -> _Spread:
        """A point, or Gauss points of a line, in cells that this rank owns. Collective."""
        key, points, weights = self._points(load)
        x, cells, local = self._located(points, load, key)
        nodes, shapes, fields = self._shapes(x[local], cells[local])
        return _Spread(load, points[local], weights[local], nodes, shapes, fields)

    def _on_parts(self, load: ConcentratedLoad) -> _Spread:
        """Named nodes, or Gauss points of named edges, that this rank owns. Collective."""
        kind, comm = load.part_kinds[0], self._body.comm
        try:
            points = points_of(self._body, kind, load.parts, EDGE_DEGREE)
        except MeshError as error:
            raise error.at("on") from None
        size = total(comm, float(points.weights.sum()))
        if not size > 0.0:
            raise InputError(
                "nothing of the mesh is there", where="on", expected="a name that has members"
            )
        x = np.zeros((points.weights.size, 3))
        x[:, : self._dim] = points.X.reshape(-1, self._dim)
        local = points.local.reshape(-1, self._dim)
        cells = np.repeat(points.cells, points.weights.shape[1])
        share = size if load.shared else 1.0
        weights = np.asarray(points.weights.ravel() / share, dtype=np.float64)
        nodes = np.asarray(self._V.dofmap.list)[cells]
        table = np.asarray(self._V.element.basix_element.tabulate(0, local)[0, :, :, 0])
        return _Spread(load, x, weights, nodes, table, self._fields(cells, local))

    def _fields(self, cells: IndexArray, local: FloatArray) -> FieldsAt:
        """Gives the fields of the mesh at points of the reference cells of some cells."""

        def values(name: str) -> FloatArray:
            return self._body.mesh_field(name).at_each(self._body.mesh, cells, local)

        return cache(values)

    def samples(self, load: Load) -> tuple[FloatArray, FloatArray]:
        """Places and weights of a load with this rank; those of all ranks make the whole.

        Returns:
            Shapes (points, dim) [m] and (points,) [1 or m].
        """
        spread = next(s for s in self._spread if s.load is load)
        return spread.x[:, : self._dim], spread.weights

    def values(self, load: Load, t: float) -> FloatArray:
        """The load at those places, without its amplitude, shape (points, dim) [N or N/m].

        Args:
            t: Time [s], or load parameter.
        """
        spread = next(s for s in self._spread if s.load is load)
        return vector_at(load.values, spread.x[:, : self._dim], t, spread.fields)

    def _points(self, load: ConcentratedLoad) -> tuple[str, FloatArray, FloatArray]:
        """Key, places and weights of the points; the same on every rank."""
        ends = np.zeros((len(load.points), 3))
        ends[:, : self._dim] = list(load.points.values())
        key = next(iter(load.points))
        if len(ends) == 1:
            return key, ends, np.ones(1)
        start, along = ends[0], ends[1] - ends[0]
        length = float(np.linalg.norm(along))
        count = max(1, int(np.ceil(PARTS * length / cell_size(self._body))))
        middle = (np.arange(count) + 0.5) / count
        half = 0.5 / (count * np.sqrt(3.0))  # Gauss points of each part
        s = np.concatenate([middle - half, middle + half])
        return key, start + s[:, None] * along, np.full(2 * count, length / (2 * count))

    def _located(
        self, points: FloatArray, load: ConcentratedLoad, key: str
    ) -> tuple[FloatArray, IndexArray, BoolArray]:
        """Nearest points of the body, their cells, and which are this rank's. Collective."""
        comm = self._body.comm
        x, cells, off = self._nearest(points)
        nearest = np.empty_like(off)
        comm.Allreduce(off, nearest, op=MPI.MIN)
        limit = NEAR * span(self._body) if load.tolerance is None else load.tolerance
        worst = int(np.argmax(nearest))
        error = None
        if nearest[worst] > limit:
            unit = self._body.unit
            place = unit.point(points[worst, : self._dim])
            what = f"{place} is {unit.length(nearest[worst])} off the body"
            if len(load.points) > 1:  # a point between the two that are written
                key, what = _nearer_end(load, points[worst, : self._dim]), f"on the line {what}"
            error = InputError(
                what,
                where=key,
                expected=f"a point of the body, or tolerance above that ({unit.length(limit)} now)",
            )
        agree(comm, error)
        rank = np.where(off <= nearest, comm.rank, comm.size)
        owner = np.empty_like(rank)
        comm.Allreduce(rank, owner, op=MPI.MIN)
        return x, cells, owner == comm.rank

    def _nearest(self, points: FloatArray) -> tuple[FloatArray, IndexArray, FloatArray]:
        """Nearest point in owned cells, the cell and the distance; of no cell infinite."""
        mesh, count = self._body.mesh, len(points)
        x, off = points.copy(), np.full(count, np.inf)
        result = np.full(count, -1, dtype=np.int32)
        own = self._body.owned_cells()
        if not len(own):
            return x, result, off
        tree = geometry.bb_tree(mesh, self._dim, entities=own)
        inside = geometry.compute_colliding_cells(
            mesh, geometry.compute_collisions_points(tree, points), points
        )
        for i, point in enumerate(points):
            if len(hit := inside.links(i)):
                result[i], off[i] = hit[0], 0.0
            else:
                result[i], off[i], x[i] = self._closest(own, point)
        return x, result, off

    def _closest(self, own: IndexArray, point: FloatArray) -> tuple[int, float, FloatArray]:
        mesh = self._body.mesh
        corners = mesh.geometry.x[mesh.geometry.dofmap[own]]
        low, high = corners.min(axis=1), corners.max(axis=1)
        box = np.linalg.norm(np.maximum(np.maximum(low - point, point - high), 0.0), axis=1)
        best, at, gap = np.inf, -1, np.zeros(3)
        for k in np.argsort(box):  # nearest boxes first: seldom more than a few cells
            if box[k] >= best:
                break
            vector = geometry.compute_distance_gjk(corners[k], point.reshape(1, 3))
            if (distance := float(np.linalg.norm(vector))) < best:
                best, at, gap = distance, int(own[k]), vector
        return at, best, point + gap

    def _shapes(self, x: FloatArray, cells: IndexArray) -> tuple[IndexArray, FloatArray, FieldsAt]:
        """Nodes of the cells of points, shape functions there, and fields."""
        mesh, V = self._body.mesh, self._V
        element = V.element.basix_element
        nodes = np.zeros((len(x), element.dim), dtype=np.int32)
        shapes, local = np.zeros((len(x), element.dim)), np.zeros((len(x), self._dim))
        for i, (point, cell) in enumerate(zip(x, cells, strict=True)):
            corners = mesh.geometry.x[mesh.geometry.dofmap[cell], : self._dim]
            reference = mesh.geometry.cmap.pull_back(point[None, : self._dim], corners)
            nodes[i] = V.dofmap.cell_dofs(cell)
            shapes[i], local[i] = element.tabulate(0, reference)[0, 0, :, 0], reference[0]
        return nodes, shapes, self._fields(cells, local)


def _nearer_end(load: ConcentratedLoad, point: FloatArray) -> str:
    """Key of the end of a line that is nearest to a point."""
    return min(load.points, key=lambda key: float(np.linalg.norm(point - load.points[key])))
