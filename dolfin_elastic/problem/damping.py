"""Damping inside a body: viscous stresses and Rayleigh's damping, as virtual work.

Viscous (Kelvin-Voigt): P = F S with S = 2 eta Edot, Edot = sym(F^T Fdot) the rate of Green's
strain.  S and Edot are not changed by rotations, so neither rotations nor their speed are damped,
and the power 2 eta Edot : Edot is never negative.  In laws of small strains P = 2 eta epsdot.

Rayleigh: forces -a M v against the velocity itself, and the stress b Sdot, the rate of the elastic
second Piola-Kirchhoff stress: b C(F) : Edot with the present material tangent C.  At rest this is b
times the stiffness, as usual; unlike that it does not resist rotations, for the geometric part of
the tangent is left out: P = b (Pdot - Fdot S).  Where a pressure carries the change of volume it
has no part in it.

Sources: G. A. Holzapfel, Nonlinear Solid Mechanics (2000), (2.163) and section 6.10; T. Belytschko,
W. K. Liu & B. Moran, Nonlinear Finite Elements (2000), section 5.4 (rates that are objective);
Lord Rayleigh, The Theory of Sound (1877), section 81; J. F. Hall, Earthq. Eng. Struct. Dyn. 35
(2006) 525 (why the stiffness must not be that of rest).
"""

from __future__ import annotations

from dataclasses import dataclass

import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.kinematics import gradient_variation, variables
from dolfin_elastic.model.materials.growth import GrownLaw
from dolfin_elastic.model.materials.law import Law, ModifiedLaw, SplitLaw
from dolfin_elastic.problem.material_regions import MaterialRegion
from dolfin_elastic.problem.problem import Problem


@dataclass(frozen=True)
class _Shape(ModifiedLaw):
    """A law without what its pressure carries."""

    law: SplitLaw

    def energy(self, F: Expr) -> Expr:
        return self.law.shape_energy(F)

    def stress(self, F: Expr) -> Expr:
        return self.law.shape_stress(F)


def check_damped(problem: Problem, stiffness: float) -> None:
    """Materials have a velocity to be damped by.

    Args:
        stiffness: Rayleigh's factor of the stiffness [s].

    Raises:
        InputError: They have none.
    """
    inside = stiffness or any(region.law.viscosity is not None for region in problem.regions)
    if not inside or not problem.unknowns.has("stretch"):
        return
    raise InputError(
        "the thickness stretch of plane stress has no velocity, so its material cannot be damped",
        where="dynamics.rayleigh" if stiffness else "materials",
        expected="plane strain, or rayleigh = [alpha, 0] and no viscosity",
    )


