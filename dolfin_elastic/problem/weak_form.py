"""`WeakForm`: the one sum of virtual-work terms.

Find u with  delta W_int(u; v) - delta W_ext(v) - delta W_res(u; v) = 0  for all virtual
displacements v, where delta W_int is the integral of P(F) : grad v over the reference volume,
delta W_ext the virtual work of the loads and delta W_res that of springs and contact pressure.
Motion adds inertia to the same sum.  Source: Bonet & Wood (2008), (5.41).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import ufl
from dolfinx import fem
from ufl import replace
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.model.discrete_gradient import StepLaw
from dolfin_elastic.model.kinematics import (
    WeightedMeasure,
    gradient_variation,
    second_from_first,
)
from dolfin_elastic.model.loads import Load
from dolfin_elastic.model.materials.growth import GrownLaw, grown_volume
from dolfin_elastic.model.materials.law import Law, ModifiedLaw, SplitLaw
from dolfin_elastic.model.materials.mixed import Mixed, variance
from dolfin_elastic.model.materials.stepped import SteppedLaw
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.material_regions import MaterialRegion
from dolfin_elastic.problem.term import Term
from dolfin_elastic.problem.term_list import forms_of

UNUSED = 1e-6
"""Compliance, times the shear modulus, of the pressure field in regions that do not need it."""


@dataclass(frozen=True)
class StepStart:
    """Where the time step begins over which internal forces are taken, see `weak_form_over_step`.

    Attributes:
        w: All unknowns at the start of the step.
        share: See `StepLaw`.
    """

    w: fem.Function
    share: fem.Constant


class WeakForm:
    """The virtual work of a body, term by term, in UFL.  Nothing is compiled here.

    Args:
        context: With its measures, in the reference configuration.
        loads: External forces; those at points and lines are no integrals and have no term here.
        eigenstrains: Material's name to its growth Fg (UFL), of those that grow.
        quadrature_degree: Of the internal forces, in place of the laws' own choice.

    Attributes:
        start: Internal forces are those of a time step; None: of a state.
        stepped: Region's name to its law over a step, of those that a `History` has put here.
    """

    def __init__(
        self,
        context: FormContext,
        regions: Sequence[MaterialRegion],
        loads: Sequence[Load],
        terms: Sequence[Term],
        *,
        eigenstrains: Mapping[str, Expr],
        quadrature_degree: int | None,
    ) -> None:
        self._context, self._regions, self._unknowns = context, regions, context.unknowns
        self._loads, self._terms = loads, terms
        self._eigenstrains, self._quadrature_degree = eigenstrains, quadrature_degree
        self._responses: dict[str, Law | ModifiedLaw] = {}
        self._last_F: tuple[Expr, Expr] | None = None
        self.start: StepStart | None = None
        self.stepped: dict[str, SteppedLaw] = {}

    def F(self, w: Expr) -> Expr:
        """The 3x3 deformation gradient of a function of all unknowns, one object of the last w."""
        if self._last_F is None or self._last_F[0] is not w:
            self._last_F = w, self._context.deformation(w)
        return self._last_F[1]

    # --- integration ---

    def rule(self, region: MaterialRegion) -> int:
        """Quadrature degree of a region's internal forces.

        Of incompressible regions at least the one that integrates J exactly, so that the volume
        of a body follows from where its surface is: else the pressure of a body that is held all
        around would be asked for a volume that the supports do not leave it.
        """
        least = _degree_of_volume(self._context) if _keeps_volume(self._context, region) else 0
        if self._quadrature_degree is not None:
            return max(self._quadrature_degree, least)
        degree = max(region.law.quadrature_degree(self._context.order), least)
        if self._context.axisymmetric:
            degree += 1  # the radius is a factor of the integrand
        if region.compliance is not None or self._context.axisymmetric:
            return max(degree, 2)  # the pressure and the radius vary inside a linear element, too
        return degree

    def volume(self, region: MaterialRegion | None, quadrature_degree: int) -> WeightedMeasure:
        """Reference volume as a measure.

        Args:
            region: The material region; None: the whole body.
            quadrature_degree: Degree of polynomials that are integrated exactly.
        """
        return self._context.measures.filled(region.marker if region else None, quadrature_degree)

    # --- internal forces ---

    def response(
        self, region: MaterialRegion, w: Expr, *, pressure: Expr | None = None
    ) -> Law | ModifiedLaw:
        """The law of a region, with its growth and its pressure, and with its time step.

        Args:
            w: Function of all unknowns, from which the pressure is taken.
            pressure: In place of that [Pa], to derive with respect to it.
        """
        # Of the present unknowns it is one object, so that the terms share its expressions.
        present = w is self._unknowns.w and pressure is None
        if present and region.name in self._responses:
            return self._responses[region.name]
        law: Law | ModifiedLaw = self.stepped.get(region.name, region.law)
        if region.compliance is not None:
            p = self._unknowns.auxiliary("pressure", w) if pressure is None else pressure
            split, keeps = cast("SplitLaw", law), _keeps_volume(self._context, region)
            law = Mixed(split, p, region.compliance, keeps)
        growth = self._eigenstrains.get(region.name)
        result: Law | ModifiedLaw = law if growth is None else GrownLaw(law, growth)
        if self.start is not None and derives_from_strain(region.law):
            result = StepLaw(result, self.F(self.start.w), self.start.share)
        if present:
            self._responses[region.name] = result
        return result

    @cached_property
    def internal(self) -> ufl.Form:
        """Internal virtual work: the integral of P(F) : grad v, and the pressure's equation."""
        unknowns = self._unknowns
        F, dF = self.F(unknowns.w), self._variation(ufl.TestFunction(unknowns.W))
        work = sum(
            (
                ufl.inner(self.response(region, unknowns.w).stress(F), dF)
                * self.volume(region, self.rule(region))
                for region in self._regions
            ),
            ufl.Form([]),
        )
        if not unknowns.has("pressure"):
            return work
        q = unknowns.auxiliary("pressure", ufl.TestFunction(unknowns.W))
        return work + sum(self._pressure_terms(region, F, q) for region in self._regions)

    def _variation(self, dw: Expr) -> Expr:
        """The variation of F, 3x3, with a test or trial function of all unknowns."""
        context, unknowns = self._context, self._unknowns
        stretch = unknowns.auxiliary("stretch", dw) if unknowns.has("stretch") else None
        return gradient_variation(context.geometry, unknowns.displacement(dw), context.X, stretch)

    def branches(self, *, of_cell: bool = False) -> ufl.Form:
        """Of the internal virtual work that of `OverStep.branch_stress`; may be empty.

        Not of laws that know what their branches store.

        Args:
            of_cell: Over the macroscopic displacement of a periodic cell, by a test function in V.
        """
        context, form = self._context, ufl.Form([])
        dF = self._variation(ufl.TestFunction(self._unknowns.W))
        if of_cell:
            v = ufl.TestFunction(self._unknowns.V)
            dF = gradient_variation(context.geometry, v, context.X, None)
        for region, law, F in self.elastic_parts():
            stress = law.branch_stress(F)
            if stress is not None and law.stored(F) is None:
                form += ufl.inner(stress, dF) * self.volume(region, self.rule(region))
        return form

    def of_steps(self, density: Callable[[SteppedLaw, Expr], Expr | None]) -> ufl.Form:
        """Integral of what laws over a step tell; may be empty.

        Args:
            density: Of a law and F without growth, per grown volume; None: that law tells nothing.
        """
        form = ufl.Form([])
        for region, law, F in self.elastic_parts():
            if (value := density(law, F)) is not None:
                grown = grown_volume(self.response(region, self._unknowns.w))
                form += grown * value * self.volume(region, self.rule(region))
        return form

    def elastic_parts(self) -> Iterator[tuple[MaterialRegion, SteppedLaw, Expr]]:
        """Each region that remembers, its law over the step, and F without growth."""
        F = self.F(self._unknowns.w)
        for region in self._regions:
            if region.name in self.stepped:
                response = self.response(region, self._unknowns.w)
                elastic = response.elastic(F) if isinstance(response, GrownLaw) else F
                yield region, self.stepped[region.name], elastic

    def _pressure_terms(self, region: MaterialRegion, F: Expr, q: Expr) -> ufl.Form:
        """The pressure's equation in a region.

        With linear elements it is stabilised by the difference of the pressure from its mean over
        each cell: Bochev, Dohrmann & Gunzburger, SIAM J. Numer. Anal. 44 (2006), (2.9).  A region
        whose law has its own volumetric part needs no pressure, but the field extends over the
        whole mesh: a small compliance makes it zero there, and the tangent regular.
        """
        p = self._unknowns.auxiliary("pressure", self._unknowns.w)
        if region.compliance is None:
            return -UNUSED / region.shear * p * q * self.volume(region, 2)
        terms = self.volume_gap(region, F, q)
        if self._unknowns.stabilised:
            off = variance(p, q, ufl.Jacobian(self._context.body.mesh))
            terms -= off / region.shear * self.volume(region, 0)
        return terms

    def volume_gap(self, region: MaterialRegion, F: Expr, q: Expr) -> ufl.Form:
        """Virtual work of the volumetric constraint in a region with a pressure.

        Args:
            region: A material region whose volumetric part a pressure carries.
            F: Deformation gradient, 3x3.
            q: Virtual pressure [Pa]; see `Mixed.gap`.
        """
        return q * self.gap(region, F) * self.volume(region, self.rule(region))

    def gap(self, region: MaterialRegion, F: Expr, *, pressure: Expr | None = None) -> Expr:
        """What the pressure's equation makes zero, see `Mixed.gap`.

        Args:
            region: A material region whose volumetric part a pressure carries.
            F: Deformation gradient, 3x3.
            pressure: See `response`.
        """
        response = self.response(region, self._unknowns.w, pressure=pressure)
        assert isinstance(response, Mixed | GrownLaw | StepLaw)
        return response.gap(F)

    @property
    def has_energy(self) -> bool:
        """All laws derive from an energy."""
        return all(region.law.has_energy for region in self._regions)

    @cached_property
    def strain_energy(self) -> ufl.Form | None:
        """Stored energy of the whole body [J]; None when a law has none."""
        if not self.has_energy:
            return None
        F = self.F(self._unknowns.w)
        return sum(
            self.response(region, self._unknowns.w).energy(F)
            * self.volume(region, self.rule(region))
            for region in self._regions
        )

    # --- external forces ---

    @cached_property
    def works(self) -> list[tuple[Load, ufl.Form]]:
        """Each load that is an integral, with its external virtual work."""
        return [
            (load, self._work(index))
            for index, load in enumerate(self._loads)
            if not (load.concentrated or load.is_eigenstrain or load.support)
        ]

    def _work(self, index: int) -> ufl.Form:
        try:
            return self._loads[index].virtual_work(self._context)
        except InputError as error:
            if error.where.startswith("materials"):  # a fault of a material names its own key
                raise
            raise error.at(f"load[{index}]" if error.where else f"load[{index}].value") from None

    @cached_property
    def external(self) -> ufl.Form | None:
        """External virtual work of all loads; None without loads."""
        return sum(work for _, work in self.works) if self.works else None

    # --- springs, dashpots and contact ---

    @cached_property
    def restraint_works(self) -> dict[str, ufl.Form]:
        """Virtual work of the forces of springs, dashpots and contact pairs, by label."""
        works: dict[str, ufl.Form] = {}
        for term in self._terms:
            if (work := term.form("work")) is not None:
                works[term.label] = works[term.label] + work if term.label in works else work
        return works

    def stored(self, account: str) -> ufl.Form | None:
        """Energy stored in terms of an account [J]; None without any."""
        forms = forms_of([term for term in self._terms if term.account == account], "energy")
        return sum(forms) if forms else None

    def damping(self, velocity: Expr | None = None) -> ufl.Form | None:
        """Virtual work against dashpots; None without any.

        Args:
            velocity: At which [m/s]; None: the present one.
        """
        works = forms_of([term for term in self._terms if term.form("drag") is not None], "work")
        now = self._context.velocity
        if not works:
            return None
        return -(sum(works) if velocity is None else replace(sum(works), {now: velocity}))

    # --- the sum ---

    @cached_property
    def residual(self) -> ufl.Form:
        """Internal virtual work minus that of loads, springs, dashpots and contact."""
        residual = self.internal if self.external is None else self.internal - self.external
        for work in self.restraint_works.values():
            residual -= work
        return residual

    @cached_property
    def tangent(self) -> ufl.Form:
        """Derivative of the residual with respect to all unknowns."""
        return ufl.derivative(self.residual, self._unknowns.w, ufl.TrialFunction(self._unknowns.W))

    def geometric(self, base: fem.Function) -> ufl.Form:
        """Geometric stiffness of the present stress, the integral of S : sym(grad v^T grad du).

        The internal virtual work changes by it at fixed second Piola-Kirchhoff stress S.  A
        pressure that is an unknown is a stress of its own: at fixed p the work of p g, see `Mixed`,
        changes by p d2g(v, du).  Of g = J - 1 that is a divergence, so that a uniform pressure does
        nothing to an enclosed body, where its level may be undetermined.  Of linear laws d2g is
        none, and p is part of S.

        Source: Bonet & Wood (2008), sections 8.3 and 8.6.

        Args:
            base: All unknowns of the state in whose geometry d2g is taken.
        """
        W, w, result = self._unknowns.W, self._unknowns.w, ufl.Form([])
        dv, du = self._variation(ufl.TestFunction(W)), self._variation(ufl.TrialFunction(W))
        for region in self._regions:
            response, volume = self.response(region, w), self.volume(region, self.rule(region))
            if region.compliance is not None and not region.law.linear:
                p = ufl.variable(self._unknowns.auxiliary("pressure", w))
                P = self.response(region, base, pressure=p).stress(self.F(base))
                work = p * ufl.inner(ufl.diff(P, p), dv) * volume
                result += ufl.derivative(work, base, ufl.TrialFunction(W))
                response = self.response(region, w, pressure=ufl.as_ufl(0.0))
            S = second_from_first(response.stress(self.F(w)), self.F(w))
            result += ufl.inner(S, ufl.sym(dv.T * du)) * volume
        return result

    def inertia(self, a: Expr, v: Expr) -> ufl.Form:
        """Virtual work of the inertia forces, the integral of density a . v (consistent mass).

        That of mounted masses is over their surfaces.

        Args:
            a: Acceleration [m/s^2], or a trial function.
        """
        body = sum(
            self._context.density(region)
            * ufl.inner(a, v)
            * self.volume(region, 2 * self._context.order)
            for region in self._regions
        )
        mounted = [rho * ufl.inner(a, v) * ds for rho, ds, _ in self._context.masses()]
        return sum(mounted, body)


