"""The verdict on a run in one sentence: the part holds, fails, or that is not known.

It follows from the numbers of `summary.json` alone, so that console, summary and report say the
same, and that runs before there were verdicts get one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any, Literal

from dolfin_elastic.core.errors import OF_MATERIAL, ElasticError, InputError
from dolfin_elastic.core.si_text import number, percent, quantity
from dolfin_elastic.core.units import LengthUnit, to_si

ENOUGH = 0.3
"""Estimated error of a stress above which it is not known."""

UNLOADED = 1e-9
"""Factor of a load below which it is none."""

SAFEST = 1000.0
"""Upper bound of the safety factor, which would be infinite without stress."""
_LEAVES = "it buckles, tips over or snaps through"
_LOADED, _NAMES = ("load", "support", "contact"), {"on", "kind", "name"}
_TIMED = re.compile(r"\bt\b")
ELSEWHERE = {"von_mises": "elsewhere", "safety_factor": "safety_factor_elsewhere"}
"""Key of an extreme value in the error of `summary.json` to that of the one where it is regular."""

_RIVAL = {"von_mises": "may_be_larger", "safety_factor": "safety_factor_may_be_smaller"}
"""Its key to that of the place where it may be exceeded."""

Kind = Literal["holds", "fails", "not known", "result"]
Table = Mapping[str, Any]


@dataclass(frozen=True)
class Verdict:
    """The verdict on a run.

    Attributes:
        kind: "result": there is nothing to judge by, such as an allowable stress.
        text: One sentence, which begins with the kind unless that is "result".
    """

    kind: Kind
    text: str

    def as_json(self) -> dict[str, str]:
        """For `summary.json`."""
        return asdict(self)


def verdict_of(summary: Table) -> Verdict | None:
    """The verdict on a run; None of one that goes on or has no results.

    Args:
        summary: `summary.json`, which may come from a stranger.
    """
    status = summary.get("status")
    if status in ("failed", "stopped"):
        return _ended_early(summary, str(status))
    if status != "completed":
        return None
    if _table(summary, "stability").get("verdict") == "unstable":
        return _verdict("fails", "the equilibrium is unstable, the part leaves it: it buckles")
    if _table(summary, "audit").get("verdict") == "fail":
        return _unknown(f"the audit fails: {_reasons(summary)}")
    modes = summary.get("modes")
    if (
        rows := [row for row in modes if isinstance(row, Mapping)]
        if isinstance(modes, list)
        else []
    ):
        return _of_buckling(rows) if rows[0].get("kind") == "buckling" else _of_modes(rows, summary)
    return _of_end(summary) if summary.get("steps") else None


def _of_end(summary: Table) -> Verdict:
    found = _of_yield(summary) or _of_rest(summary) or _of_stress(summary)
    found = _of_load(found, summary)
    return Verdict(found.kind, found.text + _added_mass(summary))


def _added_mass(summary: Table) -> str:
    """What mass scaling has added, where it has."""
    numbers = _table(summary, "numbers")
    fraction = _number(numbers.get("added_mass_fraction"))
    if not fraction > 0:
        return ""
    place = [_number(numbers.get(f"added_mass_{x}")) for x in "xyz" if f"added_mass_{x}" in numbers]
    at = f", most at {_unit(summary).point(place)}" if place else ""
    return f"; mass scaling has added {percent(fraction)} of the mass{at}"


def _verdict(kind: Kind, text: str) -> Verdict:
    return Verdict(kind, text if kind == "result" else f"{kind}: {text}")


def _unknown(text: str) -> Verdict:
    return _verdict("not known", text)


def _table(table: Table, key: str) -> Table:
    """A table in another; empty where there is none."""
    value = table.get(key)
    return value if isinstance(value, Mapping) else {}


def _reasons(summary: Table) -> str:
    reasons = _table(summary, "audit").get("reasons")
    return "; ".join(map(str, reasons)) if isinstance(reasons, list) and reasons else "?"


def _number(value: object) -> float:
    """NaN of what is no number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return math.nan
    return float(value)


