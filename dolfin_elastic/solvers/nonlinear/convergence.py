"""Convergence test of Newton's method: equilibrium found, or solve given up.

The free residual is compared with the larger of the applied forces and the reactions, so that a
mixed norm of forces and displacements decides nothing; prescribed values must hold exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.compat import norm_without_value
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.signals import stop_agreed
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import cell_size, span
from dolfin_elastic.problem.term import Multipliers
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.messages import load_not_finite
from dolfin_elastic.solvers.nonlinear.bordered import Bordered
from dolfin_elastic.solvers.nonlinear.jacobian import PATIENCE, InversionGuard

UNSTABLE = "an unstable equilibrium"
BEYOND = "the strain energy has no finite value: a material is beyond its limit"
ANOTHER = "another equilibrium than that of the path"
PASSED = "the body has passed through a thin obstacle"
ENTERED = "an edge or corner has entered a face between its vertices"

PRESCRIBED_TOLERANCE = 1e-12
"""Error of prescribed displacements over the size of the body: Newton's first full step meets them
up to round-off."""

FORCING = 1e-3
"""Relative tolerance of a linear solve inside Newton: tighter ones cost more than they save."""

LAST_FORCING = 1e-6
"""Least relative tolerance of a linear solve that may be the last one."""

OLD_TANGENT = 30.0
"""Least fall of the residual, in a step, after which the next one may keep its tangent."""

LINEAR_TOLERANCE = 1e-12
"""The same where one linear solve is all: as tight as the residual is judged."""

TO_ROUND_OFF = 1e-13
"""The same of the free residual, where it is to be as small as it can be."""

FALLING = 0.3
"""Free residual over the one before above which an iteration has met nothing but round-off."""

VANISHING = 1e-2
"""Free residual over its round-off that cannot fall any more."""

ALTERNATION = 3
"""Iterations that have to halve the residual, where forces begin and end."""

STALL = 6
"""Backtracking iterations over which the residual has to fall by a third."""

DIVERGENCE = 1e8
"""Growth of the residual from which Newton's method has diverged."""

SAFETY = 4.0
"""For the cells around a node, each with a rounding error of its own."""

MAX_STIFFENING = 1e6
"""Growth of the largest stiffness beyond which a cell is crushed: no larger round-off counts."""


IterationCheck = Callable[[PETSc.SNES, int, float], bool]
"""From solver, iteration and norm of the free residual [N] to whether to give up at once."""


@dataclass(frozen=True)
class Tolerance:
    """When equilibrium counts as found.

    Attributes:
        rtol: Free residual over the larger of applied forces and reactions.
        atol: Free residual [N].
        max_iterations: Newton iterations after which a step is given up.
        to_round_off: Iterations go on until the residual no longer falls.
    """

    rtol: float = 1e-8
    atol: float = 0.0
    max_iterations: int = 30
    to_round_off: bool = False


@dataclass(frozen=True)
class NewtonResult:
    """How one Newton solve ended.

    Attributes:
        residuals: Norm of the free residual at each iterate [N].
        newton: Iterations.
        longest: Of several solves in a row, the iterations of the longest one.
        krylov: Linear iterations.
        reason: PETSc's name of why it ended.
        converged: Whether equilibrium was found.
        rejected: Trial states refused because a cell was inside out.
        worst: Smallest det F of them, and the reference place of its cell [m].
        target: Norm of the free residual that would have been small enough [N].
        predicted: Norm of the first Newton step [m].
    """

    residuals: tuple[float, ...] = ()
    newton: int = 0
    longest: int = 0
    krylov: int = 0
    reason: str = ""
    converged: bool = False
    rejected: int = 0
    worst: tuple[float, tuple[float, ...]] | None = None
    target: float = 0.0
    predicted: float = 0.0

    def refused(self, reason: str) -> Self:
        """The same, but its equilibrium does not count.

        Args:
            reason: Why not; stands in place of PETSc's.
        """
        return replace(self, converged=False, reason=reason)

    def inverted(self, jacobian: float, place: FloatArray) -> Self:
        """The same with one more refused state.

        Args:
            place: Reference place of that cell [m].
        """
        worst = jacobian, tuple(map(float, place))
        return replace(self, rejected=self.rejected + 1, worst=worst)