def derives_from_strain(law: Law) -> bool:
    """Whether the energy of a law is a function of C, so that `StepLaw` conserves it."""
    return law.has_energy and law.frame_indifferent and law.memory is None and not law.linear


def weak_form_over_step(form: WeakForm, start: StepStart) -> WeakForm:
    """The same virtual work with the internal forces of a time step, see `discrete_gradient`.

    Laws without an energy, and those that rotations change, keep the stress of the middle.

    Args:
        start: Where the step begins.
    """
    changed = _copied(form)
    changed.start, changed._responses = start, {}
    return changed


def weak_form_without_memory(form: WeakForm) -> WeakForm:
    """The same virtual work without the stresses of regions that remember."""
    changed = _copied(form)
    changed._regions = [one for one in form._regions if one.name not in form.stepped]
    return changed


def _copied(form: WeakForm) -> WeakForm:
    changed = copy(form)
    for made in ("internal", "residual", "tangent", "strain_energy"):
        vars(changed).pop(made, None)
    return changed


def _keeps_volume(context: FormContext, region: MaterialRegion) -> bool:
    """A region keeps its volume exactly; in plane stress the stretch across gives way."""
    return region.incompressible and not context.unknowns.has("stretch")


def _degree_of_volume(context: FormContext) -> int:
    """Degree of J in the cells; of J times the radius in bodies of revolution."""
    order, dim = context.order, context.body.dim
    return dim * (order - 1) + (order if context.axisymmetric else 0)
