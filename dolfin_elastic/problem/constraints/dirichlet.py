"""Displacements that supports prescribe, as one set of boundary values."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import first_of, total
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body, cell_size
from dolfin_elastic.model.amplitude import CONSTANT, Amplitude
from dolfin_elastic.model.supports.displacement import NORMAL, PrescribingSupport, Restraint
from dolfin_elastic.model.supports.rigid_surface import Rigid
from dolfin_elastic.problem.constraints.normals import sheet, tidy
from dolfin_elastic.problem.constraints.rigid_motion import RigidMotion
from dolfin_elastic.problem.constraints.skew import SkewConstraints, SkewSupport

log = logging.getLogger("dolfin_elastic")

MIRRORED = 0.7
"""Share of a normal that has to lie in a plane of symmetry for the surface to go on beyond it."""


class DirichletConditions:
    """All prescribed displacements of a body.

    Where supports meet, the later one holds.  Nodes that are held along axes only are constrained
    entry by entry; all others are `skew`.

    Args:
        body: The mesh and its names.
        V: Space of the displacement.
        supports: What is prescribed; those that prescribe nothing are passed over.
        axis: The body is axisymmetric: nothing leaves the axis.
        pinned: Of a periodic cell, which has no supports: local entries that are unknowns of its
            fixed vertex, and one of them for each such unknown that this rank owns.

    Attributes:
        values: Function whose entries at the constrained dofs are the prescribed values.
        bcs: One DOLFINx condition a component, ready for assembly.
        dofs: Constrained entries of the local vector, owned and ghost, sorted, unrolled.
        owned: Those of them that this rank owns.
        reaction_dofs: Support's label to its owned entries: its reaction is the sum of the forces
            there, and of those that `skew` has of it.
        skew: Nodes held along other directions; None if no rank has any.
        rigid_motions: Of rigid surfaces.
    """

    def __init__(
        self,
        body: Body,
        V: fem.FunctionSpace,
        supports: Sequence[Restraint],
        *,
        axis: bool = False,
        pinned: tuple[IndexArray, IndexArray] | None = None,
    ) -> None:
        self.values = fem.Function(V)
        self._V = V
        self._x = V.tabulate_dof_coordinates()
        self._bs = V.dofmap.index_map_bs
        self.rigid_motions: list[RigidMotion] = []
        chosen = [s for s in supports if isinstance(s, PrescribingSupport | Rigid)]
        holds = [
            hold
            for support in chosen
            for hold in (
                self._rigid(body, support, axis)
                if isinstance(support, Rigid)
                else self._of(body, support, axis)
            )
        ]
        if axis:
            holds.append(self._on_axis(body))
        self.skew, holds = self._split(body, self._mirrored(holds))
        self._entries = self._given_to_the_later(holds)
        self._labels = list(dict.fromkeys(support.label for support in chosen))
        dofs = [dofs for _, dofs, _ in self._entries]
        self.dofs = np.unique(np.concatenate(dofs)) if dofs else np.empty(0, dtype=np.int32)
        owned_size = V.dofmap.index_map.size_local * self._bs
        self.owned = self.dofs[self.dofs < owned_size]
        self.bcs = [self._condition(i) for i in range(self._bs)] if dofs else []
        self.reaction_dofs = self._reactions_of(owned_size)
        if pinned is not None:
            self.dofs, self.owned = np.sort(pinned[0]), pinned[1]
        self._t, self._default = 0.0, CONSTANT

    def _rigid(self, body: Body, support: Rigid, axis: bool) -> list[SkewSupport]:
        """What a rigid surface holds. Collective."""
        where = f"support '{support.label}'"
        if axis:
            raise InputError(
                "an axisymmetric body has no rigid surface",
                where=f"{where}.kind",
                expected='"displacement"',
            )
        if any(motion.label == support.label for motion in self.rigid_motions):
            raise InputError(
                "another rigid surface has this name", where=f"{where}.name", expected="its own"
            )
        motion = RigidMotion(support, body)
        self.rigid_motions.append(motion)
        return [self._along(motion, i, self._nodes(body, support)) for i in range(self._bs)]

    def _nodes(self, body: Body, support: Restraint) -> IndexArray:
        """Nodes of its surfaces, owned and ghost, sorted. Collective."""
        facets = np.unique(np.concatenate([body.surface(name) for name in support.surfaces]))
        nodes = fem.locate_dofs_topological(self._V, body.mesh.topology.dim - 1, facets)
        return np.sort(nodes).astype(np.int32)

    def _of(self, body: Body, support: PrescribingSupport, axis: bool) -> list[SkewSupport]:
        """What a support holds. Collective."""
        which = support.prescribed_components(self._bs)
        if which == (NORMAL,):
            return [self._across(body, support, name) for name in support.surfaces]
        if axis and support.kind == "rotation":
            raise InputError(
                "an axisymmetric body cannot be turned",
                where=f"support '{support.label}'.kind",
                expected='"displacement"',
            )
        nodes = self._nodes(body, support)
        return [self._along(support, i, nodes) for i in which]

    def _along(
        self, support: PrescribingSupport | RigidMotion | None, i: int, nodes: IndexArray
    ) -> SkewSupport:
        return SkewSupport(support, i, nodes, np.tile(np.eye(self._bs)[i], (len(nodes), 1)))

    def _across(self, body: Body, support: PrescribingSupport, name: str) -> SkewSupport:
        """What is held along a surface's normal. Collective."""
        found = sheet(body, self._V, name)
        if support.needs_flat and not found.flat:
            deviation = (
                f"its nodes lie {found.unevenness:.3g} m apart across it"
                if np.isfinite(found.unevenness)
                else "it is closed"
            )
            raise InputError(
                f"the surface '{name}' is not flat: {deviation}",
                where=f"support '{support.label}'.on",
                expected='a plane of symmetry is flat; kind = "normal" takes any surface',
            )
        return SkewSupport(support, NORMAL, found.nodes, found.normals, not found.flat)

    def _on_axis(self, body: Body) -> SkewSupport:
        """Radial entries on the axis of an axisymmetric body, which stay at zero."""
        nodes = np.flatnonzero(self._x[:, 0] < 1e-9 * cell_size(body))
        return self._along(None, 0, nodes.astype(np.int32))

    def _mirrored(self, holds: list[SkewSupport]) -> list[SkewSupport]:
        """Curved surfaces go on beyond planes of symmetry and the axis: their normals lie in them.

        From the facets on this side alone the mean normal leans towards them.
        """
        planes = [h for h in holds if h.support is None or h.support.needs_flat]
        for plane in planes:
            across = np.zeros((len(self._x), self._bs))
            across[plane.nodes] = plane.directions
            for k, hold in enumerate(holds):
                if hold.curved:
                    n = hold.directions
                    t = across[hold.nodes]
                    n = n - np.einsum("ni,ni->n", n, t)[:, None] * t
                    length = np.linalg.norm(n, axis=1, keepdims=True)
                    n = np.where(
                        length > MIRRORED, n / np.maximum(length, MIRRORED), hold.directions
                    )
                    holds[k] = replace(hold, directions=tidy(n))
        return holds

    def _split(
        self, body: Body, holds: list[SkewSupport]
    ) -> tuple[SkewConstraints | None, list[SkewSupport]]:
        """Takes out all that happens at nodes with a direction that is no axis. Collective."""
        is_skew = np.zeros(len(self._x), dtype=bool)
        for hold in holds:
            is_skew[hold.nodes[np.max(np.abs(hold.directions), axis=1, initial=0.0) < 1.0]] = True
        if not total(body.comm, int(is_skew.sum())):
            return None, holds
        self._check_apart(holds, is_skew)
        skew = SkewConstraints(
            [hold.of(is_skew[hold.nodes]) for hold in holds],
            size=self._V.dofmap.index_map.size_local,
            x=self._x,
            dim=self._bs,
        )
        return skew, [hold.of(~is_skew[hold.nodes]) for hold in holds]

    def _check_apart(self, holds: list[SkewSupport], is_skew: BoolArray) -> None:
        """A rigid surface with unknowns meets no node that is held across the axes. Collective."""
        for hold in holds:
            support = hold.support
            free = isinstance(support, RigidMotion) and len(support.free) > 0
            met = int(is_skew[hold.nodes].sum()) if free else 0
            if total(self._V.mesh.comm, met):
                assert support is not None
                raise InputError(
                    "a rigid surface with free motion meets another support whose direction is "
                    "not along an axis",
                    where=f"support '{support.label}'.on",
                    expected="surfaces that share no edge with it",
                )

    def _given_to_the_later(
        self, holds: list[SkewSupport]
    ) -> list[tuple[SkewSupport, IndexArray, FloatArray]]:
        """Holds with the dofs that no later one prescribes too, and the signs of the directions."""
        entries = []
        taken: IndexArray = np.empty(0, dtype=np.int32)
        for hold in reversed(holds):
            axis = np.argmax(np.abs(hold.directions), axis=1)
            dofs = (hold.nodes * self._bs + axis).astype(np.int32)
            kept = ~np.isin(dofs, taken)
            taken = np.union1d(taken, dofs).astype(np.int32)
            signs = hold.directions[np.flatnonzero(kept), axis[kept]]
            entries.append((hold.of(kept), dofs[kept], signs))
        return entries[::-1]

    def _condition(self, i: int) -> fem.DirichletBC:
        dofs = self.dofs[self.dofs % self._bs == i]
        return fem.dirichletbc(self.values, [dofs, dofs], self._V.sub(i))

    def _reactions_of(self, owned_size: int) -> dict[str, IndexArray]:
        held: dict[str, list[IndexArray]] = {label: [] for label in self._labels}
        for hold, dofs, _ in self._entries:
            if hold.support is not None:
                held[hold.support.label].append(dofs)
        empty = np.empty(0, dtype=np.int32)
        return {
            label: np.sort(dofs[dofs < owned_size])
            for label, parts in held.items()
            for dofs in [np.concatenate([empty, *parts])]
        }

    def set_time(self, t: float, default: Amplitude = CONSTANT) -> None:
        """Sets the values of time t. Not collective.

        Args:
            t: Time [s], or load parameter.
            default: Amplitude of supports that name none.
        """
        self._t, self._default = t, default
        self._evaluate(t, default)

    @np.errstate(all="ignore")  # what has no value is told by `check_finite`
    def _evaluate(self, t: float, default: Amplitude, only: RigidMotion | None = None) -> None:
        for hold, dofs, signs in self._entries:
            if only is not None and hold.support is not only:
                continue
            if hold.support is not None:
                self.values.x.array[dofs] = signs * hold.goals(self._x, t, default)
        if self.skew is not None and only is None:
            self.skew.set_time(t, default)

    # --- rigid surfaces ---

    def update_motion(self, motion: RigidMotion) -> None:
        """Takes over changed degrees of freedom of a rigid surface. Not collective."""
        self._evaluate(self._t, self._default, motion)

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
        for hold, dofs, signs in self._entries:
            if hold.support is motion:
                D = motion.directions(self._x[hold.nodes], self._t, self._default)
                found.append(signs[:, None] * D[:, hold.which])
                found_dofs.append(dofs)
        return np.concatenate(found_dofs), np.concatenate(found)

    def moment(self, motion: RigidMotion, forces: FloatArray, u: FloatArray) -> FloatArray:
        """Moment about the present reference point of the forces by which it holds. Collective.

        Args:
            motion: The rigid surface.
            forces: At the owned entries of the displacement's space [N].
            u: The displacement's local array [m].
        """
        f = np.zeros((len(forces) // self._bs, 3))
        for hold, dofs, _ in self._entries:
            if hold.support is motion:
                own = dofs < len(forces)
                f[hold.nodes[own], hold.which] = forces[dofs[own]]
        if self.skew is not None:
            out = forces.reshape(-1, self._bs)[self.skew.nodes[: self.skew.count]]
            for support, nodes, leaning in self.skew.reactions(out):
                if support is motion:
                    f[nodes, : self._bs] += leaning
        held = np.flatnonzero(np.any(f != 0.0, axis=1))
        arms = self._x[held] - motion.place(self._t, self._default)
        arms[:, : self._bs] += u.reshape(-1, self._bs)[held]
        return total(self._V.mesh.comm, np.cross(arms, f[held]).sum(axis=0))

    def values_at(self, moments: Sequence[float], default: Amplitude) -> list[FloatArray]:
        """Values at some moments, owned and ghost; all is left as it was. Not collective.

        Args:
            moments: Times [s], or load parameters.
            default: Amplitude of supports that name none.
        """
        now, values = (self._t, self._default), self.values.x.array
        kept = values.copy()
        target = None if self.skew is None else self.skew.target.copy()
        found = []
        for t in moments:
            self.set_time(t, default)
            found.append(values.copy())
        (self._t, self._default), values[:] = now, kept
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
        """The targets of some times [s], the last of which is the present one then. Local."""
        found = []
        for t in times:
            self.set_time(t)
            found.append(self.targets)
        return found

    def extract(self, array: FloatArray) -> FloatArray:
        """What a local vector of the displacement's space has where `targets` are prescribed."""
        values = array[self.owned]
        if self.skew is None:
            return values
        nodes = self.skew.nodes[: self.skew.count]
        rows = self.skew.constrained_part(array.reshape(-1, self._bs)[nodes])
        return np.concatenate([values, rows.reshape(-1)])

    def impose(self, array: FloatArray, values: npt.NDArray[np.floating[Any]]) -> None:
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
        where, at = "support", "some nodes"  # held along an oblique direction
        if found is not None:
            where, at = f"support '{found[0]}'", f"({', '.join(f'{x:.6g}' for x in found[1])}) m"
        raise InputError(
            f"the prescribed displacement is not finite at {at} at t = {self._t:g}", where=where
        )

    def _bad(self) -> list[tuple[str, tuple[float, ...]]]:
        """Labels of supports whose entries have no value, each with the lowest place of them."""
        found = []
        for label, entries in self.reaction_dofs.items():
            nodes = entries[~np.isfinite(self.values.x.array[entries])] // self._bs
            places = self._x[nodes, : self._bs].round(12) + 0.0
            if len(places):
                found.append((label, min(map(tuple, places.tolist()))))
        return found
