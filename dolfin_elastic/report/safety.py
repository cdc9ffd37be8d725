"""Verdicts on one part from several runs: strength, stability, frequencies, motion."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.si_text import counted, listed, number, quantity
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.report.words import analysis_of
from dolfin_elastic.results.finished import findings
from dolfin_elastic.results.finished.findings import Value
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.verdict import Table, verdict_of

_WORDS = {"good": "holds", "bad": "does not hold", "warn": "cannot be judged"}
_KINDS = {"holds": "good", "fails": "bad"}
_SECOND_ORDER = 10.0
"""Critical load factor from which on deflections need not be added to the shape of the part.

Source: EN 1993-1-1:2005, 5.2.1 (3), for elastic analysis.
"""
_SAME = 1e-6
"""Relative difference of volumes of one body."""
_REFINED = 0.01
"""Relative difference of volumes of one body in two meshes, which cut curved faces differently."""

Excitation = tuple[float, float]
"""Lowest and highest frequency of what shakes the part [Hz]."""


@dataclass(frozen=True)
class Judged:
    """A row of the table.

    Attributes:
        what: What is judged.
        run: Number of the run on the page, from 1.
        kind: "good", "warn" or "bad".
        text: Why, with figures.
        value: The number that decides.
    """

    what: str
    run: int
    kind: str
    text: str
    value: Value | None = None

    @property
    def verdict(self) -> str:
        """The kind in words."""
        return _WORDS[self.kind]


@dataclass(frozen=True)
class Safety:
    """What several runs say of one part.

    Attributes:
        kind: "good", "warn" or "bad": the worst of the rows, if the runs are of one part.
        text: One sentence.
        rows: The verdicts.
        same: What has been compared, and found to be the same.
        differences: What is not the same, so that there is no verdict on all of it.
    """

    kind: str
    text: str
    rows: tuple[Judged, ...]
    same: str
    differences: tuple[str, ...]


def safety_of(
    runs: Sequence[FinishedRun], names: Sequence[str], excitation: Excitation | None
) -> Safety:
    """Judges the runs one by one, and together if they are of one part.

    Args:
        names: Of each run, for people.
        excitation: None: frequencies are not judged.
    """
    second_order = any(_stable_with_large_strains(run) for run in runs)
    buckling = any(analysis_of(run.case) == "buckling" for run in runs)
    rows = tuple(
        row
        for count, run in enumerate(runs, 1)
        for row in _rows(run, count, excitation, second_order=second_order, buckling=buckling)
    )
    same, differences = compared(runs, names)
    by_kind = {kind: _named(rows, kind) for kind in _WORDS}
    kind = next((k for k in ("bad", "warn") if by_kind[k]), "good") if rows else "warn"
    parts = [f"{_WORDS[k]}: {by_kind[k]}" for k in ("bad", "warn", "good") if by_kind[k]]
    text = "; ".join(parts) or "there are no results"
    if differences:
        kind = "bad" if kind == "bad" else "warn"
        text = f"no verdict on one part, the runs differ; {text}"
    return Safety(kind, text[:1].upper() + text[1:], rows, same, differences)


def _named(rows: Sequence[Judged], kind: str) -> str:
    """Of the rows of a kind, what they judge; empty where there are none."""
    words = list(dict.fromkeys(row.what for row in rows if row.kind == kind))
    return listed(words) if words else ""


def _rows(
    run: FinishedRun,
    count: int,
    excitation: Excitation | None,
    *,
    second_order: bool,
    buckling: bool,
) -> Iterator[Judged]:
    summary, analysis = run.summary, analysis_of(run.case)
    verdict = verdict_of(summary)
    if summary.get("status") != "completed" or not (summary.get("steps") or summary.get("modes")):
        kind = _KINDS.get(verdict.kind, "warn") if verdict else "warn"
        text = _reason(verdict.text) if verdict else findings.status_of(summary)[0]
        yield Judged(_TITLES[analysis], count, kind, text)
    elif analysis == "buckling":
        yield _of_buckling(run, count, second_order=second_order)
    elif analysis == "modal":
        yield _of_modes(run, count, excitation)
    else:
        yield _of_stress(run, count, _TITLES[analysis])
        if analysis == "statics":
            yield from _of_equilibrium(summary, count, buckling=buckling)


_TITLES = {
    "statics": "strength",
    "buckling": "stability",
    "modal": "frequencies",
    "dynamics": "motion",
}


def _reason(text: str) -> str:
    """The text of a verdict without the word that it begins with."""
    return (
        text.partition(": ")[2] if text.startswith(("holds: ", "fails: ", "not known: ")) else text
    )


def _of_stress(run: FinishedRun, count: int, what: str) -> Judged:
    """The stress alone: stability has a row of its own."""
    summary, figures = run.summary, findings.key_figures(run)
    unstable = (summary.get("stability") or {}).get("verdict") == "unstable"
    alone = {**summary, "stability": {"verdict": "stable"}}
    verdict = verdict_of(alone)
    kind, text = (
        ("warn", "") if verdict is None else (_KINDS.get(verdict.kind, "warn"), verdict.text)
    )
    if verdict is not None and verdict.kind == "result":
        text = f"{text}; no allowable stress is given"
    text = _reason(text)
    if unstable:
        kind, text = "warn", f"of an unstable state: {text}"
    factor = figures.get("safety_factor")
    if what == _TITLES["dynamics"]:
        text += _farthest(run)
    shown = factor or figures.get("von_mises")
    return Judged(what, count, kind, text, shown.value if shown else None)


def _farthest(run: FinishedRun) -> str:
    """The largest displacement of a motion, with its time."""
    t, size = (run.history.get(name) for name in ("t", "max_displacement"))
    if t is None or size is None or not np.isfinite(size).any():
        return ""
    at = int(np.nanargmax(size))
    return f"; largest displacement {quantity(size[at], 'm')} at t = {quantity(t[at], 's')}"


def _of_equilibrium(summary: Table, count: int, *, buckling: bool) -> Iterator[Judged]:
    """Whether the state at the end of statics is stable; nothing where it cannot buckle."""
    stability = summary.get("stability") or {}
    verdict, reason = stability.get("verdict"), str(stability.get("reason") or "")
    if verdict == "unstable":
        yield Judged("stability", count, "bad", "the equilibrium is unstable, the part leaves it")
    elif verdict != "stable":
        why = reason or "no reason is given"
        yield Judged("stability", count, "warn", f"the equilibrium was not judged: {why}")
    elif "know no buckling" not in reason:
        text = "the equilibrium under the loads of this run is stable, with large displacements"
        yield Judged("stability", count, "good", text)
    elif not buckling:
        yield Judged("stability", count, "warn", f"{reason}, or add a run with [buckling]")


def _stable_with_large_strains(run: FinishedRun) -> bool:
    stability = run.summary.get("stability") or {}
    return (
        run.summary.get("status") == "completed"
        and stability.get("verdict") == "stable"
        and "know no buckling" not in str(stability.get("reason") or "")
        and float(run.summary.get("load_factor") or 0.0) >= 1.0
    )


def _of_buckling(run: FinishedRun, count: int, *, second_order: bool) -> Judged:
    values = [row.value for row in findings.modes_of(run) if row.value is not None]
    positive = [value for value in values if value.value > 0]
    if not positive:
        text = "it buckles under loads of the opposite sign only"
        return Judged("stability", count, "good", text)
    least = min(positive, key=lambda value: value.value)
    times = f"it buckles at {number(least.value, 3)} times the loads of this run"
    if least.value <= 1:
        return Judged("stability", count, "bad", times, least)
    if least.value >= _SECOND_ORDER:
        text = f"{times}; from {_SECOND_ORDER:g} on deflections add little to the loads' effect"
        return Judged("stability", count, "good", f"{text} (EN 1993-1-1, 5.2.1)", least)
    if second_order:
        text = f"{times}; that deflections add to the loads' effect is in the run of statics"
        return Judged("stability", count, "good", text, least)
    text = f"{times}, less than {_SECOND_ORDER:g}: deflections add to the loads' effect; add a run"
    text += " of [statics] with a law of large strains"
    return Judged("stability", count, "warn", text, least)


def _of_modes(run: FinishedRun, count: int, excitation: Excitation | None) -> Judged:
    modes, what = findings.modes_of(run), "frequencies"
    if any(row.kind == "unstable" for row in modes):
        return Judged(what, count, "bad", "the loaded part is unstable: it buckles")
    elastic = [(row, row.value) for row in modes if row.kind == "elastic" and row.value]
    if not elastic:
        return Judged(what, count, "warn", "all modes are motions of the rigid part")
    lowest = elastic[0][1]
    first = [f"{value.text} ({row.words})" for row, value in elastic[:3]]
    if excitation is None:
        text = f"{listed(first)}; no range of excitation is given (--excitation FROM TO)"
        return Judged(what, count, "warn", text, lowest)
    low, high = excitation
    span = f"{quantity(low, 'Hz')} to {quantity(high, 'Hz')}"
    inside = [(row, v) for row, v in elastic if low <= v.value <= high]
    if inside:
        hit = listed([f"mode {row.number}, {v.text} ({row.words})" for row, v in inside[:3]])
        more = f" and {len(inside) - 3} more" if len(inside) > 3 else ""
        return Judged(what, count, "bad", f"{hit}{more}: excited by {span}", inside[0][1])
    if (last := elastic[-1][1]).value < low or last.value <= high:
        text = f"excited by {span}, but modes are known up to {last.text} only: raise modal.count"
        return Judged(what, count, "warn", text, lowest)
    below = [v.text for _, v in elastic if v.value < low][-1:]
    above = next(v.text for _, v in elastic if v.value > high)
    near = f"{below[0]} lies below it, {above} above" if below else f"the lowest is {above}"
    return Judged(what, count, "good", f"no mode is excited by {span}: {near}", lowest)


# --- one part ---


def compared(runs: Sequence[FinishedRun], names: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    """What is the same in all runs, in a sentence, and what is not, each in one."""
    first, differences, refined = runs[0], list[str](), list[str]()
    for run, name in zip(runs[1:], names[1:], strict=True):
        found, finer = _mesh_difference(first, run)
        found += _material_differences(first.case, run.case)
        if first.case.get("support") != run.case.get("support"):
            found.append("the supports")
        if found:
            differences.append(f"‘{name}’ against ‘{names[0]}’: {listed(found)}")
        if finer:
            refined.append(f"‘{name}’ has another mesh of it: {finer}")
    if differences:
        return "", tuple(differences)
    summary, mesh = first.summary, first.model.get("mesh") or {}
    size = counted(int(summary.get("cells") or 0), "element")
    volume = mesh.get("volume")
    of = f", {quantity(float(volume), 'm^3')}" if isinstance(volume, int | float) else ""
    of = "" if mesh.get("dim") == 2 else of
    text = f"mesh of {size} of degree {summary.get('degree')}{of}, materials, supports"
    return "; ".join([text, *refined]), ()


def _mesh_difference(one: FinishedRun, two: FinishedRun) -> tuple[list[str], str]:
    """How bodies differ, and how meshes of one body do."""
    a, b = one.model.get("mesh") or {}, two.model.get("mesh") or {}
    cells = [int(run.summary.get("cells") or 0) for run in (one, two)]
    sizes = [float(m.get("volume") or math.nan) for m in (a, b)]
    extents = [[float(x) for x in m.get("extent") or ()] for m in (a, b)]
    limit = _SAME if cells[0] == cells[1] else _REFINED
    whole = max(extents[0], default=math.nan)
    same = len(extents[0]) == len(extents[1]) and all(
        abs(p - q) <= _REFINED * whole for p, q in zip(*extents, strict=True)
    )
    if not (same and abs(sizes[0] - sizes[1]) <= limit * abs(sizes[0])):
        unit = "m^2" if a.get("dim") == 2 else "m^3"
        given = " and ".join("unknown" if math.isnan(s) else quantity(s, unit) for s in sizes)
        return [f"the body (volumes {given})"], ""
    return [], "" if cells[0] == cells[1] else counted(cells[1], "element")


def _material_differences(one: Table, two: Table) -> list[str]:
    """Constants that two cases give one material, and materials that one of them has not."""
    a, b = (_materials(case) for case in (one, two))
    result = [
        f"the material ‘{name}’"
        for name in dict.fromkeys([*a, *b])
        if name not in a or name not in b
    ]
    for name in a.keys() & b.keys():
        keys = [
            key
            for key, value in a[name].items()
            if key != "allowable" and key in b[name] and b[name][key] != value
        ]
        if keys:
            result.append(f"{listed(sorted(keys))} of ‘{name}’")
    return result


def _materials(case: Table) -> dict[str, dict[str, object]]:
    """Names of materials to their constants, in SI units where they can be read."""
    tables = case.get("materials")
    rows = tables.items() if isinstance(tables, Mapping) else ()
    return {str(name): _constants(row) for name, row in rows if isinstance(row, Mapping)}


def _constants(row: Table) -> dict[str, object]:
    law = MATERIALS.get(str(row.get("law")))
    known = {key: value for key, value in row.items() if value is not None}
    if known.get("law") == "linear-elastic":  # the same at small strains
        known["law"] = "st-venant-kirchhoff"
    if law is None:
        return known
    keys = [key for key in known if key != "law" and key in law.model_fields]
    try:
        read = law.model_validate({key: row[key] for key in ["law", *keys]})
    except ValueError:  # made by another version, or by a stranger
        return known
    return known | {key: getattr(read, key) for key in keys}
