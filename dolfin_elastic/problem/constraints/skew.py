"""Nodes that are held along directions other than the axes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.model.amplitude import CONSTANT, Amplitude
from dolfin_elastic.model.supports.displacement import PrescribingSupport
from dolfin_elastic.problem.constraints.rigid_motion import RigidMotion

SAME = 1e-3
"""Sine of the angle below which two directions count as one."""

SAME_CURVED = 0.5
"""The same between curved surfaces: where the parts of one smooth surface meet, their mean normals
differ by as much as its facets do."""


@dataclass(frozen=True)
class SkewSupport:
    """One direction at each of some nodes that one support prescribes.

    Attributes:
        support: None: the axis of an axisymmetric body.
        which: The component, or `NORMAL`.
        nodes: Owned and ghost, sorted.
        directions: Unit vectors, of shape (nodes, dim).
        curved: They come from a curved surface.
    """

    support: PrescribingSupport | RigidMotion | None
    which: int
    nodes: IndexArray
    directions: FloatArray
    curved: bool = False

    def of(self, chosen: BoolArray) -> SkewSupport:
        """The same at some of its nodes."""
        return SkewSupport(
            self.support, self.which, self.nodes[chosen], self.directions[chosen], self.curved
        )

    def goals(self, x: FloatArray, t: float, default: Amplitude = CONSTANT) -> FloatArray:
        """What is prescribed along each direction [m].

        It is asked on ranks without nodes, too: a curve fails on all of them or on none.
        """
        goals = np.zeros(len(self.nodes))
        if self.support is not None:
            try:
                goals[:] = self.support.at(self.which, x[self.nodes], t, default)
            except InputError as error:
                raise error.at(f"support '{self.support.label}'") from None
        return goals


@dataclass(frozen=True)
class SkewDofs:
    """The rows of N that a hold has got.

    Attributes:
        hold: Whose rows.
        kept: Which of its nodes got one.
        where: These nodes' numbers among all tilted ones.
        row: The row there.
    """

    hold: SkewSupport
    kept: IntArray
    where: IntArray
    row: IntArray


class SkewConstraints:
    """Nodes at which n_k . u = g_k is prescribed for up to `dim` directions n_k.

    Where a new direction depends on the others, the later support holds.  With N of rows n_k and
    its pseudo-inverse N+, the displacement is N+ g in the space of the directions, on which
    P = N+ N projects, and is free across; the force that holds is n_k (N+^T R)_k along n_k, R what
    is out of balance.

    Args:
        holds: In the order of the supports.
        size: Nodes that this rank owns.
        x: Places of all local nodes, of shape (n, 3).
        dim: Components of the displacement.

    Attributes:
        nodes: Local nodes, owned ones first, sorted.
        count: How many of them this rank owns.
        P: Projections, of shape (nodes, dim, dim).
        target: N+ g at the present time [m], of shape (nodes, dim).
    """

    def __init__(self, holds: Sequence[SkewSupport], *, size: int, x: FloatArray, dim: int) -> None:
        empty = np.empty(0, dtype=np.int32)
        self.nodes = np.unique(np.concatenate([empty, *(hold.nodes for hold in holds)]))
        self.count = int(np.sum(self.nodes < size))
        self._x, self._dim = x, dim
        shape = (len(self.nodes), dim, dim)
        self._rows, self._basis = np.zeros(shape), np.zeros(shape)
        self._bent = np.zeros(shape[:2], dtype=bool)
        self._filled = np.zeros(len(self.nodes), dtype=np.int64)
        self._slots = [self._take(hold) for hold in reversed(holds)]
        self._lift = np.linalg.pinv(self._rows) if len(self.nodes) else np.zeros(shape)
        self.P = self._lift @ self._rows
        self.target = np.zeros(shape[:2])

    def _take(self, hold: SkewSupport) -> SkewDofs:
        """Gives a hold its rows, where it needs any.

        By Gram & Schmidt: what a direction has across all that are there already.
        """
        at = np.searchsorted(self.nodes, hold.nodes)
        n, basis = hold.directions, self._basis[at]
        rest = n - np.einsum("nki,nkj,nj->ni", basis, basis, n)
        length = np.linalg.norm(rest, axis=1)
        cosines = np.abs(np.einsum("nki,ni->nk", self._rows[at], n)) * self._bent[at]
        alike = hold.curved & (np.max(cosines, axis=1, initial=0.0) > np.sqrt(1 - SAME_CURVED**2))
        kept = np.flatnonzero((length > SAME) & ~alike & (self._filled[at] < self._dim))
        where = at[kept]
        row = self._filled[where]
        self._rows[where, row] = n[kept]
        self._basis[where, row] = rest[kept] / length[kept, None]
        self._bent[where, row] = hold.curved
        self._filled[where] += 1
        return SkewDofs(hold, kept, where, row)

    def set_time(self, t: float, default: Amplitude) -> None:
        """Sets the target of time t. Not collective."""
        goals = np.zeros(self.target.shape)
        for s in self._slots:
            goals[s.where, s.row] = s.hold.goals(self._x, t, default)[s.kept]
        self.target[:] = np.einsum("nik,nk->ni", self._lift, goals)

    def constrained_part(self, values: FloatArray) -> FloatArray:
        """The held part of vectors at the owned nodes, of shape (count, dim)."""
        return np.asarray(np.einsum("nij,nj->ni", self.P[: len(values)], values))

    def free_part(self, values: FloatArray) -> FloatArray:
        """Their other part."""
        return np.asarray(values - self.constrained_part(values))

    def resultants(self, out: FloatArray) -> dict[str, FloatArray]:
        """Support's label to this rank's sum of its forces [N].

        Args:
            out: Forces out of balance at the owned nodes [N], of shape (count, dim).
        """
        found: dict[str, FloatArray] = {}
        for support, _, forces in self.reactions(out):
            found[support.label] = found.get(support.label, 0.0) + forces.sum(axis=0)
        return found

    def reactions(
        self, out: FloatArray
    ) -> Iterator[tuple[PrescribingSupport | RigidMotion, IndexArray, FloatArray]]:
        """Each support's forces, hold by hold: owned nodes, and forces there, shape (nodes, dim).

        Args:
            out: Forces out of balance at the owned nodes [N], of shape (count, dim).
        """
        along = np.einsum("nik,ni->nk", self._lift[: self.count], out)
        for s in self._slots:
            if s.hold.support is not None:
                own = s.where < self.count
                at = s.where[own], s.row[own]
                forces = along[at][:, None] * self._rows[at]
                yield s.hold.support, self.nodes[s.where[own]], forces
