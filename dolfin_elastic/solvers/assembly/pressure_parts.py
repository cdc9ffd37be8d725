"""Connected parts of materials that share one continuous pressure, and which are held all around.

The uniform pressure of a part does work on the displacements of its surface alone, the integrals of
the normal times their shape functions.  Where two parts meet at a node that is free to move, their
uniform pressures have to be equal for the work to vanish; where a part meets nothing, or something
without a pressure of this kind, its own has to be zero.  What is left are sets of parts with a
uniform pressure that does no work at all.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from dolfinx import la

from dolfin_elastic.core.parallel import RankExchange, largest, total
from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.body import connected_components
from dolfin_elastic.mesh.geometry.curved import facet_quadrature, facet_shape_functions
from dolfin_elastic.mesh.geometry.simplices import dofs_on_facets, prepare_facets
from dolfin_elastic.problem.constraints.rows import Rows
from dolfin_elastic.problem.material_regions import MaterialRegion
from dolfin_elastic.problem.problem import Problem

FREE = 1e-9
"""Derivative of the volume by a free displacement, over the largest one of a facet, that is
round-off."""


class PressureParts:
    """Connected parts with one continuous pressure each. Collective to make.

    Attributes:
        count: How many parts there are on all ranks.
        of_cell: Number of the part of each local cell; -1: of none.
    """

    def __init__(self, problem: Problem, regions: Sequence[MaterialRegion]) -> None:
        self._problem, self._comm = problem, problem.body.comm
        self._map = problem.W.dofmap.index_map
        table = pressure_dofs(problem)
        self.of_cell: IntArray = np.full(len(table), -1, dtype=np.int64)
        cells = np.concatenate([np.empty(0, dtype=np.int32), *(r.cells for r in regions)])
        self.count, numbers = self._joined(table[cells])
        self.of_cell[cells] = numbers
        self._nodes, self._parts, self._rows, self._share = self._gradients()

    def _joined(self, entries: IndexArray) -> tuple[int, IntArray]:
        """How many parts there are, and that of each row of pressures. Collective.

        Args:
            entries: Of all unknowns, those of the pressures of some cells, shape (cells, corners).
        """
        here, rows = np.unique(entries, return_inverse=True)
        local, own = connected_components(len(here), rows.reshape(entries.shape))
        counts = self._comm.allgather(local)
        start = sum(counts[: self._comm.rank])
        numbers = la.vector(self._map, 1, dtype=np.int64)
        numbers.array[:] = -1
        numbers.array[here] = start + own
        known = numbers.array.copy()
        numbers.scatter_forward()
        size = self._map.size_local
        ghosts = size + np.flatnonzero(known[size:] >= 0)
        pairs = np.unique(np.stack([known[ghosts], numbers.array[ghosts]], axis=1), axis=0)
        links = np.concatenate(self._comm.allgather(pairs))
        count, labels = connected_components(sum(counts), links)
        first = rows.reshape(entries.shape)[:, 0]
        return count, np.asarray(labels[start + own[first]])

    # --- what their uniform pressures do work on ---

    def _sides(self) -> tuple[IndexArray, IntArray]:
        """Facets with another part, or none, on the other side, and the parts beside, shape (n, 2).

        Those between ranks are among them, each on both.
        """
        mesh, dim = self._problem.body.mesh, self._problem.body.dim
        prepare_facets(mesh)
        links = mesh.topology.connectivity(dim - 1, dim)
        first, second = links.offsets[:-1], np.diff(links.offsets) > 1
        beside = np.full((len(first), 2), -1, dtype=np.int64)
        beside[:, 0] = self.of_cell[links.array[first]]
        beside[second, 1] = self.of_cell[links.array[first[second] + 1]]
        facets = np.flatnonzero(beside[:, 0] != beside[:, 1]).astype(np.int32)
        return facets, beside[facets]

    def _gradients(self) -> tuple[IntArray, IntArray, FloatArray, float]:
        """Derivatives of the parts' volumes by nodal displacements, of the owned nodes. Collective.

        Returns:
            Owned node, in the order of the displacement's unknowns, and part, shape (n,), sorted;
            the derivatives [m^2], shape (n, dim); and the largest share of a facet in them.
        """
        problem, dim = self._problem, self._problem.body.dim
        facets, parts = self._sides()
        nodes, shares = normal_integrals(problem, facets)
        entries = problem.unknowns.mixed_dofs((nodes * dim).reshape(-1).astype(np.int32))
        entries, vectors = entries.reshape(nodes.shape), shares
        at = [(entries, parts[:, side], vectors * sign) for side, sign in ((0, 1.0), (1, -1.0))]
        chosen = [(e[p >= 0], p[p >= 0], v[p >= 0]) for e, p, v in at]
        entry = np.concatenate([e.reshape(-1) for e, _, _ in chosen]).astype(np.int64)
        part = np.concatenate([np.repeat(p, nodes.shape[1]) for _, p, _ in chosen])
        rows = np.concatenate([v.reshape(-1, dim) for _, _, v in chosen])
        entry, part, rows = self._at_owners(*self._summed(entry, part, rows))
        moves = problem.unknowns.displacement_dofs
        offset = np.full(self._map.size_local, -1, dtype=np.int64)
        offset[moves] = np.arange(len(moves))
        node, part, rows = self._summed(offset[entry] // dim, part, rows)
        share = largest(self._comm, float(np.max(np.abs(shares), initial=0.0)))
        return node, part, rows, share

    def _summed(
        self, offset: IntArray, part: IntArray, rows: FloatArray
    ) -> tuple[IntArray, IntArray, FloatArray]:
        """Rows of the same place and part as one, sorted by both."""
        width = max(self.count, 1)
        keys, back = np.unique(offset * width + part, return_inverse=True)
        sums = np.zeros((len(keys), rows.shape[1]))
        np.add.at(sums, back, rows)
        return keys // width, keys % width, sums

    def _at_owners(
        self, entry: IntArray, part: IntArray, rows: FloatArray
    ) -> tuple[IntArray, IntArray, FloatArray]:
        """The rows of entries that this rank owns, from all ranks. Collective."""
        size = self._map.size_local
        own, ghost = entry < size, entry >= size
        there = entry[ghost] - size
        exchange = RankExchange(self._comm, np.asarray(self._map.owners)[there])
        where = np.stack([np.asarray(self._map.ghosts)[there], part[ghost]], axis=1)
        arrived, values = exchange.send(where), exchange.send(rows[ghost])
        return (
            np.concatenate([entry[own], arrived[:, 0] - self._map.local_range[0]]),
            np.concatenate([part[own], arrived[:, 1]]),
            np.concatenate([rows[own], values]),
        )

    def _free(self) -> FloatArray:
        """The derivatives by what nothing prescribes, shape (n, dim)."""
        problem, unknowns = self._problem, self._problem.unknowns
        rows = Rows(*problem.constraints.at(unknowns.merged_dofs))
        dim, size = problem.body.dim, len(unknowns.displacement_dofs)
        Q = rows.free_directions(size, dim).reshape(-1, dim, dim)
        return np.asarray(np.einsum("nij,nj->ni", Q[self._nodes], self._rows))

    def enclosed(self) -> list[IntArray]:
        """Sets of parts with a uniform pressure that does no work. Collective."""
        rows, small = self._free(), FREE * self._share
        felt = np.abs(rows).max(axis=1, initial=0.0) > small
        starts = np.flatnonzero(np.diff(self._nodes, prepend=-1))
        sums = np.add.reduceat(rows, starts, axis=0) if len(starts) else rows
        ends = np.repeat(sums, np.diff(np.append(starts, len(rows))), axis=0)
        loose = felt & (np.abs(ends).max(axis=1, initial=0.0) > small)
        opened = total(self._comm, np.bincount(self._parts[loose], minlength=self.count))
        node, part = self._nodes[felt], self._parts[felt]
        same = node[1:] == node[:-1]
        pairs = np.unique(np.stack([part[1:][same], part[:-1][same]], axis=1), axis=0)
        links = np.concatenate(self._comm.allgather(pairs))
        count, label = connected_components(self.count, links)
        closed = np.bincount(label, weights=opened, minlength=count) == 0
        return [np.flatnonzero(label == number) for number in np.flatnonzero(closed)]

    def cells(self, parts: IntArray) -> IndexArray:
        """Local cells of some parts."""
        return np.flatnonzero(np.isin(self.of_cell, parts)).astype(np.int32)

    def gradient(self, parts: IntArray) -> FloatArray:
        """Derivative of the volume of some parts by owned entries of all unknowns [m^2]."""
        moves, dim = self._problem.unknowns.displacement_dofs, self._problem.body.dim
        inside = np.isin(self._parts, parts)
        rows = np.zeros((len(moves) // dim, dim))
        np.add.at(rows, self._nodes[inside], self._rows[inside])
        result = np.zeros(self._map.size_local)
        result[moves] = rows.reshape(-1)
        return result


def pressure_dofs(problem: Problem) -> IndexArray:
    """Entries of the pressures of each local cell in the local array of all unknowns."""
    names = [field.name for field in problem.unknowns.auxiliary_fields]
    return np.asarray(problem.W.sub(1 + names.index("pressure")).dofmap.list)


def ring(problem: Problem, X: FloatArray) -> FloatArray | float:
    """Circumference at places of an axisymmetric body [m]; 1 of others.

    Args:
        X: Places [m].
    """
    return 2 * np.pi * X[..., 0] if problem.geometry == "axisymmetric" else 1.0


def normal_integrals(problem: Problem, facets: IndexArray) -> tuple[IndexArray, FloatArray]:
    """Integrals of the normal times the shape functions of displacements. Local.

    Args:
        facets: Local facets, after `prepare_facets`.

    Returns:
        Local nodes of V, shape (facets, nodes), and the integrals [m^2], shape (facets, nodes,
        dim), of the normal outward of the first cell beside a facet.
    """
    mesh, dim, V = problem.body.mesh, problem.body.dim, problem.V
    points = facet_quadrature(mesh, facets, 2 * problem.context.order)
    table = facet_shape_functions(dim, problem.degree, points.local)
    nodes = dofs_on_facets(V, facets)
    weights = points.weights * ring(problem, points.X)
    assert points.N is not None
    shares = np.einsum("pk,fpi->fki", table, weights[..., None] * points.N)
    return nodes, np.asarray(shares, dtype=np.float64)
