"""Supports, loads and the balance of forces of a finished run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.case.described import Described
from dolfin_elastic.core.si_text import size as size_text
from dolfin_elastic.core.si_text import vector
from dolfin_elastic.report.words import loads_act, names, rows_of
from dolfin_elastic.results.finished.findings import Value
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.verdict import follows_curves, parameter_text


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
    return [
        Acting(
            _where(row),
            _colour(row, "support"),
            row.text,
            _area(run, row),
            vector(force, "N", most) if (force := reactions.get(row.label)) else "",
            _moment(run, row.label, most),
        )
        for row in rows_of(run)
        if not row.key.startswith("load")
    ]


def _where(row: Described) -> str:
    """Its parts, after its own name."""
    own = row.label.removeprefix("tie_") != "+".join(row.on)
    return f"{row.label}: {names(row.on)}" if own else names(row.on)


def _moment(run: FinishedRun, label: str, force: float) -> str:
    """The moment of a support, with its point of reference; empty of older runs.

    Args:
        force: The largest reaction [N]: its moment about the end of the body is not small.
    """
    rows = (run.summary.get("moments") or {}).items()
    moments = {name: one for name, one in rows if "moment" in one and "about" in one}
    if not (moment := moments.get(label)):
        return ""
    size = max((run.model.get("mesh") or {}).get("extent") or [0.0])
    most = max(abs(x) for one in moments.values() for x in one["moment"])
    about = vector(moment["about"], "m", size)
    return f"{vector(moment['moment'], 'N m', max(most, force * size))} about {about}"


def loads_of(run: FinishedRun) -> list[Acting]:
    """What acts on the body in this analysis, with its resultants."""
    forces = _resultants(run)
    return [
        Acting(
            names(row.on),
            _colour(row, "load"),
            row.text,
            _area(run, row),
            vector(forces[row.key], "N") if row.key in forces else "",
        )
        for row in rows_of(run)
        if row.key.startswith("load") and loads_act(run.case)
    ]


def _colour(row: Described, key: str) -> str:
    """Key of a colour, "load 0"; empty: it is not drawn."""
    name, _, number = row.key.rstrip("]").partition("[")
    return f"{name} {number}" if name == key else ""


def _resultants(run: FinishedRun) -> dict[str, list[float]]:
    """Key of a load to its force, where that is known."""
    sums = run.model.get("loads") or []
    return {str(s["load"]).partition(" ")[0]: s["force"] for s in sums if s.get("force")}


def _area(run: FinishedRun, row: Described) -> str:
    parts = run.model.get("parts") or {}
    areas = [a for name in row.on if (a := (parts.get(name) or {}).get("area")) is not None]
    if not areas or len(areas) != len(row.on):
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

    The forces of ties, and between two surfaces, act inside the body.  Round the axis of a body of
    revolution radial forces balance by themselves: only the axial ones are compared.
    """
    if not run.summary.get("steps"):
        return None
    summary, rows, given = run.summary, list[tuple[str, str]](), rows_of(run)
    contacts = run.case.get("contact") or []
    inner = {f"contact[{i}]" for i, one in enumerate(contacts) if one.get("between")}
    inside = {row.label for row in given if row.key.startswith("tie") or row.key in inner}
    reactions = {
        k: v
        for k, v in (summary.get("reactions") or {}).items()
        if isinstance(v, list) and k not in inside
    }
    sums = [s for s in run.model.get("loads") or [] if s.get("load") != "all loads"]
    forces = [force for s in sums if (force := s.get("force"))]
    together = len(forces) == len(sums) and len({s.get("time") for s in sums}) == 1
    whole = _sum(forces) if together else None
    on_plates = [s["force"] for s in sums if together and str(s.get("load")).startswith("support[")]
    twice = _sum(on_plates) if together else None
    total = _sum(list(reactions.values()))
    most = max((abs(x) for row in (*reactions.values(), *forces) for x in row), default=0.0)
    ended = summary.get("status") == "completed"
    if whole is not None:
        when = "" if ended else _when_largest(run, sums[0].get("time"))
        rows.append((f"all loads{when}, on the undeformed body", vector(whole, "N", most)))
    if twice is not None:
        rows.append(("of these on rigid plates, part of their reactions", vector(twice, "N", most)))
    if total is not None:
        rows.append(("all reactions", vector(total, "N", most)))
    audit = summary.get("audit") or {}
    at_rest = ended and not run.moving
    if at_rest and whole is not None and total is not None and len(whole) == len(total):
        left = [float(x) for x in np.array(whole) + total - (twice or 0.0)]
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
        _balance_remark(run, given),
    )


def _when_largest(run: FinishedRun, time: object) -> str:
    """When loads of a run that has not come to its end are those that are summed up.

    Args:
        time: Of the sums; in statics the load parameter.
    """
    if follows_curves(run.case) and isinstance(time, int | float):
        return f" at {parameter_text(time, run.summary)}"
    return " at their full values"


def _balance_remark(run: FinishedRun, given: Sequence[Described]) -> str:
    if run.moving:
        return (
            "In motion reactions contain the inertia of the body, and need not cancel the loads; "
            "the audit counts it in."
        )
    if any(row.follows for row in given):
        return (
            "A load that follows the deformed surface has another resultant there than on the "
            "undeformed one: where deformations are large, look at the audit's figure."
        )
    return ""


def _sum(rows: Sequence[Sequence[float]]) -> list[float] | None:
    if not rows or len({len(row) for row in rows}) != 1:
        return None
    return [float(x) for x in np.sum(np.array(rows, dtype=float), axis=0)]
