"""Supports and loads of FEBio.

Sources: FEBio User Manual, version 4, sections 3.10 to 3.14, and the integrals of its classes: a
body force acts against its vector, and a traction is per deformed area unless `linear` is 1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from dolfin_elastic.case.decks.deck import Dimension, Entry, Quantity, Step
from dolfin_elastic.case.decks.febio.rigid import Bodies
from dolfin_elastic.case.decks.febio.values import Clock, flag, named_part, numbers, place
from dolfin_elastic.mesh.formats.febio.tags import Tag

_AXES = "xyz"


def _left_out(clock: Clock, tag: Tag, text: str) -> None:
    clock.deck.leave_out(place(tag), text, "changes the answer")


def _quantities(values: list[float], dimension: Dimension) -> list[object]:
    return [Quantity(v, dimension) for v in values]


# --- supports ---


def take_boundary(section: Tag, clock: Clock, step: Step, bodies: Bodies) -> None:
    """Adds the supports of a section <Boundary>, and nodes to rigid bodies."""
    for tag in section.children:
        kind = tag.attributes.get("type", tag.name if tag.name != "bc" else "")
        if kind in ("fix", "zero displacement"):
            _fix(tag, step)
        elif kind in ("prescribe", "prescribed displacement"):
            _prescribe(tag, clock, step)
        elif kind == "rigid":
            bodies.attach(tag)
        else:
            _left_out(clock, tag, f"the boundary condition '{kind[:40]}' is not known here")


def _components(tag: Tag) -> list[int]:
    """Indices of the directions of a fixed displacement."""
    old = tag.attributes.get("bc", tag.content("dofs"))
    if old or tag.first("x_dof") is None:
        words = old.replace(",", "")
        if not words or set(words) - set("xyzuvw"):
            raise tag.error(f"'{old[:40]}' are no directions", "x, y or z")
        return [i for i, axis in enumerate(_AXES) if axis in words]
    return [i for i, axis in enumerate(_AXES) if flag(tag, f"{axis}_dof")]


def _fix(tag: Tag, step: Step) -> None:
    held = _components(tag)
    if not held:
        return
    on = named_part(tag, "node_set")
    values: list[object] = [0 if i in held else "free" for i in range(3)]
    keys = {"kind": "fixed"} if len(held) == 3 else {"displacement": values}
    step.supports.append(Entry(place(tag), {"on": on, **keys}))


def _prescribe(tag: Tag, clock: Clock, step: Step) -> None:
    on = named_part(tag, "node_set")
    axis = tag.content("dof") or tag.attributes.get("bc", "")
    if axis not in tuple(_AXES):
        raise tag.error(f"'{axis[:40]}' is no direction", "x, y or z")
    if flag(tag, "relative"):
        _left_out(clock, tag, "a displacement relative to that at the beginning of a step")
        return
    value, scale = tag.first("value"), tag.first("scale")
    amount = clock.amount(tag, [(value, 1), (scale, 1)])
    values: list[object] = ["free"] * 3
    values[_AXES.index(axis)] = Quantity(amount.values[0], "length")
    step.supports.append(Entry(place(tag), {"on": on, "displacement": values}, ramp=amount.ramp))


# --- loads ---


def _force(tag: Tag, clock: Clock) -> Entry | None:
    """A force at each node of a set."""
    word = tag.attributes.get("node_set", "")
    on = named_part(tag, "node_set")
    if word.startswith("@"):
        _left_out(clock, tag, "forces at the nodes of a surface: name them by a NodeSet")
        return None
    axis = tag.content("dof") or tag.attributes.get("bc", "")
    parts = [(tag.first("value"), 1 if axis else 3), (tag.first("scale"), 1)]
    amount = clock.amount(tag, parts)
    values = amount.values
    if axis:
        if axis not in tuple(_AXES):
            raise tag.error(f"'{axis[:40]}' is no direction", "x, y or z")
        values = [values[0] if axis == a else 0.0 for a in _AXES]
    keys: dict[str, object] = {"kind": "point-force", "on": on}
    keys["value"] = _quantities(values, "force")
    return Entry(place(tag), keys, ramp=amount.ramp)


def _pressure(tag: Tag, clock: Clock) -> Entry:
    if flag(tag, "linear"):
        _left_out(clock, tag, "linear = 1: a pressure that does not follow the surface")
    amount = clock.amount(
        tag, [(tag.first("pressure") or tag.first("value"), 1), (tag.first("scale"), 1)]
    )
    value = Quantity(amount.values[0], "stress")
    keys = {"kind": "pressure", "on": named_part(tag, "surface"), "value": value}
    return Entry(place(tag), keys, ramp=amount.ramp)


def _traction(tag: Tag, clock: Clock) -> Entry:
    if not flag(tag, "linear"):
        text = "linear = 0: a traction per deformed area; here it is per undeformed area, which "
        _left_out(clock, tag, text + "is the same at small strains")
    amount = clock.amount(tag, [(tag.first("scale"), 1), (tag.first("traction"), 3)])
    values = _quantities(amount.values, "stress")
    keys: dict[str, object] = {"kind": "traction", "on": named_part(tag, "surface")}
    keys["value"] = values
    return Entry(place(tag), keys, ramp=amount.ramp)


def _bearing(tag: Tag, clock: Clock) -> Entry:
    profile = tag.content("profile", "0").lower()
    if profile not in ("0", "sinusoidal"):
        text = "a parabolic profile; here the pressure is that of a cosine, of the same total"
        _left_out(clock, tag, text)
    if not flag(tag, "linear"):
        clock.deck.leave_out(place(tag), "linear = 0: it follows the bore; here it does not")
    amount = clock.amount(tag, [(tag.first("scale"), 1), (tag.first("force"), 3)])
    values = _quantities(amount.values, "force")
    keys: dict[str, object] = {"kind": "bearing", "on": named_part(tag, "surface")}
    keys["value"] = values
    return Entry(place(tag), keys, ramp=amount.ramp)


def _weight(tag: Tag, clock: Clock) -> Entry | None:
    """A force per mass; FEBio's act against their vectors."""
    if (force := tag.first("force")) is not None:
        amount = clock.amount(tag, [(force, 3)])
        values, ramp = amount.values, amount.ramp
    else:
        each = [clock.amount(tag, [(tag.first(axis), 1)]) for axis in _AXES]
        given = [tag.first(axis) is not None for axis in _AXES]
        values = [a.values[0] if there else 0.0 for a, there in zip(each, given, strict=True)]
        ramps = {a.ramp for a, there in zip(each, given, strict=True) if there}
        if len(ramps) > 1:
            _left_out(clock, tag, "components that change over time in different ways")
            return None
        ramp = ramps.pop() if ramps else None
    value = _quantities([-v or 0.0 for v in values], "acceleration")
    keys: dict[str, object] = {"kind": "gravity", "value": value}
    return Entry(place(tag), keys, ramp=ramp, remark="FEBio's acts against its vector")


