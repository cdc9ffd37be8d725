"""Whether a step went farther than the path it was on led to expect.

Under loads that grow a lot in one step, the energy does not tell a jump from a soft path: what the
forces before and after would have done lies far apart.  But a jump is fast: a step that moves the
body several times as fast as the one before is taken again in smaller ones, whose energy does tell.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.nonlinear.progress import Progress

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

    def hasty(self, t: float, goal: float, start: FloatArray, progress: Progress) -> bool:
        """Whether the step that the problem is at the end of was faster than expected. Collective.

        Args:
            t: Load factor where it began.
            goal: Where it has ended.
            start: Local unknowns where it began.
            progress: How it was found: in the first step, the first Newton step is where the
                tangent at rest leads to.
        """
        a = self._assembler
        du = a.problem.w.x.array[a.moves] - start[a.moves]
        size = float(np.sqrt(total(a.comm, float(np.sum(du**2)))))
        self._now = size / (goal - t)
        if a.problem.linear or any(abs(corner - t) < 1e-9 for corner in self._corners if t > 0):
            return False
        known = self.speed if t > 0.0 else progress.predicted / goal
        return 0.0 < FASTER * known < self._now

    def accept(self, *, known: bool = True) -> None:
        """The step looked at last is taken; its speed is the path's unless the body has jumped."""
        self.speed = self._now if known else 0.0
