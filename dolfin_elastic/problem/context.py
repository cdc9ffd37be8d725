"""Measures of a body, and the context from which loads, supports and contacts make their forms.

Every set of cells or facets that is integrated over has a number of its own.  UFL would join equal
terms on several numbers into one, and DOLFINx 0.9 then takes the wrong kernel for it where a number
carries more than one quadrature degree.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import Constant
from ufl.core.expr import Expr

from dolfin_elastic.core.compat import integration_entities
from dolfin_elastic.core.errors import InputError, keyed
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.jit import compile_forms, options
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.shapes.directions import check_components
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.geometry.curved import facet_quadrature, quadrature_rule
from dolfin_elastic.mesh.geometry.simplices import prepare_facets
from dolfin_elastic.model.amplitude import CONSTANT, Amplitude
from dolfin_elastic.model.kinematics import Geometry, WeightedMeasure, full_gradient
from dolfin_elastic.model.loads import LoadPoints
from dolfin_elastic.model.values import Component, Parts, checked_area, depends_on_time, sized
from dolfin_elastic.problem.coefficients import CoefficientBinder
from dolfin_elastic.problem.material_regions import MaterialRegion
from dolfin_elastic.problem.mesh_fields import check_fields, check_finite
from dolfin_elastic.problem.spaces import Unknowns
from dolfin_elastic.problem.terms.at_points import FormulaValues, IntegralPoints, facet_sets
from dolfin_elastic.problem.terms.edges_points import (
    HeldPart,
    PointIntegrals,
    SummedMeasure,
    extent,
)

if TYPE_CHECKING:
    from dolfin_elastic.model.point_mass import PointMass


class Measures:
    """Volume and surface measures of the reference configuration.

    Args:
        fillings: The cells of each material, in the order of their numbers from 1.
        loaded: Names of the parts of each load, and of each spring and dashpot.
        weight: Factor of every integrand, see `model.dimension.weight`.
        contacts: Names of the surfaces of each contact, whose integrals have rules of their own.
    """

    def __init__(
        self,
        body: Body,
        fillings: Sequence[IndexArray],
        loaded: Iterable[tuple[str, ...]],
        weight: Expr | None,
        contacts: Iterable[tuple[str, ...]] = (),
    ) -> None:
        self._body, self._fillings, self._weight = body, fillings, weight
        sets = [names for names in dict.fromkeys(loaded) if names]
        regions = [names for names in sets if all(n in body.regions for n in names)]
        surfaces = [names for names in sets if all(n in body.surfaces for n in names)]
        self._regions = {names: len(fillings) + 2 + i for i, names in enumerate(regions)}
        others = [names for names in sets if names not in surfaces]
        self._lower: dict[tuple[str, ...], PointIntegrals] = {}
        first = len(fillings) + 2 + len(regions)
        for names in others:
            if all(set(body.kinds(n)) & {"edge", "point"} for n in names):
                lower = PointIntegrals(body, body.common_kind(names), names, first)
                self._lower[names] = lower
                first += len(lower.cells)
        self._surfaces = {names: 1 + i for i, names in enumerate(surfaces)}
        first = 1 + len(surfaces)
        self._contacts = {names: first + i for i, names in enumerate(dict.fromkeys(contacts))}

    @property
    def _plain(self) -> bool:
        """A single material fills the body: one unnumbered measure, for which nothing is packed."""
        return len(self._fillings) == 1 and not self._regions and not self._lower

    @cached_property
    def _dx(self) -> ufl.Measure:
        mesh = self._body.mesh
        if self._plain:
            return ufl.Measure("dx", domain=mesh)
        cells = [(1 + i, filling) for i, filling in enumerate(self._fillings)]
        cells.append((len(self._fillings) + 1, self._body.owned_cells()))
        cells += [
            (marker, np.unique(np.concatenate([self._body.owned_cells(n) for n in names])))
            for names, marker in self._regions.items()
        ]
        cells += [pair for lower in self._lower.values() for pair in lower.cells.items()]
        return ufl.Measure("dx", domain=mesh, subdomain_data=cells)

    @cached_property
    def _ds(self) -> ufl.Measure:
        mesh = self._body.mesh
        tdim = mesh.topology.dim
        mesh.topology.create_connectivity(tdim, tdim - 1)
        mesh.topology.create_connectivity(tdim - 1, tdim)
        sides = []
        for names, marker in (*self._surfaces.items(), *self._contacts.items()):
            facets = np.unique(np.concatenate([self._body.owned_facets(n) for n in names]))
            sides.append((marker, integration_entities(mesh, facets)))
        return ufl.Measure("ds", domain=mesh, subdomain_data=sides)

    def filled(self, marker: int | None, degree: int) -> WeightedMeasure:
        """Volume that a material fills, or the whole body, with a quadrature degree.

        Args:
            marker: The material region's number; None: the whole body.
        """
        rule = {"quadrature_degree": degree}
        if self._plain:
            return WeightedMeasure(self._weight, self._dx(metadata=rule))
        number = len(self._fillings) + 1 if marker is None else marker
        return WeightedMeasure(self._weight, self._dx(number, metadata=rule))

    def regions(self, names: Sequence[str], degree: int) -> WeightedMeasure:
        """Volume of loaded regions."""
        rule = {"quadrature_degree": degree}
        return WeightedMeasure(self._weight, self._dx(self._regions[tuple(names)], metadata=rule))

    def surfaces(self, names: Sequence[str], degree: int) -> WeightedMeasure:
        """Area of loaded surfaces.

        Args:
            names: Of the surfaces of one load or spring.
        """
        rule = {"quadrature_degree": degree}
        return WeightedMeasure(self._weight, self._ds(self._surfaces[tuple(names)], metadata=rule))

    def load_points(self, names: Sequence[str], degree: int) -> LoadPoints:
        """The points of `surfaces` of this rank in numbers, with their weights. Collective."""
        body, weight = self._body, self._weight
        prepare_facets(body.mesh)
        facets = np.unique(np.concatenate([body.owned_facets(name) for name in names]))
        rule = facet_quadrature(body.mesh, facets, degree, raised=False)
        depth = float(weight.value) if isinstance(weight, Constant) else 1.0
        return LoadPoints(
            rule.X,
            0.0,
            rule.N,
            axisymmetric=not (weight is None or isinstance(weight, Constant)),
            weights=depth * rule.weights,
            total=partial(total, body.comm),
        )

    def lower(self, names: Sequence[str], degree: int) -> SummedMeasure:
        """Length of edges, or the number of points, of a spring or dashpot."""
        return self._lower[tuple(names)].measure(self._dx, degree)

    def points(self, parts: Parts, degree: int) -> IntegralPoints:
        """Points of integrals over parts.  Collective.

        Args:
            parts: Regions, none for the whole body; or the surfaces, edges or points of one load.
        """
        body, names = self._body, parts.names
        if parts.kind in ("edge", "point"):
            return self._lower[names].points(degree)
        dim = body.dim
        if parts.kind == "region":
            own = [body.owned_cells(name) for name in names] or [body.owned_cells()]
            cells = np.unique(np.concatenate(own)).astype(np.int32)
            sets = quadrature_rule(dim, degree)[0][None]
            return IntegralPoints(sets, cells, np.zeros(len(cells), dtype=np.int32))
        facets = np.unique(np.concatenate([body.owned_facets(name) for name in names]))
        _ = self._ds  # makes what finds cells beside facets
        sides = integration_entities(body.mesh, facets).reshape(-1, 2)
        sets = facet_sets(dim, quadrature_rule(dim - 1, degree)[0])
        return IntegralPoints(sets, sides[:, 0], sides[:, 1])

    def contact_area(self, names: Sequence[str], rule: Mapping[str, object]) -> WeightedMeasure:
        """Area of surfaces in contact, with a quadrature rule as UFL's metadata.

        Args:
            rule: Quadrature rule as UFL's metadata.
        """
        return WeightedMeasure(
            self._weight, self._ds(self._contacts[tuple(names)], metadata=dict(rule))
        )


class FormContext:
    """Fields, measures and constants for terms of virtual work; a `LoadContext`. Collective.

    Args:
        measures: Where integrals are taken.
        mounted: What is on surfaces and has a mass, but no stiffness.

    Attributes:
        body: The mesh and its names.
        v: Virtual displacement (UFL).
        u: Displacement (UFL, of the unknowns, so that derivatives see it).
        X: Reference coordinates (UFL).
        N: Outward unit normal of the reference surface (UFL).
        velocity: Velocity [m/s] that dashpots see; solvers of motion set its values.
        t: Time [s] or load parameter (UFL constant).
        unknown_numbers: Numbers that are solved for, by label.
        formulas: Values of formulas that are evaluated, not compiled; None without any.
        axisymmetric: The body is one of revolution about y.
        order: Degree of the displacement or of the mesh's curved cells, whichever is higher.
        weight_degree: Quadrature degree of forces per volume: 2 `order`, and as much as integrates
            a constant one exactly where the map of curved cells has a determinant of degree d.
    """

    def __init__(
        self,
        body: Body,
        unknowns: Unknowns,
        regions: Sequence[MaterialRegion],
        measures: Measures,
        geometry: Geometry,
        mounted: Sequence[PointMass] = (),
    ) -> None:
        self.body, self.unknowns, self.regions, self.mounted = body, unknowns, regions, mounted
        self.measures, self.geometry = measures, geometry
        self.axisymmetric = geometry == "axisymmetric"
        curved = int(body.mesh.geometry.cmap.degree)
        self.order = max(unknowns.degree, curved)
        self.weight_degree = max(2 * self.order, self.order + body.dim * (curved - 1))
        self.v = unknowns.v
        self.u = unknowns.total_displacement(unknowns.w)
        self.X = ufl.SpatialCoordinate(body.mesh)
        self.N = ufl.FacetNormal(body.mesh)
        self.velocity = fem.Function(unknowns.V, name="velocity of dashpots")
        self.t = Constant(body.mesh, 0.0)
        self.unknown_numbers: dict[str, Constant] = {}
        self._amplitudes: list[tuple[Constant, Amplitude | None]] = []
        self.formulas: FormulaValues | None = None

    def constant(
        self, value: float | Sequence[float] | Sequence[Sequence[float]] | FloatArray
    ) -> Constant:
        """A UFL constant: a new value of it needs no new compilation."""
        return Constant(self.body.mesh, np.asarray(value, dtype=np.float64))

    def unknown(self, label: str) -> Constant:
        """A scalar unknown as a constant of forms: one for each label."""
        return self.unknown_numbers.setdefault(label, self.constant(0.0))

    @cached_property
    def linear(self) -> bool:
        """All laws are linear."""
        return all(region.law.linear for region in self.regions)

    def deformation(self, w: Expr) -> Expr:
        """The 3x3 deformation gradient of a function of all unknowns."""
        stretch = self.unknowns.auxiliary("stretch", w) if self.unknowns.has("stretch") else None
        return full_gradient(self.geometry, self.unknowns.total_displacement(w), self.X, stretch)

    @cached_property
    def F(self) -> Expr:
        """The 3x3 deformation gradient of the present unknowns."""
        return self.deformation(self.unknowns.w)

    # --- where integrals are taken ---

    def volumes(self, regions: Sequence[str]) -> WeightedMeasure:
        """Reference volume of regions, or of the whole body."""
        self._check_names("region", regions)
        if not regions:
            return self.measures.filled(None, self.weight_degree)
        return self.measures.regions(regions, self.weight_degree)

    def areas(self, surfaces: Sequence[str]) -> WeightedMeasure:
        """Reference area of surfaces."""
        self._check_names("surface", surfaces)
        return self.measures.surfaces(surfaces, 2 * self.order)

    def _check_names(self, kind: str, names: Sequence[str]) -> None:
        """Refuses parts that the body does not have, which `on` names."""
        try:
            for name in names:
                self.body.part(kind, name)
        except InputError as error:
            raise error.at("on") from None

    def surface(self, surfaces: Sequence[str]) -> tuple[LoadPoints, WeightedMeasure]:
        """Quadrature points of the reference area of surfaces, and its measure. Collective."""
        area = self.areas(surfaces)
        return self.measures.load_points(surfaces, 2 * self.order), area

    def area(self, surfaces: Sequence[str]) -> Constant:
        """Size of the reference area of surfaces [m^2]. Collective."""
        comm = self.body.comm
        form = self.constant(1.0) * self.areas(surfaces)
        value = compile_forms(comm, [form], options(comm))[0]
        return self.constant(float(total(comm, float(fem.assemble_scalar(value)))))

    def held(self, names: Sequence[str]) -> HeldPart:
        """Area of surfaces, length of edges or number of points that a spring holds."""
        kind = self.body.common_kind(names)
        if kind == "surface":
            return HeldPart(kind, self.areas(names), lambda: self.area(names))
        return HeldPart(
            kind,
            self.measures.lower(names, 2 * self.order),
            lambda: self.constant(extent(self.body, kind, names)),
        )

    def densities(self, regions: Sequence[str]) -> list[tuple[Expr, WeightedMeasure]]:
        """Density and reference volume, material by material."""
        if regions:
            cells = np.concatenate([self.body.region(name) for name in regions])
            for region in self.regions:
                if total(self.body.comm, int(np.isin(region.cells, cells).any())):
                    self.density(region)
            return [(self._density_field, self.volumes(regions))]
        return [
            (self.density(region), self.measures.filled(region.marker, self.weight_degree))
            for region in self.regions
        ]

    def inertia(self, regions: Sequence[str]) -> list[tuple[Expr, WeightedMeasure]]:
        """`densities`, and without regions those of mounted masses. Collective."""
        mounted = () if regions else self.masses()
        return [*self.densities(regions), *((rho, ds) for rho, ds, _ in mounted)]

    def masses(self) -> list[tuple[Expr, WeightedMeasure, Parts]]:
        """Mounted masses: their density, and measure and names of their surfaces. Collective."""
        return self._masses

    @cached_property
    def _masses(self) -> list[tuple[Expr, WeightedMeasure, Parts]]:
        result: list[tuple[Expr, WeightedMeasure, Parts]] = []
        for index, one in enumerate(self.mounted):
            with keyed(f"mass[{index}]"):
                area = checked_area(float(self.area(one.surfaces).value))
            density = self.constant(one.mass / area)
            result.append((density, self.areas(one.surfaces), Parts("surface", one.surfaces)))
        return result

    def density(self, region: MaterialRegion) -> Expr:
        """Density of a region's material.

        Raises:
            InputError: The material has none.
        """
        density = region.law.density
        if density is None:
            raise InputError(
                "weight and motion need a density",
                where=region.table,
                expected='for example density = "1100 kg/m^3"',
            )
        return density

    @cached_property
    def _density_field(self) -> fem.Function:
        return CoefficientBinder(self.body, self.order).joined(
            [(region.law.density, region.cells) for region in self.regions]
        )

    # --- values ---

    def factor(self, amplitude: Amplitude | None) -> Constant:
        """A constant that follows an amplitude (None: as the solver decides)."""
        factor = self.constant(1.0)
        self._amplitudes.append((factor, amplitude))
        return factor

    def factors(self, values: tuple[Component, ...], curve: Amplitude | None) -> list[Constant]:
        """A constant for each component that follows its amplitude, one for all that are alike.

        Args:
            curve: Amplitude that the user gave, or None.
        """
        changing = curve is None and depends_on_time(values)
        shared: dict[bool, Constant] = {}
        result = []
        for value in values:
            timed = changing and (value in (None, 0.0) or depends_on_time((value,)))
            if timed not in shared:
                shared[timed] = self.factor(CONSTANT if timed else curve)
            result.append(shared[timed])
        return result

    def vector(
        self, values: tuple[Component, ...], curve: Amplitude | None, parts: Parts | None = None
    ) -> Expr:
        """A vector at a point of the body, each component times its amplitude, in UFL. Collective.

        Args:
            curve: What the user wrote: see `values.amplitude_of`.
            parts: See `value`.
        """
        values = sized(values, self.body.dim)
        if len(values) != self.body.dim:
            check_components(values, self.body.dim, "load")
        factors = self.factors(values, curve)
        if not any(isinstance(value, Formula) for value in values):
            return factors[0] * self.constant([float(value) for value in values])  # type: ignore[arg-type]
        result = _made(self, values, parts, scalar=False)
        if any(factor is not factors[0] for factor in factors):
            return ufl.as_vector([factor * result[i] for i, factor in enumerate(factors)])
        return factors[0] * result

    def scalar(
        self, value: Component, amplitude: Amplitude | None, parts: Parts | None = None
    ) -> Expr:
        """A number or formula at a point of the body, times its amplitude. Collective.

        Args:
            value: A number [SI] or a formula.
            amplitude: Its amplitude; None: as the solver decides.
            parts: See `value`.
        """
        return self.factor(amplitude) * self.value(value, parts)

    def value(self, value: Component, parts: Parts | None = None) -> Expr:
        """A number, a formula in x, y, z and t or a field at a point of the body. Collective.

        Args:
            parts: Where it is integrated: there formulas are evaluated.  None: anywhere, and a
                formula in x, y and z becomes a polynomial in each cell, see `CellwiseSpace`.
        """
        if not isinstance(value, Formula):
            return self.constant(float(value or 0.0))
        return _made(self, (value,), parts, scalar=True)

    # --- time ---

    @property
    def changes(self) -> bool:
        """An amplitude changes in motion, where those without one are constant."""
        return any(amplitude not in (None, CONSTANT) for _, amplitude in self._amplitudes)

    def set_time(self, t: float, default: Amplitude) -> None:
        """Evaluates all amplitudes and formulas at time t. Not collective.

        Args:
            t: Time [s], or load parameter.
            default: Amplitude where the user gave none.
        """
        self.t.value = t
        if self.formulas is not None:
            self.formulas.set_time(t)
        for factor, amplitude in self._amplitudes:
            factor.value = default.of(amplitude, t)


def formula_places(context: FormContext, parts: Parts) -> FloatArray:
    """Points of this rank at which formulas are evaluated [m], shape (n, 3). Collective.

    Args:
        parts: Where the integral is taken that they stand in.
    """
    return _formulas(context).places(parts)


def _made(
    context: FormContext, values: tuple[Component, ...], parts: Parts | None, *, scalar: bool
) -> Constant | fem.Function:
    """Values of which some are formulas or fields, see `FormulaValues.make`. Collective."""
    check_fields(context.body, values)
    result = _formulas(context).make(values, parts, scalar=scalar)
    if isinstance(result, fem.Function):
        check_finite(context.body, values, result.x.array)
    return result


def _formulas(context: FormContext) -> FormulaValues:
    """The context's values of formulas, which plain problems have not."""
    if context.formulas is None:

        def points(parts: Parts) -> IntegralPoints:
            degree = context.weight_degree if parts.kind == "region" else 2 * context.order
            return context.measures.points(parts, degree)

        context.formulas = FormulaValues(
            context.body.mesh,
            points,
            context.unknowns.degree,
            float(context.t.value),
            context.body.fields,
        )
    return context.formulas


def show_velocity(context: FormContext, v: FloatArray) -> None:
    """Sets the velocity that dashpots see, owned entries of the displacement [m/s]. Collective."""
    seen = context.velocity.x
    seen.array[: len(v)] = v
    seen.scatter_forward()
