"""From values to what a colour bar says: range, round ticks, unit.  Plain numbers only."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.types import AnyArray

ROUGHLY = 5
"""Steps between ticks, or a few less."""
EQUAL = 1e-9
"""Values that differ by less than this share of the largest one are the same."""
_PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"))
_PREFIXED = ("Pa", "J/m^3", "m", "N", "m/s", "m/s^2")


@dataclass(frozen=True)
class ColourBar:
    """A colour bar.

    Attributes:
        ticks: Round numbers; the first and the last are the ends.
        factor: What the values are divided by.
        unit: What remains, with its prefix.
        form: How ticks are written, for printf.
    """

    ticks: tuple[float, ...]
    factor: float
    unit: str
    form: str


def make_colour_bar(values: AnyArray, unit: str, noise: float = 0.0) -> ColourBar:
    """The colour bar of some values.

    Rounding errors get no colours of their own: values that are zero but for them are shown
    between 0 and `noise`, others that are all the same between 0 and themselves.

    Args:
        values: In SI units; what is not finite does not count.
        unit: SI unit.
        noise: Differences below this are rounding errors.
    """
    low, high = _range(values[np.isfinite(values)], noise)
    factor, unit = _prefix(max(abs(low), abs(high)), unit)
    ticks = round_ticks(low / factor, high / factor)
    return ColourBar(ticks, factor, unit, _form(ticks))


def _range(values: AnyArray, noise: float) -> tuple[float, float]:
    if not len(values):
        return 0.0, noise or 1.0
    low, high = float(values.min()), float(values.max())
    largest = max(abs(low), abs(high))
    if high - low > max(noise, EQUAL * largest):
        return low, high
    if largest <= noise or not largest:
        return 0.0, noise or 1.0
    return min(low, 0.0), max(high, 0.0)


def _prefix(largest: float, unit: str) -> tuple[float, str]:
    """A factor and a unit with which the largest value reads well."""
    if unit not in _PREFIXED or not largest:
        return 1.0, unit
    # A little slack, so that 1000 kPa but for rounding are 1 MPa.
    largest *= 1 + EQUAL
    factor, prefix = next(((f, p) for f, p in _PREFIXES if largest >= f), _PREFIXES[-1])
    return factor, prefix + unit


def round_ticks(low: float, high: float) -> tuple[float, ...]:
    """Multiples of 1, 2, 2.5 or 5 times a power of ten, from `low` or below to `high` or above."""
    rough = (high - low) / ROUGHLY
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(m * power for m in (1, 2, 2.5, 5, 10) if m * power >= rough * (1 - EQUAL))
    first = math.floor(low / step + EQUAL)
    last = max(math.ceil(high / step - EQUAL), first + 1)
    return tuple(float(f"{i * step:.12g}") for i in range(first, last + 1))


def _form(ticks: tuple[float, ...]) -> str:
    """As many digits as the ticks need, and the same for all."""
    largest = max(map(abs, ticks))
    if not 1e-3 <= largest < 1e6:
        return "%.4g"
    digits = (len(f"{t:.9f}".rstrip("0").split(".")[1]) for t in ticks)
    return f"%.{max(digits)}f"
