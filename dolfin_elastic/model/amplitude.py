"""Amplitude over time: the factor of a load or of a prescribed displacement.

In statics "time" is the load parameter, from 0 (nothing) to 1 (everything).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import BeforeValidator, PlainSerializer

from dolfin_elastic.core.errors import InputError, nearest
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.schema import AlreadyRead
from dolfin_elastic.core.units import to_si

Rows = tuple[tuple[float, float], ...]


def smoothstep(s: float) -> float:
    """From 0 to 1 between s = 0 and 1 with no slope at both: 3 s^2 - 2 s^3."""
    s = min(max(s, 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


WORDS: dict[str, Callable[[float], float]] = {
    "ramp": lambda t: min(max(t, 0.0), 1.0),
    "constant": lambda t: 1.0,
    "smooth": smoothstep,
    "load-unload": lambda t: min(max(1.0 - abs(2.0 * t - 1.0), 0.0), 1.0),
}
"""Curves with a name."""


@dataclass(frozen=True)
class CurveFile:
    """A curve in a CSV file, which is read with the case.

    Attributes:
        file: Its path, relative to the case file's folder.
        time: Heading of the column of times [s]; empty: the first column.
        value: Heading of the column of values; empty: the second column.
    """

    file: str
    time: str = ""
    value: str = ""


@dataclass(frozen=True)
class Amplitude:
    """A factor that is a function of time.

    Attributes:
        written: As the user wrote it: one of `WORDS`, a formula in t, or a table of pairs
            (t, value); "file" where a file says it.
        formula: The formula, if it is one.
        smooth: The table is interpolated by smooth steps in place of straight lines.
        source: The file of the table.
        rows: The table read from `source`; empty before.
        function: A function of the time, or load parameter, of a program; the same on all ranks.
    """

    written: str | Rows
    formula: Formula | None = None
    smooth: bool = False
    source: CurveFile | None = None
    rows: Rows = field(default=())
    function: Callable[[float], float] | None = None

    def at(self, t: float) -> float:
        """Value at time t [s], or at load parameter t in statics.

        Raises:
            InputError: The curve's file has not been read.
        """
        if self.function is not None:
            return float(self.function(t))
        if self.formula is not None:
            return float(self.formula.evaluate(t=t))
        if isinstance(self.written, str) and self.source is None:
            return WORDS[self.written](t)
        return self._in_table(t)

    def of(self, own: Amplitude | None, t: float) -> float:
        """Factor of something whose curve may be its own, where this is the default."""
        return (own or self).at(t)

    def _in_table(self, t: float) -> float:
        rows = self.table
        if not rows:
            raise InputError("the curve's file has not been read", expected=_READ)
        times, values = (np.array(column) for column in zip(*rows, strict=True))
        if not self.smooth or not times[0] < t < times[-1]:
            return float(np.interp(t, times, values))
        i = int(np.searchsorted(times, t, side="right"))
        step = smoothstep((t - times[i - 1]) / (times[i] - times[i - 1]))
        return float(values[i - 1] + step * (values[i] - values[i - 1]))

    @property
    def table(self) -> Rows:
        """Rows (t, value) of the table, given or from a file; empty for a word or a formula."""
        return self.rows if self.source else () if isinstance(self.written, str) else self.written

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times [s] between which the amplitude is smooth; empty for a formula."""
        if self.written == "load-unload":
            return (0.0, 0.5, 1.0)
        rows = self.rows if self.source else self.written
        return () if isinstance(rows, str) else tuple(t for t, _ in rows)

    @property
    def is_formula(self) -> bool:
        """It is a formula in t or a function, which may oscillate between any two times."""
        timed = self.formula is not None and self.formula.names == frozenset({"t"})
        return timed or self.function is not None

    def with_rows(self, rows: Sequence[Sequence[float | str]]) -> Amplitude:
        """The same amplitude with the rows of its file.

        Raises:
            InputError: The rows are no table of a curve.
        """
        return replace(self, rows=table_of(rows))


