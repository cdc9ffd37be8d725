"""Limit points inside a step of a path: where the load has a largest or smallest value.

The load factor over the length of the step is a cubic from the values and slopes at both ends
(Hermite).  A root of its derivative is where a further point of the path is found, which replaces
one of the ends, and so on: the error of the load falls with the fourth power of the length.  The
slope is that of the tangent of the path, of the factors that Newton's method has left.

Sources: R. Seydel, Practical Bifurcation and Stability Analysis (2010), section 5.5 (test
functions); C. de Boor, A Practical Guide to Splines (1978), chapter IV (cubic Hermite
interpolation).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

EXACT = 1e-8
"""Error of a limit load, over itself, at which it counts as found."""

MOST = 6
"""Further points of the path for each limit point."""

APART = 1e-3
"""Share of the step by which two limit points in it are apart."""


@dataclass(frozen=True)
class Sample:
    """A point of the path in a step.

    Attributes:
        s: Its distance from the beginning of the step [m].
        t: Load factor.
        slope: Derivative of t by s [1/m].
    """

    s: float
    t: float
    slope: float


@dataclass(frozen=True)
class LimitPoint:
    """A largest or smallest load factor along a path.

    Attributes:
        t: The load factor.
        error: Its estimated error.
    """

    t: float
    error: float


def limit_points(
    begin: Sample, end: Sample, find: Callable[[float], Sample | None], *, least: float = 0.0
) -> list[LimitPoint]:
    """All limit points in a step that its cubics show, in their order.

    Args:
        find: The point of the path at a distance; None where it is not found.
        least: Error of the load of a point of the path, over the load.
    """
    points: list[LimitPoint] = []
    left, last, apart = begin, begin.s, APART * (end.s - begin.s)
    while roots := _further(left, end, last, apart):
        before = last
        point, limit, last = _located(left, end, roots[0], find)
        if points and last <= before + apart:  # the same one again
            break
        points.append(LimitPoint(limit.t, max(limit.error, least * abs(limit.t))))
        if point is None or len(points) > 2:
            break
        left = point
    return points


def first_reached(
    samples: Sequence[Sample], t: float, find: Callable[[float], Sample | None]
) -> Sample | None:
    """The first point of a path in a step that has a load factor; None where it is not found.

    Args:
        samples: Known points of the step, in their order; the first has a smaller load factor, and
            one of the others has not.
        find: See `limit_points`; what it has found last is returned.
    """
    a, b = next(pair for pair in pairwise(samples) if pair[0].t < t <= pair[1].t)
    for _ in range(MOST):
        sample = find(_reaching(a, b, t))
        if sample is None or abs(sample.t - t) <= EXACT * abs(t):
            return sample
        a, b = (sample, b) if sample.t < t else (a, sample)
    return sample


def _reaching(a: Sample, b: Sample, t: float) -> float:
    """Where the cubic of two points has a load factor between theirs, the first time [m]."""
    share = (t - a.t) / (b.t - a.t)
    if np.isfinite([a.slope, b.slope]).all():
        c0, c1, c2, c3 = _coefficients(a, b)
        roots = [x.real for x in np.roots([c3, c2, c1, c0 - t]) if abs(x.imag) < 1e-9]
        share = min((x for x in roots if 0.0 < x < 1.0), default=share)
    return a.s + float(share) * (b.s - a.s)


def _further(left: Sample, end: Sample, last: float, apart: float) -> list[float]:
    """Turns of the load behind the limit point that was found last [m].

    Args:
        left: The last point of the path that was found, before that limit point or behind it.
        last: Distance of that limit point [m].
        apart: Least distance between two limit points [m].
    """
    turns = _turns(left, end)
    if left.s < last:  # the first one is that limit point, as this longer cubic sees it
        turns = turns[1:]
    return [x for x in turns if x > max(left.s, last) + apart]


def _located(
    left: Sample, right: Sample, x: float, find: Callable[[float], Sample | None]
) -> tuple[Sample | None, LimitPoint, float]:
    """The last point of the path found next to x, the limit point, and its distance [m]."""
    samples, point = [left, right], None
    value = _cubic(left, right, x)
    error = max(abs(value - left.t), abs(value - right.t))
    for _ in range(MOST):
        result = find(x)
        if result is None:
            break
        point = result
        if not np.isfinite(result.slope):  # the tangent is singular: it is the limit point
            return point, LimitPoint(result.t, abs(value - result.t)), result.s
        samples = [result, *sorted(samples, key=lambda sample: abs(sample.s - result.s))]
        left, right = (left, result) if left.slope * result.slope <= 0.0 else (result, right)
        # The two nearest points give the better cubic, the two around the limit one with a root.
        pair = result, samples[1]
        roots = [at for at in _turns(*pair, inside=False) if left.s < at < right.s]
        if not roots:
            pair = left, right
            roots = _turns(left, right)
        if not roots:
            # The slope is all that is left to tell: the limit is within a step of Newton's method.
            return result, LimitPoint(result.t, abs(result.slope * (right.s - left.s))), result.s
        x = roots[int(np.argmin(np.abs(np.array(roots) - result.s)))]
        value, error = _cubic(*pair, x), abs(result.slope * (x - result.s))
        if error <= EXACT * abs(value):
            break
    return point, LimitPoint(value, error), x


def _coefficients(a: Sample, b: Sample) -> tuple[float, float, float, float]:
    """Of 1, x, x^2 and x^3, x the share of the distance from a to b."""
    h = b.s - a.s
    g, k = h * a.slope, h * b.slope
    return a.t, g, 3 * (b.t - a.t) - 2 * g - k, 2 * (a.t - b.t) + g + k


def _cubic(a: Sample, b: Sample, s: float) -> float:
    """Load factor of the cubic between two points."""
    x = (s - a.s) / (b.s - a.s)
    c = _coefficients(a, b)
    return c[0] + x * (c[1] + x * (c[2] + x * c[3]))


def _turns(a: Sample, b: Sample, *, inside: bool = True) -> list[float]:
    """Where the cubic of two points has a horizontal tangent, sorted [m].

    Args:
        inside: Between them only.
    """
    if not np.isfinite([a.slope, b.slope]).all():
        return []
    _, c1, c2, c3 = _coefficients(a, b)
    shares = [float(x.real) for x in np.roots([3 * c3, 2 * c2, c1]) if abs(x.imag) < 1e-12]
    return sorted(a.s + x * (b.s - a.s) for x in shares if not inside or 0.0 < x < 1.0)
