"""Which load factor is tried next: steps grow where Newton is quick and shrink where it is not.

Nor may a step go farther than the path it was on led to expect.  Under loads that grow a lot in
one step, the energy does not distinguish a jump from a soft path: the work of the forces before and
that of the forces after lie far apart.  But a jump is fast: a step that moves the body several
times as fast as the one before is taken again in smaller ones, whose energy does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.nonlinear.convergence import NewtonResult

QUICK, SLOW = 5, 10
"""Newton iterations up to which the next step is doubled, and from which it is shortened."""

CALM = 3
"""Steps after a failure from which they grow again."""


CLOSEST = 64
"""First step over the smallest one that a step is refined to because the body moved fast."""


class StepSizes:
    """The sizes of load steps from 0 to the end.

    Args:
        end: Last load factor.
        first: Size of the first step.
        largest: Size that no step exceeds.
        smallest: Size below which no step is tried.
        stops: Load factors that are met exactly, beside the end.
        steady: The size is the user's: a step that was found is not shortened for its iterations.
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
    ) -> None:
        self.end, self.size, self._first = end, first, first
        self._calm, self._steady = CALM, steady
        self._largest, self._smallest = largest, smallest
        self._stops = sorted({s for s in stops if 0.0 < s < end} | {end})

    def goal(self, t: float) -> float:
        """The load factor that a step from t ends at."""
        stop = next(s for s in self._stops if s > t + 1e-12 * self.end)
        # The rest up to a stop is not left for a tiny step of its own.
        near = min(1.2 * self.size, max(self.size, self._largest))
        return stop if t + near >= stop * (1 - 1e-12) else t + self.size

    def done(self, t: float) -> bool:
        """Whether the end is reached."""
        return t >= self.end * (1 - 1e-12)

    def succeeded(self, t: float, goal: float, newton: int) -> None:
        """Chooses the next size after a step that was taken.

        Args:
            t: Load factor where it began.
            goal: Load factor where it ended.
            newton: Its Newton iterations.
        """
        self._calm += 1
        if newton <= QUICK and self._calm >= CALM:
            # A step that was cut short by a stop says nothing against a longer one.
            self.size = min(self._largest, 2.0 * max(self.size, goal - t))
        elif newton >= SLOW and not self._steady:
            self.size = max(self._smallest, 0.7 * (goal - t))

    def restart_state(self) -> dict[str, float]:
        """See `Restartable`. Not collective."""
        return {"size": self.size, "calm": self._calm}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """See `Restartable`. Not collective."""
        self.size, self._calm = saved["size"], saved["calm"]

    def begin_anew(self) -> None:
        """Begins with the first size again: nothing is known of the path that was jumped to."""
        self.size, self._calm = self._first, CALM

    def refine(self, t: float, goal: float) -> bool:
        """Halves a step that may have jumped over something on its way.

        Args:
            t: Load factor where it began.
            goal: Load factor where it ended.

        Returns:
            False if it was so small that it need not be taken again.
        """
        size = (goal - t) / 2
        if size < max(self._smallest, self._first / CLOSEST):
            return False
        self.size, self._calm = size, 0
        return True

    def failed(self, t: float, goal: float, *, crushed: bool) -> bool:
        """Chooses a smaller size after a failure.

        Args:
            t: Where the step began.
            goal: Where it should have ended.
            crushed: Cells turned inside out or a force was infinite: much too far.

        Returns:
            False if no smaller step is left to try.
        """
        size = (goal - t) * (0.25 if crushed else 0.5)
        if size < self._smallest:
            return False
        self.size, self._calm = size, 0
        return True


FASTER = 3.0
"""Speed over that of the step before from which a step is looked at more closely."""


class StepSpeed:
    """Speed of the displacement with the load factor.

    Args:
        assembler: Of the problem that is solved.
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
            result: How it was found: in the first step, the first Newton step is where the
                tangent at rest leads to.
        """
        a = self._assembler
        du = a.problem.w.x.array[a.displacement_dofs] - start[a.displacement_dofs]
        size = float(np.sqrt(total(a.comm, float(np.sum(du**2)))))
        self._now = size / (goal - t)
        if a.problem.linear or any(abs(corner - t) < 1e-9 for corner in self._corners if t > 0):
            return False
        known = self.speed if t > 0.0 else result.predicted / goal
        return 0.0 < FASTER * known < self._now

    def accept(self, *, known: bool = True) -> None:
        """Accepts the step that was passed to `too_fast` last.

        Args:
            known: Its speed is that of the path: the body has not jumped.
        """
        self.speed = self._now if known else 0.0

    def restore(self, speed: float) -> None:
        """Goes on with the speed of a run that was stopped [m]."""
        self.speed = speed
