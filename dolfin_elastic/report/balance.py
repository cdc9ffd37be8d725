"""Supports, loads and the balance of forces of a finished run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.report.contents import Value
from dolfin_elastic.report.quantity import size as size_text
from dolfin_elastic.report.quantity import vector
from dolfin_elastic.report.words import (
    Table,
    contact_words,
    label,
    load_words,
    names,
    part_kind,
    part_names,
    small_strains,
    support_words,
)
from dolfin_elastic.results.finished.run import FinishedRun

_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Acting:
    """A support, load or contact.

    Attributes:
        name: The parts it acts on.
        key: Of its colour in pictures; empty: it is not drawn.
        words: What it does.
        size: Area of its surfaces, if the run has noted it.
        force: Its resultant or reaction, for people.
        moment: Its moment, and the point of reference, for people.
    """

    name: str
    key: str
    words: str
    size: str = ""
    force: str = ""
    moment: str = ""


def supports_of(run: FinishedRun) -> list[Acting]:
    """What holds the body, with the reactions and moments of the last state."""
    reactions = run.summary.get("reactions") or {}
    most = max((abs(x) for row in reactions.values() for x in row), default=0.0)

    def acting(row: Table, key: str, words: str) -> Acting:
        force = reactions.get(label(row))
        text = vector(force, "N", most) if force else ""
        return Acting(_where(row), key, words, _area(run, row), text, _moment(run, row, most))

    found = [
        acting(row, f"support {k}", support_words(row, part_kind(row, run.summary)))
        for k, row in enumerate(_rows(run.case, "support"))
    ]
    return found + [
        acting(row, "", contact_words(row, run.metres)) for row in _rows(run.case, "contact")
    ]


def _moment(run: FinishedRun, row: Table, force: float) -> str:
    """The moment of a support, with its point of reference; empty of older runs.

    Args:
        force: The largest reaction [N]: its moment about the end of the body is not small.
    """
    moments = run.summary.get("moments") or {}
    if not (found := moments.get(label(row))):
        return ""
    size = max((run.model.get("mesh") or {}).get("extent") or [0.0])
    most = max(abs(x) for one in moments.values() for x in one["moment"])
    about = vector(found["about"], "m", size)
    return f"{vector(found['moment'], 'N m', max(most, force * size))} about {about}"


def _where(table: Table) -> str:
    """The parts that a support or contact acts on, after its own name."""
    return f"{table['name']}: {names(table)}" if table.get("name") else names(table)


def loads_of(run: FinishedRun) -> list[Acting]:
    """What acts on the body, with its resultants."""
    sums = run.model.get("loads") or []
    found, fixed = [], small_strains(run.case)
    for k, row in enumerate(_rows(run.case, "load")):
        force = next(
            (s.get("force") for s in sums if str(s.get("load", "")).startswith(f"load[{k}]")), None
        )
        text = vector(force, "N") if force else ""
        words = load_words(row, fixed=fixed)
        found.append(Acting(names(row), f"load {k}", words, _area(run, row), text))
    return found


def _rows(case: Table, key: str) -> list[Table]:
    rows = case.get(key) or []
    return [row for row in rows if isinstance(row, Mapping)] if isinstance(rows, list) else []


def _area(run: FinishedRun, table: Table) -> str:
    parts = run.model.get("parts") or {}
    on = table.get("on")
    on = on if isinstance(on, list) else [on]
    areas = [a for name in on if (a := (parts.get(name) or {}).get("area")) is not None]
    if not areas or len(areas) != len(on):
        return ""
    plane = (run.model.get("mesh") or {}).get("dim") == 2
    return f"length {size_text(sum(areas), 1)}" if plane else f"area {size_text(sum(areas), 2)}"


@dataclass(frozen=True)
class Balance:
    """Loads against reactions of a body at rest.

    Attributes:
        rows: Name and force of each.
        force: The audit's measure: what is left of all forces, relative; None: not audited.
        moment: The same of moments.
        remark: What the comparison does not show.
    """

    rows: tuple[tuple[str, str], ...]
    force: Value | None
    moment: Value | None
    remark: str


def balance_of(run: FinishedRun) -> Balance | None:
    """Loads against reactions; None where there are neither, or no step was reached.

    The forces of ties act inside the body.  Round the axis of a body of revolution radial forces
    balance by themselves: only the axial ones are compared.
    """
    if not run.summary.get("steps"):
        return None
    summary, rows = run.summary, []
    inside = {
        str(row.get("name") or f"tie_{'+'.join(part_names(row))}") for row in _rows(run.case, "tie")
    }
    reactions = {
        k: v
        for k, v in (summary.get("reactions") or {}).items()
        if isinstance(v, list) and k not in inside
    }
    sums = [s for s in run.model.get("loads") or [] if s.get("force") is not None]
    own = [s for s in sums if s.get("load") != "all loads"]
    whole = next((s["force"] for s in sums if s.get("load") == "all loads"), None)
    if whole is None and len(own) == 1 == len(_rows(run.case, "load")):
        whole = own[0]["force"]
    total = _sum(list(reactions.values()))
    most = max(
        (abs(x) for row in (*reactions.values(), *(s["force"] for s in own)) for x in row),
        default=0.0,
    )
    ended = summary.get("status") == "completed"
    if whole is not None:
        when = "" if ended else " at their full values"
        rows.append((f"all loads{when}, on the undeformed body", vector(whole, "N", most)))
    if total is not None:
        rows.append(("all reactions", vector(total, "N", most)))
    audit = summary.get("audit") or {}
    at_rest = ended and not run.moving
    if at_rest and whole is not None and total is not None and len(whole) == len(total):
        left = [a + b for a, b in zip(whole, total, strict=True)]
        title = "loads and reactions together"
        if str((run.case.get("mesh") or {}).get("geometry")) == "axisymmetric":
            left, title = left[1:], f"{title}, along the axis"
        rows.append((title, vector(left, "N", most)))
    if not rows:
        return None
    return Balance(
        tuple(rows),
        Value.of(audit.get("balance_force")),
        Value.of(audit.get("balance_moment")),
        _balance_remark(run),
    )


def _balance_remark(run: FinishedRun) -> str:
    if run.moving:
        return (
            "In motion reactions contain the inertia of the body, and need not cancel the loads; "
            "the audit counts it in."
        )
    follows = {"pressure", "cavity", "centrifugal"}
    if not small_strains(run.case) and any(
        row.get("kind") in follows for row in _rows(run.case, "load")
    ):
        return (
            "A load that follows the deformed surface has another resultant there than on the "
            "undeformed one: where deformations are large, look at the audit's figure."
        )
    return ""


def _sum(rows: Sequence[Sequence[float]]) -> list[float] | None:
    if not rows or len({len(row) for row in rows}) != 1:
        return None
    return [float(x) for x in np.sum(np.array(rows, dtype=float), axis=0)]
