"""What the error estimate of a step cannot see: a surface that hits an obstacle after the stage.

The forces of a step are those of its stage.  Without contact there, the end of the step may lie
deep in an obstacle, or behind it, and the acceleration of the scheme knows nothing of it.  While
the same nodes touch, the pushes p of a penalty are as good as linear in the place,
(1 - alpha_f) p1 + alpha_f p0 = p_s; by what p1 differs from that, the acceleration of the end is
other than the scheme's, and the place h^2/6 times that, the weight that it has where accelerations
are linear in time: Zienkiewicz & Xie (1991), see `alpha`.
"""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.dynamics.residual import DynamicResidual, Forces


class ImpactError:
    """Pushes of obstacles at the ends of a step and at its stage.  Collective.

    Args:
        moving: The body.
        alpha_f: Share of the old place in the stage's.
    """

    def __init__(self, moving: DynamicResidual, alpha_f: float) -> None:
        self._moving, self._share = moving, alpha_f
        mass = moving.mass.array_r[moving.displacement_dofs]
        self._mobility = np.divide(1.0, mass, out=np.zeros(len(mass)), where=mass > 0.0)
        self._first: FloatArray = np.zeros(len(mass))
        self._stage: FloatArray = self._first

    def _contact_forces(self) -> FloatArray:
        """Nodal forces of all obstacles at the present place and time, owned entries [N]."""
        return sum(self._moving.contact_forces(), np.zeros(len(self._moving.displacement_dofs)))

    def begin(self, t: float) -> None:
        """Notes what pushes where a step begins."""
        self._moving.problem.set_time(t)
        self._first = self._contact_forces()

    def at_stage(self, forces: Forces) -> None:
        """Notes what pushes at its stage."""
        self._stage = forces.contact[self._moving.displacement_dofs]

    def error(self, h: float) -> FloatArray:
        """What an unseen push does to the place at the end, where the problem is now [m]."""
        expected = (self._stage - self._share * self._first) / (1 - self._share)
        return np.asarray(-h * h / 6 * (self._contact_forces() - expected) * self._mobility)
