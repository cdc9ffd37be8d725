"""Amplitude over time: what multiplies a load or a prescribed displacement.

In statics "time" is the load parameter, from 0 (nothing) to 1 (everything).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import BeforeValidator, PlainSerializer

from dolfin_elastic.errors import InputError, nearest
from dolfin_elastic.formulas import Formula
from dolfin_elastic.units import to_si

WORDS = ("ramp", "constant")


@dataclass(frozen=True)
class Amplitude:
    """A number that changes with time.

    Attributes:
        written: As the user wrote it: "ramp" (0 at t = 0, 1 from t = 1 on), "constant" (1), a
            formula in t, or a table of pairs (t, value) with linear interpolation between them
            and the end values beyond.
        formula: The formula, if it is one.
    """

    written: str | tuple[tuple[float, float], ...]
    formula: Formula | None = None

    def at(self, t: float) -> float:
        """Value at time t [s], or at load parameter t in statics."""
        if self.formula is not None:
            return float(self.formula.evaluate(t=t))
        if self.written == "ramp":
            return min(max(t, 0.0), 1.0)
        if self.written == "constant":
            return 1.0
        times, values = zip(*self.written, strict=True)
        return float(np.interp(t, times, values))


RAMP, CONSTANT = Amplitude("ramp"), Amplitude("constant")
PROPORTIONAL = Amplitude("t", Formula.parse("t", allowed=("t",)))
"""The load factor itself, also above 1 and below 0."""


def amplitude(written: Any) -> Amplitude:
    """Reads an amplitude from what a user wrote.

    Raises:
        InputError: Neither a known word, nor a formula in t, nor a table.
    """
    if isinstance(written, Amplitude):
        return written
    if isinstance(written, str):
        return _from_text(written)
    if isinstance(written, list | tuple):
        return _from_table(written)
    raise InputError(f"{written!r} is not a curve", expected=_EXPECTED)


_EXPECTED = 'expected "ramp", "constant", a formula in t, or a table [[t, value], ...]'


def _from_text(text: str) -> Amplitude:
    if text in WORDS:
        return Amplitude(text)
    if text.isalpha() and text not in ("t", "pi", "e"):
        raise InputError(f"unknown curve '{text}'", expected=f"{nearest(text, WORDS)} {_EXPECTED}")
    return Amplitude(text, Formula.parse(text, allowed=("t",)))


def _from_table(rows: Any) -> Amplitude:
    if not rows or any(not isinstance(row, list | tuple) or len(row) != 2 for row in rows):
        raise InputError("a curve's table needs pairs [t, value]", expected=_EXPECTED)
    table = tuple((to_si(t, "s"), to_si(value, "")) for t, value in rows)
    times = [t for t, _ in table]
    if any(later <= earlier for earlier, later in pairwise(times)):
        raise InputError("the times of a curve's table must increase")
    return Amplitude(table)


def _written(value: Amplitude | None) -> Any:
    if value is None or isinstance(value.written, str):
        return value and value.written
    return [list(row) for row in value.written]


if TYPE_CHECKING:
    Curve = Amplitude
else:
    Curve = Annotated[Amplitude, BeforeValidator(amplitude), PlainSerializer(_written)]
