"""Displacements that supports prescribe, as one set of boundary values."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfin_elastic.errors import InputError
from dolfin_elastic.formulas import Formula
from dolfin_elastic.meshes.body import Body, cell_size
from dolfin_elastic.model.components import Component
from dolfin_elastic.model.curves import Amplitude
from dolfin_elastic.model.supports import Support
from dolfin_elastic.parallel import total

Dofs = npt.NDArray[np.int32]
log = logging.getLogger("dolfin_elastic")


class Prescribed:
    """All prescribed displacement components of a body.

    Where supports meet, the later one holds.

    Args:
        body: The mesh and its names.
        V: Space of the displacement.
        supports: What is prescribed.
        axis: The body is axisymmetric: nothing leaves the axis.

    Attributes:
        values: Function whose entries at the constrained dofs are the prescribed values.
        bcs: One DOLFINx condition a component, ready for assembly.
        dofs: Constrained entries of the local vector, owned and ghost, sorted, unrolled.
        owned: Those of them that this rank owns.
        moving: Support's label to the owned entries it holds: its reaction is their sum.
    """

    def __init__(
        self,
        body: Body,
        V: fem.FunctionSpace,
        supports: Sequence[Support],
        *,
        axis: bool = False,
    ) -> None:
        self.values = fem.Function(V)
        self._V = V
        self._x = V.tabulate_dof_coordinates()
        self._bs = V.dofmap.index_map_bs
        self._entries = [self._of(body, support) for support in supports]
        self._give_to_the_later(body)
        on_axis = self._on_axis(body) if axis else np.empty(0, dtype=np.int32)
        for k, (support, parts) in enumerate(self._entries):  # nothing leaves the axis
            self._entries[k] = (support, [np.setdiff1d(part, on_axis) for part in parts])
        dofs = [dofs for entry in self._entries for dofs in entry[1]]
        if axis:
            dofs.append(on_axis)
        self.dofs = np.unique(np.concatenate(dofs)) if dofs else np.empty(0, dtype=np.int32)
        owned_size = V.dofmap.index_map.size_local * self._bs
        self.owned = self.dofs[self.dofs < owned_size]
        self.bcs = [self._condition(i) for i in range(self._bs)] if dofs else []
        self.moving = self._reactions_of(owned_size)
        self._t = 0.0

    def _of(self, body: Body, support: Support) -> tuple[Support, list[Dofs]]:
        """Unrolled dofs of each prescribed component. Collective."""
        values = support.values_in(self._bs)
        facets = np.unique(np.concatenate([body.surface(name) for name in support.surfaces]))
        nodes = fem.locate_dofs_topological(self._V, body.mesh.topology.dim - 1, facets)
        nodes = np.sort(nodes).astype(np.int32)
        empty = np.empty(0, dtype=np.int32)
        return support, [
            empty if value is None else nodes * self._bs + i for i, value in enumerate(values)
        ]

    def _on_axis(self, body: Body) -> Dofs:
        """Radial entries on the axis of an axisymmetric body, which stay at zero."""
        nodes = np.flatnonzero(self._x[:, 0] < 1e-9 * cell_size(body))
        return (nodes * self._bs).astype(np.int32)

    def _give_to_the_later(self, body: Body) -> None:
        """Takes from each support the dofs that a later one prescribes too."""
        taken: Dofs = np.empty(0, dtype=np.int32)
        for k in reversed(range(len(self._entries))):
            support, parts = self._entries[k]
            kept = [np.setdiff1d(part, taken) for part in parts]
            taken = np.union1d(taken, np.concatenate(parts)).astype(np.int32)
            self._entries[k] = (support, kept)

    def _condition(self, i: int) -> fem.DirichletBC:
        dofs = self.dofs[self.dofs % self._bs == i]
        return fem.dirichletbc(self.values, [dofs, dofs], self._V.sub(i))

    def _reactions_of(self, owned_size: int) -> dict[str, Dofs]:
        held: dict[str, list[Dofs]] = {}
        for support, parts in self._entries:
            held.setdefault(support.label, []).extend(parts)
        return {
            label: np.sort(dofs[dofs < owned_size])
            for label, parts in held.items()
            for dofs in [np.concatenate(parts)]
        }

    def pin(self, dofs: Dofs, owned: Dofs) -> None:
        """Holds the unknowns of a periodic cell's vertex, where there are no supports.

        Args:
            dofs: Local entries that are these unknowns.
            owned: One of them for each unknown that this rank owns.
        """
        self.dofs, self.owned = np.sort(dofs), owned

    def move_to(self, t: float, default: Amplitude) -> None:
        """Sets the values of time t. Not collective.

        Args:
            t: Time [s], or load parameter.
            default: Amplitude of supports that name none.
        """
        self._t = t
        for support, parts in self._entries:
            scale = (support.amplitude or default).at(t)
            values = support.values_in(self._bs)
            for i, (dofs, value) in enumerate(zip(parts, values, strict=True)):
                if value is not None and len(dofs):
                    self.values.x.array[dofs] = scale * self._at(value, (dofs - i) // self._bs, t)

    def _at(self, value: Component, nodes: Dofs, t: float) -> float | npt.NDArray[np.float64]:
        if isinstance(value, Formula):
            x, y, z = self._x[nodes].T
            return value.evaluate(x=x, y=y, z=z, t=t)
        return float(value or 0.0)

    def check_finite(self) -> None:
        """Raises on all ranks when a formula gave no finite number. Collective."""
        bad = int(
            total(self._V.mesh.comm, int(~np.isfinite(self.values.x.array[self.owned]).all()))
        )
        if bad:
            raise InputError(
                f"a prescribed displacement is not finite at some nodes at t = {self._t:g}",
                where="support",
            )
