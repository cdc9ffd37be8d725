"""Motion that turns round within a step: steps too long for what they are to follow.

The trapezoidal rule turns a mode of angular frequency w by the angle 2 atan(w h/2) a step h, and
its displacement changes by at most 2 sin(atan(w h/2)) times its amplitude.  That is 1.2 where about
four steps make a period, which is then a seventh too long, while the energy is conserved whatever
the step.  A body that starts from rest, or is carried along, never moves within a step by more than
it has moved so far.

Source: T. J. R. Hughes, The Finite Element Method (2000), section 9.3.
"""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.parallel import largest
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.audit.offences import Offence

TURN = 1.2
"""Movement within a step over the largest displacement so far that is too much."""

SHARE = 0.2
"""Share of the steps so far that may turn round: after a hit, a few do."""

LEAST = 2
"""So many may in any case."""


class TimeResolution:
    """Counts the steps within which the body turns round.

    Args:
        alpha_f: Share of the old displacement in that of a step's stage.
    """

    def __init__(self, problem: Problem, alpha_f: float) -> None:
        self._comm, self._dim, self._alpha = problem.body.comm, problem.body.dim, alpha_f
        self._steps = self._turned = 0
        self._farthest = self._worst = 0.0

    def add_step(self, u: FloatArray, du: FloatArray) -> None:
        """Compares a step with the largest displacement so far. Collective.

        Args:
            u: Displacement of the step's stage, owned entries [m].
            du: Its change in the step, owned entries [m].
        """
        end = u + self._alpha * du
        lengths = [self._longest(part) for part in (end, end - du, du)]
        self._farthest = max(self._farthest, *lengths[:2])
        self._steps += 1
        if self._farthest > 0.0 and lengths[2] > TURN * self._farthest:
            self._turned += 1
            self._worst = max(self._worst, lengths[2] / self._farthest)

    def _longest(self, entries: FloatArray) -> float:
        rows = np.linalg.norm(entries.reshape(-1, self._dim), axis=1)
        return largest(self._comm, float(rows.max(initial=0.0)))

    def offence(self) -> Offence | None:
        """The warning, if too many steps have turned round. Not collective."""
        if self._turned <= max(LEAST, SHARE * self._steps):
            return None
        return Offence(
            f"the body moves within one step by {self._worst:.3g} times its largest displacement "
            "so far: hardly four steps make a period of this motion, whose time is wrong by a "
            "seventh and more; a smaller dt",
            self._worst,
        )

    # --- restarts ---

    def restart_state(self) -> list[float]:
        """See `Restartable`. Not collective."""
        return [self._steps, self._turned, self._farthest, self._worst]

    def restore(self, saved: list[float]) -> None:
        """See `Restartable`. Not collective."""
        self._steps, self._turned = int(saved[0]), int(saved[1])
        self._farthest, self._worst = float(saved[2]), float(saved[3])
