"""How supports that move accelerate what they hold, in explicit motion."""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.errors import FormulaError
from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.problem.problem import Problem


def mean_acceleration(
    problem: Problem, v: fem.Function, t: float, dt: float, interval: float
) -> FloatArray:
    """The mean acceleration of supports in the next step, or the last where they end. Collective.

    Args:
        problem: Whose supports, at the present time.
        v: Velocity.
        t: Time [s].
        dt: The last step [s].
        interval: From the time of the velocity to the middle of its next step [s].
    """
    held = problem.prescribed
    here, now = held.present(problem.u.x.array), held.present(v.x.array)

    def targets(time: float) -> FloatArray:
        try:
            return np.asarray(held.targets_at((time,))[0])
        except FormulaError:  # of a curve or an angle: on all ranks
            return np.full_like(here, np.nan)

    found: AnyArray = ((targets(t + dt) - here) / dt - now) / interval
    if not np.all(np.isfinite(found)):
        back: AnyArray = np.zeros_like(here)
        if t > 1.5 * dt:
            back = (here - 2 * targets(t - dt) + targets(max(t - 2 * dt, 0.0))) / dt**2
        found = np.where(np.isfinite(found), found, back)
    problem.set_time(t)
    return np.asarray(found, dtype=np.float64)