def _ended_early(summary: Table, status: str) -> Verdict:
    what = "no solution was found" if status == "failed" else "the run was stopped"
    t = _number(summary.get("t"))
    if not summary.get("steps") or math.isnan(t):
        return _unknown(f"{what} in the first step")
    if _table(summary, "case").get("dynamics"):
        return _unknown(f"{what} after t = {quantity(t, 's')}")
    load = _number(summary.get("load_factor"))
    if summary.get("timed") or follows_curves(_table(summary, "case")):
        beyond = f"beyond {parameter_text(load, summary)}"
    else:
        beyond = f"beyond {percent(load)} of the load"
    if status == "failed" and _table(summary, "diagnosis").get("cause") == "unstable":
        return _verdict("fails", f"no stable equilibrium {beyond}: {_LEAVES}")
    return _unknown(f"{what} {beyond}")


# --- modes ---


def _of_buckling(rows: Sequence[Table]) -> Verdict:
    factors = [factor for row in rows if (factor := _number(row.get("load_factor"))) > 0]
    if not factors:
        return _verdict("result", "it buckles under loads of the opposite sign only")
    least = min(factors)
    text = f"it buckles at {number(least, 3)} times the load, without imperfections"
    return _verdict("result" if least > 1 else "fails", text)


def _of_modes(rows: Sequence[Table], summary: Table) -> Verdict:
    if any(row.get("kind") == "unstable" for row in rows):
        return _verdict("fails", "the loaded part is unstable: it buckles")
    elastic = [row for row in rows if row.get("kind") == "elastic"]
    if not elastic:
        return _verdict("result", "all modes are motions of the rigid part")
    first = min(elastic, key=lambda row: _number(row.get("frequency")))
    text = f"lowest natural frequency {quantity(_number(first.get('frequency')), 'Hz')}"
    shape = mode_text(first, _table(summary, "whole"))
    return _verdict("result", f"{text}: {shape}" if shape else text)


def mode_text(row: Table, whole: Table) -> str:
    """A mode in words, such as "bending in y, 33 % of the mass"; empty where nothing is known.

    Args:
        row: Of `summary.json`.
        whole: Direction to mass and inertia of the whole body.
    """
    shares = {
        axis: _number(row.get(f"effective_{axis}")) / mass
        for axis in ("x", "y", "z")
        if (mass := _number(whole.get(axis))) > 0
    }
    most = max(shares.values(), default=0.0)
    parts = [str(row.get("shape") or row.get("name") or "")]
    if row.get("kind") == "elastic" and most >= 0.005:
        parts.append(f"{percent(most)} of the mass")
    return ", ".join(filter(None, parts))


# --- stresses ---


def _of_yield(summary: Table) -> Verdict | None:
    """What has yielded: then a stress of the end says nothing of the way; None: nothing has."""
    numbers = _table(summary, "numbers")
    part = _number(numbers.get("yielded_fraction"))
    strain = _number(numbers.get("max_plastic_strain"))
    if not (part > 0 and strain > 0):
        return None
    text = f"{percent(part)} of the volume has yielded, plastic strain up to {percent(strain)}"
    u = _number(summary.get("max_displacement"))
    return _verdict("result", f"{text}; displacement at the end up to {quantity(u, 'm')}")


def _of_rest(summary: Table) -> Verdict | None:
    """Of a last state without stress, which says nothing of the way; None: it has some."""
    most = _table(summary, "unloaded")
    if not most:
        return None
    load, case = _number(most.get("load_factor")), _table(summary, "case")
    text = (
        "the stress at the end is nothing but round-off; the part was strained most in step "
        f"{most.get('step')}, at {parameter_text(load, summary)}"
    )
    if _table(case, "statics").get("method") != "arc-length":  # which may pass a load twice
        end = f'"{load:.6g} s"' if summary.get("timed") else f"{load:.6g}"
        text = f"{text}: a run with statics.end = {end} is judged there"
    limited = "safety_factor" in _table(summary, "extremes")
    return _verdict("not known" if limited else "result", text)


