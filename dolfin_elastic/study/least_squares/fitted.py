"""Constants after a fit, and their table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.errors import nearest
from dolfin_elastic.core.si_text import quantity
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.study.least_squares.certainty import Certainty
from dolfin_elastic.study.least_squares.problem import Constant, LeastSquares

_ROUND_OFF = 1e-12
"""Error over the largest number that the arithmetic makes."""


@dataclass(frozen=True)
class FittedConstant:
    """A constant after the fit.

    Attributes:
        name: As in a case file.
        unit: Of its value.
        value: In this unit.
        half: Half the width of its interval of 95 %; infinite where nothing tells it, nan
            where it is held or at a bound.
        held: Why it is not fitted; empty: it is.
        bound: It has come to a bound of its range.
    """

    name: str
    unit: str
    value: float
    half: float
    held: str = ""
    bound: bool = False

    @property
    def interval(self) -> tuple[float, float]:
        """Its ends."""
        return self.value - self.half, self.value + self.half


def rms(off: FloatArray) -> float:
    """Root mean square of differences."""
    return float(np.sqrt(np.mean(off**2)))


def error_text(error: float, relative: float, unit: str) -> str:
    """An r.m.s. error with its unit.

    Args:
        error: In SI units.
        relative: The same over the largest measured number.
        unit: The SI unit.
    """
    return quantity(error, unit) if relative > _ROUND_OFF else "round-off"


def fitted_constants(
    constants: Sequence[Constant], model: LeastSquares, z: FloatArray, known: Certainty
) -> tuple[FittedConstant, ...]:
    """All constants, those that are held as they were.

    Args:
        z: Of those that were sought, over their scales, shape (k,).
        known: What is known of them at z, from `certainty`.
    """
    order = {row.name: i for i, row in enumerate(model.free)}

    def fitted(row: Constant) -> FittedConstant:
        if row.held:
            return FittedConstant(row.name, row.unit, row.start, np.nan, row.held)
        i = order[row.name]
        value, half = float(z[i] * model.scale[i]), float(known.half[i])
        return FittedConstant(row.name, row.unit, value, half, bound=bool(known.bound[i]))

    return tuple(map(fitted, constants))


def constant_of(rows: Sequence[FittedConstant], name: str) -> FittedConstant:
    """The constant of a name; of an unknown one a KeyError that names the nearest."""
    known = {row.name: row for row in rows}
    if name not in known:
        raise KeyError(f"there is no constant '{name}'; {nearest(name, known)}")
    return known[name]


def constants_csv(rows: Sequence[FittedConstant], correlation: FloatArray) -> str:
    """Constants with intervals and correlations, as CSV.

    Args:
        rows: The k constants that were not held.
        correlation: Of these, shape (k, k).
    """
    lines = [",".join(["constant", "unit", "value", "low", "high", *(row.name for row in rows)])]
    for i, row in enumerate(rows):
        ends = [f"{x:.10g}" if math.isfinite(x) else "" for x in row.interval]
        matrix = [f"{x:.6g}" if math.isfinite(x) else "" for x in correlation[i]]
        lines.append(",".join([row.name, row.unit, f"{row.value:.10g}", *ends, *matrix]))
    return "\n".join(lines) + "\n"
