"""Measured numbers, and those of a model as functions of its constants.

The sum that is made least is that of w (y - y_measured)^2/(n s^2) over all numbers, with the weight
w of a set, the count n of its numbers and their root mean square s: each set counts alike, and of
one set it is the plain least squares.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dolfin_elastic.core.errors import CaseError, SolveError
from dolfin_elastic.core.si_text import counted
from dolfin_elastic.core.types import BoolArray, FloatArray

NULL = 1e-7
"""Sensitivity to a change of constants, over the largest, that is none."""
_SCATTER = 0.7
"""Of the logarithms of values to start from."""


@dataclass(frozen=True)
class Constant:
    """One number that is sought or held.

    Attributes:
        name: As in a case file.
        unit: Of its values; empty: a pure number, or one of which no unit is known.
        start: Where the search begins.
        low: Least value.
        high: Largest value.
        held: Why it is not fitted; empty: it is.
        scale: Its size.
        narrowed: Whether the least and the largest value are the user's.
    """

    name: str
    unit: str
    start: float
    low: float
    high: float
    held: str = ""
    scale: float = 1.0
    narrowed: tuple[bool, bool] = (False, False)

    def within(self, low: float | None, high: float | None) -> Constant:
        """With bounds of the user's inside its range; None: it has no such bound."""
        least = self.low if low is None else max(low, self.low)
        most = self.high if high is None else min(high, self.high)
        start = float(np.clip(self.start, least, most))
        narrowed = least > self.low, most < self.high
        return replace(self, low=least, high=most, start=start, narrowed=narrowed)


class LeastSquares(ABC):
    """Numbers of a model and what was measured, as functions of the constants that are sought.

    Constants are z, values over their scale.

    Args:
        constants: All of them, also those that are held.
        sets: Measured numbers of each set, such as a curve.
        weights: Of the mean square error of each set.
        names: Of each set, for messages.

    Attributes:
        free: The constants that are sought.
        scale: Their sizes, shape (k,).
        low: Least values of z; `high`: largest ones; `start`: where the search begins.
        measured: Numbers of all sets in a row, shape (N,).
        weights: Factors of the differences from them, shape (N,).

    Raises:
        CaseError: There are no more numbers than constants.
    """

    def __init__(
        self,
        constants: Sequence[Constant],
        sets: Sequence[FloatArray],
        weights: Sequence[float],
        names: Sequence[str],
    ) -> None:
        self.free = [row for row in constants if not row.held]
        self.scale = np.array([row.scale for row in self.free])
        self.low = np.array([row.low for row in self.free]) / self.scale
        self.high = np.array([row.high for row in self.free]) / self.scale
        self.start = np.array([row.start for row in self.free]) / self.scale
        self.start = np.clip(self.start, self.low, self.high)
        self.measured = np.concatenate(sets)
        self._ends = np.cumsum([len(values) for values in sets])[:-1]
        factors = [
            np.full(len(x), np.sqrt(w / len(x)) / np.sqrt(np.mean(x**2)))
            for x, w in zip(sets, weights, strict=True)
        ]
        self.weights = np.concatenate(factors)
        if len(self.measured) <= len(self.free):
            raise CaseError(
                f"{counted(len(self.measured), 'point')} cannot tell "
                f"{counted(len(self.free), 'constant')}",
                where=", ".join(names),
                expected="more points than constants, or --fix",
            )

    def by_curve(self, values: FloatArray) -> list[FloatArray]:
        """Values at all points, of shape (N,), set by set."""
        return np.split(values, self._ends)

    @abstractmethod
    def residuals(self, z: FloatArray) -> FloatArray:
        """Weighted differences from what was measured, shape (N,)."""

    @abstractmethod
    def sensitivities(self, z: FloatArray) -> FloatArray:
        """Derivatives of `residuals`, shape (N, k)."""

    def at_bound(self, z: FloatArray) -> BoolArray:
        """Constants that are at a bound, shape (k,)."""
        near = 1e-7 * np.maximum(np.abs(z), 1e-3)
        return np.asarray((z - self.low < near) | (self.high - z < near))

    @abstractmethod
    def no_start(self) -> SolveError:
        """The error where no start has all numbers and their derivatives."""

    def linear(self) -> BoolArray:
        """Constants in which all numbers are linear together, shape (k,); none is known to be."""
        return np.zeros(len(self.free), dtype=bool)

    def best_linear(self, z: FloatArray, linear: BoolArray) -> FloatArray:
        """z with the best values of the constants that enter linearly."""
        return z

    def another_start(self, draw: np.random.Generator) -> FloatArray:
        """Random values to start from, shape (k,)."""
        values = np.array([self._drawn(i, draw) for i in range(len(self.free))])
        return np.clip(values, self.low, self.high)

    def _drawn(self, index: int, draw: np.random.Generator) -> float:
        return float(self.start[index] * np.exp(draw.normal(0.0, _SCATTER)))