def _of_stress(summary: Table) -> Verdict:
    error, extremes = (_table(summary, key) for key in ("error", "extremes"))
    error = error or _table(summary, "motion")
    safety = reliable(error, "safety_factor", extremes)
    stress = reliable(error, "von_mises", extremes)
    if safety is not None and _number(safety.get("value")) > 0:
        return _of_safety(safety, summary)
    if stress is None or not _number(stress.get("value")) > 0:
        u = _number(_table(extremes, "displacement").get("value"))
        return _verdict("result", f"largest displacement {quantity(u, 'm')}, without stress")
    if why := doubt(stress):
        return _unknown(f"the largest von Mises stress{_where(stress, summary)}: {why}")
    text = f"largest von Mises stress {quantity(_number(stress['value']), 'Pa')}"
    return _verdict("result", f"{text}{_error(stress)}{_where(stress, summary)}")


def _of_load(found: Verdict, summary: Table) -> Verdict:
    """A verdict on stresses, with the load at which the path was left and which it belongs to."""
    if _table(summary, "case").get("dynamics"):
        return found
    kind, text = found.kind, found.text.removeprefix(f"{found.kind}: ")
    limits, load = summary.get("limit_points"), _number(summary.get("load_factor"))
    if unloaded(summary):
        return _verdict(kind, f"{text}; no load acts at the end")
    if summary.get("timed") or "relaxing" in _table(summary, "energies"):
        return found  # what grows is time
    if isinstance(limits, Sequence) and (at := [x for x in map(_number, limits) if x > 0]):
        kind = "not known" if kind == "holds" else kind
        text = f"{text}, but {_LEAVES} at {percent(at[0])} of the load"
    end = _number(_table(_table(summary, "case"), "statics").get("end", 1.0))
    if load < 0.999 * end and kind == "holds":
        kind, text = "not known", f"{text}, but the run has ended early"
    return _verdict(kind, f"{text}; {_load_text(load, summary)}" if abs(load - 1) > 0.001 else text)


def _load_text(load: float, summary: Table) -> str:
    """Which load a state has: in percent, or where some of it follows t, as the load parameter."""
    if follows_curves(_table(summary, "case")):
        return f"at {parameter_text(load, summary)}"
    return f"with {percent(load)} of the load"


def parameter_text(load: float, summary: Table) -> str:
    """The load parameter of a run in statics, which may be a time, in words."""
    if summary.get("timed"):
        return f"t = {quantity(load, 's')}"
    return f"load parameter {number(load, 4)}"


def _rows(case: Table, *keys: str) -> list[Table]:
    given = [case.get(key) for key in keys]
    return [row for x in given if isinstance(x, list) for row in x if isinstance(row, Mapping)]


def follows_curves(case: Table) -> bool:
    """Whether some of what acts is not in proportion to the load parameter of statics."""
    rows = _rows(case, *_LOADED)
    return any(
        bool(row.get("curve")) or _timed([row[key] for key in row.keys() - _NAMES]) for row in rows
    )


def _timed(value: object) -> bool:
    """Whether a value has a formula in t or a record over time, which stands for one."""
    if isinstance(value, Mapping):
        record = "field" not in value and bool(value.keys() & {"file", "table"})
        return record or _timed([*value.values()])
    if isinstance(value, list | tuple):
        return any(map(_timed, value))
    return isinstance(value, str) and bool(_TIMED.search(value))


def _moves(support: Table) -> bool:
    """Whether a support prescribes a motion."""
    given = support.get("displacement")
    values = given if isinstance(given, list) else [given]
    held = all(value in (None, 0, "free") for value in values)
    return not held or bool(support.keys() & {"velocity", "rotation"})


