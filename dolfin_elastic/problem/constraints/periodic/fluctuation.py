"""Unknowns of a periodic cell: the fluctuation about the macroscopic displacement."""

from __future__ import annotations

from collections.abc import Sequence

import basix.ufl
import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh
from ufl.core.expr import Expr
from ufl.finiteelement import AbstractFiniteElement

from dolfin_elastic.core.compat import collapsed
from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray
from dolfin_elastic.problem.constraints.periodic.dofmap import Field, MergedDofmap
from dolfin_elastic.problem.constraints.periodic.unit_cell import Cell
from dolfin_elastic.problem.spaces import AuxiliaryField, Unknowns


class Fluctuation(Unknowns):
    """Unknowns whose nodes on paired faces are merged; see `spaces.Unknowns`. Collective.

    The displacement u in V is the fluctuation w in U plus the macroscopic displacement, which
    `w_to_u` adds.

    Args:
        auxiliary_fields: Scalar fields beside it; they are periodic, too.
        cell: The macroscopic displacement, and which faces are one.
        groups: See `Unknowns`; on paired faces the pressures of the same group are one.

    Attributes:
        pinned: Local entries of V that are the fixed vertex or its images, and one of them for each
            unknown of the vertex that this rank owns.
    """

    def __init__(
        self,
        mesh: Mesh,
        degree: int,
        auxiliary_fields: Sequence[AuxiliaryField],
        cell: Cell,
        groups: IntArray | None = None,
    ) -> None:
        self.cell, self._dim = cell, int(mesh.geometry.dim)
        super().__init__(mesh, degree, auxiliary_fields, groups)
        self.pinned = self._pinned()
        self._unknown_places = cell.pairing.places(self.V, self._merged)

    @property
    def unknown_places(self) -> FloatArray:
        """Places [m] of the nodes of U, see `PeriodicPairing.places`."""
        return self._unknown_places

    def _pinned(self) -> tuple[IndexArray, IndexArray]:
        nodes = self.cell.pairing.corner_nodes(self.V, self._merged)
        new = self._merged.new[nodes]
        owned = nodes[new < self.U.dofmap.index_map.size_local]
        return self._unrolled(nodes), self._unrolled(owned[:1])

    def _unrolled(self, nodes: IndexArray) -> IndexArray:
        return (nodes[:, None] * self._dim + np.arange(self._dim, dtype=np.int32)).reshape(-1)

    def _spaces(
        self, mesh: Mesh, elements: Sequence[AbstractFiniteElement]
    ) -> tuple[fem.FunctionSpace, fem.FunctionSpace, fem.FunctionSpace, IndexArray]:
        pairing = self.cell.pairing
        if not self.auxiliary_fields:
            V = fem.functionspace(mesh, elements[0])
            self._merged = pairing.merged(V)
            return V, self._merged.space, self._merged.space, self._unrolled(self._merged.new)
        plain = fem.functionspace(mesh, basix.ufl.mixed_element(list(elements)))
        V, dofs = collapsed(plain.sub(0))
        dofs = np.asarray(dofs, dtype=np.int32)
        split = self._split_pressure(plain)
        space = plain
        if split is not None:
            space, dofs = split.space, split.new[dofs]
        fields = [Field(V, dofs.reshape(-1, self._dim))]
        for k, field in enumerate(self.auxiliary_fields, start=1):
            if field.continuous:
                Q, entries = collapsed(plain.sub(k))
                if split is None or field.name != "pressure":
                    fields.append(Field(Q, entries[:, None]))
                else:
                    fields.append(Field(Q, *split.of_entries(entries)))
        whole: MergedDofmap = pairing.merged(space, fields)
        self._merged = pairing.merged(V)
        return V, self._merged.space, whole.space, whole.new[dofs]

    def total_displacement(self, w: Expr) -> Expr:
        """The whole displacement of the body [m], of a function of W."""
        return self.displacement(w) + self.cell.affine(self.cell.H)

    def merged_dofs(self, dofs: IndexArray) -> IndexArray:
        """Entries of the displacement's local array as entries of U."""
        return (self._merged.new[dofs // self._dim] * self._dim + dofs % self._dim).astype(np.int32)

    @property
    def displacement_dofs(self) -> IndexArray:
        """Owned entries of all unknowns that belong to the fluctuation, in the order of U."""
        imap = self.U.dofmap.index_map
        entries = np.empty((imap.size_local + imap.num_ghosts) * self._dim, dtype=np.int32)
        assert self._dofs is not None
        entries[self._unrolled(self._merged.new)] = self._dofs
        return entries[: imap.size_local * self._dim]

    def linear_space(self) -> fem.FunctionSpace:
        """U with linear elements. Collective."""
        plain = fem.functionspace(self.V.mesh, ("Lagrange", 1, (self._dim,)))
        return self.cell.pairing.merged(plain).space

    def w_to_u(self) -> None:
        """Makes the displacement of fluctuation and macroscopic displacement."""
        super().w_to_u()
        self.u.x.array[:] += self.cell.affine_at(self.places).reshape(-1)

    def u_to_w(self) -> None:
        """Makes the fluctuation of the displacement."""
        assert self._dofs is not None
        self.w.x.array[self._dofs] = self.u.x.array - self.cell.affine_at(self.places).reshape(-1)
