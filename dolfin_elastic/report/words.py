"""A case in plain words: what was computed.

The tables are those of the case file, in the units in which they were written.  They may come from
a stranger: every text is a value here, which the page escapes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from dolfin_elastic.case.described import Described, described_tables
from dolfin_elastic.core.si_text import given, listed, number, quantity
from dolfin_elastic.model.describe import Setting
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.verdict import Table, follows_curves, unloaded


def part_names(table: Table) -> list[str]:
    """Names of the parts that a support, load or material acts on."""
    on = table.get("on")
    return [str(part) for part in on] if isinstance(on, list) else [] if on is None else [str(on)]


def names(parts: Sequence[str]) -> str:
    """Parts in a sentence; none are the whole body."""
    return listed([f"‘{part}’" for part in parts]) if parts else "the whole body"


def small_strains(case: Table) -> bool:
    """Whether all materials are linear, so that all loads act on the undeformed body."""
    materials = case.get("materials")
    rows = list(materials.values()) if isinstance(materials, Mapping) else []
    laws = [row.get("law") if isinstance(row, Mapping) else None for row in rows]
    linear = [getattr(MATERIALS.get(str(law)), "linear", False) is True for law in laws]
    return bool(linear) and all(linear)


def rows_of(run: FinishedRun) -> tuple[Described, ...]:
    """The supports, loads, contacts and ties of a run."""
    parts = run.model.get("parts") or {}
    kinds = {str(name): str((row or {}).get("kind")) for name, row in parts.items()}
    setting = Setting(run.metres, small_strains(run.case), kinds)
    return described_tables(run.case, setting)


# --- the analysis ---

_GEOMETRIES = {
    "plane-strain": "in plane strain",
    "plane-stress": "in plane stress",
    "axisymmetric": "of revolution about y",
}


def analysis_of(case: Table) -> str:
    """The analysis: "statics", "dynamics", "modal" or "buckling"."""
    kinds = ("dynamics", "modal", "buckling")
    return next((kind for kind in kinds if case.get(kind) is not None), "statics")


def loads_act(case: Table) -> bool:
    """Whether loads act: natural frequencies are those of the unloaded part without a preload."""
    return analysis_of(case) != "modal" or bool((case.get("modal") or {}).get("preload"))


def what_was_computed(run: FinishedRun, *, dim: int | None) -> list[str]:
    """Sentences for somebody who knows nothing of the program; none without a case.

    Args:
        dim: Dimension of the body; None where that is not known.
    """
    case, summary = run.case, run.summary
    if not case:
        return []
    kind = analysis_of(case)
    return [
        _body_sentence(case, dim),
        *_acting_sentences(case, rows_of(run)),
        _TASKS[kind](case, summary),
        _mesh_sentence(case, summary, dim),
    ]


def _body_sentence(case: Table, dim: int | None) -> str:
    laws = [
        f"{name} ({table.get('law', 'a law')})"
        for name, table in case.get("materials", {}).items()
        if isinstance(table, Mapping)
    ]
    made = f" of {listed(laws)}" if laws else ""
    geometry = _GEOMETRIES.get(str(case.get("mesh", {}).get("geometry", "plane-strain")), "")
    shape = f" {geometry}" if dim == 2 else ""
    return f"An elastic body{shape}{made}."


def _acting_sentences(case: Table, rows: Sequence[Described]) -> list[str]:
    """What holds the body, acts on it and may touch it."""
    supports, loads, contacts = (
        [row for row in rows if row.key.startswith(f"{key}[")]
        for key in ("support", "load", "contact")
    )
    result = ["It is supported nowhere."]
    if case.get("periodic"):
        result = ["It is a periodic cell: its faces are tied to those opposite."]
    if supports:
        held = [f"{names(row.on)} ({row.text.partition(';')[0]})" for row in supports]
        at = f"at {listed(held)}" if len(held) <= 6 else f"by {len(held)} supports"
        result = [f"It is supported {at}."]
    if not loads_act(case):
        return result
    if len(loads) > 6:
        result.append(f"{len(loads)} loads act on it.")
    elif loads:
        acting = [f"a {_short(row.text)} on {names(row.on)}" for row in loads]
        result.append(f"On it {'acts' if len(acting) == 1 else 'act'} {listed(acting)}.")
    if contacts:
        result.append(f"Contact is possible at {listed([names(row.on) for row in contacts])}.")
    return result


def _short(text: str) -> str:
    """What stands before a comma or semicolon, but for those of vectors."""
    return re.split(r"[;,] (?![^(]*\))", text)[0]


def _statics(case: Table, summary: Table) -> str:
    steps = summary.get("steps") or 0
    grown = "in one step" if steps == 1 else f"in {steps} steps"
    text = "Equilibrium was computed at rest, with inertia left out"
    factor, asked = summary.get("load_factor"), (case.get("statics") or {}).get("end", 1.0)
    if factor is None or not summary.get("steps"):
        return f"{text}, but no step was reached."
    end = "; no load acts at the end" if unloaded(summary) else ""
    if summary.get("timed"):
        return f"{text}, {grown} up to t = {quantity(factor, 's')}{end}."
    if factor > 1.0 or follows_curves(case):  # curves say how large loads are then
        return f"{text}, {grown} up to the load parameter {number(factor)}{end}."
    full = asked == 1.0 and factor >= 1.0
    reached = "their full values" if full else f"{number(100 * factor)} % of their values"
    return f"{text}; the loads were raised {grown} to {reached}."


def _dynamics(case: Table, summary: Table) -> str:
    settings = case.get("dynamics") or {}
    scheme = f" by the scheme {settings['scheme']}" if settings.get("scheme") else ""
    t = summary.get("t")
    until = (
        f" up to {quantity(float(t), 's')} of {given(settings.get('end', ''), 's')}"
        if t is not None
        else ""
    )
    return f"Its motion was computed in {summary.get('steps') or 0} time steps{until}{scheme}."


def _modal(case: Table, summary: Table) -> str:
    count = len(summary.get("modes", []))
    under = ", under its loads" if (case.get("modal") or {}).get("preload") else ""
    return f"{count} natural frequencies and modes of vibration were computed{under}."


def _buckling(case: Table, summary: Table) -> str:
    count = len(summary.get("modes", []))
    return f"The factors on all loads at which it buckles were computed: {count} of them."


_TASKS = {"statics": _statics, "dynamics": _dynamics, "modal": _modal, "buckling": _buckling}


def _mesh_sentence(case: Table, summary: Table, dim: int | None) -> str:
    cells, dofs = summary.get("cells", 0), summary.get("dofs", 0)
    degree = {1: "linear", 2: "quadratic"}.get(summary.get("degree", 0), "finite")
    shape = {2: "triangles", 3: "tetrahedra"}.get(dim or 0, "elements")
    return f"The method is that of finite elements: {cells} {degree} {shape}, {dofs} unknowns."
