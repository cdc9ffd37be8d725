"""Supports, loads, temperatures and ties of Abaqus and CalculiX."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator

import numpy as np

from dolfin_elastic.case.decks.abaqus.couplings import (
    directions,
    follower_of,
    rows_of,
    take_at_nodes,
)
from dolfin_elastic.case.decks.abaqus.materials import floats, place
from dolfin_elastic.case.decks.abaqus.state import Part, Ramp, Reading
from dolfin_elastic.case.decks.abaqus.transforms import in_directions_of_the_body
from dolfin_elastic.case.decks.deck import Entry, FieldValue, Quantity
from dolfin_elastic.core.types import IntArray
from dolfin_elastic.mesh.formats.abaqus.cards import Card
from dolfin_elastic.mesh.formats.abaqus.numbered import (
    AXES,
    components,
    part_name,
    pressure_names,
    support_words,
)

_KNOWN = {
    "BOUNDARY": {"OP", "AMPLITUDE", "TYPE", "FIXED"},
    "CLOAD": {"OP", "AMPLITUDE"},
    "DLOAD": {"OP", "AMPLITUDE"},
    "DSLOAD": {"OP", "AMPLITUDE", "FOLLOWER"},
    "TEMPERATURE": {"OP", "AMPLITUDE"},
}
_ROTATION = "rotations and temperatures are no unknowns of solids (direction {})"


def take_condition(state: Reading, card: Card) -> None:
    """*BOUNDARY, *CLOAD, *DLOAD, *DSLOAD or *TEMPERATURE."""
    known = _KNOWN[card.word]
    for key in card.options:
        if key not in known:
            state.fault(card, f"{key} is not understood")
            return
    if "FIXED" in card.options and state.deck.steps:
        _keep(state, card)
        return
    if card.options.get("OP", "MOD").upper() == "NEW":
        _forget(state, card.word)
    if state.step is None and card.word not in ("BOUNDARY",) and card.lines:
        state.fault(card, "it stands before the first *STEP")
        return
    if state.couplings and card.word in ("BOUNDARY", "CLOAD"):
        card = take_at_nodes(state, card)
    if state.transforms and card.word in ("BOUNDARY", "CLOAD"):
        card = in_directions_of_the_body(state, card)
    _TAKE[card.word](state, card)


def _forget(state: Reading, word: str) -> None:
    """OP=NEW: what earlier steps have stated is gone."""
    if word == "BOUNDARY":
        state.supports.clear()
    elif word == "CLOAD":
        state.forces.clear()
    else:
        state.loads = {key: entry for key, entry in state.loads.items() if key[0] != word}


def _ramp(state: Reading, card: Card) -> Ramp:
    """The amplitude of a keyword over its step, as a fraction of its length; in motion in time."""
    name = card.options.get("AMPLITUDE", "")
    if not name:
        return None
    amplitude = state.amplitudes.get(name.upper())
    if amplitude is None:
        raise card.error(f"there is no *AMPLITUDE '{name[:60]}' before it")
    others = set(amplitude.options) - {"NAME", "TIME", "VALUE", "DEFINITION", "INPUT"}
    kind = amplitude.options.get("DEFINITION", "TABULAR").upper()
    absolute = amplitude.options.get("VALUE", "RELATIVE").upper() == "ABSOLUTE"
    total = "TOTAL" in amplitude.options.get("TIME", "STEP TIME").upper() and state.deck.steps
    if others or kind != "TABULAR" or absolute or total or "INPUT" in amplitude.options:
        state.fault(amplitude, "only tables of relative values over the time of the step are read")
        return None
    every = np.array(floats(amplitude)).reshape(-1, 2) if amplitude.lines else np.zeros((1, 2))
    motion = state.step is not None and state.step.kind == "dynamics"
    scale = 1.0 if motion else state.period
    return tuple((float(t / scale), float(value)) for t, value in every)


def _words(card: Card) -> Iterator[tuple[int, list[str]]]:
    for row, line in enumerate(card.lines):
        yield row, [word.strip() for word in line.split(",")]


def _number(card: Card, row: int, words: list[str], index: int) -> float:
    word = words[index] if len(words) > index else ""
    try:
        value = float(word.upper().replace("D", "E", 1) or "0")
    except ValueError:
        raise card.error(f"'{word[:40]}' is no number", row=row) from None
    if not np.isfinite(value):
        raise card.error(f"'{word[:40]}' is no finite number", row=row)
    return value


def _own_set(state: Reading, card: Card, name: str, row: int) -> str:
    """The set of the nodes that a keyword names by numbers.

    Raises:
        MeshError: The mesh has none, for a node does not exist or is in one of several instances.
    """
    if name not in state.mesh.point_sets:
        raise card.error("a node of these numbers does not exist", row=row)
    return name


# --- supports ---


def _boundary(state: Reading, card: Card) -> None:
    kind = card.options.get("TYPE", "DISPLACEMENT").upper()
    if kind != "DISPLACEMENT":
        state.fault(card, f"TYPE={kind} is not read")
        return
    if state.step is not None and card.options.get("OP", "MOD").upper() == "NEW" and not card.lines:
        return
    ramp, by_number = _ramp(state, card), dict[int, int]()
    held: dict[str, dict[int, float]] = {}
    for row, words in _words(card):
        try:
            values = components(support_words(card, words))
        except (ValueError, IndexError):
            raise card.error(f"'{card.lines[row].strip()[:60]}' is no support", row=row) from None
        if not all(np.isfinite(value) for value in values.values()):
            raise card.error("a value is no finite number", row=row)
        _note_rotations(state, card, row, words)
        if words[0].isdecimal():
            by_number[int(words[0])] = row
            held.setdefault(words[0], {}).update(values)
            continue
        name = state.name(card, "point", words[0], row)
        for i, value in values.items():
            if i <= state.dim:
                part = Part(Quantity(value, "length"), place(card, row), ramp)
                state.supports.pop((name, i - 1), None)
                state.supports[name, i - 1] = part
    if by_number:
        _boundary_by_number(state, card, held, ramp, next(iter(by_number.values())))


def _note_rotations(state: Reading, card: Card, row: int, words: list[str]) -> None:
    beyond = words[1].isdecimal() and int(words[2] if len(words) > 2 and words[2] else words[1])
    if beyond and beyond > 3:
        state.note(card, _ROTATION.format("4 to 6" if beyond <= 6 else beyond), row)


def _keep(state: Reading, card: Card) -> None:
    """*BOUNDARY, FIXED in a later step: nodes stay where supports before it have them."""
    if card.options.get("OP", "MOD").upper() == "NEW":
        state.fault(card, "OP=NEW beside FIXED is not read")
        return
    held, _ = state.held()
    for row, words in _words(card):
        try:
            axes = [i - 1 for i in components(support_words(card, words)) if i <= state.dim]
        except (ValueError, IndexError):
            raise card.error(f"'{card.lines[row].strip()[:60]}' is no support", row=row) from None
        rows, kept = rows_of(state, words[0]), True
        for one, shift in filter(None, (follower_of(state, node) for node in rows)):
            periodic = one.kind == "PERIODIC"
            wanted = {i + 1 for i in axes} if periodic else directions(card, words, shift)
            kept &= one.moved.keys() >= set(wanted)
        if free := [node for node in rows if follower_of(state, node) is None]:
            _note_rotations(state, card, row, words)
            kept &= bool(held[np.ix_(free, axes)].all())
        if not rows or not kept:
            text = "FIXED: it stops nodes that moved freely in the step before it"
            state.fault(card, text, row)


def _boundary_by_number(
    state: Reading, card: Card, held: dict[str, dict[int, float]], ramp: Ramp, row: int
) -> None:
    """Nodes by number, in the sets by directions that the mesh has of them."""
    name = part_name(card, state.file)
    for values in held.values():
        axes = "".join(AXES[i - 1] for i in sorted(values))
        if not values or (f"{name} {axes}", "xyz".index(axes[0])) in state.supports:
            continue
        own = _own_set(state, card, f"{name} {axes}", row)
        for i in values:
            moved = f"{name} {AXES[i - 1]}" in state.mesh.point_data
            value: Quantity | FieldValue = Quantity(0.0, "length")
            if moved:
                value = FieldValue(f"{name} {AXES[i - 1]}", "length")
            if i <= state.dim:
                state.supports[own, i - 1] = Part(value, place(card), ramp)


# --- forces ---


def _cload(state: Reading, card: Card) -> None:
    ramp, numbered = _ramp(state, card), -1
    for row, words in _words(card):
        value = _number(card, row, words, 2)
        if len(words) < 3 or not words[1].isdecimal():
            raise card.error(f"'{card.lines[row].strip()[:60]}' is no force", row=row)
        axis = int(words[1])
        if axis > state.dim:
            if value:
                state.fault(card, _ROTATION.format(axis), row)
            continue
        if words[0].isdecimal():
            numbered = row
            continue
        name = state.name(card, "point", words[0], row)
        key = name, axis - 1
        before = state.forces.get(key)
        others = {other for other in state.forces if other[0] != name and other not in state.fresh}
        _replaced_forces(state, card, state.mesh.point_sets[name], others)
        if before and key in state.fresh and isinstance(before.value, Quantity):
            value += before.value.value
        state.fresh.add(key)
        state.forces[key] = Part(Quantity(value, "force"), place(card, row), ramp)
    if numbered >= 0:
        _cload_by_number(state, card, ramp, numbered)


def _cload_by_number(state: Reading, card: Card, ramp: Ramp, row: int) -> None:
    name = _own_set(state, card, part_name(card, state.file), row)
    others = {other for other in state.forces if other not in state.fresh}
    _replaced_forces(state, card, state.mesh.point_sets[name], others)
    state.fresh.add((name, 0))
    state.forces[name, 0] = Part(FieldValue(name, "force"), place(card), ramp)


def _replaced_forces(
    state: Reading, card: Card, nodes: IntArray, others: set[tuple[str, int]]
) -> None:
    """Names forces of earlier steps that a keyword replaces at some of their nodes.

    Args:
        nodes: Rows of the nodes of the keyword.
        others: Names and components of forces of earlier steps.
    """
    for other in sorted({name for name, _ in others}):
        if np.isin(nodes, state.mesh.point_sets[other]).any():
            state.fault(card, f"it replaces forces of an earlier step at some nodes of '{other}'")


def _facets(state: Reading, name: str) -> set[tuple[int, ...]]:
    """The facets of a surface, by the rows of their nodes in ascending order."""
    blocks = [block for block in state.mesh.blocks if name in block.parts]
    tables = [np.sort(block.nodes[block.parts[name]], axis=1) for block in blocks]
    return {tuple(map(int, facet)) for table in tables for facet in table}


def _replace_pressures(state: Reading, card: Card, names: Collection[str]) -> None:
    """Pressures on faces by number end pressures of earlier steps on the same faces."""
    new = set[tuple[int, ...]]().union(*(_facets(state, name) for name in names))
    for key, entry in list(state.loads.items()):
        if key in state.fresh or key[0] != "DLOAD" or entry.keys.get("kind") != "pressure":
            continue
        old = _facets(state, str(entry.keys["on"]))
        if old <= new:
            del state.loads[key]
        elif old & new:
            text = f"it replaces the pressure of {entry.place.file}:{entry.place.line} on some"
            state.fault(card, f"{text} faces of it")


def _add(state: Reading, card: Card, row: int, key: tuple[str, ...], entry: Entry) -> None:
    """A load, or another value of the same one."""
    if key in state.fresh and state.loads.get(key) is not None:
        key = (*key, str(card.line), str(row))
    state.fresh.add(key)
    state.loads[key] = entry


def _dload(state: Reading, card: Card) -> None:
    ramp = _ramp(state, card)
    for row, words in _words(card):
        kind = words[1].upper() if len(words) > 1 else ""
        if kind[:1] == "P" and kind[1:].isdecimal():
            _number(card, row, words, 2)
            continue
        if kind not in _BODY:
            state.fault(card, f"a load {kind[:20]} is not there", row)
            continue
        if words[0].isdecimal():
            state.fault(card, f"{kind} on one element by its number", row)
            continue
        keys = _BODY[kind](state, card, row, words)
        if words[0]:
            keys["on"] = state.name(card, "region", words[0], row)
        key = (card.word, kind, words[0].upper(), *(words[3:6] if kind == "CENTRIF" else ()))
        _add(state, card, row, key, Entry(place(card, row), keys, ramp=ramp))
    pressed = pressure_names(card, state.file)
    _replace_pressures(state, card, pressed.values())
    for value, name in pressed.items():
        if name.casefold() not in state.names["surface"]:
            raise card.error("an element of these lines does not exist, or has no such face")
        keys = {"kind": "pressure", "on": name, "value": Quantity(value, "stress")}
        _add(state, card, 0, (card.word, name), Entry(place(card), keys, ramp=ramp))


def _gravity(state: Reading, card: Card, row: int, words: list[str]) -> dict[str, object]:
    size = _number(card, row, words, 2)
    direction = np.array([_number(card, row, words, i) for i in (3, 4, 5)])
    length = np.linalg.norm(direction)
    if not length > 0:
        raise card.error("the direction of gravity is missing", row=row)
    parts = size * direction / length
    value = [Quantity(float(x), "acceleration") for x in parts[: state.dim]]
    return {"kind": "gravity", "value": value}


def _centrifugal(state: Reading, card: Card, row: int, words: list[str]) -> dict[str, object]:
    square = _number(card, row, words, 2)
    numbers = [_number(card, row, words, i) for i in range(3, 9)]
    if square < 0 or not any(numbers[3:]):
        raise card.error("the axis or the square of the speed is wrong", row=row)
    axis: dict[str, object] = {"point": numbers[:3], "axis": numbers[3:]}
    return {"kind": "centrifugal", "value": Quantity(float(np.sqrt(square)), "rotation"), **axis}


def _body_force(axis: int) -> Callable[[Reading, Card, int, list[str]], dict[str, object]]:
    def keys(state: Reading, card: Card, row: int, words: list[str]) -> dict[str, object]:
        value = [Quantity(0.0, "body force") for _ in range(state.dim)]
        value[axis] = Quantity(_number(card, row, words, 2), "body force")
        return {"kind": "body-force", "value": value}

    return keys


_BODY: dict[str, Callable[[Reading, Card, int, list[str]], dict[str, object]]] = {
    "GRAV": _gravity,
    "CENTRIF": _centrifugal,
    "BX": _body_force(0),
    "BY": _body_force(1),
    "BZ": _body_force(2),
}


def _dsload(state: Reading, card: Card) -> None:
    ramp = _ramp(state, card)
    for row, words in _words(card):
        kind = words[1].upper() if len(words) > 1 else ""
        name = state.name(card, "surface", words[0], row)
        size = _number(card, row, words, 2)
        keys: dict[str, object] = {
            "kind": "pressure",
            "on": name,
            "value": Quantity(size, "stress"),
        }
        if kind == "TRVEC":
            direction = np.array([_number(card, row, words, i) for i in (3, 4, 5)])
            length = np.linalg.norm(direction)
            if not length > 0:
                raise card.error("the direction of the traction is missing", row=row)
            if state.large and card.options.get("FOLLOWER", "YES").upper() != "NO":
                state.fault(card, "a traction that turns with the surface (FOLLOWER=YES)", row)
            parts = size * direction / length
            value = [Quantity(float(x), "stress") for x in parts[: state.dim]]
            keys |= {"kind": "traction", "value": value}
        elif kind != "P":
            state.fault(card, f"a load {kind[:20]} is not there", row)
            continue
        entry = Entry(place(card, row), keys, ramp=ramp)
        _add(state, card, row, (card.word, kind, name.upper()), entry)


# --- temperatures ---


def _temperature(state: Reading, card: Card) -> None:
    ramp, name = _ramp(state, card), part_name(card, state.file)
    if name not in state.mesh.point_data:
        raise card.error("its nodes are not understood", row=0 if card.lines else None)
    nodes, values = state.mesh.point_sets[name], state.mesh.point_data[name][:, 0]
    everywhere = len(nodes) == len(state.mesh.points)
    first = _initial(state, card)
    if first is None:
        return
    if ramp is not None and first:
        state.fault(card, "an amplitude beside an initial temperature that is not 0")
    keys: dict[str, object] = {"kind": "thermal"}
    if everywhere and np.ptp(values) == 0:
        keys["value"] = Quantity(float(values[0]) - first, "temperature")
    else:
        if not everywhere and first:
            state.fault(card, "nodes without a temperature, beside an initial one that is not 0")
        keys["value"] = FieldValue(name, "temperature", first)
    if not any(one.word == "EXPANSION" for m in state.materials.values() for one in m.cards):
        state.note(card, "no material has an *EXPANSION")
        return
    state.loads = {key: entry for key, entry in state.loads.items() if key[0] != "TEMPERATURE"}
    state.loads["TEMPERATURE", name] = Entry(place(card), keys, ramp=ramp)


def _initial(state: Reading, card: Card) -> float | None:
    """The one initial temperature of the body; None: there are several."""
    if len(set(state.start.values())) > 1:
        state.fault(card, "initial temperatures that differ from place to place")
        return None
    return next(iter(state.start.values()), 0.0)


def take_initial(state: Reading, card: Card) -> None:
    """*INITIAL CONDITIONS: a temperature, or one velocity of the whole body."""
    kind = card.options.get("TYPE", "").upper()
    if kind == "TEMPERATURE":
        for row, words in _words(card):
            state.start[words[0].upper()] = _number(card, row, words, 1)
        return
    if kind == "VELOCITY":
        velocity = [0.0] * state.dim
        for row, words in _words(card):
            name = "" if words[0].isdecimal() else state.name(card, "point", words[0], row)
            axis = int(_number(card, row, words, 1))
            whole = len(state.mesh.point_sets.get(name, ())) == len(state.mesh.points)
            if not whole or not 1 <= axis <= state.dim:
                state.fault(card, "a velocity of some nodes, not of the whole body", row)
                return
            velocity[axis - 1] = _number(card, row, words, 2)
        state.velocity = velocity
        return
    state.fault(card, f"TYPE={kind[:30]} is not read")


# --- springs ---


def take_spring(state: Reading, card: Card) -> None:
    """*SPRING of SPRING1: a line with the direction, and one with the stiffness."""
    elements = state.grounded.pop(card.option("ELSET").upper(), [])
    words = [line.split(",") for line in card.lines]
    direction = words[0][0].strip() if words else ""
    others = card.options.keys() - {"ELSET"} or direction not in ("1", "2", "3")[: state.dim]
    if not elements:
        text = "no *ELEMENT, TYPE=SPRING1 above it, of which no other *SPRING is, has this ELSET"
        state.fault(card, f"{text}; other springs are not there")
        return
    if others or len(words) != 2 or state.transforms:
        text = "springs to the ground (SPRING1) along x, y or z with one stiffness alone are read"
        state.fault(card, f'{text}; else state it as a support of kind "spring"')
        return
    names = [_own_set(state, one, part_name(one, state.file), 0) for one in elements]
    nodes = np.unique(np.concatenate([state.mesh.point_sets[name] for name in names]))
    if len(nodes) < sum(len(one.lines) for one in elements):
        state.fault(card, "a node that has several of its springs: give it one of their sum")
        return
    if np.isin(state.skin.facets, nodes).all(axis=1).any():
        text = "springs at all corners of a face, which a case has per area"
        state.fault(card, f'{text}: state them as a support of kind "spring"')
        return
    stiffness: list[object] = [0] * state.dim
    stiffness[int(direction) - 1] = Quantity(_number(card, 1, words[1], 0), "stiffness")
    keys: dict[str, object] = {"kind": "spring", "stiffness": stiffness}
    state.springs += [Entry(place(card), {"on": name, **keys}) for name in names]


# --- ties ---


def take_tie(state: Reading, card: Card) -> None:
    """*TIE: the first surface of each line follows the second one."""
    if others := card.options.keys() - {"NAME", "POSITION TOLERANCE", "ADJUST", "TYPE"}:
        state.fault(card, f"{', '.join(sorted(others))}: such a tie is not there")
        return
    if card.options.get("ADJUST", "YES").upper() != "NO":
        state.note(card, "nodes are not moved onto the other surface; a gap remains")
    for row, words in _words(card):
        if len(words) < 2:
            raise card.error("two surfaces are needed", row=row)
        keys: dict[str, object] = {}
        for key, word in zip(("on", "to"), words, strict=False):
            if word.casefold() in state.names["point"].keys() - state.names["surface"].keys():
                state.fault(card, f"'{word}' is a set of nodes, which covers no faces", row)
                return
            keys[key] = state.name(card, "surface", word, row)
        if tolerance := card.options.get("POSITION TOLERANCE", ""):
            keys["tolerance"] = _number(card, row, [tolerance], 0)
        state.deck.ties.append(Entry(place(card, row), keys))


_TAKE: dict[str, Callable[[Reading, Card], None]] = {
    "BOUNDARY": _boundary,
    "CLOAD": _cload,
    "DLOAD": _dload,
    "DSLOAD": _dsload,
    "TEMPERATURE": _temperature,
}
