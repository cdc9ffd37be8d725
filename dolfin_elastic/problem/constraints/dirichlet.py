"""Dirichlet conditions: the prescribed displacements of a body, evaluated step by step."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import first_of, total
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body, span
from dolfin_elastic.model.amplitude import CONSTANT, Amplitude
from dolfin_elastic.model.supports.displacement import Restraint, Rotation
from dolfin_elastic.problem.constraints.prescribed import (
    PrescribedComponents,
    PrescribedDofs,
    without_round_off,
)
from dolfin_elastic.problem.constraints.rigid_motion import RigidMotion
from dolfin_elastic.problem.constraints.skew import SkewConstraints, check_rigid_surfaces


class DirichletConditions:
    """All prescribed displacements of a body.  Collective to make.

    Where supports meet, the later one holds.  Nodes whose prescribed directions are along axes are
    constrained entry by entry; all others are `skew`.

    Args:
        supports: All supports; springs and dashpots are ignored.
        places: Of the space's local nodes [m], shape (nodes, 3).
        axis: The body is axisymmetric: the radial displacement of nodes on the axis is zero.
        pinned: Of a periodic cell, which has no supports: local entries that are unknowns of its
            fixed vertex, and one of them for each such unknown that this rank owns.

    Attributes:
        values: Function whose entries at the constrained dofs are the prescribed values [m].
        bcs: The DOLFINx condition of all of them, ready for assembly; empty without supports.
        dofs: Constrained entries of the local vector, owned and ghost, sorted, unrolled.
        owned: Those of them that this rank owns.
        reaction_dofs: Support's label to its owned entries: its reaction is the sum of the forces
            there, and of those that `skew` has of it.
        skew: Nodes with other directions; None if no rank has any.
        rigid_motions: Of rigid surfaces.
    """

    def __init__(
        self,
        body: Body,
        V: fem.FunctionSpace,
        supports: Sequence[Restraint],
        *,
        places: FloatArray,
        axis: bool = False,
        pinned: tuple[IndexArray, IndexArray] | None = None,
    ) -> None:
        self.values = fem.Function(V)
        self._V, self._bs = V, V.dofmap.index_map_bs
        self._x = without_round_off(places, span(body))
        found = PrescribedComponents(body, V, supports, places=places, axisymmetric=axis)
        self.rigid_motions, off_axis = found.rigid_motions, found.off_axis
        self.skew = self._skew(found, off_axis)
        self._entries = found.along_axes(~off_axis)
        dofs = np.concatenate([np.empty(0, np.int32), *(entry.dofs for entry in self._entries)])
        self.dofs = np.unique(dofs).astype(np.int32)
        size = V.dofmap.index_map.size_local * self._bs
        self.owned = self.dofs[self.dofs < size]
        # Entries of the whole space: that of a component has a map of all cells of its own, and of
        # nodes DOLFINx 0.9 takes ghosts for its own (it compares them with the number of entries).
        pair = [self.dofs, self.dofs]
        self.bcs = [fem.dirichletbc(self.values, pair, V)] if self._entries else []
        self.reaction_dofs = {label: self._dofs_of(label, size) for label in found.labels}
        if pinned is not None:
            self.dofs, self.owned = np.sort(pinned[0]), pinned[1]
        self._t, self._default = 0.0, CONSTANT

    def _skew(self, found: PrescribedComponents, off_axis: BoolArray) -> SkewConstraints | None:
        """All components at nodes with a direction that is no axis. Collective."""
        if not total(self._V.mesh.comm, int(off_axis.sum())):
            return None
        check_rigid_surfaces(found.components, off_axis, self._V.mesh.comm)
        return SkewConstraints(
            [component.at(off_axis[component.nodes]) for component in found.components],
            size=self._V.dofmap.index_map.size_local,
            x=self._x,
            dim=self._bs,
        )

    def _dofs_of(self, label: str, size: int) -> IndexArray:
        """Owned entries of the supports with this label, sorted."""
        found: list[IndexArray] = [np.empty(0, np.int32)]
        for entry in self._entries:
            support = entry.component.support
            if support is not None and support.label == label:
                found.append(entry.dofs[entry.dofs < size])
        return np.sort(np.concatenate(found))

    def set_time(self, t: float, default: Amplitude = CONSTANT) -> None:
        """Sets the values of time t. Not collective.

        Args:
            t: Time [s], or load parameter.
            default: Amplitude of supports that name none.
        """
        self._t, self._default = t, default
        self._evaluate(self._entries)
        if self.skew is not None:
            self.skew.set_time(t, default)

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
        found: list[FloatArray] = [np.empty((0, len(motion.names)))]
        for entry in self._of(motion):
            x = self._x[entry.component.nodes]
            D = motion.directions(x, self._t, self._default)
            found.append(entry.signs[:, None] * D[:, entry.component.which])
            found_dofs.append(entry.dofs)
        return np.concatenate(found_dofs), np.concatenate(found)

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
        for entry in self._of(motion):
            own = entry.dofs < len(forces)
            f[entry.component.nodes[own], entry.component.which] = forces[entry.dofs[own]]
        if self.skew is not None:
            out = forces.reshape(-1, self._bs)[self.skew.nodes[: self.skew.count]]
            for support, nodes, along in self.skew.reactions(out):
                if support is motion:
                    f[nodes, : self._bs] += along
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
        target = None if self.skew is None else self.skew.target.copy()
        found = []
        for t in moments:
            self.set_time(t, default)
            found.append(values.copy())
        (self._t, self._default), values[:] = now, saved
        if self.skew is not None:
            self.skew.target[:] = target
        return found

    @property
    def targets(self) -> FloatArray:
        """All prescribed values of the present time at owned nodes, as one new vector."""
        values = self.values.x.array[self.owned]
        if self.skew is None:
            return values
        return np.concatenate([values, self.skew.target[: self.skew.count].reshape(-1)])

    def targets_at(self, times: Iterable[float]) -> list[FloatArray]:
        """The targets at several times [s]; sets the last of these times. Not collective."""
        found = []
        for t in times:
            self.set_time(t)
            found.append(self.targets)
        return found

    def extract(self, array: FloatArray) -> FloatArray:
        """Entries of a local vector of the displacement's space, in the layout of `targets`."""
        values = array[self.owned]
        if self.skew is None:
            return values
        nodes = self.skew.nodes[: self.skew.count]
        rows = self.skew.constrained_part(array.reshape(-1, self._bs)[nodes])
        return np.concatenate([values, rows.reshape(-1)])

    def impose(self, array: FloatArray, values: npt.NDArray[np.float32 | np.float64]) -> None:
        """Puts prescribed values into a local vector of the displacement's space.

        Args:
            array: Owned entries are changed.
            values: Like `targets`, whose time derivative serves for velocities.
        """
        array[self.owned] = values[: len(self.owned)]
        if self.skew is not None:
            nodes = self.skew.nodes[: self.skew.count]
            rows = array.reshape(-1, self._bs)
            wanted = values[len(self.owned) :].reshape(-1, self._bs)
            rows[nodes] = self.skew.free_part(rows[nodes]) + wanted

    def check_finite(self) -> None:
        """Raises on all ranks when a formula gave no finite number. Collective."""
        comm = self._V.mesh.comm
        if not total(comm, int((~np.isfinite(self.targets)).sum())):
            return
        found = first_of(comm, self._bad())
        where, at = "support", "some nodes"  # skew ones, whose values belong to several supports
        if found is not None:
            where, at = f"support '{found[0]}'", f"({', '.join(f'{x:.6g}' for x in found[1])}) m"
        raise InputError(
            f"the prescribed displacement is not finite at {at} at t = {self._t:g}",
            where=where,
            expected="a formula that gives a number at every place and time",
        )

    def _bad(self) -> list[tuple[str, tuple[float, ...]]]:
        """Labels of supports whose entries have no value, each with the lowest place of them."""
        found: list[tuple[str, tuple[float, ...]]] = []
        for label, entries in self.reaction_dofs.items():
            nodes = entries[~np.isfinite(self.values.x.array[entries])] // self._bs
            places = self._x[nodes, : self._bs].round(12) + 0.0
            if len(places):
                found.append((label, min(tuple(float(c) for c in row) for row in places)))
        return found
