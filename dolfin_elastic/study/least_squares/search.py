"""The least sum of squares, from several starts.

Constants on which all numbers depend linearly follow at once from the others by linear least
squares.  Where all are such, the answer is unique; otherwise the others start from several values,
which are the same in every run.

Source: G. A. F. Seber and C. J. Wild, Nonlinear Regression (1989), section 2.8; G. H. Golub and
V. Pereyra, SIAM J. Numer. Anal. 10 (1973) 413 (constants that follow from the others).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.study.least_squares.certainty import seen
from dolfin_elastic.study.least_squares.problem import LeastSquares

_TOLERANCE = 1e-10
_SAME = 1e-6
"""Relative difference of two sums of squares that are the same answer."""
_ENOUGH = 3
"""Starts that must end in the least sum before the rest are left out."""


@dataclass(frozen=True)
class Answer:
    """Where the search has ended.

    Attributes:
        z: The constants that are fitted, over their scales, shape (k,).
        cost: Sum of squares.
        ended: It is a minimum.
        why: How it has ended.
        starts: How many were tried.
        same: How many of them have ended there.
    """

    z: FloatArray
    cost: float
    ended: bool
    why: str
    starts: int
    same: int


def search(model: LeastSquares, starts: int, evaluations: int) -> Answer:
    """The least sum of squares.

    Args:
        starts: How many are tried at most; fewer where three come to the same answer.
        evaluations: Largest number of steps of the search from each.

    Raises:
        SolveError: From no start there are numbers at all points.
    """
    linear = model.linear()
    if linear.all():
        z = model.best_linear(model.start, linear)
        cost = float(np.sum(model.residuals(z) ** 2))
        return Answer(z, cost, True, "linear least squares", 1, 1)
    ends: list[Answer] = []
    for k, z in enumerate(spread(model, starts)):
        if (end := _descend(model, z, linear, evaluations)) is not None:
            ends.append(end)
            if len(_same(ends)) >= _ENOUGH and k + 1 >= 2 * _ENOUGH:
                break
    if not ends:
        raise model.no_start()
    answer = min(ends, key=lambda one: one.cost)
    answer = replace(answer, starts=len(ends), same=len(_same(ends)))
    visible = seen(model, answer.z)
    if visible.all():
        return answer
    # What nothing sees where it has come to stays where it began, unless it is seen there.
    z = np.where(visible, answer.z, model.start)
    cost = float(np.sum(model.residuals(z) ** 2))
    return replace(answer, z=z) if cost <= answer.cost * (1 + _SAME) + 1e-24 else answer


def _same(ends: Sequence[Answer]) -> list[Answer]:
    """Those that have the least sum."""
    least = min(one.cost for one in ends)
    return [one for one in ends if one.cost <= least * (1 + _SAME) + 1e-24]


def spread(model: LeastSquares, count: int) -> list[FloatArray]:
    """Values to start from: those given first, then random ones that are always the same."""
    draw = np.random.default_rng(20)
    return [model.start, *(model.another_start(draw) for _ in range(count - 1))]


class NoSlopesError(Exception):
    """A descent has come to constants where the numbers have no derivatives."""


def known_slopes(found: FloatArray) -> FloatArray:
    """Derivatives as they are.

    Raises:
        NoSlopesError: Some have no value, as beside constants whose numbers have none.
    """
    if not np.isfinite(found).all():
        raise NoSlopesError
    return found


class _Projected:
    """The sum of squares as a function of the constants that do not enter linearly.

    Its sensitivities are those without their part in the span of the linear ones, after L. Kaufman,
    BIT 15 (1975) 49.
    """

    def __init__(self, model: LeastSquares, z: FloatArray, linear: BoolArray) -> None:
        self._model, self._base, self._linear = model, z, linear
        self._last: tuple[FloatArray, FloatArray] | None = None

    def whole(self, x: FloatArray) -> FloatArray:
        """All constants from the others, shape (k,)."""
        if self._last is None or not np.array_equal(self._last[0], x):
            z = self._base.copy()
            z[~self._linear] = x
            self._last = x.copy(), self._model.best_linear(z, self._linear)
        return self._last[1]

    def residuals(self, x: FloatArray) -> FloatArray:
        """See `Model`."""
        return self._model.residuals(self.whole(x))

    def sensitivities(self, x: FloatArray) -> FloatArray:
        """Of `residuals`, shape (N, number of the others)."""
        z = self.whole(x)
        A = self._model.sensitivities(z)
        span = A[:, self._linear & ~self._model.at_bound(z)]
        size = np.linalg.norm(span, axis=0)
        q = np.linalg.qr(span[:, size > 0] / size[size > 0])[0]
        other = A[:, ~self._linear]
        return np.asarray(other - q @ (q.T @ other))


def _descend(
    model: LeastSquares, z: FloatArray, linear: BoolArray, evaluations: int
) -> Answer | None:
    """Where a descent from one start ends; None: it cannot begin, or comes where nothing ends."""
    from scipy.optimize import least_squares

    inside = 1e-8 * np.maximum(np.abs(z), 1e-3)
    z = np.clip(z, model.low + inside, model.high - inside)
    part = _Projected(model, z, linear)
    x, bounds = z[~linear], (model.low[~linear], model.high[~linear])
    if not (np.isfinite(part.residuals(x)).all() and np.isfinite(part.sensitivities(x)).all()):
        return None
    try:
        found = least_squares(
            part.residuals,
            x,
            lambda x: known_slopes(part.sensitivities(x)),
            bounds,
            x_scale="jac",
            ftol=_TOLERANCE,
            xtol=_TOLERANCE,
            gtol=_TOLERANCE,
            max_nfev=evaluations,
        )
    except NoSlopesError:
        return None
    why = f"{evaluations} steps are done" if found.status == 0 else "least squares"
    z = part.whole(found.x)
    return Answer(z, 2 * float(found.cost), found.status > 0, why, 1, 1)
