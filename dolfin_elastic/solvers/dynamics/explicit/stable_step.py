"""The step of explicit schemes: the stable step, and when it is computed again."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from dolfin_elastic.core.errors import InputError, StabilityError
from dolfin_elastic.core.parallel import largest
from dolfin_elastic.core.startup.slepc import SLEPc
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.term_list import forms_of
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.diagnostics.negative_curvature import start_vector
from dolfin_elastic.solvers.dynamics.explicit.damper import Damper, sees_velocity
from dolfin_elastic.solvers.dynamics.explicit.frequency_bound import (
    FrequencyBound,
    extremes,
    rows_over_mass,
)

log = logging.getLogger("dolfin_elastic")

CHECKS = (10, 200)
"""Fewest and most steps between two checks of the stable step: the less it changes, the more."""

CHECKS_IN_CONTACT = 50
"""The most where an obstacle may be hit between two checks."""

CHECKS_OF_VISCOSITY = CHECKS[0]
"""Steps between two looks at bulk viscosity alone, which shortens the step as a shock sets in."""

SPACING = 100
"""Fewest steps between two eigenvalue problems of the body, each of which costs about 15 steps."""

RESONANCE = 0.6
"""Largest share of the stable step where obstacles are hit, which excites the highest frequencies.

At omega dt = sqrt(2) and sqrt(3) four and three steps are a period of a motion, and what is not
linear about it feeds it at each (T. Schlick, M. Mandziuk, R. Skeel and K. Srinivas, J. Comput.
Phys. 140 (1998) 1): at 0.7 and above corners of cubes that bounce were thrown off after a second,
one node in a rhythm of four steps; at 0.65 and below cubes of 5 to 8 cells an edge conserved their
energy to 1.5 % for 5,000 to 10,000 steps.  0.6 leaves them room to become stiffer by a third
between two checks.
"""

CONTACT = 1.0
"""Largest (omega dt)^2 of a node on an obstacle's penalty.

