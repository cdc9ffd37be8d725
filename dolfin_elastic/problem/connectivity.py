"""Connected bodies: sets of cells connected by shared nodes or ties, over all ranks."""

from __future__ import annotations

import numpy as np
from dolfinx import la

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.body import connected_components
from dolfin_elastic.problem.problem import Problem

_JOINED = 3
"""Regions that the name of one body is made of."""


class ConnectedBodies:
    """The connected bodies of a problem. Collective.

    Each rank finds its own components; those that share nodes across ranks are joined.  The ranks
    exchange one pair of numbers for two such components, however many nodes they share.

    Args:
        problem: Whose unknown nodes connect the cells: those on periodic faces are one, and tied
            ones belong to what they follow.

    Attributes:
        comm: The ranks.
        count: How many bodies there are, on all ranks.
        of_node: Number of the body of each local node of `unknowns.U` (ghosts included), from 0.
        places: Local nodes in the reference configuration [m], shape (nodes, dim).
    """

    def __init__(self, problem: Problem) -> None:
        self._body, self.comm = problem.body, problem.body.comm
        self._ties = problem.constraints.ties
        dofmap = problem.unknowns.U.dofmap
        self._plain = np.asarray(problem.V.dofmap.list)
        self._dofs, self._map = np.asarray(dofmap.list), dofmap.index_map
        self.places = problem.places[:, : problem.body.dim]
        own = self._components_here()
        self.count, numbers = self._joined(own)
        self.of_node: IntArray = numbers[own]
        self._middle: FloatArray = np.empty((0, problem.body.dim))
        self._number_by_place()

    def _components_here(self) -> IntArray:
        """Component of each local node, numbered from 0 on each rank."""
        nodes = self._map.size_local + self._map.num_ghosts
        return connected_components(nodes, self._dofs)[1]

    def _joined(self, own: IntArray) -> tuple[int, IntArray]:
        """How many bodies there are, and the body of each of this rank's components."""
        local = int(own.max(initial=-1)) + 1
        counts = self.comm.allgather(local)
        start = sum(counts[: self.comm.rank])
        vector = la.vector(self._map, 1)
        vector.array[: self._map.size_local] = start + own[: self._map.size_local]
        vector.scatter_forward()
        ghosts = slice(self._map.size_local, None)
        here, there = start + own[ghosts], vector.array[ghosts].astype(np.int64)
        pairs = np.stack([here, there], axis=1)
        if self._ties is not None:
            nodes = start + own[: self._map.size_local]
            pairs = np.concatenate([pairs, self._ties.links(nodes)])
        pairs = np.unique(pairs, axis=0)
        links = np.concatenate(self.comm.allgather(pairs))
        count, numbers = connected_components(sum(counts), links)
        return count, numbers[start : start + local]

    def _number_by_place(self) -> None:
        """Numbers several bodies by where they are, then by their cells: the same on any ranks."""
        if self.count == 1:
            return
        middle, cells = self._middles()
        step = 1e-9 * max(float(np.max(np.abs(middle), initial=0.0)), np.finfo(float).tiny)
        order = np.lexsort([-cells, *np.round(middle / step).T[::-1]])
        self._middle = middle[order]
        numbers = np.empty_like(order)
        numbers[order] = np.arange(self.count)
        self.of_node = numbers[self.of_node]

    def names(self) -> list[str]:
        """Name of each body, from the regions that lie in it alone. Collective."""
        if self.count == 1:
            return [""]
        cells, middle = self._cells(self._body.owned_cells()), self._middle
        return [
            _name(inside, int(cells[k]))
            or f"body {k + 1}, about {self._body.unit.point(middle[k])}"
            for k, inside in enumerate(self.regions())
        ]

    def regions(self) -> list[dict[str, int]]:
        """Of each body the regions that lie in it alone, with their cells' number. Collective."""
        parts = {name: self._cells(self._body.owned_cells(name)) for name in self._body.regions}
        return [
            {n: int(c[k]) for n, c in parts.items() if 0 < c[k] == c.sum()}
            for k in range(self.count)
        ]

    def _cells(self, cells: IndexArray) -> IntArray:
        """How many of these cells each body has."""
        of = self.of_node[self._dofs[cells, 0]]
        return np.asarray(total(self.comm, np.bincount(of, minlength=self.count)))

    def _middles(self) -> tuple[FloatArray, FloatArray]:
        """Mean place of each body's cells [m], and how many there are. Collective."""
        own = self._body.owned_cells()
        dim = self.places.shape[1]
        sums = np.zeros((self.count, dim + 1))
        middle = self.places[self._plain[own]].mean(axis=1)
        rows = np.concatenate([middle, np.ones((len(own), 1))], axis=1)
        np.add.at(sums, self.of_node[self._dofs[own, 0]], rows)
        sums = total(self.comm, sums)
        return sums[:, :dim] / sums[:, dim:], sums[:, dim]


def _name(inside: dict[str, int], cells: int) -> str:
    """A region that is all of a body, else the regions it is made of."""
    whole = [name for name, count in inside.items() if count == cells]
    if whole:
        return whole[0]
    several = sorted(inside, key=lambda name: (-inside[name], name))
    return "+".join(several[:_JOINED])
