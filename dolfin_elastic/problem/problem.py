"""`Problem`: the unknown displacement and ONE sum of virtual-work terms.

Find u with  delta W_int(u; v) - delta W_ext(v) = 0  for all virtual displacements v, where
delta W_int is the integral of P(F) : grad v over the reference volume.  Motion adds inertia to the
same sum.  Source: Bonet & Wood (2008), (5.41).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import ufl
from dolfinx.fem import Constant
from ufl.core.expr import Expr

from dolfin_elastic.core import jit
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.mesh.body import Body, cell_size
from dolfin_elastic.model.amplitude import CONSTANT, Amplitude
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.model.dimension import (
    Geometry,
    Weighted,
    gradient_variation,
    weight,
)
from dolfin_elastic.model.loads import Load
from dolfin_elastic.model.materials.growth import GrownLaw
from dolfin_elastic.model.materials.law import Law, SplitLaw
from dolfin_elastic.model.materials.mixed import Mixed, variance
from dolfin_elastic.model.periodic import Periodic
from dolfin_elastic.model.supports.displacement import Restraint
from dolfin_elastic.model.supports.springs import Dashpot, ResistingSupport, Spring
from dolfin_elastic.model.values import depends_on_time
from dolfin_elastic.problem.constraints.dirichlet import DirichletConditions
from dolfin_elastic.problem.constraints.normals import check_facing
from dolfin_elastic.problem.constraints.spring_directions import Projections, spring_directions
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.eigenstrain import eigenstrains
from dolfin_elastic.problem.formulation import Formulation, shear_modulus
from dolfin_elastic.problem.loads.cavities import make_cavities
from dolfin_elastic.problem.loads.contact import check_contacts, make_contacts
from dolfin_elastic.problem.loads.point_loads import NodalLoads
from dolfin_elastic.problem.loads.pressure_symmetry import rim_held
from dolfin_elastic.problem.material_regions import (
    WHOLE,
    MaterialRegion,
    checked_geometry,
    make_material_regions,
)
from dolfin_elastic.problem.measures import Measures
from dolfin_elastic.problem.periodic.fluctuation import Fluctuation, make_unknowns
from dolfin_elastic.problem.periodic.unit_cell import Cell, make_cell

UNUSED = 1e-6
"""Compliance, over 1/shear modulus, of the pressure in parts that have none."""


class Problem:
    """An elastic body with materials, supports and loads.

    All of it is collective: make it on every rank with the same arguments.

    Args:
        body: The mesh and its names.
        materials: A law for the whole body, or region's name to law; together the regions must
            cover every cell exactly once.
        supports: What holds surfaces; where displacements are prescribed twice the later one holds.
        loads: External forces.
        contacts: Rigid obstacles that surfaces may touch.
        degree: Degree of the displacement on tetrahedra or triangles, 1 or 2.
        quadrature_degree: Overrides the law's own choice for the internal forces.
        formulation: "displacement"; "mixed", with a pressure for nearly incompressible materials;
            or "auto": what the materials need.
        geometry: What a two-dimensional body is: "plane-strain", "plane-stress" or
            "axisymmetric" (x is the radius, y the axis).
        thickness: Of a plane body [m].
        periodic: Faces that are one, and the macroscopic deformation of the cell they bound.

    Attributes:
        u: The displacement [m]; solvers change it through `w`.
        w: All unknowns: the displacement and, in some problems, scalar fields beside it.
        cavities: Hollow spaces with a pressure.
        site: What loads find on the body.
        cell: The macroscopic deformation of a periodic cell, or None.
        rest: Material's name to its growth Fg (UFL), of those that grow.
        nodal_loads: Forces at points and along lines, which are in no form.
        constant: Makes a number that forms refer to by place, so that changing it compiles nothing.
        t: UFL constant with the time, used by formulas.
        X: Reference coordinates (UFL).
        touching: The contacts as they stand on the body.

    Raises:
        MeshError: A name does not exist, or the materials do not cover the body exactly once.
        InputError: A vector with the wrong number of components, a missing density, an energy of
            the user's own that is no material.
    """

    def __init__(
        self,
        body: Body,
        materials: Law | Mapping[str, Law],
        *,
        supports: Sequence[Restraint] = (),
        loads: Sequence[Load] = (),
        contacts: Sequence[Contact] = (),
        degree: int = 1,
        quadrature_degree: int | None = None,
        formulation: Formulation = "auto",
        geometry: Geometry = "plane-strain",
        thickness: float = 1.0,
        periodic: Periodic | None = None,
    ) -> None:
        self.body, self.degree = body, degree
        self.supports, self.loads = tuple(supports), tuple(loads)
        self.quadrature_degree = quadrature_degree
        self.geometry = checked_geometry(geometry, thickness, body)
        turned = self.geometry == "axisymmetric"
        check_contacts(contacts, body, turned=turned)
        check_facing(body, supports, loads, contacts)
        self.cell: Cell | None = None
        if periodic is not None:
            others = {"support": supports, "load": loads, "contact": contacts}
            self.cell = make_cell(body, periodic, others, geometry=self.geometry, depth=thickness)
        laws = materials if isinstance(materials, Mapping) else {WHOLE: materials}
        self.parts, fields = make_material_regions(
            body, laws, formulation, degree=degree, order=self._order, geometry=self.geometry
        )
        self.unknowns = make_unknowns(body.mesh, degree, fields.extras, self.cell)
        self.V, self.u = self.unknowns.V, self.unknowns.u
        self.W, self.w, self.v = self.unknowns.W, self.unknowns.w, self.unknowns.v
        self._scale_unknowns()
        depth = None if thickness == 1.0 else Constant(body.mesh, float(thickness))
        self.measures = Measures(
            body,
            [part.cells for part in self.parts],
            [
                *(term.parts for term in self.loads),
                *(s.surfaces for s in self.supports if isinstance(s, ResistingSupport)),
            ],
            weight(self.geometry, ufl.SpatialCoordinate(body.mesh), depth),
            [contact.surfaces for contact in contacts],
        )
        self.site = FormContext(body, self.unknowns, self.parts, self.measures, self.geometry)
        self.constant, self.t, self.X = self.site.constant, self.site.t, self.site.X
        self.prescribed = DirichletConditions(body, self.V, self.supports, axis=turned)
        if isinstance(self.unknowns, Fluctuation):
            self.prescribed.pin(*self.unknowns.pinned)
        self.cavities = list(make_cavities(self.loads, self.site))
        self.touching = make_contacts(contacts, self.site, self._order)
        self.rest = eigenstrains(self.site, self.loads)
        self.nodal_loads = NodalLoads(body, self.V, self.loads)
        _ = self.external, self.holding  # says now what is wrong with a load or a spring

    def _scale_unknowns(self) -> None:
        """Gives the scalar fields the size of displacements, see `unknowns`."""
        h = cell_size(self.body)
        stiff = max(float(part.shear.value) for part in self.parts)
        for name, factor in (("pressure", stiff / h), ("stretch", 1 / h)):
            if self.unknowns.has(name):
                self.unknowns.scale[name].value = factor

    # --- the one sum of terms ---

    def F(self, w: Expr) -> Expr:
        """The 3x3 deformation gradient of a function of all unknowns."""
        return self.site.deformation(w)

    def response(self, part: MaterialRegion, w: Expr) -> Law | Mixed | GrownLaw:
        """A part's law, with its growth and with the pressure of a function of all unknowns."""
        law: Law | Mixed = part.law
        if part.compliance is not None:
            assert isinstance(part.law, SplitLaw)
            law = Mixed(part.law, self.unknowns.extra("pressure", w), part.compliance)
        growth = self.rest.get(part.name)
        return law if growth is None else GrownLaw(law, growth)

    def _extra(self, name: str, w: Expr) -> Expr | None:
        return self.unknowns.extra(name, w) if self.unknowns.has(name) else None

    @cached_property
    def internal(self) -> ufl.Form:
        """Internal virtual work: the integral of P(F) : grad v, and the pressure's equation."""
        test = ufl.TestFunction(self.W)
        F = self.F(self.w)
        dF = gradient_variation(self.geometry, self.v, self.X, self._extra("stretch", test))
        work = sum(
            ufl.inner(self.response(part, self.w).stress(F), dF) * self._internal_volume(part)
            for part in self.parts
        )
        if not self.unknowns.has("pressure"):
            return work
        q = self.unknowns.extra("pressure", test)
        return work + sum(self._pressure_terms(part, F, q) for part in self.parts)

    def _pressure_terms(self, part: MaterialRegion, F: Expr, q: Expr) -> ufl.Form:
        """The pressure's equation in a part.

        With linear elements it is stabilised by what the pressure differs from its mean over each
        cell: Bochev, Dohrmann & Gunzburger, SIAM J. Numer. Anal. 44 (2006), (2.9).  Where a part
        needs no pressure it is kept at zero.
        """
        p = self.unknowns.extra("pressure", self.w)
        if part.compliance is None:
            return -UNUSED / part.shear * p * q * self.volume(part, 2)
        terms = self.volume_gap(part, F, q)
        if self.unknowns.stabilised:
            off = variance(p, q, ufl.Jacobian(self.body.mesh))
            terms -= off / part.shear * self.volume(part, 0)
        return terms

    def volume_gap(self, part: MaterialRegion, F: Expr, q: Expr) -> ufl.Form:
        """Virtual work of a pressure in a part that has one, see `Mixed.gap`."""
        response = self.response(part, self.w)
        assert not isinstance(response, Law)
        return q * response.gap(F) * self._internal_volume(part)

    def _internal_volume(self, part: MaterialRegion) -> Weighted:
        return self.volume(part, self.rule(part))

    def volume(self, part: MaterialRegion | None, quadrature_degree: int) -> Weighted:
        """Reference volume of a part, or of the whole body."""
        return self.measures.filled(part.marker if part else None, quadrature_degree)

    def rule(self, part: MaterialRegion) -> int:
        """Quadrature degree of a part's internal forces."""
        if self.quadrature_degree is not None:
            return self.quadrature_degree
        degree = part.law.quadrature_degree(self._order)
        if part.compliance is not None or self.geometry == "axisymmetric":
            return max(degree, 2)  # fields that vary inside a linear element, too
        return degree

    @property
    def _order(self) -> int:
        """Degree of the displacement or of the mesh's curved cells, whichever is higher."""
        return max(self.degree, int(self.body.mesh.geometry.cmap.degree))

    @cached_property
    def external(self) -> ufl.Form | None:
        """External virtual work of all loads; None without loads."""
        return sum(work for _, work in self.works) if self.works else None

    @cached_property
    def works(self) -> list[tuple[Load, ufl.Form]]:
        """Each load that is an integral, with its external virtual work."""
        return [
            (load, self._work(index))
            for index, load in enumerate(self.loads)
            if not (load.nodal or load.swells)
        ]

    def _work(self, index: int) -> ufl.Form:
        try:
            return self.loads[index].virtual_work(self.site)
        except InputError as error:
            raise (self._placed(error, index)) from None

    def _placed(self, error: InputError, index: int) -> InputError:
        """A fault of a load, with its key; those of materials have theirs."""
        if error.where.startswith("materials"):
            return error
        return error.at(f"load[{index}]" if error.where else f"load[{index}].value")

    @cached_property
    def holding(self) -> dict[str, ufl.Form]:
        """Virtual work of the forces by which springs and obstacles hold the body, by label."""
        held: dict[str, ufl.Form] = {}
        for support in self.supports:
            if isinstance(support, ResistingSupport):
                work = support.virtual_work(self.site)
                held[support.label] = held[support.label] + work if support.label in held else work
        for touch in self.touching:
            known = held.get(touch.label)
            held[touch.label] = touch.work if known is None else known + touch.work
        return held

    @property
    def springs(self) -> tuple[Spring, ...]:
        """Supports that hold by stored energy."""
        return tuple(s for s in self.supports if isinstance(s, Spring))

    @property
    def dashpots(self) -> tuple[Dashpot, ...]:
        """Supports that hold against velocity, in motion only."""
        return tuple(s for s in self.supports if isinstance(s, Dashpot))

    @cached_property
    def spring_energy(self) -> ufl.Form | None:
        """Energy stored in springs; None without any."""
        return sum(s.energy(self.site) for s in self.springs) if self.springs else None

    @cached_property
    def resisting(self) -> list[Projections]:
        """Owned nodes that springs hold, with projections on the directions. Collective."""
        return [held for s in self.springs for held in spring_directions(s, self.body, self.V)]

    def damping(self, velocity: Expr) -> ufl.Form | None:
        """Virtual work against dashpots at a velocity; None without any."""
        works = [d.work_at(self.site, velocity) for d in self.dashpots]
        return -sum(works) if works else None

    @cached_property
    def residual(self) -> ufl.Form:
        """Internal minus external virtual work."""
        residual = self.internal if self.external is None else self.internal - self.external
        for work in self.holding.values():
            residual -= work
        return residual

    @cached_property
    def tangent(self) -> ufl.Form:
        """Derivative of the residual with respect to u."""
        return ufl.derivative(self.residual, self.w, ufl.TrialFunction(self.W))

    @cached_property
    def strain_energy(self) -> ufl.Form | None:
        """Stored energy of the whole body; None when a law has none."""
        if not self.has_energy:
            return None
        F = self.F(self.w)
        return sum(
            self.response(part, self.w).energy(F) * self._internal_volume(part)
            for part in self.parts
        )

    def inertia(self, a: Expr, v: Expr) -> ufl.Form:
        """Virtual work of the inertia forces, the integral of density a . v (consistent mass)."""
        return sum(
            self.site.density(part) * ufl.inner(a, v) * self.volume(part, 2 * self._order)
            for part in self.parts
        )

    # --- what solvers ask ---

    @property
    def has_energy(self) -> bool:
        """All laws derive from an energy."""
        return all(part.law.has_energy for part in self.parts)

    @cached_property
    def symmetric(self) -> bool:
        """The tangent is symmetric: laws and loads derive from potentials. Collective."""
        return self.has_energy and all(self._conservative(load) for load in self.loads)

    def _conservative(self, load: Load) -> bool:
        if load.conservative or not self._follows(load):
            return True
        # A stretch out of the plane widens the surface, but no work of the load belongs to it.
        if not load.conservative_if_held or self.unknowns.has("stretch"):
            return False
        return rim_held(self.body, self.prescribed, load.parts)

    def _follows(self, load: Load) -> bool:
        return load.follows and not (load.linearises and self.site.linear)

    @property
    def linear(self) -> bool:
        """The residual is linear in u."""
        if self.touching or any(self._follows(load) for load in self.loads):
            return False
        return self.site.linear

    @property
    def num_dofs(self) -> int:
        """Unknowns on all ranks, prescribed ones included."""
        return int(self.W.dofmap.index_map.size_global * self.W.dofmap.index_map_bs)

    @property
    def mixed(self) -> bool:
        """There is a pressure beside the displacement."""
        return self.unknowns.has("pressure")

    @cached_property
    def jit(self) -> dict[str, object]:
        """Options for the form compiler. Collective."""
        return jit.options(self.body.comm)

    @property
    def loads_change(self) -> bool:
        """The applied nodal forces change in motion: with time, or with the body's shape."""
        return (
            self.site.changes
            or self.nodal_loads.change
            or any(self._follows(load) or depends_on_time(load.values) for load in self.loads)
        )

    def set_time(self, t: float, *, default: Amplitude = CONSTANT) -> None:
        """Puts loads and prescribed displacements to time t. Not collective.

        Args:
            t: Time [s], or load parameter from 0 to 1.
            default: Amplitude of all that name none.
        """
        self.site.set_time(t, default)
        self.nodal_loads.set_time(t, default)
        self.prescribed.move_to(t, default)
        if self.cell is not None:
            self.cell.move_to(t, default)
            self.unknowns.tell()
        for touch in self.touching:
            touch.set_time(t, default)
        for cavity in self.cavities:
            cavity.t, cavity.default = t, default

    @cached_property
    def stiffness(self) -> float:
        """Largest shear modulus of all parts at small strains [Pa]."""
        return max(shear_modulus(part.typical) for part in self.parts)
