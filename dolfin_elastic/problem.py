"""`Problem`: the unknown displacement and ONE sum of virtual-work terms.

Find u with  delta W_int(u; v) - delta W_ext(v) = 0  for all virtual displacements v, where
delta W_int is the integral of P(F) : grad v over the reference volume.  Motion adds inertia to the
same sum.  Source: Bonet & Wood (2008), (5.41).
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.fem import Constant
from ufl.core.expr import Expr

from dolfin_elastic import compiler
from dolfin_elastic._compat import integration_entities
from dolfin_elastic.errors import InputError, MeshError
from dolfin_elastic.formulas import Formula
from dolfin_elastic.meshes.body import Body, Indices
from dolfin_elastic.model.components import Component, depends_on_time
from dolfin_elastic.model.curves import CONSTANT, Amplitude
from dolfin_elastic.model.kinematics import deformation_gradient, embedded, padded
from dolfin_elastic.model.law import Law
from dolfin_elastic.model.loads import Load
from dolfin_elastic.model.supports import Support
from dolfin_elastic.parallel import total
from dolfin_elastic.prescribed import Prescribed
from dolfin_elastic.varying import Binder

log = logging.getLogger("dolfin_elastic")
Vector = npt.NDArray[np.float64]
WHOLE = "body"


@dataclass(frozen=True)
class Part:
    """The cells that one material fills.

    Attributes:
        name: Material's name.
        law: The law with UFL expressions in place of its numbers.
        cells: Owned local cells of this rank, sorted.
        marker: The part's number in the volume measure.
        density: UFL expression [kg/m^3], or None if not given.
        typical: The law with numbers only, the means of what varies in space.
    """

    name: str
    law: Law
    cells: Indices
    marker: int
    density: Expr | None
    typical: Law


class Problem:
    """An elastic body with materials, supports and loads.

    All of it is collective: make it on every rank with the same arguments.

    Args:
        body: The mesh and its names.
        materials: A law for the whole body, or region's name to law; together the regions must
            cover every cell exactly once.
        supports: Prescribed displacements; where they meet the later one holds.
        loads: External forces.
        degree: Degree of the displacement on tetrahedra or triangles, 1 or 2.
        quadrature_degree: Overrides the law's own choice for the internal forces.

    Attributes:
        u: The displacement [m]; solvers change it.
        t: UFL constant with the time, used by formulas.

    Raises:
        MeshError: A name does not exist, or the materials do not cover the body exactly once.
        InputError: A vector with the wrong number of components, a missing density.
    """

    def __init__(
        self,
        body: Body,
        materials: Law | Mapping[str, Law],
        *,
        supports: Sequence[Support] = (),
        loads: Sequence[Load] = (),
        degree: int = 1,
        quadrature_degree: int | None = None,
    ) -> None:
        self.body, self.degree = body, degree
        self.supports, self.loads = tuple(supports), tuple(loads)
        self.quadrature_degree = quadrature_degree
        self.V = fem.functionspace(body.mesh, ("Lagrange", degree, (body.dim,)))
        self.u, self.v = fem.Function(self.V, name="displacement"), ufl.TestFunction(self.V)
        self.t = Constant(body.mesh, 0.0)
        self._amplitudes: list[tuple[Constant, Amplitude | None]] = []
        laws = materials if isinstance(materials, Mapping) else {WHOLE: materials}
        self.parts = tuple(self._part(i, name, law) for i, (name, law) in enumerate(laws.items()))
        self._check_cover()
        self.prescribed = Prescribed(body, self.V, self.supports)
        _ = self.external  # says now what is wrong with a load

    # --- materials ---

    def _part(self, index: int, name: str, law: Law) -> Part:
        whole = name == WHOLE and name not in self.body.regions
        cells = self.body.owned_cells(None if whole else name)
        if law.warning:
            log.warning("%s", law.warning)
        bound = self._binder.bind(law, cells, "" if whole else f"materials.{name}")
        return Part(name, bound.law, cells, index + 1, bound.density, bound.typical)

    @cached_property
    def _binder(self) -> Binder:
        return Binder(self.body, self._order)

    def _check_cover(self) -> None:
        times = np.zeros(len(self.body.owned_cells()), dtype=np.int64)
        for part in self.parts:
            times[part.cells] += 1
        comm = self.body.comm
        bare, twice = total(comm, np.array([np.sum(times == 0), np.sum(times > 1)]))
        if bare:
            raise MeshError(
                f"{bare} of {self.body.num_cells} cells have no material",
                where="materials",
                expected="every cell needs exactly one",
            )
        if twice:
            raise MeshError(
                f"{twice} cells have more than one material",
                where="materials",
                expected="every cell needs exactly one",
            )

    def constant(self, value: float | Sequence[float]) -> Constant:
        """A number that forms refer to by place, so that changing it compiles nothing."""
        return Constant(self.body.mesh, np.asarray(value, dtype=np.float64))

    # --- where integrals are taken ---

    # Every set of cells or facets that is integrated over has a number of its own.  UFL would join
    # equal terms on several numbers into one, and DOLFINx 0.9 then takes the wrong kernel for it
    # where a number carries more than one quadrature degree.

    @cached_property
    def _region_markers(self) -> dict[tuple[str, ...], int]:
        sets = dict.fromkeys(load.parts for load in self.loads if load.parts)
        known = [names for names in sets if all(n in self.body.regions for n in names)]
        return {names: len(self.parts) + 2 + i for i, names in enumerate(known)}

    @cached_property
    def _surface_markers(self) -> dict[tuple[str, ...], int]:
        sets = dict.fromkeys(load.parts for load in self.loads if load.parts)
        known = [names for names in sets if all(n in self.body.surfaces for n in names)]
        return {names: 1 + i for i, names in enumerate(known)}

    @property
    def _plain(self) -> bool:
        """A single material fills the body: one unnumbered measure, for which nothing is packed."""
        return len(self.parts) == 1 and not self._region_markers

    @cached_property
    def dx(self) -> ufl.Measure:
        """Reference volume, numbered by part, by loaded regions, and as a whole."""
        if self._plain:
            return ufl.Measure("dx", domain=self.body.mesh)
        cells = [(part.marker, part.cells) for part in self.parts]
        cells.append((len(self.parts) + 1, self.body.owned_cells()))
        cells += [
            (marker, np.unique(np.concatenate([self.body.owned_cells(n) for n in names])))
            for names, marker in self._region_markers.items()
        ]
        return ufl.Measure("dx", domain=self.body.mesh, subdomain_data=cells)

    def volume(self, part: Part | None, quadrature_degree: int) -> ufl.Measure:
        """Reference volume of a part, or of the whole body."""
        rule = {"quadrature_degree": quadrature_degree}
        if self._plain:
            return self.dx(metadata=rule)
        return self.dx(part.marker if part else len(self.parts) + 1, metadata=rule)

    @cached_property
    def _ds(self) -> ufl.Measure:
        tdim = self.body.mesh.topology.dim
        self.body.mesh.topology.create_connectivity(tdim, tdim - 1)
        self.body.mesh.topology.create_connectivity(tdim - 1, tdim)
        sides = []
        for names, marker in self._surface_markers.items():
            facets = np.unique(np.concatenate([self.body.owned_facets(n) for n in names]))
            sides.append((marker, integration_entities(self.body.mesh, facets)))
        return ufl.Measure("ds", domain=self.body.mesh, subdomain_data=sides)

    # --- what loads find on the body (model.loads.Site) ---

    def volumes(self, regions: Sequence[str]) -> ufl.Measure:
        """Reference volume of regions, or of the whole body."""
        for name in regions:
            self.body.region(name)
        if not regions:
            return self.volume(None, 2 * self._order)
        rule = {"quadrature_degree": 2 * self._order}
        return self.dx(self._region_markers[tuple(regions)], metadata=rule)

    def areas(self, surfaces: Sequence[str]) -> ufl.Measure:
        """Reference area of surfaces."""
        for name in surfaces:
            self.body.surface(name)
        rule = {"quadrature_degree": 2 * self._order}
        return self._ds(self._surface_markers[tuple(surfaces)], metadata=rule)

    def densities(self, regions: Sequence[str]) -> list[tuple[Expr, ufl.Measure]]:
        """Density and reference volume, material by material."""
        if regions:
            cells = np.concatenate([self.body.region(name) for name in regions])
            for part in self.parts:
                if total(self.body.comm, int(np.isin(part.cells, cells).any())):
                    self.density(part)
            return [(self._density_field, self.volumes(regions))]
        return [(self.density(part), self.volume(part, 2 * self._order)) for part in self.parts]

    def density(self, part: Part) -> Expr:
        """Density of a part's material.

        Raises:
            InputError: The material has none.
        """
        if part.density is None:
            raise InputError(
                "weight and motion need a density",
                where=f"materials.{part.name}",
                expected='for example density = "1100 kg/m^3"',
            )
        return part.density

    @cached_property
    def _density_field(self) -> fem.Function:
        return self._binder.joined([(part.density, part.cells) for part in self.parts])

    def vector(self, values: tuple[Component, ...], amplitude: Amplitude | None) -> Expr:
        """A load's vector, times its amplitude, as a UFL expression."""
        if len(values) != self.body.dim:
            raise InputError(
                f"{len(values)} components given, the body has {self.body.dim}", where="load"
            )
        factor = self.constant(1.0)
        self._amplitudes.append((factor, amplitude))
        if not any(isinstance(value, Formula) for value in values):
            return factor * self.constant([float(value) for value in values])  # type: ignore[arg-type]
        return factor * ufl.as_vector([self._scalar(value) for value in values])

    def _scalar(self, value: Component) -> Expr:
        if not isinstance(value, Formula):
            return self.constant(float(value or 0.0))
        X = ufl.SpatialCoordinate(self.body.mesh)
        z = X[2] if self.body.dim == 3 else self.constant(0.0)
        return value.ufl(x=X[0], y=X[1], z=z, t=self.t)

    # --- the one sum of terms ---

    @cached_property
    def internal(self) -> ufl.Form:
        """Internal virtual work: the integral of P(F) : grad v."""
        F = embedded(deformation_gradient(self.u))
        grad_v = padded(ufl.grad(self.v))
        return sum(
            ufl.inner(part.law.stress(F), grad_v) * self._internal_volume(part)
            for part in self.parts
        )

    def _internal_volume(self, part: Part) -> ufl.Measure:
        return self.volume(part, self.rule(part))

    def rule(self, part: Part) -> int:
        """Quadrature degree of a part's internal forces."""
        if self.quadrature_degree is not None:
            return self.quadrature_degree
        return part.law.quadrature_degree(self._order)

    @property
    def _order(self) -> int:
        """Degree of the displacement or of the mesh's curved cells, whichever is higher."""
        return max(self.degree, int(self.body.mesh.geometry.cmap.degree))

    @cached_property
    def external(self) -> ufl.Form | None:
        """External virtual work of all loads; None without loads."""
        return sum(load.virtual_work(self) for load in self.loads) if self.loads else None

    @cached_property
    def residual(self) -> ufl.Form:
        """Internal minus external virtual work."""
        return self.internal if self.external is None else self.internal - self.external

    @cached_property
    def tangent(self) -> ufl.Form:
        """Derivative of the residual with respect to u."""
        return ufl.derivative(self.residual, self.u, ufl.TrialFunction(self.V))

    @cached_property
    def strain_energy(self) -> ufl.Form | None:
        """Stored energy of the whole body; None when a law has none."""
        if not self.has_energy:
            return None
        F = embedded(deformation_gradient(self.u))
        return sum(part.law.energy(F) * self._internal_volume(part) for part in self.parts)

    def inertia(self, a: Expr, v: Expr) -> ufl.Form:
        """Virtual work of the inertia forces, the integral of density a . v (consistent mass)."""
        return sum(
            self.density(part) * ufl.inner(a, v) * self.volume(part, 2 * self._order)
            for part in self.parts
        )

    # --- what solvers ask ---

    @property
    def has_energy(self) -> bool:
        """All laws derive from an energy: the tangent is symmetric."""
        return all(part.law.has_energy for part in self.parts)

    @property
    def linear(self) -> bool:
        """The residual is linear in u."""
        return all(part.law.linear for part in self.parts)

    @property
    def num_dofs(self) -> int:
        """Displacement components on all ranks, prescribed ones included."""
        return int(self.V.dofmap.index_map.size_global * self.V.dofmap.index_map_bs)

    @cached_property
    def jit(self) -> dict[str, object]:
        """Options for the form compiler. Collective."""
        return compiler.options(self.body.comm)

    @property
    def loads_change(self) -> bool:
        """The applied nodal forces depend on time, in motion."""
        curved = any(amplitude not in (None, CONSTANT) for _, amplitude in self._amplitudes)
        return curved or any(depends_on_time(load.values) for load in self.loads)

    def set_time(self, t: float, *, default: Amplitude = CONSTANT) -> None:
        """Puts loads and prescribed displacements to time t. Not collective.

        Args:
            t: Time [s], or load parameter from 0 to 1.
            default: Amplitude of all that name none.
        """
        self.t.value = t
        for factor, amplitude in self._amplitudes:
            factor.value = (amplitude or default).at(t)
        self.prescribed.move_to(t, default)