@dataclass(frozen=True)
class Share(Amplitude):
    """A default that multiplies other curves, too: so much of everything that acts at a time.

    Attributes:
        share: The factor.
    """

    share: float = 1.0

    def of(self, own: Amplitude | None, t: float) -> float:
        """See `Amplitude`."""
        return self.share * (own or CONSTANT).at(t)


RAMP, CONSTANT = Amplitude("ramp"), Amplitude("constant")
PROPORTIONAL = Amplitude("t", Formula.parse("t", allowed=("t",)))
"""The load factor itself, also above 1 and below 0."""


def amplitude(written: object) -> Amplitude:
    """Reads an amplitude from what a user wrote.

    Raises:
        InputError: Neither a known word, nor a formula in t, nor a table, nor where there is one.
    """
    if isinstance(written, Amplitude):
        return written
    if callable(written):
        return Amplitude(getattr(written, "__name__", "function"), function=written)
    if isinstance(written, str):
        return _from_text(written)
    if isinstance(written, list | tuple):
        return Amplitude(table_of(written))
    if isinstance(written, Mapping):
        return _from_keys(written)
    raise InputError(f"{written!r} is not a curve", expected=_EXPECTED)


_EXPECTED = (
    "expected "
    + ", ".join(f'"{word}"' for word in WORDS)
    + ", a formula in t, a table [[t, value], ...], {smooth = [[t, value], ...]}, "
    'or {file = "a.csv"}'
)
_READ = "in Python, give the table as [[t, value], ...]; files are read with a case file"


def _from_text(text: str) -> Amplitude:
    if text in WORDS:
        return Amplitude(text)
    word = text.replace("-", "")
    if word.isalpha() and not {*text.split("-")} <= {"t", "pi", "e"}:
        raise InputError(f"unknown curve '{text}'", expected=f"{nearest(text, WORDS)} {_EXPECTED}")
    return Amplitude(text, Formula.parse(text, allowed=("t",)))


def table_of(rows: Sequence[Any]) -> Rows:
    """Rows (t, value) of numbers, or texts with units, as numbers [s, 1].

    Raises:
        InputError: They are no pairs, or the times do not increase.
    """
    if not rows or any(not isinstance(row, list | tuple) or len(row) != 2 for row in rows):
        raise InputError("a curve's table needs pairs [t, value]", expected=_EXPECTED)
    table = tuple((to_si(t, "s"), to_si(value, "")) for t, value in rows)
    times = [t for t, _ in table]
    if any(later <= earlier for earlier, later in pairwise(times)):
        raise InputError(
            "the times of a curve's table must increase", expected="a jump takes a short time"
        )
    return table


def _from_keys(keys: Mapping[str, object]) -> Amplitude:
    known = ("smooth",) if "smooth" in keys else ("file", "time", "value")
    for key in keys:
        if key not in known:
            raise InputError(f"unknown key '{key}'", expected=nearest(str(key), known))
    if "smooth" in keys:
        if not isinstance(keys["smooth"], list | tuple):
            raise InputError(
                "a curve's table needs pairs [t, value]",
                where="smooth",
                expected="for example [[0, 0], [1, 1]]",
            )
        return Amplitude(table_of(keys["smooth"]), smooth=True)
    texts = {key: text for key, text in keys.items() if isinstance(text, str) and text}
    for key, value in keys.items():
        if key not in texts:
            raise InputError(f"{value!r} is wrong", where=key, expected="expected a text")
    if "file" not in keys:
        raise InputError("this key is missing", where="file", expected=_EXPECTED)
    return Amplitude("file", source=CurveFile(**texts))


def _written(value: Amplitude | None) -> Any:
    if value is None:
        return None
    if value.source is not None:
        return {name: text for name, text in vars(value.source).items() if text}
    if isinstance(value.written, str):
        return value.written
    rows = [list(row) for row in value.written]
    return {"smooth": rows} if value.smooth else rows


if TYPE_CHECKING:
    Curve = Amplitude
else:
    Curve = Annotated[AlreadyRead[Amplitude], BeforeValidator(amplitude), PlainSerializer(_written)]