def unloaded(summary: Table) -> bool:
    """Whether there are loads in statics, and curves say that all of them are 0 at the end."""
    from dolfin_elastic.model.amplitude import amplitude

    case, load = _table(summary, "case"), _number(summary.get("load_factor"))
    plates = [row for row in _rows(case, "support", "contact") if row.keys() & {"force", "moment"}]
    moved = [row for row in _rows(case, "support") if _moves(row)]
    rows = [*_rows(case, "load"), *plates, *moved]
    try:
        return bool(rows) and all(
            row.get("curve") is not None and abs(amplitude(row["curve"]).at(load)) < UNLOADED
            for row in rows
        )
    except (ElasticError, TypeError, ValueError):  # a file that is not read here
        return False


def reliable(error: Table, name: str, extremes: Table) -> Table | None:
    """The extreme value to judge by: where it is singular, that away from there.

    Args:
        error: Of `summary.json`; of a motion its `motion`.
        name: One of `ELSEWHERE`.
        extremes: Of `summary.json`, where no error was estimated.
    """
    peak = error.get(name)
    if not isinstance(peak, Mapping):  # unloaded, or of a motion before these were kept
        peak = extremes.get(name)
        return peak if isinstance(peak, Mapping) else None
    other, rival = error.get(ELSEWHERE[name]), error.get(_RIVAL[name], error.get("may_be_larger"))
    if peak.get("singular") and isinstance(other, Mapping):
        peak = {**other, "apart": peak["singular"], "distance": _distance(other, peak)}
    if isinstance(rival, Mapping) and rival.get("unresolved"):
        peak = {**peak, "unresolved": peak.get("unresolved") or rival["unresolved"]}
    return peak


def _distance(one: Table, other: Table) -> float:
    """Between two places [m]; NaN where one is not known."""
    a, b = _place(one), _place(other)
    return math.dist(a, b) if len(a) == len(b) > 0 else math.nan


def doubt(peak: Table) -> str:
    """Why a value is not known; empty where it is, or where its error was not estimated."""
    if peak.get("singular"):
        return f"it is singular at {peak['singular']}, and elements are too large to look beside"
    if peak.get("unresolved"):
        return str(peak["unresolved"])
    if "error" not in peak:
        return ""
    error = _number(peak.get("error"))
    if math.isnan(error):
        return "the elements are too large for it"
    return "" if error <= ENOUGH else f"it is known to {percent(error)} only: refine the mesh"


def _of_safety(safety: Table, summary: Table) -> Verdict:
    value, error = _number(safety.get("value")), _number(safety.get("error"))
    where, allowable = _where(safety, summary), _allowable(safety, summary)
    limit = quantity(allowable, "Pa") if allowable else _criterion(safety, summary)
    # With an error that large the stress is known only if it exceeds the limit without the error.
    known = not error > ENOUGH or value < 1 - error
    if value < 1 and known and not safety.get("singular"):
        stress = f"von Mises stress {quantity(allowable / value, 'Pa')} is " if allowable else ""
        named = f"the allowable {limit}" if allowable else limit
        times = f"{stress}{_times(1 / value)} times {named}"
        return _verdict("fails", f"{times}{_error(safety)}{where}")
    below = f"{_times(value) if value < SAFEST else factor_text(value)} times below"
    times = f"{below if value >= 1 else f'{_times(1 / value)} times above'} {limit}"
    stress = "strain" if limit.endswith("strain limit") else "stress"
    if why := doubt(safety):
        return _unknown(f"{stress} {times}{where}, but {why}")
    times += _error(safety)
    if value / (1 + (0.0 if math.isnan(error) else error)) < 1:
        return _unknown(f"{stress} {times}{where}: refine the mesh")
    if why := _unjudged(safety, summary):
        return _unknown(f"{stress} {times}{where}, but {why}")
    return _verdict("holds", f"{times}{where}")


