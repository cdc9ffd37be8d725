"""Keywords of *COUPLING, and what is prescribed at its reference nodes."""

from __future__ import annotations

from dataclasses import replace

from dolfin_elastic.case.decks.abaqus.coupling import ALL, Coupling
from dolfin_elastic.case.decks.abaqus.state import Reading
from dolfin_elastic.mesh.formats.abaqus.cards import Card
from dolfin_elastic.mesh.formats.abaqus.numbered import FIXED

_ROTATIONS = {"ENCASTRE": (4, 5, 6), "XSYMM": (5, 6), "YSYMM": (4, 6), "ZSYMM": (4, 5)}
"""Words of *BOUNDARY to the rotations that they fix."""


def take_coupling(state: Reading, card: Card) -> None:
    """*COUPLING."""
    state.coupling = None
    others = sorted(card.options.keys() - {"CONSTRAINT NAME", "REF NODE", "SURFACE"})
    surface, word = card.option("SURFACE"), card.option("REF NODE")
    if others or state.dim == 2 or state.mesh.numbers is None:
        what = f"{', '.join(others)} is not read" if others else "in 3D and with one instance only"
        state.fault(card, what)
        return
    if surface.casefold() not in state.names["surface"]:
        state.fault(card, f"'{surface[:60]}' is a set of nodes, which covers no faces")
        return
    nodes = _nodes(state, word)
    if len(nodes) != 1:
        raise card.error(f"'{word[:60]}' is not one node")
    row = [*state.mesh.numbers].index(nodes[0])
    point = [float(x) for x in state.mesh.points[row]]
    state.coupling = Coupling(card, state.name(card, "surface", surface), point)
    state.couplings[nodes[0]] = state.coupling


def take_kind(state: Reading, card: Card) -> None:
    """*KINEMATIC or *DISTRIBUTING below it: all directions, as a rigid body or on average."""
    one = state.coupling
    if one is None:
        return  # *COUPLING has said why
    held = {i for line in card.lines for i in _range(card, line.split(","))}
    # Displacements follow the node's rotation whether or not rotations of a solid are listed.
    if card.options or (held and not held >= {1, 2, 3}):
        state.fault(card, "only all directions, without options, are read")
    one.kind, one.turns = card.word, not held or 6 in held


def take_at_nodes(state: Reading, card: Card) -> Card:
    """What *BOUNDARY and *CLOAD prescribe at reference nodes.

    Returns:
        The keyword without these lines.
    """
    if card.options.get("OP", "MOD").upper() == "NEW":
        for one in state.couplings.values():
            (one.moved if card.word == "BOUNDARY" else one.forces).clear()
    rest = list[int]()
    for row, line in enumerate(card.lines):
        words = [word.strip() for word in line.split(",")]
        nodes = _nodes(state, words[0])
        if not nodes or not set(nodes) <= state.couplings.keys():
            if state.couplings.keys() & set(nodes):
                state.fault(card, "reference nodes of *COUPLING beside other nodes", row)
            rest.append(row)
            continue
        if "AMPLITUDE" in card.options:
            state.fault(card, "AMPLITUDE at a reference node of *COUPLING", row)
        for node in nodes:
            _prescribe(state.couplings[node], card, row, words)
    numbered = any(card.lines[row].strip()[:1].isdigit() for row in rest)
    if numbered and len(rest) < len(card.lines):
        state.fault(card, "reference nodes of *COUPLING beside other nodes")
    lines, at = [card.lines[row] for row in rest], [card.at[row] for row in rest]
    return replace(card, lines=lines, at=at)


def _nodes(state: Reading, word: str) -> list[int]:
    """Numbers of a node or of a set of nodes."""
    numbers = state.mesh.numbers
    if word.isdigit() or numbers is None:
        return [int(word)] if word.isdigit() and numbers is not None else []
    name = state.names["point"].get(word.strip('"').rpartition(".")[2].casefold())
    return [int(numbers[row]) for row in state.mesh.point_sets[name]] if name else []


def _range(card: Card, words: list[str]) -> range:
    try:
        first = int(words[0])
        last = int(words[1]) if len(words) > 1 and words[1].strip() else first
    except ValueError:
        raise card.error(f"'{','.join(words)[:60]}' are no directions") from None
    return range(first, min(last, ALL) + 1)


def _prescribe(one: Coupling, card: Card, row: int, words: list[str]) -> None:
    word = words[1].upper() if len(words) > 1 else ""
    if card.word == "BOUNDARY" and word in FIXED:
        one.moved |= dict.fromkeys((*FIXED[word], *_ROTATIONS.get(word, ())), 0.0)
        return
    boundary = card.word == "BOUNDARY"
    at = 3 if boundary else 2
    try:
        value = float((words[at] if len(words) > at else "").upper().replace("D", "E") or "0")
    except ValueError:
        raise card.error(f"'{words[at][:40]}' is no number", row=row) from None
    if not abs(value) < float("inf"):
        raise card.error(f"'{words[at][:40]}' is no finite number", row=row)
    target = one.moved if boundary else one.forces
    target |= dict.fromkeys(_range(card, words[1:3] if boundary else words[1:2]), value)