A node hits in the middle of a step and leaves in that of another.  Of a bar thrown at a wall the
energy grew by 0.1 % at 0.7, 1 % at 1.1 and 2 % at 1.3, but fivefold at 1.5 and more.
"""

RENEWAL = 0.1
"""Growth of the nodal bounds, since omega_max was found, from which it is found anew."""


class StepSize:
    """Stable step and step of an explicit scheme. Collective to make.

    The limit 2/omega_max follows from the largest eigenvalue omega_max^2 of M^-1 K, found by
    Lanczos' method (`largest_frequency`), or from the bound by cells (`FrequencyBound`) if that is
    lower.  Between two eigenvalue problems only the bound is evaluated, for a seventh of the cost:
    omega_max^2 is taken to grow with the bound of that node whose bound has grown most, among the
    nodes whose bound is above it.

    Args:
        mass: Lumped mass at every owned entry [kg].
        chosen: The user's step [s]; None: the stable step times `safety`.
        safety: Share of the stable step that is taken.
        damper: Bulk viscosity shortens the stable step; None: there is none.

    Attributes:
        stable: The stable step at the last check [s].
        next_check: Number of the step before which the stable step is found again.
        dt: The step to take [s].
        bound: The bound by cells, where there is one.
        contact_limit: Longest step with which obstacles throw no node back too fast [s].
    """

    def __init__(
        self,
        problem: Problem,
        assembler: Assembler,
        mass: FloatArray,
        *,
        chosen: float | None,
        safety: float,
        damper: Damper | None = None,
    ) -> None:
        self._problem, self._assembler, self._mass = problem, assembler, mass
        self._damper, self._viscous = damper, 0.0
        self._chosen = chosen
        self._contact = problem.terms.opens
        self._safety = min(safety, RESONANCE) if self._contact else safety
        self.bound = (
            FrequencyBound(problem, assembler, mass) if FrequencyBound.applies(problem) else None
        )
        self._drag = self._largest_row(forms_of(problem.terms, "drag"))
        opening = [term for term in problem.terms if term.opens]
        contact_rates = self._largest_row(forms_of(opening, "bound"))
        self.contact_limit = np.sqrt(CONTACT / contact_rates) if contact_rates else np.inf
        self._nodal_bounds = fem.Function(problem.V)
        self._places = slice(0, assembler.size, problem.body.dim)
        self._square = self._found_square = 0.0
        # What yields is softer, and as stiff as before when it is unloaded in the next step.
        history = problem.history
        self._unloads, self._least = history is not None and history.yields, 0.0
        self._interval, self._found_at, self._bound_in_doubt = CHECKS[0], 0, False
        self.stable, self.dt = np.inf, np.inf
        self.next_check = self._bound_due = CHECKS[0]

    # --- frequencies ---

    def largest_frequency(self) -> float:
        """Largest omega^2 of the present tangent and the lumped mass [1/s^2]. Collective.

        It is that of M^-1/2 K M^-1/2; 0 where all displacements are prescribed.  All contact
        surfaces count as closed, for what is open now may close within the next steps.
        """
        with stage("stable step"):
            a = self._assembler
            x, scale = a.create_vector(), a.create_vector()
            a.get(x)
            with self._problem.terms.assumed(closed=True):
                a.tangent.assemble(x, unit=0.0)
            scale.array_w[:] = 1 / np.sqrt(self._mass)
            scale.array_w[self._problem.constraints.prescribed_dofs] = 0.0
            a.tangent.matrix.diagonalScale(scale, scale)
            a.tangent.invalidate()
            x.array_w[a.displacement_dofs] = start_vector(a)
            square = _largest_eigenvalue(a.tangent.matrix, x, self._problem.symmetric)
            x.destroy()
            scale.destroy()
        return max(square, 0.0)

    def cell_bound(self) -> float:
        """The bound by cells [1/s^2]; infinite where there is none. Collective."""
        if self.bound is None:
            return np.inf
        with stage("stable step"):
            return extremes(self._problem.body.comm, [_maximum(self.bound.evaluate())])[0]

    def step_for(self, square: float, viscous: float | None = None) -> float:
        """Stable step for the largest omega^2 and the dashpots' largest rate c/m [s].

        With dashpots at the old velocity, z^2 - (2 - h c/m - h^2 omega^2) z + 1 - h c/m has no root
        beyond -1 up to h = 4/(c/m + sqrt((c/m)^2 + 4 omega^2)), which is 2/omega without them.

        Args:
            square: Largest omega^2 [1/s^2].
            viscous: Largest rate c/m of bulk viscosity; None: the present one [1/s].
        """
        drag = self._drag + (self._viscous if viscous is None else viscous)
        below = drag + np.sqrt(drag**2 + 4 * square)
        return float(4 / below) if below > 0 else np.inf

    def _find_viscosity(self) -> None:
        """Finds the largest rate c/m of bulk viscosity, to the digits that ranks share."""
        if self._damper is not None:
            self._viscous = _same(self._damper.largest_rate())

    def _largest_row(self, bounds: Sequence[ufl.Form]) -> float:
        """Largest bound of a row of a matrix over its mass [1/s^2]. Collective.

        Args:
            bounds: Forms that are linear in the test function, whose entries bound row sums.
        """
        rows = rows_over_mass(self._assembler, bounds, self._mass)
        return largest(self._problem.body.comm, float(np.max(rows, initial=0.0)))

    # --- the step ---

    def begin(self, end: float) -> None:
        """Finds the first step. Collective.

        Args:
            end: When the motion ends [s].

        Raises:
            InputError: The user's step is above the stable one.
        """
        self._find_viscosity()
        self._find_frequency(0)
        self._least = self._square if self._unloads else 0.0
        if self._chosen is None:
            self._set_step()
            step = min(self.dt, end)
            count = float(f"{end / step:.2g}") if step > 0 else 0.0
            values = self.stable, step, count, self._safety, self._where()
            log.info("stable step %.4g s, used %.4g s, about %.0f in all (safety %g%s)", *values)
        elif self._chosen > self.stable:
            raise InputError(
                f"{self._chosen:.4g} s is above the stable step, {self.stable:.4g} s",
                where="dynamics.dt",
                expected="leave dt out to have it chosen, or "
                f"give at most {self._safety * self.stable:.3g} s",
            )
        else:
            self.dt = self._chosen
            self._warn()

    def _warn(self) -> None:
        if self.dt > self.contact_limit:
            log.warning(
                "a node that hits an obstacle may be thrown back too fast: dt = %.4g s is long for "
                "the stiffness of the contact; at most %.3g s, or a smaller stiffness",
                self.dt,
                self.contact_limit,
            )
        elif self._contact and self.dt > self._safety * self.stable:
            log.warning(
                "nodes that hit an obstacle may gain energy at each step: dt = %.4g s is %.2g of "
                "the stable step; at most %.3g s, %.2g of it, or leave dt out",
                self.dt,
                self.dt / self.stable,
                self._safety * self.stable,
                self._safety,
            )

    def _where(self) -> str:
        """The cells or contacts that limit the step, for messages. Collective."""
        if self.dt == self.contact_limit:
            return "; the stiffness of contacts asks for it"
        contact = "; obstacles may be hit" if self._contact and self._safety == RESONANCE else ""
        if self.bound is None or not self._square:
            return contact
        return f"{contact}; elements at {self._problem.body.unit.point(self.location())} ask for it"

    def location(self) -> tuple[float, ...]:
        """Where the bound by cells is largest, undeformed [m]; empty without one. Collective."""
        return () if self.bound is None else self.bound.location(self.bound.evaluate())

    def check_before(self, step: int) -> None:
        """Demands an eigenvalue problem before the next step, because energy has drifted."""
        self.next_check = self._bound_due = step
        self._bound_in_doubt = True

    def update(self, step: int, t: float) -> None:
        """Finds the stable step of the present state, and the step from here on. Collective.

        Args:
            t: Time [s].

        Raises:
            StabilityError: The user's step is above the stable one now.
        """
        self._find_viscosity()
        if self._problem.linear and not sees_velocity(self._damper):
            self.next_check = step + CHECKS[1]  # it cannot have changed
            return
        before, due = self.stable, step >= self._bound_due
        if due:
            self._follow_bound(step)
        else:
            self.stable = self.step_for(self._square)
        if self._chosen is None:
            self._set_step()
        elif self._chosen > self.stable:
            self._confirm(step, t)
        if due:
            change = abs(self.stable / before - 1) if np.isfinite(before) else 0.0
            factor = 2.0 if change < 0.01 else 0.5 if change > 0.03 else 1.0
            most = CHECKS_IN_CONTACT if self._contact else CHECKS[1]
            self._interval = int(np.clip(factor * self._interval, CHECKS[0], most))
            self._bound_due = step + self._interval
        looks = step + CHECKS_OF_VISCOSITY if sees_velocity(self._damper) else self._bound_due
        self.next_check = min(self._bound_due, looks)

    def _set_step(self) -> None:
        self.dt = min(self._safety * self.stable, self.contact_limit)

    def _confirm(self, step: int, t: float) -> None:
        """Checks the user's step against the eigenvalue itself. Collective.

        Raises:
            StabilityError: It is above the stable step.
        """
        if self._found_at != step:
            self._find_frequency(step)
        assert self._chosen is not None
        if self._chosen > self.stable:
            viscous = self._viscous and self._chosen <= self.step_for(self._square, viscous=0.0)
            why = "of the bulk viscosity" if viscous else "the body has deformed"
            raise StabilityError(
                f"at t = {t:.6g} s the stable step has fallen to {self.stable:.4g} s, below "
                f"dt = {self._chosen:.4g} s, because {why}",
                advice="leave dt out to have it follow the stable step",
            )

    def _find_frequency(self, step: int) -> None:
        """Finds omega_max^2 of the present state. Collective."""
        # With all displacements prescribed there is no eigenvalue: then the bound decides.
        bounds = (
            self.largest_frequency() or np.inf,
            self.cell_bound(),
        )
        square = min(bounds) if min(bounds) < np.inf else 0.0
        self._found_square = self._square = max(_same(square), self._least)
        if self.bound is not None:
            self._nodal_bounds.x.array[self._places] = self.bound.evaluate()
        self.stable, self._found_at = self.step_for(self._square), step
        self._bound_in_doubt = False

    def _follow_bound(self, step: int) -> None:
        """Estimates omega_max^2 from the growth of the nodal bounds. Collective."""
        if self.bound is None or self._bound_in_doubt:
            self._find_frequency(step)
            return
        with stage("stable step"):
            rates = self.bound.evaluate()
            could = rates > self._found_square
            known = self._nodal_bounds.x.array[self._places]
            worst, growth = extremes(
                self._problem.body.comm, [_maximum(rates), _maximum(rates[could] / known[could])]
            )
        if step - self._found_at >= SPACING and abs(growth - 1) > RENEWAL:
            self._find_frequency(step)
            return
        # The stiffest motion of a cell may grow more than the norm of its matrix does.
        square = _same(min(worst, self._found_square * max(growth, 1.0) ** 1.5))
        self._square = max(square, self._least)
        self.stable = self.step_for(self._square)

    # --- restarts ---

    @property
    def field(self) -> fem.Function:
        """Nodal bounds, in first components, when omega_max^2 was last found [1/s^2]."""
        return self._nodal_bounds

    def restart_state(self) -> dict[str, Any]:
        """See `Restartable`. Not collective."""
        return {
            "square": self._square,
            "known_square": self._found_square,
            "found_at": self._found_at,
            "interval": self._interval,
            "due": self.next_check,
            "bound_due": self._bound_due,
            "doubtful": self._bound_in_doubt,
            "least": self._least,
            "viscous": self._viscous,
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """See `Restartable`. Not collective."""
        self._square, self._found_square = saved["square"], saved["known_square"]
        self._found_at, self._interval = saved["found_at"], saved["interval"]
        self.next_check, self._bound_in_doubt = saved["due"], saved["doubtful"]
        self._bound_due = int(saved.get("bound_due", self.next_check))
        self._least = float(saved.get("least", 0.0))
        self._viscous = float(saved.get("viscous", 0.0))
        self.stable = self.step_for(self._square)
        if self._chosen is None:
            self._set_step()
        else:
            self.dt = self._chosen


def _maximum(values: FloatArray) -> float:
    """The largest, 0 of none; what is not finite is infinite."""
    return float(np.max(np.nan_to_num(values, nan=np.inf, posinf=np.inf), initial=0.0))


def _same(value: float) -> float:
    """Without the last digits, in which ranks differ: steps are the same on any number of them."""
    return float(f"{value:.9e}")


def _largest_eigenvalue(matrix: PETSc.Mat, start: PETSc.Vec, symmetric: bool) -> float:
    """Largest eigenvalue, plus the norm of what is left of its equation. Collective.

    Of a symmetric matrix an eigenvalue is no farther than that from the one found.  Any ranks find
    the same one from the same start, to round-off.
    """
    size = float(matrix.norm())
    if not np.isfinite(size):
        raise _no_eigenvalue()
    if size == 0.0:
        return 0.0
    eps = SLEPc.EPS().create(matrix.comm)
    eps.setOperators(matrix)
    eps.setProblemType(SLEPc.EPS.ProblemType.HEP if symmetric else SLEPc.EPS.ProblemType.NHEP)
    eps.setWhichEigenpairs(SLEPc.EPS.Which.LARGEST_REAL)
    eps.setTolerances(tol=1e-3, max_it=200)
    eps.setInitialSpace(start)
    try:
        eps.solve()
        converged = eps.getConverged() > 0
        value = float(eps.getEigenvalue(0).real) if converged else 0.0
        if converged:
            value += float(eps.computeError(0, SLEPc.EPS.ErrorType.ABSOLUTE))
    finally:
        eps.destroy()
    if not converged:
        raise _no_eigenvalue()
    return value


def _no_eigenvalue() -> StabilityError:
    return StabilityError(
        "the stable step cannot be estimated: no largest eigenvalue was found",
        advice="is the displacement finite, and every density positive?",
    )
