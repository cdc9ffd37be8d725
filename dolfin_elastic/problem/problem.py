"""`Problem`: a model on a mesh, as solvers and results see it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

import ufl
from dolfinx.fem import Constant, Function
from ufl.core.expr import Expr

from dolfin_elastic.core import jit
from dolfin_elastic.core.errors import InputError, all_errors, keyed, nearest
from dolfin_elastic.core.help.notebook import Shown
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import Body, cell_size, span
from dolfin_elastic.model.amplitude import CONSTANT, PROPORTIONAL, Amplitude, Share
from dolfin_elastic.model.axes import LocalAxes, PlacedAxes, check_name
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.model.kinematics import Geometry, weight
from dolfin_elastic.model.loads import Cavity, ConcentratedLoad, Eigenstrain, Force, Load
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.periodic import Periodic
from dolfin_elastic.model.self_contact import AnyContact, SelfContact
from dolfin_elastic.model.supports.displacement import Restraint, Rotation
from dolfin_elastic.model.supports.springs import Dashpot, ResistingSupport, Spring
from dolfin_elastic.model.tie import Tie
from dolfin_elastic.model.values import OnSurfaces, depends_on_time
from dolfin_elastic.problem.constraints.normals import check_outside
from dolfin_elastic.problem.constraints.periodic.unit_cell import Cell, Fluctuation, make_cell
from dolfin_elastic.problem.constraints.rows import Constraints
from dolfin_elastic.problem.context import FormContext, Measures
from dolfin_elastic.problem.eigenstrain import Shank, eigenstrains, shanks_of
from dolfin_elastic.problem.material_regions import (
    WHOLE,
    Formulation,
    checked_geometry,
    make_material_regions,
    shear_modulus,
)
from dolfin_elastic.problem.obstacles import with_surfaces
from dolfin_elastic.problem.pressure.groups import pressure_groups
from dolfin_elastic.problem.spaces import Unknowns
from dolfin_elastic.problem.term import Resistance
from dolfin_elastic.problem.term_list import Terms
from dolfin_elastic.problem.terms.bolts import make_bolts
from dolfin_elastic.problem.terms.cavities import make_cavities
from dolfin_elastic.problem.terms.contact.checks import check_contacts, check_pairs
from dolfin_elastic.problem.terms.contact.friction import CoulombFriction
from dolfin_elastic.problem.terms.contact.loaded_obstacle import make_loaded_obstacles
from dolfin_elastic.problem.terms.contact.pair import ContactPair
from dolfin_elastic.problem.terms.point_loads import NodalLoads
from dolfin_elastic.problem.terms.pressure_symmetry import follower_pressure_has_potential
from dolfin_elastic.problem.terms.rigid_surfaces import RigidSurface, TurnedSurface
from dolfin_elastic.problem.weak_form import (
    StepStart,
    WeakForm,
    derives_from_strain,
    weak_form_over_step,
)

if TYPE_CHECKING:
    from dolfin_elastic.model.point_mass import PointMass
    from dolfin_elastic.problem.history.history import History


def placed_axes(
    axes: Mapping[str, LocalAxes], body: Body, geometry: Geometry
) -> dict[str, PlacedAxes]:
    """Local axes on a body. Collective.

    Raises:
        InputError: A name that axes cannot have, or the body has no such axes.
    """
    size, result = span(body), dict[str, PlacedAxes]()
    with all_errors() as attempt:
        for name, one in axes.items():
            with attempt(), keyed(f"axes.{name}"):
                check_name(name)
                result[name] = one.in_metres(body.unit.metres).placed(
                    size, body.dim, axisymmetric=geometry == "axisymmetric"
                )
    return result


Placed = TypeVar("Placed", bound=Record)


class _Parameters(dict[str, Constant]):
    def __missing__(self, key: str) -> Constant:
        raise InputError(f"there is no parameter '{key}'", expected=nearest(key, self))


class Problem(Shown):
    """An elastic body with materials, supports and loads.

    All of it is collective: make it on every rank with the same arguments.

    Args:
        materials: A law for the whole body, or region's name to law; together the regions must
            cover every cell exactly once.
        supports: Prescribed displacements, springs and dashpots; where a displacement is
            prescribed twice, the later one counts.
        contacts: Contact of surfaces with rigid obstacles and with each other, see `Contact`, and
            with themselves, see `SelfContact`.
        ties: Surfaces with different meshes that move together.
        masses: What is mounted on surfaces and has a mass, but no stiffness.
        degree: Degree of the displacement on tetrahedra or triangles, 1 or 2; explicit schemes
            need 1.
        quadrature_degree: Overrides the law's own choice for the internal forces.
        formulation: "displacement"; "mixed", with a pressure for nearly incompressible materials;
            or "auto": what the materials need.
        geometry: What a two-dimensional body is: "plane-strain", "plane-stress" or
            "axisymmetric" (x is the radius, y the axis).
        thickness: Of a plane body [m].
        periodic: Faces that are one, and the macroscopic deformation of the cell they bound.
        axes: Name to local axes in which results are asked for.

    Bare numbers of places are in the mesh's unit; in the attributes all lengths are in metres.

    Attributes:
        u: The displacement [m]; solvers change it through `w`.
        w: All unknowns: the displacement and, in some problems, scalar fields beside it.
        places: Of the local nodes of the displacement in the reference configuration [m], shape
            (nodes, 3).
        thickness: Of a plane body [m]; 1 of others.
        context: Measures, fields and amplitudes from which loads and supports make their forms.
        weak_form: The sum of virtual-work terms.
        regions: The materials, each on its cells.
        constraints: Prescribed displacements, and those that follow others.
        contacts: In metres, those of `contact_pairs` and of surfaces with themselves.
        contact_pairs: The contacts with obstacles and between two surfaces.
        frictions: The friction of those that have some.
        cell: The macroscopic deformation of a periodic cell, or None.
        eigenstrains: Material's name to its growth Fg (UFL), of those that grow.
        terms: Springs, dashpots, contacts, loads at points, cavities, rigid surfaces, and what else
            acts on the body.
        history: What materials remember; None where none does.
        nodal_loads: Forces at points and along lines, which have no UFL form; None without any.
        constant: Makes a UFL constant: a new value of it needs no new compilation.
        t: UFL constant with the time, used by formulas.
        X: Reference coordinates (UFL).
        axes: Name to local axes, on this body.

    Raises:
        MeshError: A name does not exist, or the materials do not cover the body exactly once.
        InputError: A vector with the wrong number of components, a missing density, an energy of
            the user's own that is no material.
    """

    _growing = False

    def __init__(
        self,
        body: Body,
        materials: Law | Mapping[str, Law],
        *,
        supports: Sequence[Restraint] = (),
        loads: Sequence[Load] = (),
        contacts: Sequence[AnyContact] = (),
        ties: Sequence[Tie] = (),
        masses: Sequence[PointMass] = (),
        degree: int = 2,
        quadrature_degree: int | None = None,
        formulation: Formulation = "auto",
        geometry: Geometry = "plane-strain",
        thickness: float = 1.0,
        periodic: Periodic | None = None,
        axes: Mapping[str, LocalAxes] | None = None,
    ) -> None:
        self.body, self.degree, self.thickness = body, degree, thickness
        supports, loads = _in_metres(body, supports), _in_metres(body, loads)
        contacts, ties = _in_metres(body, contacts), _in_metres(body, ties)
        self.contacts = tuple(contacts)
        self.supports, self.loads = _all_supports(supports, loads), tuple(_on_parts(body, loads))
        self.geometry = checked_geometry(geometry, thickness, body)
        self.axes = placed_axes(axes, body, self.geometry) if axes else {}
        order = max(degree, int(body.mesh.geometry.cmap.degree))
        axisymmetric = self.geometry == "axisymmetric"
        if contacts:
            check_contacts(contacts, body, turned=axisymmetric)
            check_pairs(contacts, ties, body)
            contacts = with_surfaces(contacts, body)
        _check_normals(body, self.supports, self.loads, contacts)
        self.cell: Cell | None = None
        if periodic is not None:
            others = {"support": supports, "load": loads, "contact": contacts, "tie": ties}
            self.cell = make_cell(body, periodic, others, geometry=self.geometry, depth=thickness)
        laws = materials if isinstance(materials, Mapping) else {WHOLE: materials}
        self.regions, fields = make_material_regions(
            body, laws, formulation, degree=degree, order=order, geometry=self.geometry
        )
        pinned, auxiliary = None, fields.auxiliary_fields
        groups = pressure_groups(body, self.regions, laws, self.loads) if fields.mixed else None
        if self.cell is None:
            self.unknowns = Unknowns(body.mesh, degree, auxiliary, groups)
        else:
            self.unknowns = Fluctuation(body.mesh, degree, auxiliary, self.cell, groups)
            pinned = self.unknowns.pinned
        self.V, self.u = self.unknowns.V, self.unknowns.u
        self.W, self.w, self.v = self.unknowns.W, self.unknowns.w, self.unknowns.v
        self.places = self.unknowns.places
        self._scale_unknowns()
        self.measures = self._make_measures(contacts, masses)
        self.context = FormContext(
            body, self.unknowns, self.regions, self.measures, self.geometry, tuple(masses)
        )
        self.constant, self.t, self.X = self.context.constant, self.context.t, self.context.X
        self.constraints = Constraints(
            body,
            self.V,
            self.supports,
            ties,
            coordinates=self.places,
            axis=axisymmetric,
            pinned=pinned,
        )
        self._make_rare_terms(contacts)
        self.weak_form = WeakForm(
            self.context,
            self.regions,
            self.loads,
            self.terms,
            eigenstrains=self.eigenstrains,
            quadrature_degree=quadrature_degree,
        )
        self.history = _history(self)
        # Forms are made lazily; evaluated here, an invalid load or spring fails on construction.
        _ = self.weak_form.external, self.weak_form.restraint_works

    def _make_measures(
        self, contacts: Sequence[AnyContact], masses: Sequence[PointMass]
    ) -> Measures:
        mesh, thickness = self.body.mesh, float(self.thickness)
        depth = None if thickness == 1.0 else Constant(mesh, thickness)
        return Measures(
            self.body,
            [region.cells for region in self.regions],
            [
                *(term.parts for term in self.loads if not term.concentrated),
                *(s.surfaces for s in self.supports if isinstance(s, ResistingSupport)),
                *(mass.surfaces for mass in masses),
            ],
            weight(self.geometry, ufl.SpatialCoordinate(mesh), depth),
            [contact.surfaces for contact in contacts if isinstance(contact, Contact)],
        )

    def _make_rare_terms(self, contacts: Sequence[AnyContact]) -> None:
        """Makes what few problems have where there is any, to keep the usual path short."""
        kinds = {type(load) for load in self.loads}
        resisting = [s for s in self.supports if isinstance(s, ResistingSupport)]
        self.terms = Terms(Resistance(s, self.context) for s in resisting)
        self.contact_pairs: tuple[ContactPair, ...] = ()
        self.frictions: tuple[CoulombFriction, ...] = ()
        if contacts:
            from dolfin_elastic.problem.terms.bodies.contact import make_contacts
            from dolfin_elastic.problem.terms.bodies.friction import make_frictions

            self.contact_pairs = make_contacts(contacts, self.context, self.thickness)
            for pair in self.contact_pairs:
                if pair.contact.mesh is not None:  # of any shape, and as thin as a blade
                    pair.follows = self.constraints
            self.terms += self.contact_pairs
            self.terms += make_loaded_obstacles(self.contact_pairs, self.context)
            self.frictions = tuple(make_frictions(self.contact_pairs, self.context))
            self.terms += self.frictions
        if any(isinstance(contact, SelfContact) for contact in contacts):
            from dolfin_elastic.problem.terms.bodies.barrier import make_barriers

            self.terms += make_barriers(contacts, self.context, self.thickness)
        self.eigenstrains: dict[str, Expr] = {}
        shanks: dict[int, Shank] = {}
        if any(issubclass(kind, Eigenstrain) for kind in kinds):
            shanks = shanks_of(self.context, self.loads)
            self.eigenstrains = eigenstrains(self.context, self.loads, shanks)
        self.nodal_loads: NodalLoads | None = None
        if any(issubclass(kind, ConcentratedLoad) for kind in kinds):
            self.nodal_loads = NodalLoads(self.body, self.V, self.loads)
            self.terms.append(self.nodal_loads)
        if any(issubclass(kind, Cavity) for kind in kinds):
            self.terms += make_cavities(self.loads, self.context, self.constraints)
        if shanks:
            self.terms += make_bolts(self.loads, shanks, self.context, lambda: self.weak_form)
        what = self.context, self.constraints
        self.terms += [RigidSurface(motion, *what) for motion in self.constraints.rigid_motions]
        self.terms += [TurnedSurface(s, *what) for s in self.supports if isinstance(s, Rotation)]

    def _scale_unknowns(self) -> None:
        """Scales the auxiliary fields to the magnitude of displacements, see `spaces.Unknowns`."""
        h = cell_size(self.body)
        if self.mixed:
            self.unknowns.scale["pressure"].value = self.stiffness / h
        if self.unknowns.has("stretch"):
            self.unknowns.scale["stretch"].value = 1 / h

    @property
    def springs(self) -> tuple[Spring, ...]:
        """Supports with a stored energy."""
        return tuple(s for s in self.supports if isinstance(s, Spring))

    @property
    def dashpots(self) -> tuple[Dashpot, ...]:
        """Supports whose force depends on the velocity: they act in motion only."""
        return tuple(s for s in self.supports if isinstance(s, Dashpot))

    @cached_property
    def parameters(self) -> dict[str, Constant]:
        """Dotted key of each number in the materials, "materials.rubber.E", to its UFL constant.

        A material without a region is called "body".  A new `value` counts from then on, in SI
        units and unchecked, and needs no new compilation.  What was chosen when the problem was
        made stays: its unknowns, and scales of solvers; so nu = 0.5 is no parameter.  Asked for
        another key it raises an `InputError` with the nearest one.
        """
        return _Parameters(
            (f"{region.table}.{name}", constant)
            for region in self.regions
            for name, constant in region.constants.items()
        )

    # --- properties that solvers depend on ---

    @property
    def has_energy(self) -> bool:
        """All laws derive from an energy."""
        return self.weak_form.has_energy

    @cached_property
    def symmetric(self) -> bool:
        """The tangent is symmetric: laws and loads derive from potentials. Collective.

        The stress of a time step depends on its start, too, and has none.
        """
        of_a_state = self.weak_form.start is None
        potentials = self.has_energy and all(term.symmetric for term in self.terms)
        potentials &= all(region.given.symmetric_steps for region in self.regions)
        return of_a_state and potentials and all(map(self._conservative, self.loads))

    def _conservative(self, load: Load) -> bool:
        if load.conservative or not self._follows(load):
            return True
        # The stretch out of the plane enlarges the loaded area, but has no equation with the load.
        if not load.conservative_if_edge_fixed or self.unknowns.has("stretch"):
            return False
        return follower_pressure_has_potential(self.body, self.constraints, load.parts)

    def _follows(self, load: Load) -> bool:
        return load.follower and not (load.linearises and self.context.linear)

    @property
    def linear(self) -> bool:
        """The residual is linear in u."""
        if self.history is not None:  # affine, but with another tangent for each length of a step
            return False
        if any(self._follows(load) for load in self.loads):
            return False
        return self.context.linear and all(term.linear for term in self.terms)

    @property
    def num_dofs(self) -> int:
        """Unknowns on all ranks, prescribed ones included."""
        return int(self.W.dofmap.index_map.size_global * self.W.dofmap.index_map_bs)

    @property
    def mixed(self) -> bool:
        """There is a pressure beside the displacement."""
        return self.unknowns.has("pressure")

    @cached_property
    def jit(self) -> jit.JitOptions:
        """Options for the form compiler. Collective."""
        return jit.options(self.body.comm)

    @property
    def loaded(self) -> bool:
        """There are loads, in forms or in none."""
        return bool(self.loads) or any(term.nodal and not term.restrains for term in self.terms)

    @property
    def loads_change(self) -> bool:
        """The applied nodal forces change in motion: with time, or with the body's shape."""
        return (
            self.context.changes
            or any(term.changes for term in self.terms)
            or any(self._follows(load) or depends_on_time(load.values) for load in self.loads)
        )

    @property
    def curves(self) -> list[Amplitude]:
        """Amplitudes that loads, supports and obstacles have of their own."""
        obstacles = (pair.contact for pair in self.contact_pairs)
        result = [
            getattr(thing, "curve", None) for thing in (*self.loads, *self.supports, *obstacles)
        ]
        return [curve for curve in result if isinstance(curve, Amplitude)]

    @property
    def corners(self) -> list[float]:
        """Times at which an amplitude has a corner or turns around, sorted [s]."""
        return sorted({t for curve in self.curves for t in curve.breakpoints})

    @property
    def driven_by_formula(self) -> bool:
        """A formula in t drives a load, support or obstacle: it may turn around at any time."""
        formulas = [load.values for load in self.loads]
        formulas += [function for support in self.supports for function in support.time_functions]
        formulas += [pair.contact.moves for pair in self.contact_pairs]
        curves = any(curve.is_formula for curve in self.curves)
        return curves or any(depends_on_time(vector) for vector in formulas)

    def check_start(self, *, default: Amplitude = CONSTANT) -> list[str]:
        """Warnings of what acts on the body as a run begins, see `Term.check_start`. Collective.

        Args:
            default: Of `set_time`.
        """
        if not self.terms.opens:
            return []
        self.set_time(0.0, default=default)
        return [note for term in self.terms if (note := term.check_start())]

    def set_time(self, t: float, *, default: Amplitude = CONSTANT) -> None:
        """Evaluates loads, prescribed displacements and obstacles at time t. Not collective.

        Args:
            t: Time [s], or load parameter from 0 to 1.
            default: Amplitude of loads, supports and obstacles without `curve`.
        """
        t, default = self.acting(t, default)
        self.context.set_time(t, default)
        self.constraints.set_time(t, default)
        if self.cell is not None:
            self.cell.set_time(t, default)
            self.unknowns.w_to_u()
        for term in self.terms:
            term.set_time(t, default)
        if self.history is not None:
            self.history.set_time(t)

    def acting(self, t: float, default: Amplitude = PROPORTIONAL) -> tuple[float, Amplitude]:
        """Time and default amplitude of what acts at t, see `growing_to_start`."""
        return (0.0, Share("constant", share=t)) if self._growing else (t, default)

    @contextmanager
    def growing_to_start(self) -> Iterator[None]:
        """Inside, the time is the share of all that acts at time 0 of a motion. Not collective."""
        self._growing = True
        try:
            yield
        finally:
            self._growing = False

    @cached_property
    def stiffness(self) -> float:
        """Largest shear modulus of all materials at small strains [Pa]."""
        return max(shear_modulus(region.typical) for region in self.regions)


