"""Linear constraints of a displacement as rows: u = T q + g(t), where q is free.

The row of a prescribed entry is empty: u_i = g_i.  At a skew node, whose prescribed directions are
not along the axes, rows are those of Q = 1 - P, with P the projection on these directions.  An
entry that follows others has their factors, in which chains are resolved: u_i = T_ij u_j.  All
other rows are the identity's.  Forces go the other way, T^T f; a matrix K becomes T^T K T, as
symmetric as before, without a penalty.  Sources: M. Ainsworth, Comput. Methods Appl. Mech. Engrg.
190 (2001) 6323, for projections; class AffineConstraints of deal.II, for the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import first_of, total
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.body import Body, span
from dolfin_elastic.model.amplitude import CONSTANT, Amplitude
from dolfin_elastic.model.supports.displacement import PrescribingSupport, Restraint, Rotation
from dolfin_elastic.model.tie import Tie
from dolfin_elastic.problem.constraints.prescribed import (
    PrescribedComponents,
    PrescribedDofs,
    without_round_off,
)
from dolfin_elastic.problem.constraints.rigid_motion import RigidMotion
from dolfin_elastic.problem.constraints.skew import SkewNodes, check_rigid_surfaces

if TYPE_CHECKING:
    from dolfin_elastic.problem.constraints.ties.exchange import Product
    from dolfin_elastic.problem.constraints.ties.ties import TiedSurfaces, Ties

    Holder = PrescribingSupport | RigidMotion | TiedSurfaces


SkewRows = tuple[IndexArray, FloatArray]
TiedRows = tuple[IndexArray, "Product"]
RowParts = tuple[IndexArray, SkewRows | None, TiedRows | None]


class Rows:
    """The constraints of a vector's owned entries.

    Args:
        prescribed: See the attribute.
        skew: Entries and projections; None if no rank has any.
        follow: Entries that follow others, and their rows; None if no rank has any.

    Attributes:
        prescribed_dofs: Owned entries with a value of their own.
        skew_dofs: All entries of the owned skew nodes, of shape (nodes, dim).
        P: Projections on the prescribed directions there, of shape (nodes, dim, dim).
        tied_dofs: Owned entries that follow others, sorted.
        skewed: Some rank has a skew node.
        tied: On some rank an entry follows others.
        combined: One of both: T has other rows than those of entries by themselves.
    """

    def __init__(
        self,
        prescribed: IndexArray,
        skew: SkewRows | None = None,
        follow: TiedRows | None = None,
    ) -> None:
        nothing: IndexArray = np.empty(0, dtype=np.int32)
        self.prescribed_dofs, self.skewed, self.tied = prescribed, bool(skew), bool(follow)
        self.combined = self.skewed or self.tied
        self.skew_dofs, self.P = skew or (nothing.reshape(0, 1), np.zeros((0, 1, 1)))
        self.tied_dofs, self._product = nothing, None if follow is None else follow[1]
        if follow is not None:
            self.tied_dofs = follow[0]

    def at(self, numbers: Callable[[IndexArray], IndexArray]) -> RowParts:
        """What `Rows` are made of, for a vector that has these entries at other places.

        Args:
            numbers: From owned entries of this vector to those of the other one.
        """
        skew = (numbers(self.skew_dofs), self.P) if self.skewed else None
        product = self._product
        follow = None if product is None else (numbers(self.tied_dofs), product.at(numbers))
        return numbers(self.prescribed_dofs), skew, follow

    def constrained_part(self, vector: FloatArray) -> FloatArray:
        """The part of a vector that is prescribed; of forces, reactions. Not collective."""
        part = np.zeros_like(vector)
        part[self.prescribed_dofs] = vector[self.prescribed_dofs]
        if self.skewed:
            part[self.skew_dofs] = self._along(vector)
        return part

    def free_part(self, vector: FloatArray) -> FloatArray:
        """What is not prescribed of a vector; see `constrained_part`."""
        part = vector.copy()
        part[self.prescribed_dofs] = 0.0
        if self.skewed:
            part[self.skew_dofs] -= self._along(vector)
        return part

    def _along(self, vector: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("nij,nj->ni", self.P, vector[self.skew_dofs]))

    def impose(self, vector: FloatArray, g: FloatArray) -> None:
        """Prescribes values, which other entries follow. Collective.

        Args:
            vector: Displacement, velocity or acceleration; owned entries are changed.
            g: Read where something is prescribed.
        """
        vector[self.prescribed_dofs] = g[self.prescribed_dofs]
        if self.skewed:
            vector[self.skew_dofs] += g[self.skew_dofs] - self._along(vector)
        self.extend(vector)

    def extend(self, vector: FloatArray) -> None:
        """Makes entries follow the others. Collective.

        Args:
            vector: Owned entries of a displacement, velocity or acceleration, or more behind them.
        """
        if self._product is not None:
            vector[self.tied_dofs] = self._product.times(vector)

    def collect(self, forces: FloatArray) -> FloatArray:
        """Moves forces on entries that follow others to those: T^T f. Collective.

        Args:
            forces: Owned entries [N].
        """
        if self._product is None:
            return forces
        moved = forces.copy()
        moved[self.tied_dofs] = 0.0
        self._product.add_transposed(forces[self.tied_dofs], moved)
        return moved

    def free_directions(self, size: int, dim: int) -> FloatArray:
        """What is not prescribed of unit vectors: all rows of 1 - P, of shape (size, dim).

        Args:
            size: Entries of the vector, those of a node side by side.
        """
        result = np.tile(np.eye(dim), (size // dim, 1))
        if self.skewed:
            result[self.skew_dofs] -= self.P
        result[self.prescribed_dofs] = 0.0
        return result

    @property
    def count(self) -> int:
        """How many of the owned entries are not free."""
        held = len(self.prescribed_dofs) + len(self.tied_dofs)
        return held + int(np.rint(np.trace(self.P, axis1=1, axis2=2).sum()))

    def eliminated(
        self, first: int, soft: float = 1.0
    ) -> tuple[IndexArray, IndexArray, FloatArray]:
        """Row, column and value of the entries of the projection on what T does not reach.

        Without prescribed entries.

        Args:
            soft: In place of ones where entries follow others.
        """
        coordinates, dim = self.skew_dofs, self.skew_dofs.shape[1]
        return (
            np.concatenate([self.tied_dofs, np.repeat(coordinates, dim, axis=1).ravel()]),
            first + np.concatenate([self.tied_dofs, np.tile(coordinates, dim).ravel()]),
            np.concatenate([np.full(len(self.tied_dofs), soft), self.P.ravel()]),
        )


class Constraints(Rows):
    """All linear constraints of a body's displacement.  Collective to make.

    Where supports meet, the later one holds.  Nodes whose prescribed directions are along axes are
    constrained entry by entry; all others are `skew`.

    Args:
        supports: All supports; springs and dashpots are ignored.
        ties: Surfaces with different meshes that move together.
        coordinates: Of the space's local nodes [m], shape (nodes, 3).
        axis: The body is axisymmetric: the radial displacement of nodes on the axis is zero.
        pinned: Of a periodic cell, which has no supports: local entries that are unknowns of its
            fixed vertex, and one of them for each such unknown that this rank owns.

    Attributes:
        values: Function with the prescribed values g [m], also of skew nodes.
        bcs: The DOLFINx condition of all prescribed entries, ready for assembly; empty without.
        dofs: Prescribed entries of the local vector, owned and ghost, sorted, unrolled.
        labels: Of the supports that prescribe anything.
        reaction_dofs: Support's label to its owned entries; `skew` may have more of it.
        skew: Nodes with other directions; None if no rank has any.
        ties: Which displacements follow others; None without ties.
        rigid_motions: Of rigid surfaces.
    """

    def __init__(
        self,
        body: Body,
        V: fem.FunctionSpace,
        supports: Sequence[Restraint],
        ties: Sequence[Tie] = (),
        *,
        coordinates: FloatArray,
        axis: bool = False,
        pinned: tuple[IndexArray, IndexArray] | None = None,
    ) -> None:
        self.values = fem.Function(V)
        self._V, self._bs = V, V.dofmap.index_map_bs
        self._x = without_round_off(coordinates, span(body))
        prescribed = PrescribedComponents(
            body, V, supports, coordinates=coordinates, axisymmetric=axis
        )
        self.rigid_motions, self.labels = prescribed.rigid_motions, prescribed.labels
        off_axis = prescribed.off_axis
        self.skew = self._skew(prescribed, off_axis)
        self._entries = prescribed.along_axes(~off_axis)
        dofs = np.concatenate([np.empty(0, np.int32), *(entry.dofs for entry in self._entries)])
        self.dofs = np.unique(dofs).astype(np.int32)
        size = V.dofmap.index_map.size_local * self._bs
        # Entries of the whole space: that of a component has a map of all cells of its own, and of
        # nodes DOLFINx 0.9 takes ghosts for its own (it compares them with the number of entries).
        pair = [self.dofs, self.dofs]
        self.bcs = [fem.dirichletbc(self.values, pair, V)] if self._entries else []
        self.reaction_dofs = {label: self._dofs_of(label, size) for label in prescribed.labels}
        owned = self.dofs[self.dofs < size]
        if pinned is not None:
            self.dofs, owned = np.sort(pinned[0]), pinned[1]
        rows = None if self.skew is None else self.skew.rows
        super().__init__(owned, rows)
        self.ties: Ties | None = None
        if ties:
            from dolfin_elastic.problem.constraints.ties.ties import Ties  # and all of scipy.sparse

            held = np.zeros(size, dtype=bool)
            held[self.prescribed_dofs] = held[self.skew_dofs] = True
            self.ties = Ties(body, V, ties, held, axisymmetric=axis)
            super().__init__(owned, rows, self.ties.row_products)
        self._t, self._default = 0.0, CONSTANT

    def _skew(self, prescribed: PrescribedComponents, off_axis: BoolArray) -> SkewNodes | None:
        """All components at nodes with a direction that is no axis. Collective."""
        if not total(self._V.mesh.comm, int(off_axis.sum())):
            return None
        check_rigid_surfaces(prescribed.components, off_axis, self._V.mesh.comm)
        return SkewNodes(
            [component.at(off_axis[component.nodes]) for component in prescribed.components],
            size=self._V.dofmap.index_map.size_local,
            x=self._x,
            dim=self._bs,
        )

    def _dofs_of(self, label: str, size: int) -> IndexArray:
        """Owned entries of the supports with this label, sorted."""
        result: list[IndexArray] = [np.empty(0, np.int32)]
        for entry in self._entries:
            support = entry.component.support
            if support is not None and support.label == label:
                result.append(entry.dofs[entry.dofs < size])
        return np.sort(np.concatenate(result))

    def set_time(self, t: float, default: Amplitude = CONSTANT) -> None:
        """Sets the values of time t. Not collective.

        Args:
            t: Time [s], or load parameter.
            default: Amplitude of supports that name none.
        """
        self._t, self._default = t, default
        self._evaluate(self._entries)
        if self.skew is not None:
            self.values.x.array.reshape(-1, self._bs)[self.skew.nodes] = self.skew.at(t, default)

    @np.errstate(all="ignore")  # `check_finite` raises where there is no value
    def _evaluate(self, entries: Iterable[PrescribedDofs]) -> None:
        for entry in entries:
            if entry.component.support is not None:
                values = entry.component.values(self._x, self._t, self._default)
                self.values.x.array[entry.dofs] = entry.signs * values

    # --- rigid surfaces ---

    def update_motion(self, motion: RigidMotion) -> None:
        """Takes over changed degrees of freedom of a rigid surface. Not collective."""
        self._evaluate(self._of(motion))

    def _of(self, motion: RigidMotion | Rotation) -> list[PrescribedDofs]:
        return [entry for entry in self._entries if entry.component.support is motion]

    def motion_forces(self, motion: RigidMotion) -> FloatArray:
        """Forces and moments on its free degrees of freedom at the present time [N, N m]."""
        return motion.applied(self._t, self._default)

    def motion_values(self, motion: RigidMotion) -> FloatArray:
        """All its degrees of freedom at the present time [m, rad]."""
        return motion.all_at(self._t, self._default)

    def motion_directions(self, motion: RigidMotion) -> tuple[IndexArray, FloatArray]:
        """Entries that it prescribes, owned and ghost, and their derivatives.

        Returns:
            Entries of the local vector, and du/dq, of shape (entries, degrees of freedom).
        """
        found_dofs: list[IndexArray] = [np.empty(0, np.int32)]
        result: list[FloatArray] = [np.empty((0, len(motion.names)))]
        for entry in self._of(motion):
            x = self._x[entry.component.nodes]
            D = motion.directions(x, self._t, self._default)
            result.append(entry.signs[:, None] * D[:, entry.component.which])
            found_dofs.append(entry.dofs)
        return np.concatenate(found_dofs), np.concatenate(result)

    def moment(
        self, motion: RigidMotion | Rotation, forces: FloatArray, u: FloatArray
    ) -> FloatArray:
        """Moment about the present reference point of the forces of constraint on it. Collective.

        Args:
            motion: The rigid surface, or a support that turns one.
            forces: At the owned entries of the displacement's space [N].
            u: The displacement's local array [m].
        """
        f = np.zeros((len(forces) // self._bs, 3))
        for holder, nodes, rows in self.reactions(forces):
            if holder is motion:
                f[nodes, : self._bs] += rows
        loaded = np.flatnonzero(np.any(f != 0.0, axis=1))
        arms = self._x[loaded] - motion.place(self._t, self._default)
        arms[:, : self._bs] += u.reshape(-1, self._bs)[loaded]
        return total(self._V.mesh.comm, np.cross(arms, f[loaded]).sum(axis=0))

    def values_at(self, moments: Sequence[float], default: Amplitude) -> list[FloatArray]:
        """Values at several times, owned and ghost; changes no state. Not collective.

        Args:
            moments: Times [s], or load parameters.
            default: Amplitude of supports that name none.
        """
        now, values = (self._t, self._default), self.values.x.array
        saved = values.copy()
        result = []
        for t in moments:
            self.set_time(t, default)
            result.append(values.copy())
        (self._t, self._default), values[:] = now, saved
        return result

    @property
    def targets(self) -> FloatArray:
        """Prescribed values of the present time, a new local vector."""
        return self.values.x.array.copy()

    def targets_at(self, times: Iterable[float]) -> list[FloatArray]:
        """The targets at several times [s]; sets the last of these times. Not collective."""
        result = []
        for t in times:
            self.set_time(t)
            result.append(self.targets)
        return result

    def nodes_combined(self) -> IndexArray:
        """Local nodes whose entries are combined with others."""
        none = np.empty(0, dtype=np.int32)
        skew = none if self.skew is None else self.skew.nodes
        return np.union1d(skew, none if self.ties is None else self.ties.nodes).astype(np.int32)

    def reactions(
        self, forces: FloatArray, tied: FloatArray | None = None
    ) -> Iterator[tuple[Holder, IndexArray, FloatArray]]:
        """What holds the body, owned nodes and the forces on them, shape (nodes, dim).

        By rows: each support comes once for each of its components.  Not collective.

        Args:
            forces: Out of balance, owned entries of the displacement [N].
            tied: The same on `tied_dofs`, without ties; None: ties are left out.
        """
        for entry in self._entries:
            if (support := entry.component.support) is not None:
                yield support, *self._along_axes(entry.dofs[entry.dofs < len(forces)], forces)
        if self.skew is not None:
            yield from self.skew.reactions(forces)
        if self.ties is not None and tied is not None:
            for surfaces, dofs, passed in self.ties.passed_forces(tied):
                acting = np.zeros(len(forces))
                acting[dofs] = passed
                yield surfaces, *self._along_axes(dofs, acting)

    def levers(self, x: FloatArray) -> FloatArray:
        """From what tied entries follow to where they are [m], shape (tied, dim). Collective.

        With a gap between the surfaces the forces of a tie have a couple, and so they have where a
        support holds some components only, and the rows of the others lead to other nodes.

        Args:
            x: Places of the owned nodes where moments balance, shape (nodes, dim) [m].
        """
        assert self._product is not None
        return x[self.tied_dofs // self._bs] - self._product.times(np.repeat(x, self._bs, axis=0))

    def factors(self, numbers: IntArray) -> tuple[IntArray, IntArray, FloatArray]:
        """See `Ties`; asked for where there are ties. Collective."""
        assert self.ties is not None
        free = self.free_directions(self.ties.dofs.count, self._bs)
        return self.ties.factors(free, numbers)

    def _along_axes(self, dofs: IndexArray, forces: FloatArray) -> tuple[IndexArray, FloatArray]:
        """Nodes and forces of entries."""
        result = np.zeros((len(dofs), self._bs))
        result[np.arange(len(dofs)), dofs % self._bs] = forces[dofs]
        return dofs // self._bs, result

    def check_finite(self) -> None:
        """Raises on all ranks when a formula gave no finite number. Collective."""
        comm = self._V.mesh.comm
        if not total(comm, int((~np.isfinite(self.targets)).sum())):
            return
        first = first_of(comm, self._bad())
        where, at = "support", "some nodes"  # skew ones, whose values belong to several supports
        if first is not None:
            where, at = f"support '{first[0]}'", f"({', '.join(f'{x:.6g}' for x in first[1])}) m"
        raise InputError(
            f"the prescribed displacement is not finite at {at} at t = {self._t:g}",
            where=where,
            expected="a formula that gives a number at every point and time",
        )

    def _bad(self) -> list[tuple[str, tuple[float, ...]]]:
        """Labels of supports whose entries have no value, each with the lowest place of them."""
        result: list[tuple[str, tuple[float, ...]]] = []
        for label, entries in self.reaction_dofs.items():
            nodes = entries[~np.isfinite(self.values.x.array[entries])] // self._bs
            coordinates = self._x[nodes, : self._bs].round(12) + 0.0
            if len(coordinates):
                result.append((label, min(tuple(float(c) for c in row) for row in coordinates)))
        return result
