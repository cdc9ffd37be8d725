"""What a step must not jump over: output times, corners of amplitudes, strides of obstacles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.model.amplitude import PROPORTIONAL
from dolfin_elastic.model.values import depends_on_time
from dolfin_elastic.problem.problem import Problem

STRIDE = 0.5
"""Share of an obstacle's radius that it may move in one step, lest it jump over a surface."""

HALVINGS = 30
"""Of a step in which an obstacle moves too far."""


def refuse_times_beyond(times: Sequence[float], end: float, key: str, unit: str = "") -> None:
    """Refuses output times after the end.

    Args:
        times: Times or load factors that are to be met exactly.
        end: Where the run ends.
        unit: Of all of them, for the message.

    Raises:
        InputError: The first one beyond the end.
    """
    unit = f" {unit}" if unit else ""
    for index, time in enumerate(times):
        if time > end:
            raise InputError(
                f"{time:g}{unit} lies beyond the end",
                where=f"times[{index}]",
                expected=f"at most {key} = {end:g}{unit}",
            )


def driven_by_formula(problem: Problem) -> bool:
    """Whether a formula in t drives a load, support or obstacle: it may turn around at any time."""
    formulas = [load.values for load in problem.loads]
    formulas += [function for support in problem.supports for function in support.time_functions]
    formulas += [pair.contact.values for pair in problem.contact_pairs]
    curves = any(curve.is_formula for curve in problem.curves)
    return curves or any(depends_on_time(vector) for vector in formulas)


def within_stride(problem: Problem, t: float, goal: float) -> float:
    """The load factor up to which no obstacle moves farther than it is thick.

    Args:
        problem: What may touch.
        t: Where the step begins.
        goal: Where it should end.
    """
    dim = problem.body.dim
    for contact in (pair.contact for pair in problem.contact_pairs):
        if not (contact.values and np.isfinite(stride := STRIDE * contact.obstacle.thickness)):
            continue
        start = np.array(contact.displacement_at(t, PROPORTIONAL, dim))
        for _ in range(HALVINGS):
            if (
                np.linalg.norm(np.array(contact.displacement_at(goal, PROPORTIONAL, dim)) - start)
                <= stride
            ):
                break
            goal = t + (goal - t) / 2
    return goal
