"""What steps must not pass over: corners of curves, and obstacles that move by their own size."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dolfin_elastic.model.components import depends_on_time
from dolfin_elastic.model.curves import RAMP, Amplitude
from dolfin_elastic.problem import Problem

STRIDE = 0.5
"""Share of an obstacle's radius that it may move in one step, lest it jump over a surface."""

HALVINGS = 30
"""Of a step in which an obstacle moves too far."""


def corners(problem: Problem) -> list[float]:
    """Times at which a curve has a corner, also where it turns around [s]."""
    return sorted({t for curve in _curves(problem) for t in curve.corners})


def winds(problem: Problem) -> bool:
    """A formula in t says how something changes: it may turn around at any time."""
    formulas = [load.values for load in problem.loads]
    formulas += [vector for s in problem.supports for vector in s.vectors.values()]
    formulas += [touch.contact.values for touch in problem.touching]
    curves = any(curve.winding for curve in _curves(problem))
    return curves or any(depends_on_time(vector) for vector in formulas)


def _curves(problem: Problem) -> Iterator[Amplitude]:
    things = [*problem.loads, *problem.supports, *(touch.contact for touch in problem.touching)]
    for thing in things:
        curve = getattr(thing, "curve", None)
        if isinstance(curve, Amplitude):
            yield curve


def gentle(problem: Problem, t: float, goal: float) -> float:
    """The load factor up to which no obstacle moves farther than it is thick.

    Args:
        problem: What may touch.
        t: Where the step begins.
        goal: Where it should end.
    """
    dim = problem.body.dim
    for contact in (touch.contact for touch in problem.touching):
        if not (contact.values and np.isfinite(stride := STRIDE * contact.obstacle.thickness)):
            continue
        start = np.array(contact.moved(t, RAMP, dim))
        for _ in range(HALVINGS):
            if np.linalg.norm(np.array(contact.moved(goal, RAMP, dim)) - start) <= stride:
                break
            goal = t + (goal - t) / 2
    return goal
