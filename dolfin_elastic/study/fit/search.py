"""Least squares of the stresses of tests: from several starts, and what it says of the constants.

The sum that is made least is that of w (P - P_measured)^2/(n s^2) over all points, with the weight
w of a curve, its number of points n and the root mean square s of its stresses: each curve counts
alike, and of one curve it is the plain least squares.  Constants on which all stresses depend
linearly follow at once from the others by linear least squares.  Where all are such, the answer is
unique; otherwise the others start from several values, which are the same in every run.

Of the answer: with the weighted sensitivities A and the variance v of the errors of each curve,
estimated from its own residuals, the covariance of the constants is B A^T V A B, B = (A^T A)^-1,
which for one curve is v B; intervals are those of Student's distribution.

Source: G. A. F. Seber and C. J. Wild, Nonlinear Regression (1989), sections 2.1 and 2.8; H. White,
Econometrica 48 (1980) 817 (the covariance where variances differ); G. H. Golub and V. Pereyra,
SIAM J. Numer. Anal. 10 (1973) 413 (constants that follow from the others).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dolfin_elastic.core.errors import CaseError, SolveError
from dolfin_elastic.core.si_text import counted
from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.viscous import Relaxation
from dolfin_elastic.study.fit.constants import Constant
from dolfin_elastic.study.fit.curves import TestCurve
from dolfin_elastic.study.fit.homogeneous import HomogeneousTests, check_curves
from dolfin_elastic.study.fit.stepped import SteppedBars

_STEP = 1e-5
"""Of central differences, over the constant: their error is its square."""
_TOLERANCE = 1e-10
_SAME = 1e-6
"""Relative difference of two sums of squares that are the same answer."""
_LINEAR = 1e-9
_ENOUGH = 3
"""Starts that must end in the least sum before the rest are left out."""
_FAR = 8.0
"""Largest exponent that a search starts from."""
_NULL = 1e-7
"""Sensitivity to a change of constants, over the largest, that is none."""
_LEVEL = 0.95


class Model:
    """The stresses of all curves as a function of the constants that are fitted.

    Constants are z, those of the law over their scale.

    Attributes:
        free: The constants that are fitted.
    """

    def __init__(
        self, law: Law, curves: Sequence[TestCurve], constants: Sequence[Constant]
    ) -> None:
        check_curves(law, curves)
        self.curves = list(curves)
        self.free = [row for row in constants if not row.held]
        names = [row.name for row in self.free]
        memory = law.memory
        simple = memory is None or isinstance(memory, Relaxation)
        self.tests = HomogeneousTests(law, names) if simple else SteppedBars(law, names)
        self.scale = np.array([row.scale for row in self.free])
        self.low = np.array([row.low for row in self.free]) / self.scale
        self.high = np.array([row.high for row in self.free]) / self.scale
        self.start = np.array([row.start for row in self.free]) / self.scale
        self.start = np.clip(self.start, self.low, self.high)
        self.measured = np.concatenate([curve.stress for curve in curves])
        factors = [np.full(len(c.x), np.sqrt(c.weight / len(c.x)) / c.size) for c in curves]
        self.weights = np.concatenate(factors)
        self._last: tuple[FloatArray, FloatArray, FloatArray] | None = None
        if len(self.measured) <= len(self.free):
            raise CaseError(
                f"{counted(len(self.measured), 'point')} cannot tell "
                f"{counted(len(self.free), 'constant')}",
                where=", ".join(curve.source or curve.kind for curve in curves),
                expected="more points than constants, or --fix",
            )

    def stresses(self, z: FloatArray) -> FloatArray:
        """Of all curves in a row [Pa], shape (m, N), for sets of constants of shape (m, k)."""
        rows = z * self.scale
        return np.hstack([self.tests.predict(curve, rows) for curve in self.curves])

    def by_curve(self, values: FloatArray) -> list[FloatArray]:
        """Values at all points, of shape (N,), curve by curve."""
        return np.split(values, np.cumsum([len(curve.x) for curve in self.curves])[:-1])

    def residuals(self, z: FloatArray) -> FloatArray:
        """Weighted differences from what was measured, shape (N,)."""
        return self._both(z)[0]

    def sensitivities(self, z: FloatArray) -> FloatArray:
        """Derivatives of `residuals`, shape (N, k)."""
        return self._both(z)[1]

    def _both(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The two, found together: a test of many sets takes hardly longer than of one."""
        if self._last is None or not np.array_equal(self._last[0], z):
            steps = _STEP * np.maximum(np.abs(z), 0.1)
            above = np.minimum(z + np.diag(steps), self.high)
            below = np.maximum(z - np.diag(steps), self.low)
            found = self.stresses(np.vstack([z, above, below]))
            k = len(z)
            apart = np.diag(above - below)
            slopes = ((found[1 : k + 1] - found[k + 1 :]) / apart[:, None]).T
            residuals = self.weights * (found[0] - self.measured)
            self._last = z.copy(), residuals, self.weights[:, None] * slopes
        return self._last[1], self._last[2]

    def linear(self) -> BoolArray:
        """Constants in which all stresses are linear together, shape (k,)."""
        draw = np.random.default_rng(1)
        chosen = np.zeros(len(self.free), dtype=bool)
        if not isinstance(self.tests, HomogeneousTests):
            return chosen
        for i in range(len(self.free)):
            trial = chosen.copy()
            trial[i] = True
            a, b = (self.start.copy() for _ in range(2))
            a[trial] *= draw.uniform(0.8, 1.2, trial.sum())
            b[trial] *= draw.uniform(0.8, 1.2, trial.sum())
            first, middle, last = self.stresses(np.array([a, (a + b) / 2, b]))
            off = np.abs(first + last - 2 * middle).max()
            bent = not off <= _LINEAR * np.abs(middle).max()
            chosen = chosen if bent or not np.abs(b - a).max() > 0 else trial
        # Free sides have no state where all moduli are 0.
        without = np.where(chosen, 0.0, self.start)
        return chosen & np.isfinite(self.stresses(without[None])).all()

    def at_bound(self, z: FloatArray) -> BoolArray:
        """Constants that are at a bound, shape (k,)."""
        near = 1e-7 * np.maximum(np.abs(z), 1e-3)
        return np.asarray((z - self.low < near) | (self.high - z < near))

    def best_linear(self, z: FloatArray, linear: BoolArray) -> FloatArray:
        """z with the best values of the constants that enter linearly."""
        from scipy.optimize import lsq_linear

        if not linear.any():
            return z
        base = z.copy()
        base[linear] = 0.0
        units = base + np.eye(len(z))[linear]
        found = self.stresses(np.vstack([base, units]))
        matrix = self.weights[:, None] * (found[1:] - found[0]).T
        right = self.weights * (self.measured - found[0])
        if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
            return z
        size = np.linalg.norm(matrix, axis=0)
        size[size == 0] = 1.0
        low, high = self.low[linear] * size, self.high[linear] * size
        x = np.linalg.lstsq(matrix / size, right, rcond=_NULL)[0]
        if not ((low <= x) & (x <= high)).all():
            x = lsq_linear(matrix / size, right, (low, high), tol=1e-14).x
        base[linear] = x / size
        return base


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


