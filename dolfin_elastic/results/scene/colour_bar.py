"""Range, round ticks and unit of a colour bar; plain numbers only."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.startup.elsewhere import elsewhere
from dolfin_elastic.core.types import AnyArray

if TYPE_CHECKING:
    from matplotlib.colors import ListedColormap

INTERVALS = 5
"""Number of intervals between ticks at the most."""
_APART = 0.06
EQUAL = 1e-9
"""Relative difference below which values count as equal."""
_VIRIDIS = (0.2, 1.0)
"""Part of the colour map: its beginning is nearly black."""
_PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"))
_PREFIXED = ("Pa", "J/m^3", "m", "N", "m/s", "m/s^2", "J", "N m", "s")


@dataclass(frozen=True)
class ColourBar:
    """A colour bar.

    Attributes:
        ticks: Round numbers; the first and the last are the ends.
        factor: SI values over those on the bar.
        unit: Unit on the bar, with a prefix.
        form: Format of the ticks, for printf.
        label: Above it.
        reversed: Small values are warm.
        limit: Marked value on the bar, such as the allowable stress; None: there is none.
    """

    ticks: tuple[float, ...]
    factor: float
    unit: str
    form: str
    label: str = ""
    reversed: bool = False
    limit: float | None = None

    @property
    def labels(self) -> tuple[float, ...]:
        """Ticks with a number: the limit, and those that it leaves room for."""
        if self.limit is None:
            return self.ticks
        room = _APART * (self.ticks[-1] - self.ticks[0])
        kept = (tick for tick in self.ticks if abs(tick - self.limit) > room)
        return tuple(sorted((*kept, self.limit)))


def colour_map(*, warm_first: bool = False) -> ListedColormap:
    """Blue, green, yellow, evenly lighter, so that the colour-blind and a grey print show the same.

    None is dark, so that edges and shades are seen on all.

    Source: N. Smith and S. van der Walt, viridis (2015).
    """
    with elsewhere():
        from matplotlib import colormaps
        from matplotlib.colors import ListedColormap
    shades = colormaps["viridis"](np.linspace(*_VIRIDIS, 256))
    return ListedColormap(shades[::-1] if warm_first else shades)


def make_colour_bar(
    values: AnyArray, unit: str, noise: float = 0.0, *, exact: bool = False
) -> ColourBar:
    """The colour bar of some values.

    Round-off gets no colours: values that are zero but for round-off are shown between 0 and
    `noise`, others that are equal between 0 and their value.

    Args:
        values: In SI units; those that are not finite are left out.
        unit: SI unit.
        exact: The bar ends at the smallest and the largest value, not at round numbers.
    """
    low, high = _range(values[np.isfinite(values)], noise)
    factor, unit = prefixed(max(abs(low), abs(high)), unit)
    ticks = round_ticks(low / factor, high / factor)
    if exact:
        first, last = float(f"{low / factor:.4g}"), float(f"{high / factor:.4g}")
        apart = _APART * (last - first)  # labels must not touch
        inside = (t for t in ticks if first + apart < t < last - apart)
        return ColourBar((first, *inside, last), factor, unit, "%.4g")
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


def prefixed(largest: float, unit: str) -> tuple[float, str]:
    """Factor and prefixed unit in which the largest value is between 1 and 1000.

    Args:
        largest: Absolute value [SI].
        unit: SI unit; small areas and volumes are in squares and cubes of cm or mm.
    """
    # With a tolerance, so that 1000 kPa less round-off are 1 MPa.
    largest *= 1 + EQUAL
    if unit in ("m^2", "m^3") and largest:
        power = int(unit[-1])
        lengths = ((1.0, "m"), (1e-2, "cm"), (1e-3, "mm"))
        shown = (one for one in lengths if largest >= one[0] ** power)
        length, name = next(shown, lengths[-1])
        return length**power, f"{name}^{power}"
    if unit not in _PREFIXED or not largest:
        return 1.0, unit
    factor, prefix = next(((f, p) for f, p in _PREFIXES if largest >= f), _PREFIXES[-1])
    return factor, prefix + unit


def round_ticks(low: float, high: float) -> tuple[float, ...]:
    """Multiples of 1, 2, 2.5 or 5 times a power of ten that enclose a range.

    Args:
        low: Lower end; the first tick is at or below it.
        high: Upper end, above `low`; the last tick is at or above it.
    """
    rough = (high - low) / INTERVALS
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(m * power for m in (1, 2, 2.5, 5, 10) if m * power >= rough * (1 - EQUAL))
    first = math.floor(low / step + EQUAL)
    last = max(math.ceil(high / step - EQUAL), first + 1)
    return tuple(float(f"{i * step:.12g}") for i in range(first, last + 1))


def _form(ticks: tuple[float, ...]) -> str:
    """Format with the digits that the ticks need, the same for all."""
    largest = max(map(abs, ticks))
    if not 1e-3 <= largest < 1e6:
        return "%.4g"
    digits = (len(f"{t:.9f}".rstrip("0").split(".")[1]) for t in ticks)
    return f"%.{max(digits)}f"
