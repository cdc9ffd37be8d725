"""Sizes of load steps: longer after few Newton iterations, shorter after many.

`StepSpeed` also limits the displacement of a step by that of the step before.  Under a large load
step the energy cannot distinguish a jump to another equilibrium from a soft path, for the bounds of
the work, by the forces before and after the step, lie far apart.  But a jump is fast: a step that
moves the body several times as fast as the one before is repeated in smaller steps, for which the
bounds are close enough.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.nonlinear.convergence import NewtonResult

FEW_ITERATIONS, MANY_ITERATIONS = 5, 10
"""Newton iterations up to which the next step is doubled, and from which it is shortened."""

STEPS_BEFORE_GROWTH = 3
"""Successful steps after a failure before steps grow again."""

STEPS_BEFORE_RETURN = 4
"""Successful steps in a row after which a size below the first one is doubled, though they took
more than few iterations: contact may take these in steps of any size, and what failed lies behind.
"""

NEARLY = 0.99
"""Size over another one from which on they are the same but for what a stop cuts off."""

MOST_PATIENCE = 24
"""Easy steps, at most, after which a size that has failed again and again is tried once more."""

MAX_REFINEMENT = 64
"""First step over the smallest step to which `StepSpeed` may refine."""


class StepSizes:
    """The sizes of load steps from 0 to the end.

    Args:
        largest: Size that no step exceeds.
        smallest: Size below which no step is tried.
        stops: Load factors that are met exactly, beside the end.
        steady: The user has set the size: many iterations do not shorten the next step.
        remembers: Materials remember.  What made a step hard, as a plastic zone that spreads, then
            goes on in the next ones: a size that took many iterations or failed is not tried again
            before some easy steps, twice as many each time that it fails.
    """

    def __init__(
        self,
        end: float,
        *,
        first: float,
        largest: float,
        smallest: float,
        stops: Sequence[float] = (),
        steady: bool = False,
        remembers: bool = False,
    ) -> None:
        self.end, self.size, self._first = end, first, first
        self._steps_since_failure, self._steady = STEPS_BEFORE_GROWTH, steady
        self._remembers = remembers
        # The smallest size that is known to be too long, and easy steps before it is tried again.
        self._too_long, self._patience = math.inf, STEPS_BEFORE_GROWTH
        self._largest, self._smallest = largest, smallest
        self._stops = sorted({s for s in stops if 0.0 < s < end} | {end})

    def goal(self, t: float) -> float:
        """The load factor that a step from t ends at."""
        stop = next(s for s in self._stops if s > t + 1e-12 * self.end)
        # The rest up to a stop is not left for a tiny step of its own.
        near = min(1.2 * self.size, max(self.size, self._largest))
        return stop if t + near >= stop * (1 - 1e-12) else t + self.size

    def stop_at(self, t: float) -> None:
        """Meets a load factor exactly, too."""
        if all(abs(stop - t) > 1e-12 * self.end for stop in self._stops):
            self._stops = sorted([*self._stops, t])

    def done(self, t: float) -> bool:
        """Whether the end is reached."""
        return t >= self.end * (1 - 1e-12)

    def succeeded(self, t: float, goal: float, newton: int) -> None:
        """Chooses the next size after a step that was taken.

        Args:
            t: Load factor where it began.
            goal: Load factor where it ended.
        """
        self._steps_since_failure += 1
        calm, size = self._steps_since_failure, max(self.size, goal - t)
        if self._remembers:
            self._carefully(goal - t, newton)
        elif newton <= FEW_ITERATIONS and calm >= STEPS_BEFORE_GROWTH:
            # A stop may have cut the step short: the size before it is the one to double.
            self.size = min(self._largest, 2.0 * size)
        elif newton < MANY_ITERATIONS and calm >= STEPS_BEFORE_RETURN and size < self._first:
            self.size, self._steps_since_failure = min(self._first, 2.0 * size), 0
        elif newton >= MANY_ITERATIONS and not self._steady:
            self.size = max(self._smallest, 0.7 * (goal - t))

    def _carefully(self, step: float, newton: int) -> None:
        """Chooses the next size after a step where materials remember.

        Args:
            step: Load factor at its end minus that where it began.
        """
        if newton >= MANY_ITERATIONS:
            self._avoid(step)
            self.size = max(self._smallest, step / 2)
            return
        if step >= NEARLY * self._too_long:
            self._too_long, self._patience = math.inf, STEPS_BEFORE_GROWTH
        wanted = min(self._largest, 2.0 * max(self.size, step))
        easy = self._patience if wanted >= NEARLY * self._too_long else STEPS_BEFORE_GROWTH
        if newton > FEW_ITERATIONS:
            easy = max(easy, STEPS_BEFORE_RETURN)
            wanted = min(wanted, self._first)
        if wanted > self.size and self._steps_since_failure >= easy:
            recovers = math.isfinite(self._too_long)
            self.size, self._steps_since_failure = wanted, 0 if recovers else easy

    def _avoid(self, step: float) -> None:
        """Notes that a size is too long."""
        again = step >= NEARLY * self._too_long
        self._patience = min(2 * self._patience, MOST_PATIENCE) if again else STEPS_BEFORE_GROWTH
        self._too_long, self._steps_since_failure = step, 0

    def restart_state(self) -> dict[str, float]:
        """See `Restartable`. Not collective."""
        numbers = {"size": self.size, "calm": self._steps_since_failure}
        if math.isfinite(self._too_long):
            numbers |= {"too long": self._too_long, "patience": self._patience}
        return numbers

    def restore(self, saved: Mapping[str, Any]) -> None:
        """See `Restartable`. Not collective."""
        self.size, self._steps_since_failure = saved["size"], saved["calm"]
        self._too_long = saved.get("too long", math.inf)
        self._patience = saved.get("patience", STEPS_BEFORE_GROWTH)

    def begin_anew(self) -> None:
        """Returns to the first size, after a jump to a path of unknown curvature."""
        self.size, self._steps_since_failure = self._first, STEPS_BEFORE_GROWTH

    def refine(self, t: float, goal: float) -> bool:
        """Halves a step that may have jumped to another path.

        Args:
            t: Load factor where it began.
            goal: Load factor where it ended.

        Returns:
            False if the step is too small to be repeated.
        """
        size = (goal - t) / 2
        if size < max(self._smallest, self._first / MAX_REFINEMENT):
            return False
        self.size, self._steps_since_failure = size, 0
        return True

    def failed(self, t: float, goal: float, *, inverted: bool) -> bool:
        """Chooses a smaller size after a failure.

        Args:
            t: Where the step began.
            goal: Where it should have ended.
            inverted: Cells turned inside out or a force was not finite: a quarter of the step is
                tried next, not half of it.

        Returns:
            False if no smaller step is left to try.
        """
        size = (goal - t) * (0.25 if inverted else 0.5)
        if size < self._smallest:
            return False
        self._avoid(goal - t)
        self.size, self._steps_since_failure = size, 0
        return True


SPEED_RATIO = 3.0
"""Speed over that of the step before above which a step is repeated in smaller ones."""


class StepSpeed:
    """Speed of the displacement with the load factor.

    Args:
        corners: Load factors at which curves have corners, and speeds may change.

    Attributes:
        speed: Of the last step, |du|/dt in the norm of nodal displacements [m]; 0: not known.
    """

    def __init__(self, assembler: Assembler, corners: Sequence[float] = ()) -> None:
        self._assembler, self._corners = assembler, corners
        self.speed = self._now = 0.0

    def too_fast(self, t: float, goal: float, start: FloatArray, result: NewtonResult) -> bool:
        """Whether the step that the problem is at the end of was faster than expected. Collective.

        Args:
            t: Load factor where it began.
            goal: Where it has ended.
            start: Local unknowns where it began.
            result: Of the Newton solve; in the first load step, its first iteration is the linear
                prediction with which the displacement is compared.
        """
        a = self._assembler
        du = a.problem.w.x.array[a.displacement_dofs] - start[a.displacement_dofs]
        size = float(np.sqrt(total(a.comm, float(np.sum(du**2)))))
        self._now = size / (goal - t)
        if a.problem.linear or any(abs(corner - t) < 1e-9 for corner in self._corners if t > 0):
            return False
        known = self.speed if t > 0.0 else result.predicted / goal
        return 0.0 < SPEED_RATIO * known < self._now

    def accept(self, *, known: bool = True) -> None:
        """Accepts the step that was passed to `too_fast` last.

        Args:
            known: The body followed its path, so that the next step can be compared with this one.
        """
        self.speed = self._now if known else 0.0

    def restore(self, speed: float) -> None:
        """Goes on with the speed of a run that was stopped [m]."""
        self.speed = speed