def search(model: Model, starts: int, evaluations: int) -> Answer:
    """The least sum of squares.

    Args:
        starts: How many are tried at most; fewer where three come to the same answer.
        evaluations: Largest number of steps of the search from each.

    Raises:
        SolveError: From no start there are stresses at all points.
    """
    linear = model.linear()
    if linear.all():
        z = model.best_linear(model.start, linear)
        cost = float(np.sum(model.residuals(z) ** 2))
        return Answer(z, cost, True, "linear least squares", 1, 1)
    ends: list[Answer] = []
    for k, z in enumerate(_starts(model, linear, starts)):
        if (end := _descend(model, z, linear, evaluations)) is not None:
            ends.append(end)
            if len(_same(ends)) >= _ENOUGH and k + 1 >= 2 * _ENOUGH:
                break
    if not ends:
        raise SolveError(
            "the law has no stress at some of the points, whatever the start",
            advice="other starting values, --bounds, or fewer points",
        )
    answer = min(ends, key=lambda one: one.cost)
    z = np.where(_seen(model, answer.z), answer.z, model.start)
    return replace(answer, z=z, starts=len(ends), same=len(_same(ends)))


def _same(ends: Sequence[Answer]) -> list[Answer]:
    """Those that have the least sum."""
    least = min(one.cost for one in ends)
    return [one for one in ends if one.cost <= least * (1 + _SAME) + 1e-24]


def _starts(model: Model, linear: BoolArray, count: int) -> list[FloatArray]:
    """Values to start from: those given first, then random ones that are always the same."""
    draw, result = np.random.default_rng(20), [model.start]
    times = [c.time for c in model.curves if c.time is not None]
    last = max((float(t[-1]) for t in times), default=1.0)
    first = min((float(t[t > 0].min(initial=last)) for t in times), default=last)
    for _ in range(count - 1):
        z = model.start.copy()
        for i, row in enumerate(model.free):
            if row.name.endswith(".time"):
                x = np.exp(draw.uniform(np.log(first), np.log(last))) / row.scale
            elif row.name.startswith("alpha"):
                x = draw.choice([-1, 1]) * np.exp(draw.uniform(np.log(0.5), np.log(_FAR)))
                x /= row.scale
            else:
                x = z[i] * np.exp(draw.normal(0.0, 0.7))
            z[i] = np.clip(x, model.low[i], model.high[i])
        result.append(z)
    return result