def factor_text(value: float) -> str:
    """A safety factor; at its bound only that it is more."""
    return f"{value:.3g}" if value < SAFEST else f"more than {SAFEST:.0f}"


def _unjudged(safety: Table, summary: Table) -> str:
    """What speaks against a part whose stress is known to be below the allowable one."""
    stability, most = _table(summary, "stability"), _table(summary, "largest")
    if _number(summary.get("max_displacement")) < 0.99 * _number(most.get("max_displacement")):
        return f"that is the end of the run alone: it was deformed more in step {most.get('step')}"
    if "error" not in safety:
        text = "its error is not estimated"
        alone = "" if "t" in safety else "that is the end of the motion alone, and "
        return text if most else f"{alone}{text} in motion"
    if _table(summary, "audit").get("verdict") == "warn":
        return f"the audit has doubts: {_reasons(summary)}"
    if stability.get("verdict") != "stable":
        return f"its stability is not judged: {stability.get('reason') or 'no reason is given'}"
    if stability.get("may_buckle"):
        return (
            "so slender a part under compression may buckle, which small strains do not show: "
            "compute it with [buckling]"
        )
    return ""


def _times(ratio: float) -> str:
    """A ratio with as many digits as tell it from 1."""
    digits = 2 if ratio >= 1.2 else 3
    return number(float(f"{ratio:.{digits}g}"), digits)


def _error(peak: Table) -> str:
    error = _number(peak.get("error"))
    return "" if math.isnan(error) else f", ± {percent(error)}"


def _material(peak: Table, summary: Table) -> Table:
    """The table of the material at a place."""
    name = str(peak.get("part")).removesuffix(OF_MATERIAL)
    return _table(_table(_table(summary, "case"), "materials"), name)


def _allowable(peak: Table, summary: Table) -> float:
    """The allowable stress [Pa] of the material at a place; 0 where it is no number."""
    row = _material(peak, summary)
    try:
        return max(0.0, float(to_si(row["allowable"], "Pa")))
    except (InputError, KeyError, TypeError, ValueError):  # a field of the mesh, or a formula
        return 0.0


def _criterion(peak: Table, summary: Table) -> str:
    """What limits the stress of the material at a place, if it is no number."""
    row = _material(peak, summary)
    if isinstance(table := row.get("allowable"), Mapping) and "field" not in table:
        from dolfin_elastic.model.strength import Strength  # reports need no UFL

        with suppress(ElasticError, TypeError, ValueError):
            return f"the {Strength(**table).sentence()} limit"
    return "the allowable stress"


def _where(peak: Table, summary: Table) -> str:
    """Where, when in a motion, and how far from which singular place that does not count."""
    place, t = place_text(peak, summary), _number(peak.get("t"))
    text = f", on ‘{peak['surface']}’" if peak.get("surface") else f", at {place}" if place else ""
    text = text if math.isnan(t) else f"{text}, t = {quantity(t, 's')}"
    if not peak.get("apart"):
        return text
    distance = _number(peak.get("distance"))
    far = "" if math.isnan(distance) else f", {_unit(summary).length(distance)} away"
    return f"{text} (not at {peak['apart']}{far}: singular)"


def place_text(row: Table, summary: Table) -> str:
    """Coordinates for people, in the unit of the mesh; empty where there are none.

    Args:
        row: With "place" [m].
    """
    place = _place(row)
    return _unit(summary).point(place) if place else ""


def _place(row: Table) -> list[float]:
    given = row.get("place")
    return [x for x in given if isinstance(x, int | float)] if isinstance(given, Sequence) else []


def _unit(summary: Table) -> LengthUnit:
    metres = _number(_table(_table(summary, "model"), "mesh").get("metres"))
    return LengthUnit.of(metres if metres > 0 else 1.0)
