"""What a finished run has found, in words: its end, largest values with their errors, modes, mesh.

All of it follows from `summary.json`, whose types `FinishedRun` has checked, see `SUMMARY`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from dolfin_elastic.core.si_text import percent, quantity
from dolfin_elastic.results.verdict import (
    ELSEWHERE,
    Table,
    doubt,
    factor_text,
    mode_text,
    place_text,
    reliable,
)

if TYPE_CHECKING:
    from dolfin_elastic.results.finished.run import FinishedRun

_GOOD = 0.1
"""Estimated error of the largest stress up to which a mesh is good."""


@dataclass(frozen=True)
class Value:
    """A number of `summary.json` as it is shown.

    Attributes:
        value: In SI units, as it is there.
        text: For people.
    """

    value: float
    text: str

    @staticmethod
    def of(value: object, unit: str = "") -> Value | None:
        """None of what is no number.

        Args:
            unit: Its SI unit.
        """
        if isinstance(value, bool) or not isinstance(value, int | float):
            return None
        return Value(float(value), quantity(float(value), unit))


@dataclass(frozen=True)
class Extreme:
    """A largest or smallest value with its place.

    Attributes:
        key: Its name in `summary.json`.
        name: Of what.
        value: The value.
        place: Where, for people.
        trust: How well it is known; empty: that is not known.
        remark: What limits it.
        singular: It has no finite value there, and another row has the one to judge by.
    """

    key: str
    name: str
    value: Value
    place: str
    trust: str = ""
    remark: str = ""
    singular: bool = False


# --- how it ended ---

STATUS = {
    "completed": ("Completed", "good"),
    "stopped": ("Stopped before its end", "warn"),
    "failed": ("Failed: no solution was found", "bad"),
    "running": ("Still running, or killed", "warn"),
}


def status_of(summary: Table) -> tuple[str, str]:
    """Words and kind ("good", "warn", "bad") of how a run has ended."""
    return STATUS.get(str(summary.get("status")), ("Its end is not known", "warn"))


# --- largest values ---

_EXTREMES = {
    "displacement": ("largest displacement", "m"),
    "von_mises": ("largest von Mises stress", "Pa"),
    "safety_factor": ("smallest safety factor", ""),
    "speed": ("largest speed", "m/s"),
    "velocity": ("largest velocity", "m/s"),
    "min_jacobian": ("most compressed element", "of its volume"),
    "max_jacobian": ("most expanded element", "of its volume"),
    "contact_pressure": ("largest contact pressure", "Pa"),
}
_LAST, _SINGULAR = " at the end", ", singular"
"""What the name of a value adds if it is that of the last state, or has a regular one beside it."""


def extremes_of(summary: Table) -> list[Extreme]:
    """The largest values of all states of a motion, then of the last state; none before a step."""
    result: list[Extreme] = []
    if not summary.get("steps"):
        return result
    motion, error = summary.get("motion") or {}, summary.get("error") or {}
    when = _LAST if motion else ""
    for name, row in (summary.get("extremes") or {}).items():
        if worst := motion.get(name):
            result += _extremes(summary, name, worst, motion)
        result += _extremes(summary, name, row, error, when)
    return result


def _extremes(
    summary: Table, name: str, row: Table, peaks: Table, when: str = ""
) -> Iterator[Extreme]:
    """A largest value; where it is singular, after the largest one elsewhere.

    Args:
        peaks: What is known of it, and of the one elsewhere.
        when: Of which state it is; empty: of all, or of the only one.
    """
    title, unit = _EXTREMES.get(name, (str(name).replace("_", " "), ""))
    several = len((summary.get("case") or {}).get("materials") or ()) != 1
    title, value = f"{title}{when}", _value_of(name, row, unit)
    if value is None:
        return
    peak, other = (peaks.get(key) or {} for key in (name, ELSEWHERE.get(name, "")))
    peak = peak if peak.get("value") == row.get("value") else {}
    here = row if several else {**row, "part": ""}
    where, singular = _place(here, peak, summary), bool(peak.get("singular"))
    trust = _trust(peak) if peak else ("", "")
    mine = Extreme(name, title, value, where, *trust, singular)
    if (regular := _value_of(name, other, unit)) is not None:
        where = _place(other if several else {**other, "part": ""}, other, summary)
        yield Extreme(name, title, regular, where, *_trust(other))
        mine = replace(mine, name=f"{title}{_SINGULAR}")
    yield mine


def _value_of(name: str, row: Table, unit: str) -> Value | None:
    value = Value.of(row.get("value"), unit)
    bounded = value and name == "safety_factor"
    return replace(value, text=factor_text(value.value)) if value and bounded else value


def lines_of_motion(summary: Table) -> list[str]:
    """Largest von Mises stresses and smallest safety factors of a motion, for people."""
    return [
        f"{row.name:<36} {row.value.text} at {row.place}"
        for row in extremes_of(summary)
        if row.key in ELSEWHERE and row.value.value > 0
    ]


def _trust(peak: Table) -> tuple[str, str]:
    """Estimated error and remark of a peak, in the words of the verdict."""
    why = doubt(peak)
    remark = f"{why[:1].upper()}{why[1:]}"
    if peak.get("singular"):
        text = f"Singular at {peak['singular']}: it depends on the size of the elements alone"
        return "no finite value", text
    error = peak.get("error")
    if isinstance(error, int | float):
        return f"± {percent(error)}", remark
    # Runs before this was recorded know neither.
    return ("not known", remark) if "unresolved" in peak else ("", "")


def _place(row: Table, peak: Table, summary: Table) -> str:
    part = f", in ‘{row['part']}’" if row.get("part") else ""
    on = f", on ‘{peak['surface']}’" if peak.get("surface") else ""
    t = row.get("t")
    when = f", t = {quantity(float(t), 's')}" if isinstance(t, int | float) else ""
    return place_text(row, summary) + part + on + when


def mesh_badge(summary: Table) -> tuple[str, str]:
    """How well the mesh gives the largest stress, and its kind; see `status_of`."""
    error = summary.get("error")
    peak = reliable(error, "von_mises", {}) if isinstance(error, Mapping) else None
    if peak is None:
        return "Mesh: error not estimated", "warn"
    if doubt(peak) or not isinstance(known := peak.get("error"), int | float):
        return "Mesh: largest stress not known", "bad"
    return f"Mesh: largest stress ± {percent(known)}", "good" if known <= _GOOD else "warn"


@dataclass(frozen=True)
class KeyFigure:
    """What a reader looks for first.

    Attributes:
        name: Of what.
        value: The value.
        trust: How well it is known; empty: that is not known.
        remark: Where, or the shape of a mode.
        other: What is singular.
        kind: "bad" of what fails.
    """

    name: str
    value: Value
    trust: str = ""
    remark: str = ""
    other: str = ""
    kind: str = ""


def key_figures(run: FinishedRun) -> dict[str, KeyFigure]:
    """Largest values by which a part is judged, each by its key in the summary, and first modes."""
    rows, result = extremes_of(run.summary), dict[str, KeyFigure]()
    for key in ("safety_factor", "von_mises", "displacement"):
        every = [row for row in rows if row.key == key]
        mine = [row for row in every if _LAST not in row.name] or every
        mine.sort(key=lambda row: row.singular)
        for row in mine[:1]:
            other = "".join(f"{o.value.text} at {o.place}: singular" for o in mine[1:])
            bad = key == "safety_factor" and row.value.value < 1
            kind = "bad" if bad else ""
            result[key] = KeyFigure(row.name, row.value, row.trust, row.place, other, kind)
    for mode in modes_of(run)[:3]:
        if mode.value is not None:
            name = f"{mode.quantity} {mode.number}"
            result[name] = KeyFigure(name, mode.value, remark=mode.words)
    return result


# --- modes ---


@dataclass(frozen=True)
class ModeRow:
    """A mode.

    Attributes:
        number: 1, 2, ...
        kind: Of the mode.
        words: Its shape, and how much of the mass it moves.
        value: Frequency, or load factor.
        shares: Direction to share of the effective mass, for people.
    """

    number: int
    kind: str
    words: str
    value: Value | None
    shares: tuple[tuple[str, str], ...]

    @property
    def quantity(self) -> str:
        """What its value is."""
        return "load factor of buckling" if self.kind == "buckling" else "frequency"


def modes_of(run: FinishedRun) -> list[ModeRow]:
    """The modes of a run."""
    result, whole = [], run.summary.get("whole") or {}
    for row in run.summary.get("modes") or []:
        key, unit = ("load_factor", "") if row.get("kind") == "buckling" else ("frequency", "Hz")
        shares = [
            (axis, percent(float(row.get(f"effective_{axis}") or 0.0) / mass))
            for axis, mass in whole.items()
            if mass and math.isfinite(mass)
        ]
        kind, value = str(row.get("kind", "")), Value.of(row.get(key), unit)
        words = mode_text(row, whole) or kind
        result.append(ModeRow(int(row.get("mode", 0)), kind, words, value, tuple(shares)))
    return result