def _centrifugal(tag: Tag, clock: Clock) -> Entry | None:
    speed = tag.first("angular_speed") or tag.first("omega")
    if speed is None or "lc" in speed.attributes:
        _left_out(clock, tag, "a speed of rotation that changes over time")
        return None
    axis, centre = tag.first("rotation_axis"), tag.first("rotation_center")
    keys: dict[str, object] = {
        "kind": "centrifugal",
        "value": Quantity(numbers(speed, 1)[0], "rotation"),
        "axis": numbers(axis, 3) if axis is not None else "z",
    }
    if centre is not None:
        keys["point"] = numbers(centre, 3)
    _left_out(clock, tag, "it grows with the deformed radius; here with the undeformed one")
    return Entry(place(tag), keys)


_LOADS: Mapping[str, Callable[[Tag, Clock], Entry | None]] = {
    "nodal_force": _force,
    "nodal_load": _force,
    "pressure": _pressure,
    "traction": _traction,
    "bearing load": _bearing,
    "const": _weight,
    "body force": _weight,
    "centrifugal": _centrifugal,
}


def take_loads(section: Tag, clock: Clock, step: Step) -> None:
    """Adds the loads of a section <Loads>."""
    for tag in section.children:
        kind = tag.attributes.get("type", tag.name)
        if tag.name not in ("nodal_load", "surface_load", "body_load") or kind not in _LOADS:
            _left_out(clock, tag, f"the load '{kind[:40]}' is not known here")
        elif not all(_is_constant(child) for child in tag.children):
            _left_out(clock, tag, "a load that varies in space")
        elif (entry := _LOADS[kind](tag, clock)) is not None:
            step.loads.append(entry)


def _is_constant(tag: Tag) -> bool:
    return tag.attributes.get("type", "const") in ("const", "vector")


# --- contact and constraints ---

_TIED = ("tied-node-on-facet", "tied-facet-on-facet", "tied-elastic", "tied", "mortar-tied")


def take_contact(section: Tag, clock: Clock, pairs: Mapping[str, tuple[str, str]]) -> None:
    """Adds ties; other contact is left out.

    Args:
        pairs: Name of a pair of surfaces to both, the one whose nodes are tied first.
    """
    for tag in section.all("contact"):
        kind, pair = tag.attributes.get("type", ""), tag.attributes.get("surface_pair", "")
        if kind not in _TIED or pair not in pairs:
            text = f"the contact '{kind[:40]}': write it as [[contact]]"
            _left_out(clock, tag, text if kind not in _TIED else "it names no SurfacePair")
            continue
        on, to = pairs[pair]
        clock.deck.ties.append(Entry(place(tag), {"on": on, "to": to}, "without a penalty"))


def take_constraints(section: Tag, clock: Clock, step: Step) -> None:
    """Adds constraints that are supports."""
    kinds = {"fixed normal displacement": "normal", "symmetry plane": "symmetry"}
    for tag in section.children:
        kind = tag.attributes.get("type", tag.name)
        if kind in kinds and "surface" in tag.attributes:
            keys: dict[str, object] = {"on": named_part(tag, "surface"), "kind": kinds[kind]}
            step.supports.append(Entry(place(tag), keys, "exactly, without a penalty"))
        else:
            _left_out(clock, tag, f"the constraint '{kind[:40]}' is not known here")
