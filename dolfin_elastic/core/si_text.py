"""Numbers for people: four digits, with a prefix of the unit that keeps them short."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence

from dolfin_elastic.core.units import is_quantity

_PREFIXES = {
    "Pa": ((1e9, "GPa"), (1e6, "MPa"), (1e3, "kPa"), (1.0, "Pa")),
    "N": ((1e6, "MN"), (1e3, "kN"), (1.0, "N"), (1e-3, "mN"), (1e-6, "µN")),
    "N m": ((1e6, "MN m"), (1e3, "kN m"), (1.0, "N m"), (1e-3, "mN m"), (1e-6, "µN m")),
    "J": ((1e6, "MJ"), (1e3, "kJ"), (1.0, "J"), (1e-3, "mJ"), (1e-6, "µJ"), (1e-9, "nJ")),
    "Hz": ((1e6, "MHz"), (1e3, "kHz"), (1.0, "Hz"), (1e-3, "mHz")),
    "m": ((1e3, "km"), (1.0, "m"), (1e-3, "mm"), (1e-6, "µm"), (1e-9, "nm")),
    "s": ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs")),
    "kg": ((1e3, "t"), (1.0, "kg"), (1e-3, "g"), (1e-6, "mg")),
    "m^2": ((1.0, "m²"), (1e-4, "cm²"), (1e-6, "mm²"), (1e-12, "µm²")),
    "m^3": ((1.0, "m³"), (1e-6, "cm³"), (1e-9, "mm³"), (1e-18, "µm³")),
    "byte": ((1e9, "GB"), (1e6, "MB"), (1e3, "kB"), (1.0, "byte")),
}
_ROUND_OFF = 1e-9
"""Components of a vector, over the largest, that are shown as 0."""


def scaled_unit(largest: float, unit: str) -> tuple[float, str]:
    """What to divide SI values by, and the unit that they then have.

    Args:
        unit: Their SI unit.
    """
    steps = _PREFIXES.get(unit)
    if not steps or not math.isfinite(largest) or largest == 0:
        return 1.0, unit_text(unit)
    return next((step for step in steps if abs(largest) >= 0.99995 * step[0]), steps[-1])


def number(value: float, digits: int = 4) -> str:
    """A number without unit; "1.2e-05" only far from 1."""
    if not math.isfinite(value):
        return "not known" if math.isnan(value) else "unbounded"
    text = f"{value:.{digits}g}"
    if "e" in text and 1e-3 <= abs(value) < 1e7:
        text = f"{value:.0f}"
    return text.replace("-", "−")


def quantity(value: float, unit: str = "") -> str:
    """A number with its unit, such as "185.2 MPa".

    Args:
        value: In SI units.
        unit: The SI unit.
    """
    factor, name = scaled_unit(value, unit)
    text = number(value / factor)
    return f"{text} {name}" if name and math.isfinite(value) else text


def vector(values: Iterable[float], unit: str = "", largest: float = 0.0, digits: int = 4) -> str:
    """Components with one unit, such as "(0, 0, −1.5) kN"; round-off is shown as 0.

    Args:
        values: The components, in SI units.
        unit: The SI unit.
        largest: Of what they are compared to, beside the largest of them.
    """
    parts = [float(value) for value in values]
    most = max((abs(value) for value in parts), default=0.0)
    limit = _ROUND_OFF * max(most, largest)
    factor, name = scaled_unit(most if most > limit else largest, unit)
    shown = (number(value / factor, digits) if abs(value) > limit else "0" for value in parts)
    return f"({', '.join(shown)})" + (f" {name}" if name else "")


def size(value: float, dim: int) -> str:
    """A length, area or volume.

    Args:
        value: In metres to the power `dim`.
        dim: 1, 2 or 3.
    """
    if dim == 1:
        return quantity(value, "m")
    steps = _PREFIXES[f"m^{dim}"]
    factor, unit = next((step for step in steps if value >= 0.1 * step[0]), steps[-1])
    return f"{number(value / factor)} {unit}"


def percent(value: float | None) -> str:
    """A share in per cent, such as "12 %"; "< 0.01 %" of one that is smaller but not 0."""
    if value is None or not math.isfinite(value):
        return "not known"
    shown = 100 * value
    if 0 < shown < 0.01:
        return "< 0.01 %"
    return f"{shown:.0f} %" if shown >= 10 else f"{shown:.2g} %"


def counted(count: int, thing: str) -> str:
    """A number with its noun in the singular or plural.

    Args:
        thing: The noun, whose first part takes the plural.
    """
    first, of, rest = thing.partition(" of ")
    return f"{count} {first}{'' if count == 1 else 's'}{of}{rest}"


def listed(words: Sequence[str], word: str = "and") -> str:
    """Words as a list in a sentence.

    Args:
        word: Before the last one.
    """
    *others, last = words
    return f"{', '.join(others)} {word} {last}" if others else last


def time_or_load(t: float, *, timed: bool, curves: bool = False) -> str:
    """The time, or the share of the load: "t = 0.25 s" or "load 60 %".

    Args:
        curves: Loads follow curves over the load parameter, so that it is no share of theirs.
    """
    share = f"load parameter {t:.4g}" if curves else f"load {100 * t:.4g} %"
    return f"t = {t:.4g} s" if timed else share


# --- what users have written ---


def given(value: object, unit: str = "") -> str:
    """A value as a user wrote it, with its unit.

    Args:
        value: A number, a text with a unit, a formula, a word, or a list or table of these.
        unit: SI unit of bare numbers and of formulas.
    """
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        factor, name = scaled_unit(float(value), unit)
        text = number(float(value) / factor, 6)
        return f"{text} {name}" if unit and value else text
    if isinstance(value, str):
        if is_quantity(value):
            return value.replace("-", "−")
        return value if value == "free" or not unit else f"{value} [{unit_text(unit)}]"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {given(item)}" for key, item in value.items())
    return _list(list(value), unit) if isinstance(value, Iterable) else str(value)


def _list(items: list[object], unit: str) -> str:
    if len(items) > 24:
        return f"{len(items)} values"
    numbers = [item for item in items if isinstance(item, int | float)]
    if unit and items and len(numbers) == len(items):
        return vector(map(float, numbers), unit, digits=6)
    bare = [item for item in items if isinstance(item, str) and not is_quantity(item)]
    if unit and {*bare} - {"free"} and len(bare) + len(numbers) == len(items):
        return f"({', '.join(map(given, items))}) {unit_text(unit)}"
    return f"({', '.join(given(item, unit) for item in items)})"


def unit_text(unit: str) -> str:
    """An SI unit as it is printed: "N/m³"."""
    return unit.replace("^2", "²").replace("^3", "³").replace("*", " ")


def natural(name: str) -> list[tuple[int, str]]:
    """Key that sorts names for people by the numbers in them: 1, 2, 10."""
    parts = re.split(r"([0-9]+)", name)
    return [(int(part) if part.isdecimal() else 0, part) for part in parts]


def literal(text: str) -> str:
    """A text in which matplotlib finds no formula."""
    return text.replace("$", r"\$")
