"""`NodalContact`: contact of linear faces, its pressures at their nodes.

Gap and multiplier are compared at the nodes, by the trapezoidal rule, so that a face on a curved
obstacle is not asked for more than its nodes can do.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from ufl.core.expr import Expr

from dolfin_elastic.core.ghosts import assembled
from dolfin_elastic.core.jit import compile_forms, options
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.shapes.shapes import Operations, Plane
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray, Scalar
from dolfin_elastic.mesh.geometry.simplices import cells_beside_facets, facet_corners
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.model.kinematics import WeightedMeasure
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.term import Kind
from dolfin_elastic.problem.terms.contact.pair import FAR, ContactPair
from dolfin_elastic.problem.terms.contact.pressures import LinearGaps
from dolfin_elastic.problem.terms.contact.step import pressure_of_step

RULE = {"quadrature_rule": "vertex", "quadrature_degree": 1}
"""The trapezoidal rule."""


def _choose(sign: Scalar, a: Scalar, b: Scalar) -> Expr:
    return ufl.conditional(ufl.ge(sign, 0.0), a, b)


class NodalContact(ContactPair):
    """One contact of linear faces.  Its forces are integrals. Collective to make."""

    def __init__(
        self, contact: Contact, context: FormContext, index: int, thickness: float
    ) -> None:
        super().__init__(contact, context, index, thickness)
        self._measure = context.measures.contact_area(contact.surfaces, RULE)
        if self._axisymmetric:
            self._measure = self._weights_at_axis(self.facets)

    def _weights_at_axis(self, facets: IndexArray) -> WeightedMeasure:
        """The measure with weights of nodes near the axis of an axisymmetric body.

        The trapezoidal rule would give a node on the axis none of the ring around it: its weight is
        the integral of its shape function times the radius, for which the radius at a node is
        replaced by (r + 2 r_middle)/3, r_middle that of the facet.
        """
        middle = _middle_radius(self._context.body.mesh, facets)
        weight = 2 * ufl.pi * (self._context.X[0] + 2 * middle) / 3
        return WeightedMeasure(weight, self._measure.measure)

    # --- forms ---

    def form(self, kind: Kind) -> ufl.Form | None:
        """See `Term`.

        The potential has the multiplier at rest.  The penalty bounds the rows of the tangent: at an
        obstacle's curvature 1/R that has the further eigenvalue eps g/R, which is smaller.
        """
        if kind == "work":
            push = self.pose.acting_in_form(self._normal)
            return self.pressure * ufl.inner(push, self._context.v) * self._measure
        if kind == "energy":
            q = ufl.max_value(self._trial_pressure, 0.0)
            return (q**2 - self.lam**2) / (2 * self.penalty) * self._measure
        return self.penalty * sum(self._context.v) * self._measure if kind == "bound" else None

    @cached_property
    def _gap(self) -> tuple[Expr, Expr]:
        """Gap and normal of the current place."""
        return self._gap_at(self.step.place(self._context.X))

    @cached_property
    def _ends(self) -> tuple[Expr, Expr]:
        """Places at both ends of the step."""
        return self.step.places(self._context.X)

    @cached_property
    def _normal(self) -> Expr:
        """Direction of the forces, see `step`."""
        first, last = self._ends
        at_middle = self._gap_at((first + last) / 2)[1]
        if isinstance(self.contact.obstacle, Plane):
            return at_middle
        gaps = self._gap_at(first)[0], self._gap_at(last)[0]
        return self.step.mean_normal(gaps, last - first, at_middle)

    def _gap_at(self, place: Expr) -> tuple[Expr, Expr]:
        use = Operations(self._context.constant, ufl.sqrt, _choose)
        distance, normal = self.contact.obstacle.gap([place[i] for i in range(self._dim)], use)
        return distance, ufl.as_vector(normal)

    @cached_property
    def _trial_pressure(self) -> Expr:
        """Trial contact pressure lam - eps g [Pa]."""
        return self.lam - self.penalty * self._gap[0]

    @cached_property
    def pressure(self) -> Expr:
        """Contact pressure on the reference area [Pa], of the step."""
        first, last = (self.lam - self.penalty * self._gap_at(place)[0] for place in self._ends)
        return pressure_of_step(self.step, first, last, -self.penalty * self._reach)

    def keep(self, pressing: BoolArray | None) -> None:
        """See `Pressures`: in the form, the others' multipliers are below all that is contact."""
        super().keep(pressing)
        self.assume(None if pressing is None else True)
        if pressing is not None:
            # Penalties are those of cells there: by this factor they do not differ at a node.
            self.lam.x.array[self.nodes[~pressing]] = -1e6 * FAR * self.eps[~pressing]
            self.lam.x.scatter_forward()

    @cached_property
    def linearised(self) -> _NodalGaps:
        """See `Pressures`."""
        return _NodalGaps(self)

    def along(self, way: FloatArray) -> _ForceOfForm:
        """See `ContactPair`."""
        n = ufl.dot(self._normal, self._context.constant([float(x) for x in way]))
        force = self.pressure * n * self._measure
        return _ForceOfForm(self._context, force, self.penalty * self._measure)


