"""The cell of a repeated structure: its macroscopic deformation as numbers that forms refer to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.fem import Constant
from dolfinx.mesh import Mesh
from ufl.core.expr import Expr
from ufl.finiteelement import AbstractFiniteElement

from dolfin_elastic.core.compat import collapsed
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.model.amplitude import RAMP, Amplitude
from dolfin_elastic.model.periodic import Periodic
from dolfin_elastic.problem.constraints.periodic.dofmap import Field, MergedDofmap, PeriodicPairing
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


class Cell:
    """Macroscopic state of a periodic cell. Collective to make.

    The displacement is u = H (X - X0) + w with the macroscopic displacement gradient H = F - I,
    the fixed vertex X0, and the periodic fluctuation w.

    Args:
        periodic: Pairs of faces and what is prescribed.
        thickness: Of a plane body [m].

    Attributes:
        pairing: Which faces are one.
        free: Places of the components of H that are unknown.
        H: Macroscopic displacement gradient (UFL constant, dim x dim).
        stress: Prescribed stress [Pa], NaN where it is a result.
        volume: Of the cell, holes included [m^3].

    Raises:
        MeshError: A surface does not exist.
        InputError: The faces are no images of one another, or the gradient does not fit.
    """

    def __init__(self, body: Body, periodic: Periodic, thickness: float = 1.0) -> None:
        self._periodic, self.free = periodic, periodic.free
        _check_gradient(periodic, body.dim)
        self.pairing = PeriodicPairing(body, periodic.pairs)
        self._dim = body.dim
        self.H = Constant(body.mesh, np.zeros((body.dim, body.dim)))
        self._origin = Constant(body.mesh, self.pairing.corner[: body.dim])
        self._X = ufl.SpatialCoordinate(body.mesh)
        self.volume = self.pairing.volume * thickness
        self.stress: FloatArray = np.full((body.dim, body.dim), np.nan)

    @property
    def gradient(self) -> FloatArray:
        """Macroscopic deformation gradient F."""
        return np.eye(self._dim) + self.H.value

    @property
    def length(self) -> float:
        """A length of the size of the cell [m]."""
        return float(self.pairing.volume ** (1 / self._dim))

    def affine(self, H: Expr) -> Expr:
        """The displacement H (X - X0), UFL."""
        return ufl.dot(H, self._X - self._origin)

    def affine_at(self, x: FloatArray) -> FloatArray:
        """The present macroscopic displacement of points, shape (points, 3) to (points, dim)."""
        return np.asarray((x - self.pairing.corner)[:, : self._dim] @ self.H.value.T)

    def free_values(self) -> FloatArray:
        """The free components of H."""
        return np.array([self.H.value[place] for place in self.free])

    def set_free(self, values: FloatArray) -> None:
        """Changes the free components of H."""
        for place, value in zip(self.free, values, strict=True):
            self.H.value[place] = value

    def set_time(self, t: float, default: Amplitude) -> None:
        """Sets what is prescribed at time t; free components stay. Not collective.

        Args:
            t: Time [s], or load parameter.
            default: Amplitude where the user gave none.
        """
        F = self._periodic.gradient_at(t, default)
        self.H.value[:] = np.where(np.isnan(F), self.H.value, F - np.eye(self._dim))
        self.stress = self._periodic.stress_at(t, default)


def make_cell(
    body: Body,
    periodic: Periodic,
    others: Mapping[str, object],
    *,
    geometry: str,
    depth: float,
) -> Cell:
    """The cell of a body. Collective.

    Args:
        periodic: Pairs of faces and what is prescribed.
        others: Key to what else is to act on the body.
        depth: Thickness of a plane body [m].

    Raises:
        InputError: Something else acts on the cell, or the body cannot be repeated.
    """
    for key, given in others.items():
        if given:
            raise InputError(
                f"a periodic cell takes no {key}s: it is loaded by its macroscopic deformation",
                where=f"{key}[0]",
                expected="leave it out; periodic.gradient and periodic.stress deform the cell",
            )
    if geometry == "axisymmetric":
        raise InputError(
            "an axisymmetric body cannot be repeated along its radius",
            where="mesh.geometry",
            expected='"plane-strain" or "plane-stress"',
        )
    return Cell(body, periodic, depth)


def _check_gradient(periodic: Periodic, dim: int) -> None:
    if periodic.dim != dim:
        raise InputError(
            f"{periodic.dim} rows of {periodic.dim} components",
            where="periodic.gradient",
            expected=f"the body is {dim}-dimensional: {dim} rows of {dim}",
        )
    F = periodic.gradient_at(1.0, RAMP)
    known = _known_block(F)
    if len(known) and not np.linalg.det(F[np.ix_(known, known)]) > 0:
        raise InputError(
            f"det F = {np.linalg.det(F):.4g} at full load"
            if len(known) == dim
            else "det F is not above 0 at full load, whatever the free stretches are",
            where="periodic.gradient",
            expected="above 0: a gradient that keeps volume positive; no deformation is the "
            "unit matrix",
        )


def _known_block(F: FloatArray) -> npt.NDArray[np.intp]:
    """Rows and columns whose determinant has the sign of det F; none where it is not known yet.

    Free stretches are positive, and with nothing beside them they are factors of det F.
    """
    free, diagonal = np.isnan(F), np.eye(len(F), dtype=bool)
    stretches = np.diag(free)
    beside = np.where(diagonal, 0.0, F)[stretches]
    known = not np.any(free & ~diagonal) and not np.any(beside)
    return np.flatnonzero(~stretches) if known else np.empty(0, dtype=np.intp)
