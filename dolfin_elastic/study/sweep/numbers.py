"""The numbers of a run that a sweep tells, from the files of its results."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from dolfin_elastic.case.case import Case
from dolfin_elastic.results.fields import FIELDS
from dolfin_elastic.results.finished.findings import extremes_of, modes_of
from dolfin_elastic.results.finished.run import BEGINNINGS, FinishedRun, column_unit
from dolfin_elastic.results.verdict import ELSEWHERE, doubt, reliable
from dolfin_elastic.study.wanted import Wanted

_UNITS = {"von_mises": "Pa", "displacement": "m", "safety_factor": "", "seconds": "s"}
_FIRST = ("safety_factor", "von_mises", "displacement")
NO_RESULT = "this run has no such result"
UNKNOWN_ERROR = "its error is not known: "
_COLUMNS = {
    *("displacement", "external_work", "max_displacement", "balance_force", "balance_moment"),
    *("min_jacobian", "max_jacobian", "inverted_cells", "max_plastic_strain", "yielded_fraction"),
}
_ENERGIES = {
    *("strain", "kinetic", "external", "total", "relaxing", "remembered", "springs", "contact"),
    *("damping", "bulk_viscosity", "dashpots", "friction", "potential", "balance", "dissipated"),
}
_NUMBERED = {"frequency": "modal", "load_factor": "buckling"}
_OF_VECTOR, _OF_TENSOR = re.compile(r"_[ru]?[xyz]$"), re.compile(r"_[xyz]{1,2}$")
_MODES = 3
"""Modes that are told unless others are asked for."""


@dataclass(frozen=True)
class Known:
    """What runs in some folders tell.

    Attributes:
        numbers: Name to value, SI units: extremes, modes, probes, last row of history.csv.
        errors: Name to estimated relative error of the mesh, nan where it is not known.
        usual: Names that are told where none is asked for: the values by which a part is judged,
            the first modes, and the probes and other results that the case asks for.
        remarks: Name to what a peak leaves out, or why its error is not known.
        failure: Why the audit of one fails; empty where none does.
    """

    numbers: dict[str, float] = field(default_factory=dict)
    errors: dict[str, float] = field(default_factory=dict)
    usual: list[str] = field(default_factory=list)
    remarks: dict[str, str] = field(default_factory=dict)
    failure: str = ""


def known_of(folders: Sequence[Path]) -> Known:
    """What the analyses of a case tell, of one name the first. Not collective.

    Raises:
        InputError: One is no folder of results.
    """
    numbers, errors, usual, failure = dict[str, float](), dict[str, float](), list[str](), ""
    remarks = dict[str, str]()
    for folder in folders:
        run = FinishedRun(folder)
        summary = run.summary
        audit = summary.get("audit") or {}
        failure = failure or ("; ".join(audit["reasons"]) if audit.get("verdict") == "fail" else "")
        own = {name: _number(value) for name, value in (summary.get("numbers") or {}).items()}
        extremes, trust, doubts = _extremes(run)
        modes = {
            f"{'load_factor' if mode.kind == 'buckling' else 'frequency'}_{mode.number}": value
            for mode in modes_of(run)
            if (value := None if mode.value is None else mode.value.value) is not None
        }
        last = {name: float(column[-1]) for name, column in run.history.items() if len(column)}
        told = [*(name for name in _FIRST if name in extremes), *list(modes)[:_MODES], *own]
        usual += [name for name in told if name not in numbers]
        known = set(numbers)
        numbers = {**last, **own, **extremes, **modes, **numbers}
        errors |= {name: value for name, value in trust.items() if name not in known}
        remarks |= {name: text for name, text in doubts.items() if name not in known}
        if modes:
            remarks[next(iter(modes))] = "the error of the mesh is not estimated for modes"
    return Known(numbers, errors, usual, remarks, failure)


def _extremes(run: FinishedRun) -> tuple[dict[str, float], dict[str, float], dict[str, str]]:
    """Extremes by which a part is judged, their errors (nan: not known), and remarks on them."""
    summary, errors, remarks = run.summary, dict[str, float](), dict[str, str]()
    peaks = summary.get("motion") or summary.get("error") or {}
    numbers = {row.key: row.value.value for row in reversed(extremes_of(summary))}
    for name in ELSEWHERE:
        peak = reliable(peaks, name, summary.get("extremes") or {})
        if peak is None or not isinstance(peak.get("value"), int | float):
            continue
        numbers[name] = float(peak["value"])
        errors[name] = math.nan if doubt(peak) else _number(peak.get("error"))
        if why := doubt(peak):
            remarks[name] = f"{UNKNOWN_ERROR}{why}"
        elif apart := peak.get("apart"):
            which = "smallest" if name == "safety_factor" else "largest"
            remarks[name] = f"not at {apart}, where it is singular: the {which} elsewhere"
    return numbers, errors, remarks


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


def may_have(case: Case, name: str) -> bool:
    """Whether a run of a case may have a result, by the names in the case. Not collective.

    Columns of `history.csv` appear with what they are of: a support, a probe, friction, a law that
    relaxes; and only so many modes are found.
    """
    if name in _COLUMNS or name in FIELDS or name.removesuffix("_energy") in _ENERGIES:
        return True
    kind, _, number = name.rpartition("_")
    if kind in _NUMBERED and number.isdigit():
        return getattr(case, _NUMBERED[kind]) is not None
    words = {*_words(case.to_dict()), *(support.label for support in case.support)}
    stem = _OF_VECTOR.sub("", name)
    if stem != name and stem in words:  # the displacement of a probe
        return True
    begins = [*BEGINNINGS, "smallest_distance_"]
    if f"{stem}_" in begins or any(stem == f"{of}{part}" for of in begins for part in words):
        return True
    pieces = _OF_TENSOR.sub("", name).split("_")
    splits = (("_".join(pieces[:n]), "_".join(pieces[n:])) for n in range(1, len(pieces)))
    return any(part in words and rest in FIELDS for part, rest in splits)


def _words(value: object) -> Iterator[str]:
    """All keys and texts in tables."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield str(key)
            yield from _words(inner)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _words(inner)
    elif isinstance(value, str):
        yield value


def unit_of(name: str) -> str:
    """SI unit of a result by its name; empty of a pure number."""
    if name in _UNITS:
        return _UNITS[name]
    if name.startswith("frequency_"):
        return "Hz"
    if name.isidentifier():
        return column_unit(name, timed=True)
    return Wanted.read(name, "--tell").unit