def _history(problem: Problem) -> History | None:
    """What the materials of a problem remember; None where none does. Collective."""
    if all(region.law.memory is None for region in problem.regions):
        return None
    from dolfin_elastic.problem.history.history import History

    grows = bool(problem.eigenstrains)
    return History(problem.context, problem.weak_form, problem.cell, grows=grows)


def results_of(problem: Problem, forces: FloatArray) -> dict[str, float]:
    """Results of terms and of what has yielded, by name [SI units]. Collective.

    Args:
        forces: See `Term.add_results`.
    """
    history = {} if problem.history is None else problem.history.results()
    return problem.terms.results(forces) | history


def over_step(problem: Problem) -> Problem:
    """The same problem with the internal forces of a time step, see `weak_form_over_step`.

    It shares the unknowns and all else.  Collective.
    """
    changed = copy(problem)
    vars(changed).pop("symmetric", None)
    w = Function(problem.W, name="unknowns at the start of the step")
    start = StepStart(w, problem.constant(0.0))
    changed.weak_form = weak_form_over_step(problem.weak_form, start)
    return changed


def conserves(problem: Problem) -> bool:
    """Whether `over_step` changes anything. Not collective.

    In plane stress it would extrapolate the stretch out of the plane; growth changes volumes, which
    belong to the end of a step, where its forces belong to the middle; and a periodic cell is
    deformed from outside.
    """
    unknowns = problem.unknowns
    excluded = unknowns.has("stretch") or (problem.mixed and problem.eigenstrains) or problem.cell
    return not excluded and any(derives_from_strain(part.law) for part in problem.regions)