class Damping:
    """Damping of a body by its materials.  Collective to make.

    Args:
        mass: Rayleigh's factor of the mass [1/s].
        stiffness: Rayleigh's factor of the stiffness [s].

    Attributes:
        mass: As given: forces -a M v are in no form.
        shift: Derivative of the velocity by the displacement in the tangent [1/s].
        rate: Velocity in the space of all unknowns [m/s], zero for scalar fields.

    Raises:
        InputError: The body cannot be damped so.
    """

    def __init__(self, problem: Problem, mass: float = 0.0, stiffness: float = 0.0) -> None:
        self._problem, self.mass = problem, mass
        self._stiffness = problem.constant(stiffness) if stiffness else None
        self.shift = problem.constant(0.0)
        self.rate = fem.Function(problem.W, name="velocity")
        self._viscous_regions = [p for p in problem.regions if p.law.viscosity is not None]
        check_damped(problem, stiffness)

    @property
    def inside(self) -> bool:
        """There are stresses that damp."""
        return bool(self._viscous_regions) or self._stiffness is not None

    @property
    def none(self) -> bool:
        """Nothing is damped."""
        return not self.inside and not self.mass

    def set_velocity(self, v: FloatArray) -> None:
        """Sets the velocity that damps, owned entries of the displacement [m/s]. Collective."""
        self.rate.x.array[self._problem.unknowns.displacement_dofs] = v
        self.rate.x.scatter_forward()

    # --- virtual work ---

    def work(self) -> ufl.Form | None:
        """Virtual work of the stresses that damp, at the velocity `rate`."""
        form = ufl.Form([])
        for region in self._problem.regions:
            if self._damps(region):
                form += ufl.inner(self._stress(region), self._test) * self._volume(region)
        return form if self.inside else None

    def moduli(self, region: MaterialRegion) -> Expr | None:
        """Of a region what adds to dP/dF in the tangent, 3x3x3x3 [Pa]; None where nothing damps.

        The derivative of the damping stress by the velocity's gradient, times `shift`: symmetric;
        and of that by the displacement what is symmetric, grad du S : grad v.  The rest is small,
        of the strain within a step over one.
        """
        if not self._damps(region):
            return None
        i, j, k, m = ufl.indices(4)
        one, moduli = ufl.Identity(3), []
        fixed = [] if region.law.linear else [ufl.inv(self._F) * self._stress(region)]
        if region.law.viscosity is not None:
            G = ufl.variable(self._gradient(self.rate))
            moduli.append(self.shift * ufl.diff(self._viscous(region, G), G))
        if self._stiffness is not None:
            H, F = variables(self._F)
            P, factor = self._elastic_stress(region, F), self.shift * self._stiffness
            moduli.append(factor * ufl.diff(P, H))
            if not region.law.linear:
                fixed.append(-factor * ufl.inv(F) * P)
        moduli += [ufl.as_tensor(one[i, k] * S[j, m], (i, j, k, m)) for S in fixed]
        return sum(moduli[1:], moduli[0])

    def tangent(self) -> ufl.Form:
        """Its part of the tangent as a form, which may be empty."""
        form, (i, j, k, m) = ufl.Form([]), ufl.indices(4)
        trial = self._gradient(ufl.TrialFunction(self._problem.W))
        for region in self._problem.regions:
            if (A := self.moduli(region)) is not None:
                change = ufl.as_tensor(A[i, j, k, m] * trial[k, m], (i, j))
                form += ufl.inner(change, self._test) * self._volume(region)
        return form

    # --- stresses ---

    def _damps(self, region: MaterialRegion) -> bool:
        return region.law.viscosity is not None or self._stiffness is not None

    @property
    def _F(self) -> Expr:
        return self._problem.weak_form.F(self._problem.w)

    def _gradient(self, w: Expr) -> Expr:
        """What a displacement adds to F, of a function of all unknowns."""
        problem = self._problem
        u = problem.unknowns.displacement(w)
        return gradient_variation(problem.geometry, u, problem.X, None)

    @property
    def _test(self) -> Expr:
        return self._gradient(ufl.TestFunction(self._problem.W))

    def _volume(self, region: MaterialRegion) -> ufl.Form:
        return self._problem.weak_form.volume(region, self._problem.weak_form.rule(region))

    def _viscous(self, region: MaterialRegion, dF: Expr) -> Expr:
        eta, F = region.law.viscosity, self._F
        assert eta is not None
        if region.law.linear:
            return 2 * eta * ufl.sym(dF)
        return F * (2 * eta * ufl.sym(F.T * dF))

    def _elastic_stress(self, region: MaterialRegion, F: Expr) -> Expr:
        law: Law | ModifiedLaw = region.law
        if region.compliance is not None:
            assert isinstance(region.law, SplitLaw)
            law = _Shape(region.law)
        growth = self._problem.eigenstrains.get(region.name)
        return (law if growth is None else GrownLaw(law, growth)).stress(F)

    def _rate_of(self, region: MaterialRegion) -> Expr:
        """b F Sdot = b (Pdot - Fdot F^-1 P), b Pdot in laws of small strains."""
        P = self._elastic_stress(region, self._F)
        dP = ufl.derivative(P, self._problem.w, self.rate)
        if not region.law.linear:
            dP = dP - self._gradient(self.rate) * ufl.inv(self._F) * P
        return self._stiffness * dP

    def _stress(self, region: MaterialRegion) -> Expr:
        """All damping stress of a region."""
        result = 0 * self._F
        if region.law.viscosity is not None:
            result += self._viscous(region, self._gradient(self.rate))
        if self._stiffness is not None:
            result += self._rate_of(region)
        return result
