"""Displacement components that supports prescribe, with their nodes: found once for a body."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.errors import InputError, keyed
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body, cell_size
from dolfin_elastic.model.amplitude import CONSTANT, Amplitude
from dolfin_elastic.model.supports.displacement import NORMAL, PrescribingSupport, Restraint
from dolfin_elastic.model.supports.rigid_surface import Rigid
from dolfin_elastic.model.values import Component, FieldsAt, fields_of
from dolfin_elastic.problem.constraints.normals import surface_normals, unit_normals
from dolfin_elastic.problem.constraints.rigid_motion import RigidMotion
from dolfin_elastic.problem.mesh_fields import check_fields, check_finite, fields_at_nodes
from dolfin_elastic.problem.spaces import part_nodes

IN_PLANE = 0.7
"""Component of a normal in a plane of symmetry from which the mirrored surface is smooth there."""


def without_round_off(x: FloatArray, size: float) -> FloatArray:
    """Places rounded to 14 digits of the body's size.

    Interpolated to a node, x = 0 comes out as 1e-17, where "1/x" has a value.

    Args:
        x: Places, shape (n, 3) [m].
        size: Of the body [m].
    """
    if not size > 0.0:
        return x
    return np.asarray(np.round(x, 14 - math.ceil(math.log10(size))) + 0.0)


@dataclass(frozen=True)
class PrescribedComponent:
    """One displacement component that one support prescribes at some nodes.

    Attributes:
        support: The support; None: the axis of an axisymmetric body.
        which: Number of the component, or `NORMAL`.
        nodes: Local nodes, owned and ghost, sorted.
        directions: Unit vectors along which it is measured, of shape (nodes, dim).
        curved: The directions are normals of a curved surface.
        fields: Gives the fields of the mesh at all local nodes; None: none is prescribed.
    """

    support: PrescribingSupport | RigidMotion | None
    which: int
    nodes: IndexArray
    directions: FloatArray
    curved: bool = False
    fields: FieldsAt | None = None

    def at(self, chosen: BoolArray) -> PrescribedComponent:
        """The same at some of its nodes."""
        return replace(self, nodes=self.nodes[chosen], directions=self.directions[chosen])

    def values(self, x: FloatArray, t: float, default: Amplitude = CONSTANT) -> FloatArray:
        """Prescribed displacement along each direction [m].

        Called on ranks without nodes, too: an amplitude fails on all of them or on none.

        Args:
            x: Reference places of all local nodes, of shape (n, 3) [m].
            t: Time [s], or load parameter.
            default: Amplitude of a support that names none.

        Raises:
            InputError: With the support's label.
        """
        values = np.zeros(len(self.nodes))
        if self.support is not None:
            try:
                values[:] = self._given(x[self.nodes], t, default)
            except InputError as error:
                raise error.at(f"support '{self.support.label}'") from None
        return values

    def _given(self, x: FloatArray, t: float, default: Amplitude) -> FloatArray | float:
        support, fields = self.support, self.fields
        if isinstance(support, PrescribingSupport) and fields is not None:
            own = partial(_rows, fields, self.nodes)
            return support.at(self.which, x, t, default, own)
        return 0.0 if support is None else support.at(self.which, x, t, default)


def _rows(fields: FieldsAt, nodes: IndexArray, name: str) -> FloatArray:
    return fields(name)[nodes]


@dataclass(frozen=True)
class PrescribedDofs:
    """The dofs of a component along an axis.

    Attributes:
        component: What is prescribed, at the nodes of `dofs`.
        dofs: Entries of the displacement's local array, owned and ghost.
        signs: Of the direction along the axis, 1 or -1.
    """

    component: PrescribedComponent
    dofs: IndexArray
    signs: FloatArray


class PrescribedComponents:
    """All components that supports prescribe.  Collective to make.

    Args:
        supports: All supports; springs and dashpots are ignored.
        coordinates: Of the space's local nodes [m], shape (nodes, 3).
        axisymmetric: The radial displacement of nodes on the axis is zero.

    Attributes:
        components: In the order of the supports.
        rigid_motions: Of rigid surfaces.
        labels: Of the supports that prescribe anything.

    Raises:
        InputError: A support that this body cannot have, with its key.
    """

    def __init__(
        self,
        body: Body,
        V: fem.FunctionSpace,
        supports: Sequence[Restraint],
        *,
        coordinates: FloatArray,
        axisymmetric: bool,
    ) -> None:
        self._body, self._V, self._axisymmetric = body, V, axisymmetric
        self._x, self._dim = coordinates, V.dofmap.index_map_bs
        self.components: list[PrescribedComponent] = []
        self.rigid_motions: list[RigidMotion] = []
        labels = []
        for support in supports:
            if isinstance(support, Rigid):
                self._add_rigid(support)
            elif isinstance(support, PrescribingSupport):
                self._add(support)
            else:
                continue
            labels.append(support.label)
        self.labels = tuple(dict.fromkeys(labels))
        if axisymmetric:
            on_axis = np.flatnonzero(self._x[:, 0] < 1e-9 * cell_size(body))
            self.components.append(self._along_axis(None, 0, on_axis.astype(np.int32)))
        if any(component.curved for component in self.components):
            self._turn_into_planes()

    def _add(self, support: PrescribingSupport) -> None:
        which = support.prescribed_components(self._dim)
        fields = self._fields(support, [support.component(i) for i in which])
        if which == (NORMAL,):
            self.components += [
                self._along_normal(support, name, fields) for name in support.surfaces
            ]
            return
        if self._axisymmetric and support.kind == "rotation":
            raise InputError(
                "an axisymmetric body cannot be turned",
                where=f"support '{support.label}'.kind",
                expected='"displacement"',
            )
        nodes = self._nodes(support)
        self.components += [self._along_axis(support, i, nodes, fields) for i in which]

    def _fields(self, support: PrescribingSupport, values: Sequence[Component]) -> FieldsAt | None:
        """Fields at all nodes, with values at those of a support; None without any. Collective."""
        if not (given := fields_of(values)):
            return None
        with keyed(f"support '{support.label}'.displacement"):
            check_fields(self._body, values)
            fields, nodes = fields_at_nodes(self._body, self._V), self._nodes(support)
            table = [fields(one.field)[nodes].ravel() for one in given]
            check_finite(self._body, values, np.concatenate(table))
        return fields

    def _add_rigid(self, support: Rigid) -> None:
        where = f"support '{support.label}'"
        if self._axisymmetric:
            raise InputError(
                "an axisymmetric body has no rigid surface",
                where=f"{where}.kind",
                expected='"displacement"',
            )
        if any(motion.label == support.label for motion in self.rigid_motions):
            raise InputError(
                "another rigid surface has this name",
                where=f"{where}.name",
                expected="a name of its own",
            )
        motion, nodes = RigidMotion(support, self._body), self._nodes(support)
        self.rigid_motions.append(motion)
        self.components += [self._along_axis(motion, i, nodes) for i in range(self._dim)]

    def _nodes(self, support: Restraint) -> IndexArray:
        """Nodes of its parts, owned and ghost, sorted. Collective."""
        result = [part_nodes(self._body, self._V, name) for name in support.surfaces]
        return np.unique(np.concatenate(result)).astype(np.int32)

    def _along_axis(
        self,
        support: PrescribingSupport | RigidMotion | None,
        i: int,
        nodes: IndexArray,
        fields: FieldsAt | None = None,
    ) -> PrescribedComponent:
        directions = np.tile(np.eye(self._dim)[i], (len(nodes), 1))
        return PrescribedComponent(support, i, nodes, directions, fields=fields)

    def _along_normal(
        self, support: PrescribingSupport, name: str, fields: FieldsAt | None
    ) -> PrescribedComponent:
        """The component along a surface's normal. Collective."""
        normals = surface_normals(self._body, self._V, name)
        if support.needs_flat and not normals.flat:
            deviation = (
                f"its nodes lie {self._body.unit.length(normals.unevenness)} apart across it"
                if np.isfinite(normals.unevenness)
                else "it is closed"
            )
            raise InputError(
                f"the surface '{name}' is not flat: {deviation}",
                where=f"support '{support.label}'.on",
                expected='a plane of symmetry is flat; kind = "normal" takes any surface',
            )
        return PrescribedComponent(
            support, NORMAL, normals.nodes, normals.normals, not normals.flat, fields
        )

    def _turn_into_planes(self) -> None:
        """Projects normals of curved surfaces onto adjacent planes of symmetry and the axis.

        The mirrored surface continues beyond a plane of symmetry, so its normal lies in the plane.
        The mean normal at a node, from the facets on this side alone, deviates from the plane by
        half the angle between facets, which would prevent sliding along the plane.
        """
        for plane in [c for c in self.components if c.support is None or c.support.needs_flat]:
            across = np.zeros((len(self._x), self._dim))
            across[plane.nodes] = plane.directions
            for k, component in enumerate(self.components):
                if component.curved:
                    n, t = component.directions, across[component.nodes]
                    n = n - np.einsum("ni,ni->n", n, t)[:, None] * t
                    length = np.linalg.norm(n, axis=1, keepdims=True)
                    turned = np.where(
                        length > IN_PLANE, n / np.maximum(length, IN_PLANE), component.directions
                    )
                    self.components[k] = replace(component, directions=unit_normals(turned))

    @property
    def off_axis(self) -> BoolArray:
        """Local nodes at which a direction is not along an axis."""
        nodes = np.zeros(len(self._x), dtype=bool)
        for c in self.components:
            nodes[c.nodes[np.max(np.abs(c.directions), axis=1, initial=0.0) < 1.0]] = True
        return nodes

    def along_axes(self, chosen: BoolArray) -> list[PrescribedDofs]:
        """Dofs of the components at nodes where all directions are along axes.

        Where supports meet, the later one prescribes the dof.

        Args:
            chosen: Which local nodes.
        """
        result: list[PrescribedDofs] = []
        taken: IndexArray = np.empty(0, dtype=np.int32)
        for component in reversed(self.components):
            here = component.at(chosen[component.nodes])
            axis = np.argmax(np.abs(here.directions), axis=1)
            dofs = (here.nodes * self._dim + axis).astype(np.int32)
            free = ~np.isin(dofs, taken)
            taken = np.union1d(taken, dofs).astype(np.int32)
            signs = here.directions[np.flatnonzero(free), axis[free]]
            result.append(PrescribedDofs(here.at(free), dofs[free], signs))
        return result[::-1]
