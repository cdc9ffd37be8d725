"""Nodes at which displacements are prescribed along directions other than the axes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.model.amplitude import Amplitude
from dolfin_elastic.model.supports.displacement import PrescribingSupport
from dolfin_elastic.problem.constraints.prescribed import PrescribedComponent
from dolfin_elastic.problem.constraints.rigid_motion import RigidMotion

SAME = 1e-3
"""Sine of the angle below which two directions count as one."""

SAME_CURVED = 0.5
"""The same between curved surfaces: where the parts of one smooth surface meet, their mean normals
differ by as much as its facets do."""


@dataclass(frozen=True)
class SkewDofs:
    """The rows of N that a component has.

    Attributes:
        component: Whose rows.
        chosen: Which of its nodes have one: at others the direction depends on later ones.
        where: These nodes' numbers among all skew nodes.
        row: The row there.
    """

    component: PrescribedComponent
    chosen: IntArray
    where: IntArray
    row: IntArray


class SkewNodes:
    """Nodes at which n_k . u = g_k is prescribed for up to `dim` directions n_k.

    Where a new direction depends on the others, the later support holds.  With N of rows n_k and
    its pseudo-inverse N+, the displacement is N+ g in the space of the directions, on which
    P = N+ N projects, and is free across; the force of constraint is n_k (N+^T R)_k along n_k, R
    what is out of balance.

    Args:
        components: At these nodes, in the order of the supports.
        size: Nodes that this rank owns.
        x: Reference places of all local nodes, of shape (n, 3) [m].

    Attributes:
        nodes: Local nodes, owned ones first, sorted.
        rows: All entries of the owned ones, of shape (nodes, dim), and P there.
    """

    def __init__(
        self, components: Sequence[PrescribedComponent], *, size: int, x: FloatArray, dim: int
    ) -> None:
        nodes = [component.nodes for component in components]
        self.nodes = np.unique(np.concatenate([np.empty(0, dtype=np.int32), *nodes]))
        own = self.nodes[self.nodes < size]
        self._x, self._dim = x, dim
        shape = (len(self.nodes), dim, dim)
        self._rows, self._basis = np.zeros(shape), np.zeros(shape)
        self._curved = np.zeros(shape[:2], dtype=bool)
        self._filled = np.zeros(len(self.nodes), dtype=np.int64)
        # The last support first: where directions depend on one another, it gets the row.
        self._dofs = [self._add(component) for component in reversed(components)]
        self._lift = np.linalg.pinv(self._rows) if len(self.nodes) else np.zeros(shape)
        entries = (own[:, None] * dim + np.arange(dim)).astype(np.int32)
        self.rows = entries, (self._lift @ self._rows)[: len(own)]

    def _add(self, component: PrescribedComponent) -> SkewDofs:
        """Gives a component its rows, at nodes where its direction is a new one.

        By Gram & Schmidt: what a direction has across all that are there already.
        """
        at = np.searchsorted(self.nodes, component.nodes)
        n, basis = component.directions, self._basis[at]
        across = n - np.einsum("nki,nkj,nj->ni", basis, basis, n)
        length = np.linalg.norm(across, axis=1)
        cosines = np.abs(np.einsum("nki,ni->nk", self._rows[at], n)) * self._curved[at]
        smooth = np.max(cosines, axis=1, initial=0.0) > np.sqrt(1 - SAME_CURVED**2)
        same = (length <= SAME) | (component.curved & smooth)
        chosen = np.flatnonzero(~same & (self._filled[at] < self._dim))
        where = at[chosen]
        row = self._filled[where]
        self._rows[where, row] = n[chosen]
        self._basis[where, row] = across[chosen] / length[chosen, None]
        self._curved[where, row] = component.curved
        self._filled[where] += 1
        return SkewDofs(component, chosen, where, row)

    def at(self, t: float, default: Amplitude) -> FloatArray:
        """N+ g at time t [m], of shape (nodes, dim). Not collective.

        Args:
            t: Time [s], or load parameter.
            default: Amplitude where the user gave none.
        """
        goals = np.zeros((len(self.nodes), self._dim))
        for s in self._dofs:
            goals[s.where, s.row] = s.component.values(self._x, t, default)[s.chosen]
        return np.asarray(np.einsum("nik,nk->ni", self._lift, goals))

    def reactions(
        self, forces: FloatArray
    ) -> Iterator[tuple[PrescribingSupport | RigidMotion, IndexArray, FloatArray]]:
        """Each support's forces, component by component: owned nodes, forces of shape (nodes, dim).

        Args:
            forces: Out of balance, owned entries of the displacement [N].
        """
        coordinates, _ = self.rows
        along = np.einsum("nik,ni->nk", self._lift[: len(coordinates)], forces[coordinates])
        for s in self._dofs:
            if s.component.support is not None:
                own = s.where < len(coordinates)
                at = s.where[own], s.row[own]
                yield s.component.support, self.nodes[at[0]], along[at][:, None] * self._rows[at]


def check_rigid_surfaces(
    components: Sequence[PrescribedComponent], skew: BoolArray, comm: MPI.Comm
) -> None:
    """A rigid surface with unknown motion meets no skew node. Collective.

    Its unknowns are coupled to nodes entry by entry, which rows of N are not.

    Args:
        components: All that supports prescribe.
        skew: Which local nodes are skew.
        comm: The ranks of the body.

    Raises:
        InputError: It does; on all ranks.
    """
    for component in components:
        support = component.support
        free = isinstance(support, RigidMotion) and len(support.free) > 0
        met = int(skew[component.nodes].sum()) if free else 0
        if total(comm, met):
            assert support is not None
            raise InputError(
                "a rigid surface with free motion meets another support whose direction is "
                "not along an axis",
                where=f"support '{support.label}'.on",
                expected="surfaces that share no edge with it",
            )