class _NodalGaps(LinearGaps):
    """See `LinearGaps`. Collective to make."""

    def __init__(self, pair: NodalContact) -> None:
        S, v = pair.lam.function_space, pair._context.v
        self._pair, self._field = pair, fem.Function(S)
        area = ufl.TestFunction(S) * pair._measure
        work = self._field * ufl.inner(pair.pose.acting_in_form(pair._normal), v) * pair._measure
        sizes, self._work = compile_forms(pair.comm, [area, work], options(pair.comm))
        self.areas = assembled(sizes, S)[pair.nodes]

    def rates(self, motion: FloatArray) -> FloatArray:
        """See `LinearGaps`."""
        pair, normals = self._pair, self._pair.gaps()[1]
        along = np.sum(normals * pair._of_nodes(motion.reshape(-1, normals.shape[1])), axis=1)
        return along if pair.kept is None else along * pair.kept

    def spread(self, pressures: FloatArray) -> FloatArray:
        """See `LinearGaps`."""
        self._field.x.array[self._pair.nodes] = pressures
        self._field.x.scatter_forward()
        return assembled(self._work, self._pair._context.unknowns.W)


class Touch(NamedTuple):
    """What friction depends on, in UFL, and the area over which its forces are integrated.

    Attributes:
        normal: The obstacle's, as it has it, at the present place.
        pressure: Contact pressure on the reference area, not below 0 [Pa].
        closed: 1 where the surface is in contact, also without a pressure; else 0.
        area: Reference area, by the rule of the pressure.
    """

    normal: Expr
    pressure: Expr
    closed: Expr
    area: WeightedMeasure


def touch(pair: NodalContact) -> Touch:
    """What friction needs of a contact. Not collective."""
    trials = (pair.lam - pair.penalty * pair._gap_at(place)[0] for place in pair._ends)
    at_ends = [ufl.ge(trial, -pair.penalty * pair._reach) for trial in trials]
    closed = ufl.conditional(ufl.Or(*at_ends), 1.0, 0.0)
    pressure = ufl.max_value(pair.pressure, 0.0)
    return Touch(pair._gap[1], pressure, closed, pair._measure)


class _ForceOfForm:
    """See `ForceAlong`.

    Args:
        penalty: As a whole [N/m].
    """

    def __init__(self, context: FormContext, force: ufl.Form, penalty: ufl.Form) -> None:
        self._comm, self._space = context.body.comm, context.unknowns.W
        row = ufl.derivative(force, context.unknowns.w, ufl.TestFunction(self._space))
        forms = compile_forms(self._comm, [force, row, penalty], options(self._comm))
        self._force, self._row, whole = forms
        self.stiffness = total(self._comm, float(fem.assemble_scalar(whole)))

    def value(self) -> float:
        """See `ForceAlong`."""
        return total(self._comm, float(fem.assemble_scalar(self._force)))

    def row(self) -> FloatArray:
        """See `ForceAlong`."""
        return assembled(self._row, self._space)


def _middle_radius(mesh: Mesh, facets: IndexArray) -> Expr:
    """Radius of the middle of the facet at hand [m]: a cell may have several in contact.

    On the reference triangle the outward normals are (1, 1)/sqrt(2), (-1, 0) and (0, -1).
    """
    radii = fem.Function(fem.functionspace(mesh, ("DG", 0, (3,))))
    beside, local = cells_beside_facets(mesh, facets)
    cells = radii.function_space.dofmap.list[beside, 0]
    radii.x.array.reshape(-1, 3)[cells, local] = facet_corners(mesh, facets)[:, :, 0].mean(axis=1)
    normal = ufl.geometry.ReferenceNormal(mesh)
    left = ufl.conditional(ufl.lt(normal[0], -0.5), radii[1], radii[2])
    return ufl.conditional(ufl.gt(normal[0], 0.5), radii[0], left)