class _Projected:
    """The sum of squares as a function of the constants that do not enter linearly.

    Its sensitivities are those without their part in the span of the linear ones, after L. Kaufman,
    BIT 15 (1975) 49.
    """

    def __init__(self, model: Model, z: FloatArray, linear: BoolArray) -> None:
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


def _descend(model: Model, z: FloatArray, linear: BoolArray, evaluations: int) -> Answer | None:
    """Where a descent from one start ends; None: it cannot begin."""
    from scipy.optimize import least_squares

    inside = 1e-8 * np.maximum(np.abs(z), 1e-3)
    z = np.clip(z, model.low + inside, model.high - inside)
    part = _Projected(model, z, linear)
    x, bounds = z[~linear], (model.low[~linear], model.high[~linear])
    if not (np.isfinite(part.residuals(x)).all() and np.isfinite(part.sensitivities(x)).all()):
        return None
    found = least_squares(
        part.residuals,
        x,
        part.sensitivities,
        bounds,
        x_scale="jac",
        ftol=_TOLERANCE,
        xtol=_TOLERANCE,
        gtol=_TOLERANCE,
        max_nfev=evaluations,
    )
    why = f"{evaluations} steps are done" if found.status == 0 else "least squares"
    z = part.whole(found.x)
    return Answer(z, 2 * float(found.cost), found.status > 0, why, 1, 1)


# --- what the answer says of the constants ---


@dataclass(frozen=True)
class Certainty:
    """How well the constants are known.

    Attributes:
        half: Half widths of the intervals of 95 % [units of the constants], shape (k,); infinite
            where nothing tells a constant, nan at a bound.
        correlation: Shape (k, k); nan beside constants that the data cannot tell apart.
        bound: Constants at a bound, shape (k,).
        unknown: Groups of constants, by index, that the data cannot tell apart, or alone.
        weak: The change of z that the data see least, shape (k,).
    """

    half: FloatArray
    correlation: FloatArray
    bound: BoolArray
    unknown: tuple[tuple[int, ...], ...]
    weak: FloatArray


def certainty(model: Model, z: FloatArray) -> Certainty:
    """See `Certainty`, by the formula of the module."""
    from scipy.stats import t

    A, residuals, k = model.sensitivities(z), model.residuals(z), len(z)
    seen = _seen(model, z)
    bound = model.at_bound(z) & seen
    inner = np.flatnonzero(~bound & seen)
    size = np.linalg.norm(A[:, inner], axis=0)
    unknown: list[tuple[int, ...]] = [(int(i),) for i in np.flatnonzero(~seen)]
    half, correlation = np.full(k, np.nan), np.eye(k)
    half[[i for group in unknown for i in group]] = np.inf
    weak = np.zeros(k)
    if len(inner):
        _, s, vt = np.linalg.svd(A[:, inner] / size, full_matrices=False)
        weak[inner] = vt[-1] / size
        null = s < _NULL * s[0]
        for v in vt[null]:
            unknown.append(tuple(int(i) for i in inner[np.abs(v) > 0.1]))
        lost = np.abs(vt[null]).max(axis=0, initial=0.0) > 0.1
        half[inner[lost]] = np.inf
        inverse = (vt[~null].T / s[~null] ** 2) @ vt[~null]
        meat = A[:, inner] / size * _variances(model, residuals, len(inner))[:, None]
        covariance = inverse @ (A[:, inner] / size).T @ meat @ inverse
        deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        wide = deviation / size * model.scale[inner]
        quantile = t.ppf((1 + _LEVEL) / 2, len(residuals) - len(inner))
        half[inner[~lost]] = (quantile * wide)[~lost]
        safe = np.where(deviation > 0, deviation, 1.0)
        correlation[np.ix_(inner, inner)] = covariance / np.outer(safe, safe)
        # What is left of a covariance without its lost directions says nothing of their constants.
        correlation[inner[lost]] = correlation[:, inner[lost]] = np.nan
        np.fill_diagonal(correlation, 1.0)
    return Certainty(half, correlation, bound, tuple(unknown), weak)


def _seen(model: Model, z: FloatArray) -> BoolArray:
    """Constants that some stress depends on, shape (k,)."""
    size = np.linalg.norm(model.sensitivities(z), axis=0) * np.maximum(np.abs(z), 1e-3)
    return np.asarray(size > _NULL * np.linalg.norm(model.weights * model.measured))


def _variances(model: Model, residuals: FloatArray, k: int) -> FloatArray:
    """Of the weighted errors, estimated curve by curve, shape (N,)."""
    left = 1 - k / len(residuals)
    parts = model.by_curve(residuals)
    return np.concatenate([np.full(len(x), np.sum(x**2) / (len(x) * left)) for x in parts])
