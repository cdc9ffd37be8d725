"""Bulk viscosity: a pressure against the rate of volume, which smears shocks over a few cells.

With the rate r = tr(Fdot F^-1), density rho, speed c of pressure waves and size L of a cell,

    s = rho L r (b1 c + b2^2 L max(-r, 0)),

a mean stress that is added to that of the material: the linear term damps what rings behind a
wave, the quadratic one, in compression alone, the shock itself.  Its power s r is never negative.
rho and L are those of the undeformed body, L is the least altitude of a cell; shear is not damped.

Sources: J. von Neumann and R. D. Richtmyer, J. Appl. Phys. 21 (1950) 232 (quadratic term); R.
Landshoff, Los Alamos report LA-1930 (1955) (linear term); Abaqus 2016 Analysis User's Guide,
section 6.3.3, Explicit dynamic analysis, whose b1 = 0.06 and b2 = 1.2 are usual, and whose sum of
both terms this is.
"""

from __future__ import annotations

from functools import reduce

import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.model.kinematics import cofactor, gradient_variation
from dolfin_elastic.problem.material_regions import MaterialRegion
from dolfin_elastic.problem.problem import Problem


class BulkViscosity:
    """Bulk viscosity of a body, in UFL, at the velocity that dashpots see.

    Args:
        linear: b1 of the module.
        quadratic: b2.

    Raises:
        InputError: The speed of waves in a material is not known.
    """

    def __init__(self, problem: Problem, linear: float, quadratic: float) -> None:
        self._problem = problem
        self._b1, self._b2 = problem.constant(linear), problem.constant(quadratic)
        for region in problem.regions:
            if region.law.small_strain() is None:
                raise InputError(
                    f"bulk viscosity needs the speed of pressure waves, which the law of "
                    f"'{region.name}' does not tell",
                    where="dynamics.bulk_viscosity",
                    expected="an isotropic law, or leave it out",
                )

    @property
    def velocity(self) -> fem.Function:
        """Of which the rate is [m/s]."""
        return self._problem.context.velocity

    def work(self) -> ufl.Form:
        """Virtual work of the stress."""
        problem, form = self._problem, ufl.Form([])
        dF = self._gradient(problem.v)
        for region in problem.regions:
            s = self._damping(region) * self._rate(region)
            form += s * ufl.inner(self._cofactor(region), dF) * self._volume(region)
        return form

    def bound(self) -> ufl.Form:
        """Linear in the test function: at each node a bound of the rows of ds/dr [N s/m].

        A cell's matrix is no larger than the sum of the squares of its gradients.
        """
        problem, form = self._problem, ufl.Form([])
        d = problem.body.dim
        for region in problem.regions:
            cof = self._cofactor(region)
            squares = sum(
                ufl.inner(row, row) for row in (ufl.dot(self._in_space(cof), g) for g in self._rows)
            )
            size = (d + 1) * squares / self._J(region)
            form += self._damping(region) * size * problem.v[0] * self._volume(region)
        return form

    # --- one region ---

    def _damping(self, region: MaterialRegion) -> Expr:
        """s/r [Pa s]."""
        moduli, rho, L = region.law.small_strain(), self._problem.context.density(region), self._L
        assert moduli is not None
        c = ufl.sqrt((moduli.lmbda + 2 * moduli.mu) / rho)
        shock = self._b2**2 * L * ufl.max_value(-self._rate(region), 0.0)
        return rho * L * (self._b1 * c + shock)

    def _rate(self, region: MaterialRegion) -> Expr:
        dF = self._gradient(self.velocity)
        return ufl.inner(self._cofactor(region), dF) / self._J(region)

    def _cofactor(self, region: MaterialRegion) -> Expr:
        if region.law.linear:
            return ufl.Identity(3)
        return cofactor(self._problem.weak_form.F(self._problem.w))

    def _J(self, region: MaterialRegion) -> Expr:
        if region.law.linear:
            return ufl.as_ufl(1.0)
        return ufl.det(self._problem.weak_form.F(self._problem.w))

    def _gradient(self, w: Expr) -> Expr:
        return gradient_variation(self._problem.geometry, w, self._problem.X, None)

    def _in_space(self, tensor: Expr) -> Expr:
        axes = range(self._problem.body.dim)
        return ufl.as_matrix([[tensor[i, j] for j in axes] for i in axes])

    @property
    def _rows(self) -> list[Expr]:
        """Gradients of the shape functions of a linear cell [1/m]."""
        K, d = ufl.JacobianInverse(self._problem.body.mesh), self._problem.body.dim
        rows = [ufl.as_vector([K[i, j] for j in range(d)]) for i in range(d)]
        return [*rows, -sum(rows[1:], rows[0])]

    @property
    def _L(self) -> Expr:
        squares = [ufl.inner(row, row) for row in self._rows]
        return 1 / ufl.sqrt(reduce(ufl.max_value, squares))

    def _volume(self, region: MaterialRegion) -> ufl.Measure:
        return self._problem.weak_form.volume(region, self._problem.weak_form.rule(region))