def partly_incompressible(problem: Problem) -> bool:
    """Whether some region is incompressible, so that its pressure is a Lagrange multiplier.

    Such a pressure does not follow from the displacement.  In plane stress it does: the stretch out
    of the plane gives way. Not collective.
    """
    if problem.unknowns.has("stretch"):
        return False
    return any(part.incompressible for part in problem.regions)


def wholly_incompressible(problem: Problem) -> bool:
    """Whether every region is incompressible. Not collective."""
    return all(part.incompressible for part in problem.regions)


def parts_held(problem: Problem) -> dict[str, list[str]]:
    """Label of supports, springs, contacts and ties to the parts that they act on."""
    contacts = [pair.contact for pair in problem.contact_pairs]
    ties = [] if problem.constraints.ties is None else problem.constraints.ties.given
    result: dict[str, list[str]] = defaultdict(list)
    every: list[OnSurfaces] = [*problem.supports, *contacts, *ties]
    for holder in every:
        result[holder.label] += holder.surfaces
    return result


def configuration_of_moments(problem: Problem) -> str:
    """In which configuration moments balance: "reference", "current", or "none".

    The stress P of a small-strain law is symmetric itself, that of all others is where it acts:
    P F^T is symmetric (Bonet & Wood (2008), section 5.2).
    """
    linear = [part.law.linear for part in problem.regions]
    if problem.geometry == "axisymmetric" or (any(linear) and not all(linear)):
        return "none"
    return "reference" if all(linear) else "current"


