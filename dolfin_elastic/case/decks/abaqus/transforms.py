"""*TRANSFORM: lines of *BOUNDARY and *CLOAD in local directions, written in those of the body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dolfin_elastic.case.decks.abaqus.materials import floats
from dolfin_elastic.case.decks.abaqus.state import Reading, Transform
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.formats.abaqus.cards import Card
from dolfin_elastic.mesh.formats.abaqus.numbered import components

_ALL = {1, 2, 3}


def take_transform(state: Reading, card: Card) -> None:
    """*TRANSFORM by a point on the local x axis and one in the local xy plane."""
    name, kind = state.name(card, "point", card.option("NSET")), card.options.get("TYPE", "R")
    numbers = floats(card, 0) if card.lines else []
    if len(numbers) < 6 or state.dim == 2:
        raise card.error("six coordinates are needed, and a body in 3D")
    x, y = np.array(numbers[:3]), np.array(numbers[3:6])
    normal = np.cross(x, y)
    axes = np.array([x, np.cross(normal, x), normal])
    sizes = np.linalg.norm(axes, axis=1)
    plain = kind.upper() == "R"
    if plain and not sizes.all():
        raise card.error("its two points and the origin are on one line")
    rows = axes / sizes[:, None] if plain else None
    nodes = state.mesh.point_sets[name]
    before = {one for one, _ in (*state.supports, *state.forces)}
    reference = [node for node, one in state.couplings.items() if one.moved or one.forces]
    every = [*(state.mesh.point_sets[one] for one in before), np.array(reference, dtype=np.int64)]
    if any(np.isin(nodes, one).any() for one in every):
        state.fault(card, "its nodes have a *BOUNDARY or *CLOAD above it: put it above them")
    state.transforms.append(Transform(nodes, rows))


def in_directions_of_the_body(state: Reading, card: Card) -> Card:
    """The keyword with its lines in the directions of the body.

    What has no such lines is an error of the deck's reading: supports along oblique directions,
    and forces along directions that differ from node to node.
    """
    fixed, lines, at = _fixed(card), list[str](), list[int]()
    for row, line in enumerate(card.lines):
        words, new = [word.strip() for word in line.split(",")], [line]
        local = [
            one for one in state.transforms if np.isin(_nodes(state, words[0]), one.nodes).any()
        ]
        if local and not (card.word == "BOUNDARY" and fixed.get(words[0]) == _ALL):
            whole = all(np.isin(_nodes(state, words[0]), one.nodes).all() for one in local)
            axes = local[0].axes if whole and len(local) == 1 else None
            if card.word == "CLOAD" and state.deck.steps and state.forces:
                axes = None  # which components of an earlier step it replaces
            turned = None if axes is None else _turned(card, words, axes)
            if turned is None:
                state.fault(card, "local directions (*TRANSFORM) that no table has", row)
            new = turned or []
        lines += new
        at += [card.at[row]] * len(new)
    return replace(card, lines=lines, at=at)


def _nodes(state: Reading, word: str) -> IntArray:
    """Rows of a node or a set."""
    if word.isdigit():
        return np.flatnonzero(state.mesh.numbers == int(word))
    name = state.names["point"].get(word.strip('"').rpartition(".")[2].casefold(), "")
    return state.mesh.point_sets.get(name, np.empty(0, dtype=np.int64))


def _fixed(card: Card) -> dict[str, set[int]]:
    """Directions of each node or set that a *BOUNDARY fixes: all three are so in any system."""
    result: dict[str, set[int]] = {}
    for line in card.lines if card.word == "BOUNDARY" else ():
        words = [word.strip() for word in line.split(",")]
        try:
            held = {i for i, value in components(words[1:]).items() if not value}
        except (ValueError, IndexError):
            continue  # its own reader says what is wrong
        result.setdefault(words[0], set()).update(held)
    return result


def _turned(card: Card, words: list[str], axes: FloatArray) -> list[str] | None:
    """Lines of a set in the directions of the body; None: there are none.

    Nodes by number have their values in the mesh, in the directions of the deck.
    """
    forces = card.word == "CLOAD"
    try:
        held = {int(words[1]): float(words[2])} if forces else components(words[1:])
    except (ValueError, IndexError):
        return None
    if words[0].isdigit() or not held.keys() <= _ALL:
        return None
    lines = []
    for i, value in held.items():
        parts = axes[i - 1]
        if not forces:
            j = int(np.abs(parts).argmax())
            if abs(parts[j]) < 1.0 - 1e-9:
                return None
            parts = np.eye(3)[j] * np.sign(parts[j])
        for j in np.flatnonzero(np.abs(parts) > 1e-12):
            number = float(value * parts[j]) + 0.0
            direction = f"{j + 1}" if forces else f"{j + 1}, {j + 1}"
            lines.append(f"{words[0]}, {direction}, {number!r}")
    return lines