class Inertia(Protocol):
    """What of the residual and of the tangent is inertia, kept up to date by the time scheme."""

    @property
    def mass(self) -> PETSc.Vec:
        """Diagonal of the mass matrix [kg], in the layout of all unknowns."""

    @property
    def factor(self) -> float:
        """Factor of the mass matrix in the tangent [1/s^2]."""

    @property
    def norm(self) -> float:
        """Norm of the inertia forces at the last residual [N]."""


class RoundOff:
    """Forces out of balance that rounding errors alone leave, row by row: epsilon K_ii (h + |u|).

    A row with large entries cannot come closer to zero than their rounding error, but a row of a
    soft material beside it can.  The stress has the relative error of F = I + grad u, which grows
    with |u|; |u| counts up to the size of the body only, or the tolerance of a body carried far
    away would grow without bound.  Rows of pressures, whose diagonal may be zero, count as a mean
    row of displacements, to whose magnitude they are scaled.

    Source: N. Higham, Accuracy and Stability of Numerical Algorithms (2002), (3.5):
    |error| <= n eps sum |K_ij| |x_j|.

    Args:
        inertia: Of a motion, whose rounding errors are added to the norm.

    Attributes:
        norm: Of all rows [N].
        first: Largest stiffness of the first tangent [N/m].
    """

    def __init__(self, assembler: Assembler, inertia: Inertia | None = None) -> None:
        self._assembler, self._inertia = assembler, inertia
        self._h, self._span = cell_size(assembler.problem.body), span(assembler.problem.body)
        self._rows: FloatArray = np.zeros(assembler.size)
        self.first, self.norm = 0.0, 0.0

    def restore(self, first: float) -> None:
        """Goes on with the first stiffness of a run that was stopped [N/m]."""
        self.first = first

    def renew(self, tangent: PETSc.Mat) -> None:
        """Takes the rows from a fresh tangent. Collective."""
        a = self._assembler
        diagonal = tangent.getDiagonal()
        stiff = np.abs(diagonal.array_r[a.displacement_dofs])
        most = largest(a.comm, float(np.max(stiff, initial=0.0)))
        self.first = self.first or most
        stiff = np.minimum(stiff, MAX_STIFFENING * self.first)
        size = SAFETY * np.finfo(float).eps * (self._h + min(a.max_displacement(), self._span))
        square, count = total(a.comm, np.array([np.sum(stiff**2), len(stiff)]))
        self._rows[:] = size * np.sqrt(square / max(count, 1.0))
        self._rows[a.displacement_dofs] = size * stiff
        self.norm = float(np.sqrt(total(a.comm, float(np.sum(self._rows**2)))))
        if self._inertia is not None:
            self.norm = self._norm_in_motion(diagonal, self._inertia)
        diagonal.destroy()

    def _norm_in_motion(self, diagonal: PETSc.Vec, inertia: Inertia) -> float:
        """Round-off of the stress is that of F, of inertia that of the place itself [N].

        Args:
            diagonal: Of stiffness and mass; the mass is taken from it.
        """
        a, factor = self._assembler, inertia.factor
        diagonal.axpy(-factor, inertia.mass)
        most = MAX_STIFFENING * self.first
        diagonal.array_w[:] = np.clip(diagonal.array_r, -most, most)
        inertial = factor * float(inertia.mass.norm()) * a.max_unknown()
        elastic = float(diagonal.norm()) * max(self._h, a.max_displacement())
        return float(SAFETY * np.finfo(float).eps * (elastic + inertial))

    def beyond(self) -> float:
        """Norm of what the free rows of the last residual have beyond it [N]. Collective."""
        a = self._assembler
        out = a.balanced(a.residual.owned)
        rows = np.maximum(np.abs(out - a.constrained_part(out)) - self._rows, 0.0)
        return float(np.sqrt(total(a.comm, float(np.sum(rows**2)))))