def _in_metres(body: Body, records: Sequence[Placed]) -> list[Placed]:
    """Records with all lengths in metres, of which bare numbers are in the mesh's unit. Local."""
    return [record.in_metres(body.unit.metres) for record in records]


def _all_supports(supports: Sequence[Restraint], loads: Sequence[Load]) -> tuple[Restraint, ...]:
    return (*supports, *(plate for load in loads if (plate := load.support) is not None))


def _on_parts(body: Body, loads: Sequence[Load]) -> Iterator[Load]:
    """The loads, total forces as those on the kind of their parts. Local.

    A set of nodes that facets do not cover counts as points.
    """
    for index, load in enumerate(loads):
        if isinstance(load, Force):
            with keyed(f"load[{index}].on"):
                load = load.on_kind(_kind(body, load.parts))  # noqa: PLW2901
        yield load


def _kind(body: Body, names: Sequence[str]) -> str:
    return "point" if body.uncovered.keys() & names else body.common_kind(names)


def _check_normals(
    body: Body,
    supports: Sequence[Restraint],
    loads: Sequence[Load],
    contacts: Sequence[AnyContact],
) -> None:
    """Surfaces whose outward normal a spring, load or contact needs are outside. Collective."""
    result = [
        (f"support[{i}].on", s.surfaces)
        for i, s in enumerate(supports)
        if isinstance(s, ResistingSupport) and s.by_normal
    ]
    result += [(f"load[{i}].on", load.parts) for i, load in enumerate(loads) if load.along_normal]
    result += [
        (f"contact[{i}].{contact.key_of_names}", contact.surfaces)
        for i, contact in enumerate(contacts)
    ]
    for where, names in result:
        for name in names:
            if name in body.surfaces:  # unknown names are refused where they are used
                check_outside(body, name, where)
