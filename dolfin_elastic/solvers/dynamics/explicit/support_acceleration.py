"""How supports that move accelerate what they hold, in explicit motion."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfin_elastic.core.errors import FormulaError
from dolfin_elastic.problem.problem import Problem

Vector = npt.NDArray[np.float64]


def mean_acceleration(
    problem: Problem, v: fem.Function, t: float, dt: float, interval: float
) -> Vector:
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

    def targets(time: float) -> Vector:
        try:
            return np.asarray(held.targets_at((time,))[0])
        except FormulaError:  # of a curve or an angle: on all ranks
            return np.full_like(here, np.nan)

    found: npt.NDArray[Any] = ((targets(t + dt) - here) / dt - now) / interval
    if not np.all(np.isfinite(found)):
        back: npt.NDArray[Any] = np.zeros_like(here)
        if t > 1.5 * dt:
            back = (here - 2 * targets(t - dt) + targets(max(t - 2 * dt, 0.0))) / dt**2
        found = np.where(np.isfinite(found), found, back)
    problem.set_time(t)
    return np.asarray(found, dtype=np.float64)
