"""Records over time as values: forces, displacements, velocities and accelerations in tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dolfin_elastic.core.errors import InputError, keyed
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import unit_to_si
from dolfin_elastic.model.amplitude import Rows, table_of

RATES = ("m", "m/s", "m/s^2")
"""Units of a displacement and its derivatives."""
GRAVITY = 9.80665
"""Standard acceleration of gravity [m/s^2]."""


class RecordTable(dict[str, object]):
    """What a user wrote of a record in a file, with the rows of the file.

    Attributes:
        rows: Texts or numbers (time, value).
    """

    rows: Sequence[Sequence[float | str]]


class _RecordKeys(Record):
    """``{file = "quake.csv", time = "t", value = "ax", unit = "g"}`` or ``{table = [...]}``."""

    file: str = ""
    time: str = ""
    value: str = ""
    table: list[object] | None = None
    unit: str = ""


@dataclass(frozen=True)
class RecordFormula(Formula):
    """A record over time: a formula in t, linear between the rows.

    Velocities and accelerations are 0 before the first row and after the last; of all other
    quantities these rows hold.

    Attributes:
        rows: Time [s] and value [SI]; empty before the file has been read.
        integrals: How many times it is integrated over time, from rest: 0, 1 or 2.
        holds: The first and the last value hold outside of the rows.
    """

    rows: Rows
    integrals: int = 0
    holds: bool = True

    @classmethod
    def read(cls, written: Mapping[str, object], unit: str, integrals: int = 0) -> RecordFormula:
        """A record as a user wrote it.

        Args:
            unit: SI unit of its values.

        Raises:
            InputError: Unknown keys, no rows, or a unit or a row that does not fit.
        """
        if "field" in written:
            raise InputError(
                "a field of the mesh cannot stand here",
                expected="expected a number, a formula, or a record over time",
            )
        keys = _RecordKeys(**written)
        if bool(keys.file) == bool(keys.table):
            raise InputError(
                "a record needs a file or a table",
                expected='expected {file = "quake.csv", unit = "g"} or '
                '{table = [[0, 0], [0.1, 2.5]], unit = "m/s^2"}',
            )
        factor = 1.0
        if keys.unit:
            with keyed("unit"):
                g = unit == RATES[2] and keys.unit == "g"  # no gram
                factor = GRAVITY if g else unit_to_si(keys.unit, unit)
        given = keys.table if keys.table else getattr(written, "rows", None)
        rows: Rows = ()
        if given:
            with keyed("table" if keys.table else "file"):
                rows = tuple((t, factor * value) for t, value in table_of(given))
                if integrals and rows[0][0] < 0:
                    raise InputError(
                        f"the record begins at {rows[0][0]:g} s",
                        expected="times from 0 on: at t = 0 everything is at rest",
                    )
        holds = unit not in RATES[1:]
        name = keys.file or "table"
        return cls(f"record '{name}'", frozenset("t"), 0.0, rows, integrals, holds)

    @cached_property
    def _pieces(self) -> FloatArray:
        """Times, values, slopes behind them, first and second integrals, shape (5, rows)."""
        if not self.rows:
            raise InputError(
                "the record's file has not been read",
                expected="in Python, give {'table': [[t, value], ...]}; files are read with a case",
            )
        t, a = np.array(self.rows, dtype=np.float64).T
        h, zero = np.diff(t), np.zeros(1)
        slopes = np.append(np.diff(a) / h, 0.0)
        v = np.concatenate([zero, np.cumsum(h * (a[1:] + a[:-1]) / 2)])
        u = np.cumsum(v[:-1] * h + h**2 * (2 * a[:-1] + a[1:]) / 6)
        return np.stack([t, a, slopes, v, np.concatenate([zero, u])])

    def evaluate(self, **values: float | FloatArray) -> float | FloatArray:
        """See `Formula.evaluate`: the record at t, or its integral from rest."""
        time, a, slopes, v, u = self._pieces
        t = np.asarray(values["t"], dtype=np.float64)
        i = np.searchsorted(time, t, side="right") - 1
        before, after = i < 0, t > time[-1]
        s, i = np.where(before, 0.0, t - time[i]), np.maximum(i, 0)
        rate, slope = (np.where(after & (not self.holds), 0.0, x[i]) for x in (a, slopes))
        pieces = (
            rate + slope * s,
            v[i] + rate * s + slope * s**2 / 2,
            u[i] + v[i] * s + rate * s**2 / 2 + slope * s**3 / 6,
        )
        nothing = before & (bool(self.integrals) or not self.holds)
        result = np.where(nothing, 0.0, pieces[self.integrals])
        shape = np.broadcast_shapes(*(np.shape(value) for value in values.values()))
        return np.array(np.broadcast_to(result, shape)) if shape else float(result)

    @property
    def drift(self) -> tuple[float, float]:
        """Velocity [m/s] and displacement [m] at the end of a record of accelerations."""
        return float(self._pieces[3, -1]), float(self._pieces[4, -1])

    @property
    def fastest(self) -> float:
        """Largest velocity at the rows of a record of accelerations [m/s]."""
        return float(np.abs(self._pieces[3]).max())

    @property
    def spacing(self) -> float:
        """Mean time between rows [s]; infinite of a single one."""
        times = self._pieces[0]
        return float(np.ptp(times)) / (len(times) - 1) if len(times) > 1 else np.inf
