"""The least sum of squares of a fit whose constants have to fulfil a condition together.

A condition is g > 0 of functions g of the constants.  The search makes least the sum of squares and

    w sum max(0, c - g)^2

with a small c.  w grows until g > 0.

Source: J. Nocedal and S. Wright, Numerical Optimization (2006), section 17.1 (exterior penalties).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from dolfin_elastic.case.toml import changed_tables
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.materials.isochoric import Isochoric
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.study.fit.constants import with_numbers
from dolfin_elastic.study.fit.model import Model, differentiated
from dolfin_elastic.study.least_squares.search import Answer, NoSlopesError, known_slopes, spread

_MARGIN = 1e-3
"""Of g, to be above zero between the states that are looked at, too."""
_STAGES = ((1e2, 1e-5), (1e4, 1e-5), (1e6, 1e-8))
"""Weights w of what a condition lacks, each with the tolerance of its search."""
_SAME = 1e-3
"""Relative difference of two sums of squares that are the same answer."""
_STARTS = 2
"""Further starts."""


@dataclass(frozen=True)
class Condition(ABC):
    """What constants have to fulfil together.

    Args:
        law: With the constants that are not fitted.
    """

    model: Model
    law: Law

    name: ClassVar[str]
    """In a few words."""
    without: ClassVar[str]
    """What constants have that do not fulfil it."""
    nowhere: ClassVar[str]
    """Why a search has not ended that has found none that fulfil it."""

    @abstractmethod
    def holds(self, z: FloatArray) -> bool:
        """Whether constants over their scales fulfil it, shape (k,)."""

    @abstractmethod
    def margins(self, z: FloatArray) -> FloatArray:
        """g of sets of constants of shape (m, k), shape (m, n), of the order of 1."""

    def lacks(self, z: FloatArray) -> FloatArray:
        """max(0, c - g), shape (m, n)."""
        g = np.nan_to_num(self.margins(z), nan=-1.0, posinf=1.0, neginf=-1.0)
        return np.maximum(0.0, _MARGIN - g)

    @cached_property
    def size(self) -> float:
        """Of the stresses [Pa]."""
        return max(curve.size for curve in self.model.curves)

    def law_at(self, z: FloatArray) -> Law:
        """The law with constants over their scales, shape (k,).

        Raises:
            InputError: It does not accept them.
        """
        return with_numbers(self.law, self._values(z))

    def _values(self, z: FloatArray) -> dict[str, float]:
        rows = zip(self.model.free, z * self.model.scale, strict=True)
        return {row.name: float(x) for row, x in rows}


class PositiveShear(Condition):
    """The shear modulus at small strains is positive, which isochoric laws ask for."""

    name = "that of a positive shear modulus"
    without = "the shear modulus at small strains is not positive, which the law does not accept"
    nowhere = "no constants were found with a positive shear modulus at small strains"

    def holds(self, z: FloatArray) -> bool:
        """See `Condition`."""
        return bool((self.margins(z[None]) > 0).all())

    def margins(self, z: FloatArray) -> FloatArray:
        """The modulus over the size of the stresses."""
        return np.array([[self._shear(self._values(one)) / self.size] for one in z])

    def _shear(self, numbers: dict[str, float]) -> float:
        assert isinstance(self.law, Isochoric)
        given = self.law.constants()
        own = {name: x for name, x in numbers.items() if name.partition("[")[0] in given}
        return float(self.law.with_values(changed_tables(given, own, frozenset())).shear())


class _Penalised:
    """Weighted differences from what was measured, and below them what a condition lacks."""

    def __init__(self, condition: Condition) -> None:
        self._condition, self._model = condition, condition.model
        self.weight = 1.0
        self._last: tuple[FloatArray, FloatArray, FloatArray] | None = None

    def residuals(self, z: FloatArray) -> FloatArray:
        """Shape (N + n,)."""
        return self._both(z)[0]

    def sensitivities(self, z: FloatArray) -> FloatArray:
        """Derivatives of `residuals`, shape (N + n, k)."""
        return self._both(z)[1]

    def _both(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self._last is None or not np.array_equal(self._last[0], z):
            lacks, model = self._condition.lacks, self._model
            self._last = z.copy(), *differentiated(lacks, z, model.low, model.high)
        root = np.sqrt(self.weight)
        return (
            np.concatenate([self._model.residuals(z), root * self._last[1]]),
            np.vstack([self._model.sensitivities(z), root * self._last[2]]),
        )


@dataclass(frozen=True)
class Constrained:
    """A search for the best constants that fulfil a condition.

    Args:
        free: Where the search without it has ended.
        evaluations: Largest number of steps from each start, and with each weight.
    """

    condition: Condition
    free: Answer
    evaluations: int

    @cached_property
    def answer(self) -> Answer:
        """That without the condition if it holds there; the best one that was found, else.

        Where there is none, it has not ended.
        """
        if self.condition.holds(self.free.z):
            return self.free
        ends, starts = list[Answer](), [self.free.z, *spread(self.condition.model, _STARTS)]
        for z in starts:
            least = min((end.cost for end in ends), default=np.inf)
            if (end := self._descend(z, least * (1 + _SAME))) is not None:
                ends.append(end)
        if not ends:
            return replace(self.free, ended=False, why=self.condition.nowhere)
        best = min(ends, key=lambda one: one.cost)
        same = sum(one.cost <= best.cost * (1 + _SAME) for one in ends)
        return replace(best, starts=len(starts), same=same)

    def _descend(self, z: FloatArray, most: float) -> Answer | None:
        """Where a descent ends.

        None: it cannot begin, comes where nothing ends or the condition fails, or has lost.

        Args:
            most: Sum of squares that others have reached: with the penalties it only grows with w.
        """
        from scipy.optimize import least_squares

        model, part = self.condition.model, _Penalised(self.condition)
        inside = 1e-8 * np.maximum(np.abs(z), 1e-3)
        z = np.clip(z, model.low + inside, model.high - inside)
        if not np.isfinite(model.sensitivities(z)).all():
            return None
        size = np.where(self.free.z != 0, np.abs(self.free.z), 1.0)  # tolerances are of all alike
        for part.weight, tolerance in _STAGES:
            try:
                found = least_squares(
                    lambda x: part.residuals(x * size),
                    z / size,
                    lambda x: known_slopes(part.sensitivities(x * size) * size),
                    (model.low / size, model.high / size),
                    x_scale="jac",
                    ftol=tolerance,
                    xtol=tolerance,
                    gtol=tolerance,
                    max_nfev=self.evaluations,
                )
            except NoSlopesError:
                return None
            z = np.clip(found.x * size, model.low, model.high)
            if 2 * found.cost > most:
                return None
        if not self.condition.holds(z):
            return None
        cost = float(np.sum(model.residuals(z) ** 2))
        why = f"{self.evaluations} steps are done" if found.status == 0 else "least squares"
        return Answer(z, cost, found.status > 0, why, 1, 1)
