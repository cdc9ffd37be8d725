"""Gradients of load factors at which a body buckles, linearised at rest.

With K u = f before buckling and (K + lambda G(u)) v = 0, G being the geometric stiffness of the
stress that belongs to u, to which it is proportional,

    d lambda/dm = -v . (dK/dm + lambda dG/dm) v/g - (lambda/g) v . G(du/dm) v,    g = v . G(u) v,

whose last term one adjoint solution gives: K a = (lambda/g) d(v . G(u) v)/du.
Source: E. J. Haug, K. K. Choi and V. Komkov, Design Sensitivity Analysis of Structural Systems
(1986), section 1.3.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import ufl
from dolfinx import fem

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.ghosts import assembled
from dolfin_elastic.core.petsc_options import PetscOptions
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.amplitude import PROPORTIONAL
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import Mode
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled, integral
from dolfin_elastic.solvers.linear.choice import choose, in_blocks
from dolfin_elastic.solvers.nonlinear.adjoint import Adjoint
from dolfin_elastic.solvers.nonlinear.convergence import Tolerance
from dolfin_elastic.solvers.nonlinear.newton import Newton
from dolfin_elastic.study.gradient.functionals import Functional
from dolfin_elastic.study.gradient.modes import check_quotient, chosen
from dolfin_elastic.study.gradient.parameters import Sides, move_prescribed, residual_of

if TYPE_CHECKING:
    from dolfin_elastic.case.case import Case


class LoadFactor(Functional):
    """A load factor by Rayleigh's quotient of its mode.  All of it is collective.

    The problem is at rest whenever it is evaluated.

    Args:
        shape: Of the mode, as the displacement's local array.
        before: The displacement before buckling under the loads as they are given.
    """

    def __init__(
        self, name: str, problem: Problem, shape: FloatArray, before: fem.Function
    ) -> None:
        super().__init__(name, "", problem)
        v, w = fem.Function(problem.V), problem.w
        v.x.array[:] = shape
        self._factor, self.shape, self._g = problem.constant(0.0), shape, 1.0
        stiffness = ufl.action(ufl.action(problem.weak_form.tangent, v), v)
        of_stress = ufl.action(ufl.action(problem.weak_form.geometric(w), v), v)
        geometric = ufl.derivative(of_stress, w, before)
        slope = ufl.derivative(of_stress, w, ufl.TestFunction(problem.W))
        self._stiffness, self._geometric, self._slope = compiled(
            problem, [stiffness, geometric, slope]
        )
        self.form = stiffness + self._factor * geometric

    def value(self, forces: FloatArray) -> float:
        """See `Functional`."""
        self._g = integral(self.problem, self._geometric)
        self._factor.value = -integral(self.problem, self._stiffness) / self._g
        return float(self._factor.value)

    @property
    def factor(self) -> float:
        """See `Functional`."""
        return -1 / self._g

    def by_unknowns(self, assembler: Assembler | None = None) -> FloatArray:
        """See `Functional`: by the displacement before buckling."""
        scale = -float(self._factor.value) / self._g
        return scale * assembled(self._slope, self.problem.W)


class Prebuckling:
    """The linear solution of a problem from rest, under its whole load. Collective; `close` it.

    Attributes:
        before: The displacement.
        residual: Virtual work of its equations.
        assembler: Of the problem at rest.
        adjoint: Solves with its tangent.

    Raises:
        InputError: Something changes the stiffness or the loads otherwise than in proportion.
    """

    def __init__(self, case: Case, problem: Problem, petsc: PetscOptions | None) -> None:
        follows = any(load.follower for load in problem.loads)
        if follows or problem.terms.scalars or problem.eigenstrains:
            what = "loads that follow the body" if follows else "growth or scalar unknowns"
            raise InputError(
                f"there is no gradient of modes with {what}", where="gradient", expected="`sweep`"
            )
        self.problem = problem
        at_rest(problem)
        options = {**case.solver.petsc, **(petsc or {})}
        choice = choose(problem, case.solver)
        self.assembler = Assembler(problem, iterated=in_blocks(choice, options))
        self._newton = Newton(self.assembler, choice, Tolerance(1e-8, 0.0, 1), users=options)
        self._newton.begin()
        self.adjoint = Adjoint(self._newton)
        self.before = fem.Function(problem.W)
        self.before.x.array[: self.assembler.size] = self.adjoint.step()
        self.before.x.scatter_forward()
        at_rest(problem)
        form = problem.weak_form
        self.residual = ufl.action(form.tangent, self.before)
        if form.external is not None:
            self.residual -= form.external

    def close(self) -> None:
        """Frees what it owns. Collective."""
        self.adjoint.close()
        self._newton.destroy()
        self.assembler.destroy()


def at_rest(problem: Problem) -> None:
    """Puts a problem at rest under its whole load. Collective."""
    problem.terms.begin(moving=False)
    problem.set_time(1.0, default=PROPORTIONAL)
    problem.w.x.array[:] = 0.0
    problem.unknowns.w_to_u()


class LinearState:
    """The linear equations before buckling, and load factors, see `parameters.Basis`."""

    def __init__(self, prebuckling: Prebuckling, factors: Sequence[LoadFactor]) -> None:
        self._of, self._factors = prebuckling, factors
        problem = prebuckling.problem
        form = ufl.action(problem.weak_form.tangent, prebuckling.before)
        self._stiff = compiled(problem, [form])[0]

    def evaluated(self) -> Sides:
        """Forces and load factors with the present constants. Collective."""
        at_rest(self._of.problem)
        residual = self._of.assembler.residual
        residual.assemble()  # minus the loads
        stiff = self._of.assembler.collect(assembled(self._stiff, self._of.problem.W))
        return self._sides(residual.owned + stiff, self._factors)

    def on(self, changed: Problem) -> Sides:
        """Of another problem, with the same modes. Collective."""
        at_rest(changed)
        dofs, residual = residual_of(changed)
        before = fem.Function(changed.W)
        changed.w.x.array[:] = self._of.before.x.array
        move_prescribed(dofs)
        before.x.array[:] = changed.w.x.array
        at_rest(changed)
        residual.assemble()
        form = compiled(changed, [ufl.action(changed.weak_form.tangent, before)])[0]
        factors = [LoadFactor(one.name, changed, one.shape, before) for one in self._factors]
        return self._sides(residual.owned + dofs.collect(assembled(form, changed.W)), factors)

    def _sides(self, forces: FloatArray, factors: Sequence[LoadFactor]) -> Sides:
        numbers = np.array([one.value(forces) for one in factors])
        return Sides(forces, np.zeros(0), numbers)


def load_factors(
    names: Sequence[str], prebuckling: Prebuckling, modes: Mapping[int, Mode]
) -> list[LoadFactor]:
    """Load factors as functionals. Collective.

    Args:
        names: "load_factor_1" ...
        prebuckling: The state before.
        modes: Number to mode, of all that were found.

    Raises:
        InputError: There is no such mode, or another one has the same load factor.
    """
    result = []
    for name, mode in chosen(names, modes, "buckling"):
        shape = np.array(mode.u.x.array)
        one = LoadFactor(name, prebuckling.problem, shape, prebuckling.before)
        check_quotient(mode, one.value(shape), mode.eigenvalue)
        result.append(one)
    return result
