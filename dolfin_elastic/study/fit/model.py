"""The stresses of tests as functions of a law's constants."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dolfin_elastic.core.errors import SolveError
from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.viscous import Relaxation
from dolfin_elastic.study.fit.curves import TestCurve
from dolfin_elastic.study.fit.homogeneous import HomogeneousTests, check_curves
from dolfin_elastic.study.fit.stepped import SteppedBars
from dolfin_elastic.study.least_squares.problem import NULL, Constant, LeastSquares

_STEP = 1e-5
"""Of central differences, over the constant: their error is its square."""
_LINEAR = 1e-9
_FAR = 8.0
"""Largest exponent that a search starts from."""


class Model(LeastSquares):
    """The stresses of all curves as a function of the constants that are fitted.

    Constants are z, those of the law over their scale.
    """

    def __init__(
        self, law: Law, curves: Sequence[TestCurve], constants: Sequence[Constant]
    ) -> None:
        check_curves(law, curves)
        self.curves = list(curves)
        super().__init__(
            constants,
            [curve.stress for curve in curves],
            [curve.weight for curve in curves],
            [curve.source or curve.kind for curve in curves],
        )
        names = [row.name for row in self.free]
        memory = law.memory
        simple = memory is None or isinstance(memory, Relaxation)
        self.tests = HomogeneousTests(law, names) if simple else SteppedBars(law, names)
        self._last: tuple[FloatArray, FloatArray, FloatArray] | None = None

    def stresses(self, z: FloatArray) -> FloatArray:
        """Of all curves in a row [Pa], shape (m, N), for sets of constants of shape (m, k)."""
        rows = z * self.scale
        return np.hstack([self.tests.predict(curve, rows) for curve in self.curves])

    def residuals(self, z: FloatArray) -> FloatArray:
        """Weighted differences from what was measured, shape (N,)."""
        return self._both(z)[0]

    def sensitivities(self, z: FloatArray) -> FloatArray:
        """Derivatives of `residuals`, shape (N, k)."""
        return self._both(z)[1]

    def _both(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The two, found together: a test of many sets takes hardly longer than of one."""
        if self._last is None or not np.array_equal(self._last[0], z):
            found, slopes = differentiated(self.stresses, z, self.low, self.high)
            residuals = self.weights * (found - self.measured)
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
        x = np.linalg.lstsq(matrix / size, right, rcond=NULL)[0]
        if not ((low <= x) & (x <= high)).all():
            x = lsq_linear(matrix / size, right, (low, high), tol=1e-14).x
        base[linear] = x / size
        return base

    def no_start(self) -> SolveError:
        """See `LeastSquares`."""
        return SolveError(
            "the law has no stress at some of the points, whatever the start",
            advice="other starting values, --bounds, or fewer points",
        )

    def _drawn(self, index: int, draw: np.random.Generator) -> float:
        name, scale = self.free[index].name, self.scale[index]
        if name.endswith(".time"):
            times = [c.time for c in self.curves if c.time is not None]
            last = max((float(t[-1]) for t in times), default=1.0)
            first = min((float(t[t > 0].min(initial=last)) for t in times), default=last)
            return float(np.exp(draw.uniform(np.log(first), np.log(last))) / scale)
        if name.startswith("alpha"):
            sign = draw.choice([-1, 1])
            return float(sign * np.exp(draw.uniform(np.log(0.5), np.log(_FAR))) / scale)
        return super()._drawn(index, draw)


def differentiated(
    function: Callable[[FloatArray], FloatArray], z: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A function of sets of constants at one, and its derivatives there, by central differences.

    Args:
        function: Of rows of constants, shape (m, k), gives rows, shape (m, n).
        z: Shape (k,).
        low: Least values, within which the differences stay.
        high: Largest values, the same.

    Returns:
        Shapes (n,) and (n, k).
    """
    steps, k = _STEP * np.maximum(np.abs(z), 0.1), len(z)
    above = np.minimum(z + np.diag(steps), high)
    below = np.maximum(z - np.diag(steps), low)
    found = function(np.vstack([z, above, below]))
    apart = np.diag(above - below)
    return found[0], ((found[1 : k + 1] - found[k + 1 :]) / apart[:, None]).T
