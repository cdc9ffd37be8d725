"""A case in plain words: what was computed, how the body is held, what acts on it.

The tables are those of the case file, in the units in which they were written.  They may come from
a stranger: every text is a value here, which the page escapes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from dolfin_elastic.core.units import is_quantity
from dolfin_elastic.model.contact import obstacle_shapes
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.report.quantity import listed, number, quantity, scaled_unit, vector

Table = Mapping[str, Any]
_KNOWN = {"kind", "on", "name"}
_REST = {
    **dict.fromkeys(("point", "at", "center", "radius"), "m"),
    **dict.fromkeys(("start", "end", "motion", "displacement"), "m"),
    **dict.fromkeys(("tolerance", "gap_tolerance"), "m"),
}
"""SI units of keys of supports, loads and contacts that are told after their kind."""


# --- values ---


def value_text(value: object, unit: str = "") -> str:
    """A value of a case file, with its unit.

    Args:
        value: A number, a text with a unit, a formula, a word, or a list of these.
        unit: SI unit of bare numbers.
    """
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        factor, name = scaled_unit(float(value), unit)
        text = number(float(value) / factor, 6)
        return f"{text} {name}" if unit and value else text
    if isinstance(value, str):
        return _given_text(value, unit)
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {value_text(item)}" for key, item in value.items())
    return _list_text(list(value), unit) if isinstance(value, Iterable) else str(value)


def _given_text(text: str, unit: str) -> str:
    """A quantity, a word, or a formula, which gives numbers in SI units."""
    if is_quantity(text):
        return text.replace("-", "−")
    return text if text == "free" or not unit else f"{text} [{unit}]"


def _list_text(items: list[Any], unit: str) -> str:
    if len(items) > 24:
        return f"{len(items)} values"
    numbers = [item for item in items if isinstance(item, int | float)]
    if unit and numbers and len(numbers) == len(items):
        return vector((float(value) for value in numbers), unit, digits=6)
    return f"({', '.join(value_text(item, unit) for item in items)})"


def names(table: Table, whole: str = "the whole body") -> str:
    """The parts that a support or load acts on.

    Args:
        whole: Words for all of the body.
    """
    parts = part_names(table)
    return listed([f"‘{part}’" for part in parts]) if parts else whole


def part_names(table: Table) -> list[str]:
    """Names of the parts that a support or load acts on."""
    on = table.get("on")
    return [str(part) for part in on] if isinstance(on, list) else [] if on is None else [str(on)]


def label(table: Table) -> str:
    """The name of a support or contact in results."""
    return str(table.get("name") or "+".join(part_names(table)))


def _rest(table: Table, *known: str) -> str:
    """What else is given."""
    others = {k: v for k, v in table.items() if k not in _KNOWN and k not in known}
    return "".join(
        f"; {key.replace('_', ' ')} {value_text(v, _REST.get(key, ''))}"
        for key, v in others.items()
    )


# --- supports ---


def support_words(table: Table, part: str = "surface") -> str:
    """How a support holds the body, without its place.

    Args:
        part: What it acts on: "surface", "edge" or "point".
    """
    kind = str(table.get("kind", "displacement"))
    moved = table.get("displacement")
    if kind == "displacement":
        return _held(moved) + _rest(table, "displacement")
    if kind in ("normal", "roller"):
        by = f", moved across it by {value_text(moved, 'm')}" if moved else ", not across it"
        return f"free to slide along the surface{by}" + _rest(table, "displacement")
    if kind == "symmetry":
        return "plane of symmetry: no displacement across it" + _rest(table)
    if kind == "rotation":
        angle = value_text(table.get("angle", 0), "rad")
        about = value_text(table.get("axis", "z"))
        point = value_text(table.get("point", [0, 0, 0]), "m")
        by = f", and moved by {value_text(moved, 'm')}" if moved else ""
        text = f"turned by {angle} about the axis {about} through {point}{by}"
        return text + _rest(table, "angle", "axis", "point", "displacement")
    if kind == "rigid":
        return _rigid(table)
    return _resisting(table, kind, part) if kind in ("spring", "dashpot") else kind + _rest(table)


def _rigid(table: Table) -> str:
    units = {"displacement": "m", "rotation": "rad", "force": "N", "moment": "N m", "point": "m"}
    given = [f"{key} {value_text(table[key], units[key])}" for key in units if key in table]
    text = "moves as a rigid plate" + (f": {', '.join(given)}" if given else ", which is held")
    return text + _rest(table, *units)


def _resisting(table: Table, kind: str, part: str) -> str:
    per = "m" if table.get("total") else {"edge": "m^2", "point": "m"}.get(part, "m^3")
    unit = f"N/{per}" if kind == "spring" else f"N s/{per}"
    keys = ("stiffness", "viscosity", "normal", "tangential")
    given = [f"{key} {value_text(table[key], unit)}" for key in keys if key in table]
    return f"on {kind}s: {', '.join(given)}" + _rest(table, *keys, "total")


def _held(moved: object) -> str:
    if not isinstance(moved, list):
        return "fixed: no displacement"
    if all(value == 0 and not isinstance(value, bool) for value in moved):
        return "fixed: no displacement"
    axes = dict(zip("xyz", moved, strict=False))
    free = [axis for axis, value in axes.items() if value == "free"]
    fixed = [axis for axis, value in axes.items() if value == 0]
    given = {axis: v for axis, v in axes.items() if axis not in (*free, *fixed)}
    parts = [f"moved along {axis} by {value_text(value, 'm')}" for axis, value in given.items()]
    if fixed:
        parts.append(f"no displacement along {listed(fixed)}")
    if free:
        parts.append(f"free along {listed(free)}")
    return "; ".join(parts)


# --- loads ---

_FOLLOWS = ", which follows the deformed surface"
_LOADS = {
    "pressure": ("pressure of {}" + _FOLLOWS, "Pa"),
    "body-force": ("force per volume of {}", "N/m^3"),
    "gravity": ("weight, with the acceleration of gravity {}", "m/s^2"),
    "centrifugal": ("centrifugal force of a rotation with {}", "rad/s"),
    "point-force": ("force of {} at a point", "N"),
    "line-force": ("force of {} along a line", "N/m"),
    "thermal": ("change of temperature by {}", "K"),
    "growth": ("growth by the stretches {}", ""),
}


def small_strains(case: Table) -> bool:
    """Whether all materials are linear, so that all loads act on the undeformed body."""
    materials = case.get("materials")
    rows = list(materials.values()) if isinstance(materials, Mapping) else []
    laws = [row.get("law") if isinstance(row, Mapping) else None for row in rows]
    linear = [getattr(MATERIALS.get(str(law)), "linear", False) is True for law in laws]
    return bool(linear) and all(linear)


def load_words(table: Table, *, fixed: bool = False) -> str:
    """What a load does, without its place.

    Args:
        fixed: It acts on the undeformed body, see `small_strains`.
    """
    kind = str(table.get("kind", "traction"))
    if kind == "traction":
        if "force" in table:
            text = f"total force of {value_text(table['force'], 'N')}, spread over the surface"
        else:
            text = f"force per area of {value_text(table.get('value', []), 'Pa')}"
        return text + _rest(table, "value", "force")
    if kind == "cavity":
        keys = ("pressure", "volume", "volume_ratio", "added")
        units = dict(zip(keys, ("Pa", "m^3", "", "m^3"), strict=True))
        given = [
            f"{key.replace('_', ' ')} {value_text(table[key], units[key])}"
            for key in keys
            if key in table
        ]
        return f"closed cavity with {', '.join(given)}" + _rest(table, *keys)
    if kind in _LOADS:
        text, unit = _LOADS[kind]
        if fixed:
            text = text.removesuffix(_FOLLOWS)
        if kind == "gravity" and not table.get("value"):
            return text.format("9.81 m/s² against the last axis") + _rest(table, "value")
        if kind == "line-force" and table.get("total"):
            return text.format(value_text(table.get("value", 0), "N")) + _rest(table, "value")
        return text.format(value_text(table.get("value", 0), unit)) + _rest(table, "value")
    return kind + _rest(table)


def contact_words(table: Table, metres: float = 1.0) -> str:
    """What a surface may touch.

    Args:
        metres: Per unit of length of the mesh, in which its bare numbers are.
    """
    shapes = obstacle_shapes()
    shape = next((key for key in shapes if key in table), "obstacle")
    given, lengths = table.get(shape), getattr(shapes.get(shape), "lengths", ())
    what = ""
    if isinstance(given, Mapping):
        told = (
            f"{key} {value_text(_in_metres(v, metres), 'm') if key in lengths else value_text(v)}"
            for key, v in given.items()
        )
        what = f" ({', '.join(told)})"
    text = f"may touch a rigid {shape}{what}"
    if "with" in table or "other" in table:
        text = f"may touch ‘{table.get('with', table.get('other'))}’"
    if "stiffness" in table:
        text += f"; stiffness {value_text(table['stiffness'], 'Pa/m')}"
    return text + _rest(table, shape, "with", "other", "stiffness")


def _in_metres(value: object, metres: float) -> object:
    """Bare numbers of a place in metres; texts as they are."""
    if isinstance(value, list):
        return [_in_metres(item, metres) for item in value]
    return value * metres if isinstance(value, int | float) else value


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


def what_was_computed(case: Table, summary: Table, *, dim: int | None) -> list[str]:
    """Sentences for somebody who knows nothing of the program.

    Args:
        dim: Dimension of the body; None where that is not known.
    """
    kind = analysis_of(case)
    return [
        _body_sentence(case, dim),
        *_support_sentences(case, summary, kind),
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


def part_kind(table: Table, summary: Table) -> str:
    """What a support acts on: "surface", "edge" or "point".

    Args:
        summary: Of the run, which has noted its parts.
    """
    parts = (summary.get("model") or {}).get("parts") or {}
    kinds = [str((parts.get(name) or {}).get("kind", "surface")) for name in part_names(table)]
    return kinds[0] if kinds else "surface"


def _support_sentences(case: Table, summary: Table, kind: str) -> list[str]:
    supports, loads = case.get("support", []), case.get("load", [])
    held = [
        f"{names(row)} ({support_words(row, part_kind(row, summary)).partition(';')[0]})"
        for row in supports[:6]
    ]
    nowhere = "It is held nowhere."
    if case.get("periodic"):
        nowhere = "It is a periodic cell: its faces are held by those opposite."
    found = [f"It is held at {listed(held)}." if held else nowhere]
    if len(supports) > 6:
        found[0] = f"It is held by {len(supports)} supports."
    if kind == "modal" and not (case["modal"] or {}).get("preload"):
        return found
    fixed = small_strains(case)
    acting = [f"a {_short(load_words(row, fixed=fixed))} on {names(row)}" for row in loads[:6]]
    if len(loads) > 6:
        found.append(f"{len(loads)} loads act on it.")
    elif acting:
        found.append(f"On it {'acts' if len(acting) == 1 else 'act'} {listed(acting)}.")
    touching = [names(row) for row in case.get("contact", [])]
    if touching:
        found.append(f"Contact is possible at {listed(touching)}.")
    return found


def _short(words: str) -> str:
    """Words without what a sentence has no room for."""
    return words.partition(";")[0].removesuffix(", spread over the surface")


def _statics(case: Table, summary: Table) -> str:
    steps = summary.get("steps") or 0
    grown = "in one step" if steps == 1 else f"in {steps} steps"
    text = "Equilibrium was computed at rest, with inertia left out"
    factor, asked = summary.get("load_factor"), (case.get("statics") or {}).get("end", 1.0)
    if factor is None or not summary.get("steps"):
        return f"{text}, but no step was reached."
    full = asked == 1.0 and factor >= 1.0
    reached = "their full values" if full else f"{number(100 * factor)} % of their values"
    return f"{text}; the loads were raised {grown} to {reached}."


def _dynamics(case: Table, summary: Table) -> str:
    settings = case.get("dynamics") or {}
    scheme = f" by the scheme {settings['scheme']}" if settings.get("scheme") else ""
    t = summary.get("t")
    until = (
        f" up to {quantity(float(t), 's')} of {value_text(settings.get('end', ''), 's')}"
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