class ConvergenceTest:
    """The test that SNES asks after each iteration.

    Args:
        tolerance: When equilibrium counts as found.
        bordered: System with scalar unknowns, whose equations must hold, too.
        guard: Counts the steps that it has shortened.

    Attributes:
        residuals: Norm of the free residual at each iterate [N].
        predicted: Norm of the first Newton step [m].
        first: Norm of the first residual of the last solve [N]; 0 before any.
        round_off: Of the last tangent.
    """

    def __init__(
        self,
        assembler: Assembler,
        tolerance: Tolerance,
        *,
        inertia: Inertia | None = None,
        bordered: Bordered | None = None,
        guard: InversionGuard | None = None,
    ) -> None:
        self._assembler, self._tolerance, self._inertia = assembler, tolerance, inertia
        self._bordered, self._guard = bordered, guard
        self._span = span(assembler.problem.body)
        self.round_off = RoundOff(assembler, inertia)
        self.residuals: list[float] = []
        self.interrupted = False
        self.predicted = self._applied = self.first = self._norm = 0.0
        self._max_iterations, self._backtracks, self._patient = (
            tolerance.max_iterations,
            False,
            False,
        )
        self._check: IterationCheck | None = None
        self._multipliers: Sequence[Multipliers] = ()
        self._alternates, self._delayed = False, 0

    def begin(
        self,
        *,
        multipliers: Sequence[Multipliers] = (),
        backtracks: bool = False,
        patient: bool = False,
        max_iterations: int | None = None,
        check: IterationCheck | None = None,
    ) -> None:
        """Forgets the last solve. Collective.

        Args:
            multipliers: What else is unknown: its equations must hold, too, and where states
                alternate it gives up.
            backtracks: Steps are shortened until the residual falls: then it may stall.
            patient: Steps that are shortened again and again are no reason to give up.
            check: Watches iterates that must not stray; no step may then have to be shortened.

        Raises:
            InputError: A load has no finite value now.
        """
        self._backtracks, self._patient, self._check = backtracks, patient, check
        self._multipliers = multipliers
        self._max_iterations = max_iterations or self._tolerance.max_iterations
        self.residuals.clear()
        self.predicted, self._alternates, self._delayed = 0.0, False, 0
        self.take_loads()
        if not np.isfinite(self._applied):
            problem = self._assembler.problem
            raise load_not_finite(problem, float(problem.t.value))

    def take_loads(self) -> None:
        """Measures the applied forces, which scalar unknowns may change. Collective."""
        self._applied = self._assembler.reactions.load_norm()

    def take_norm(self, norm: float) -> None:
        """Takes the norm of the residual with which an iteration solves [N]. Not collective."""
        self._norm = norm

    def linear_tolerance(self) -> float:
        """Relative tolerance of the next linear solve. Collective.

        No tighter than the step after it can use: half of what the residual still has to fall by.
        """
        forcing = LINEAR_TOLERANCE if self._assembler.problem.linear else FORCING
        if self.may_be_last():
            forcing = LAST_FORCING
        needed = self._needed() if self._norm > 0 else forcing
        return min(0.1, max(forcing, needed))

    def _needed(self) -> float:
        """Half of what the residual still has to fall by. Collective."""
        return 0.5 * self.target() / self._norm

    def may_be_last(self) -> bool:
        """Whether the next linear solve can be the last one, if it is exact enough. Collective.

        Newton's method itself lets the residual fall by the square of its last fall: what that
        leaves has to be less than half of the target.

        Source: S. Eisenstat and H. Walker, SIAM J. Sci. Comput. 17 (1996) 16, Choice 2.
        """
        if self._assembler.problem.linear or len(self.residuals) < 2:
            return False
        before, now = self.residuals[-2:]
        quadratic = now < before and now * (now / before) ** 2 <= 0.5 * self.target()
        return quadratic and self._norm > 0 and self._needed() >= LAST_FORCING

    def old_tangent_suffices(self) -> bool:
        """Whether the next step can be the last one also with the last tangent. Collective.

        With the tangent of the iterate before, the residual falls by its last fall once more, not
        by the square of it; where it fell by little, something else has changed, such as contact.

        Source: C. T. Kelley, Iterative Methods for Linear and Nonlinear Equations (1995), 5.4.2,
        (5.17), the chord method's error with the last Newton step's.
        """
        if self._assembler.problem.linear or len(self.residuals) < 2:
            return False
        before, now = self.residuals[-2:]
        return OLD_TANGENT * now <= before and now * (now / before) <= 0.5 * self.target()

    def alternates(self) -> bool:
        """States of contact go on to alternate although none opens any more. Not collective.

        They alternate where three iterations have not halved the least residual before.  Then what
        closes is first kept from opening again; where that does not help, a point slides to and
        fro, and sticks between.
        """
        since, r = self._delayed, self.residuals
        opens = self._assembler.problem.terms.opens and not self._backtracks
        before, last = r[since + 1 : -ALTERNATION], r[-ALTERNATION:]
        if opens and len(before) > 1 and min(last) > 0.5 * min(before):
            self._alternates = since > 0
            if not since:
                self._delayed = len(r)
                for term in self._assembler.problem.terms:
                    term.delays = term.opens
        return self._alternates

    def target(self) -> float:
        """Norm of the free residual that is small enough [N]. Collective."""
        return max(self._tolerated(), self.round_off.norm)

    def _tolerated(self) -> float:
        """The same by the tolerance, whatever round-off does [N]. Collective."""
        rtol = TO_ROUND_OFF if self._tolerance.to_round_off else self._tolerance.rtol
        return max(rtol * self._reference(), self._tolerance.atol)

    def _reference(self) -> float:
        """Norm of the forces that the residual is measured by [N]. Collective."""
        a = self._assembler
        reference = max(self._applied, a.residual.reaction_norm, a.residual.restraint_norm)
        if self._inertia is not None:
            reference = max(reference, self._inertia.norm)
        return reference

    def _balanced(self) -> bool:
        """The free residual is as small as wanted, but for the round-off of each row. Collective.

        The norm of the round-off of all rows is no criterion in statics: stiff rows make it large,
        and a soft part beside them could be out of balance by as much.  So the rounding error of
        each row is subtracted from it, and the norm of the remainder must meet the tolerance.  In
        motion the round-off of inertia is known as a norm only, so the norm decides.
        """
        free = self._assembler.residual.free_norm
        wanted, floor = self._tolerated(), self.round_off.norm
        if self._tolerance.to_round_off:
            return self._fallen(free, floor)
        if free <= wanted or self._inertia is not None:
            return free <= max(wanted, floor)
        # So far above the norm of the round-off, subtracting it row by row cannot help.
        return free <= DIVERGENCE * floor and self.round_off.beyond() <= wanted

    def _fallen(self, free: float, floor: float) -> bool:
        """The free residual is small, and as small as it can be. Collective.

        What round-off leaves is known to its order only, so the residual itself says.

        Args:
            free: Its norm [N].
            floor: What round-off may leave of it [N].
        """
        if free > max(self._tolerance.rtol * self._reference(), self._tolerance.atol, floor):
            return False
        falls = len(self.residuals) < 2 or free <= FALLING * self.residuals[-2]
        return free <= VANISHING * floor or not falls

    def __call__(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int:
        """What SNES is to do: PETSc's number of a reason to stop, or 0. Collective.

        Args:
            iteration: Number of the iterate, from 0.
            norms: Of the iterate, of the last step, and of the residual.
        """
        reason, a = PETSc.SNES.ConvergedReason, self._assembler
        if iteration == 0:
            self.residuals.clear()
            self.first = norms[2]
        if iteration == 1:
            self.predicted = norms[1]
        self._norm = norms[2]
        self.residuals.append(a.residual.free_norm)
        if not norms[2] <= DIVERGENCE * max(self.first, self.target()):  # NaN, too
            return norm_without_value()
        prescribed = a.residual.gap <= PRESCRIBED_TOLERANCE * self._span
        balanced = prescribed and self._balanced() and self._scalars_hold()
        if balanced and all(one.holds() for one in self._multipliers):
            return int(reason.CONVERGED_FNORM_RELATIVE)
        self.interrupted = stop_agreed(a.comm)
        if self.interrupted or self._shortened_too_often():
            return int(reason.DIVERGED_FUNCTION_DOMAIN)
        cycles = self._multipliers and self.alternates()
        if cycles or self._stalled() or self._strays(snes, iteration):
            return int(reason.DIVERGED_LINE_SEARCH)
        if iteration >= self._max_iterations:
            return int(reason.DIVERGED_MAX_IT)
        return 0

    def _strays(self, snes: PETSc.SNES, iteration: int) -> bool:
        check = self._check
        return check is not None and check(snes, iteration, self.residuals[-1])

    def _shortened_too_often(self) -> bool:
        """Too many Newton steps were shortened: a smaller load step is faster."""
        guard = self._guard
        if guard is None:
            return False
        shortened = guard.rejected + guard.passes
        if self._check is not None and shortened:
            return True
        return guard.stuck or (shortened > PATIENCE and not self._patient)

    def _scalars_hold(self) -> bool:
        bordered = self._bordered
        return bordered is None or bordered.scalars.settled(bordered.last, self.target())

    def _stalled(self) -> bool:
        """Backtracking takes ever smaller steps: a smaller load step is faster."""
        if not self._backtracks or self._inertia is not None or len(self.residuals) <= STALL:
            return False
        return self.residuals[-1] > 0.7 * self.residuals[-1 - STALL]
