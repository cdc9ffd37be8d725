"""Error estimate of impacts within a step, which that of the time scheme does not see.

The forces of a step are those of its stage.  A surface that hits an obstacle after the stage may
lie deep in it, or behind it, at the end of the step, and the acceleration of the scheme knows
nothing of that.  While the same nodes are in contact, their penalty forces p are almost linear in
the displacement: (1 - alpha_f) p1 + alpha_f p0 = p_s.  The difference of p1 from that, over the
mass, is the error of the acceleration at the end; the displacement's is h^2/6 times that, its
weight where accelerations are linear in time: Zienkiewicz & Xie (1991), see `generalized_alpha`.
"""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.dynamics.residual import DynamicResidual, Forces


class ImpactError:
    """Contact forces at the ends of a step and at its stage.  Collective.

    Args:
        alpha_f: Share of the old displacement in the stage's.
    """

    def __init__(self, moving: DynamicResidual, alpha_f: float) -> None:
        self._moving, self._share = moving, alpha_f
        mass = moving.mass.array_r[moving.displacement_dofs]
        self._mobility = np.divide(1.0, mass, out=np.zeros(len(mass)), where=mass > 0.0)
        self._first: FloatArray = np.zeros(len(mass))
        self._stage: FloatArray = self._first

    def _contact_forces(self) -> FloatArray:
        """Nodal forces of all contacts at the present displacement and time, owned entries [N]."""
        return sum(self._moving.contact_forces(), np.zeros(len(self._moving.displacement_dofs)))

    def begin(self, t: float) -> None:
        """Stores the contact forces at the start of a step.

        Args:
            t: Time of the start [s].
        """
        self._moving.problem.set_time(t)
        self._first = self._contact_forces()

    def at_stage(self, forces: Forces) -> None:
        """Stores the contact forces at its stage."""
        self._stage = forces.contact[self._moving.displacement_dofs]

    def error(self, h: float) -> FloatArray:
        """Error of the displacement at the end of the step, where the problem is now [m].

        Args:
            h: The step [s].
        """
        expected = (self._stage - self._share * self._first) / (1 - self._share)
        return np.asarray(-h * h / 6 * (self._contact_forces() - expected) * self._mobility)
