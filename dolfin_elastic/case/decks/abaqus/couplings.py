"""Keywords of *COUPLING, and what is prescribed at its reference nodes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dolfin_elastic.case.decks.abaqus.materials import place
from dolfin_elastic.case.decks.abaqus.state import Reading
from dolfin_elastic.case.decks.coupling import ALL, Coupling
from dolfin_elastic.mesh.formats.abaqus.cards import Card
from dolfin_elastic.mesh.formats.abaqus.numbered import FIXED, support_words

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
    nodes = rows_of(state, word)
    if len(nodes) != 1:
        raise card.error(f"'{word[:60]}' is not one node")
    point = [float(x) for x in state.mesh.points[nodes[0]]]
    state.coupling = Coupling(place(card), state.name(card, "surface", surface), point)
    _follow(state, card, nodes[0], state.coupling)


def take_rigid_body(state: Reading, card: Card) -> None:
    """*RIGID BODY of the nodes of a surface; ROT NODE has its rotations as directions 1 to 3."""
    others = sorted(card.options.keys() - {"NSET", "REF NODE", "ROT NODE"})
    if others or state.dim == 2:
        state.fault(card, f"{', '.join(others)} is not read" if others else "it is read in 3D only")
        return
    name = state.name(card, "point", card.option("NSET"))
    if not state.skin.covered_by(state.mesh.point_sets[name]):
        state.fault(card, f"nodes of '{name[:60]}' that are no corners of faces within it")
        return
    nodes = [rows_of(state, card.option("REF NODE"))]
    if "ROT NODE" in card.options:
        nodes.append(rows_of(state, card.option("ROT NODE")))
    if any(len(one) != 1 for one in nodes):
        raise card.error("REF NODE or ROT NODE is not one node")
    point = [float(x) for x in state.mesh.points[nodes[0][0]]]
    one = Coupling(place(card), name, point, kind="KINEMATIC")
    _follow(state, card, nodes[0][0], one)
    if len(nodes) > 1:
        state.turning[nodes[1][0]] = one


def _follow(state: Reading, card: Card, node: int, one: Coupling) -> None:
    """Makes a node the reference node of a surface."""
    if node in state.couplings:
        state.fault(card, "another *COUPLING, *RIGID BODY or *EQUATION has its reference node")
    state.couplings[node] = one


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
    rest, known = list[int](), state.couplings.keys() | state.turning.keys()
    for row, line in enumerate(card.lines):
        words = [word.strip() for word in line.split(",")]
        nodes = rows_of(state, words[0])
        if not nodes or not set(nodes) <= known:
            if known & set(nodes):
                state.fault(card, "reference nodes beside other nodes", row)
            rest.append(row)
            continue
        if "AMPLITUDE" in card.options:
            state.fault(card, "AMPLITUDE at a reference node", row)
        if card.word == "BOUNDARY":
            words[1:] = support_words(card, words)
        for one, shift in filter(None, (follower_of(state, node) for node in nodes)):
            _prescribe(one, card, row, words, shift)
            if _is_turned(state, card, nodes, one, directions(card, words, shift)):
                state.fault(card, "local directions (*TRANSFORM) at a reference node", row)
    numbered = any(card.lines[row].strip()[:1].isdigit() for row in rest)
    cell = all(one.kind == "PERIODIC" for one in state.couplings.values())
    if numbered and len(rest) < len(card.lines) and not cell:
        state.fault(card, "reference nodes beside other nodes")
    lines, at = [card.lines[row] for row in rest], [card.at[row] for row in rest]
    return replace(card, lines=lines, at=at)


def rows_of(state: Reading, word: str) -> list[int]:
    """Rows of a node or of a set of nodes; none of a number that several instances have."""
    if word.isdigit():
        rows = [int(row) for row in np.flatnonzero(state.mesh.numbers == int(word))]
        return rows if len(rows) == 1 else []
    name = state.names["point"].get(word.strip('"').rpartition(".")[2].casefold())
    return [*map(int, state.mesh.point_sets[name])] if name else []


def _range(card: Card, words: list[str]) -> range:
    try:
        first = int(words[0])
        last = int(words[1]) if len(words) > 1 and words[1].strip() else first
    except ValueError:
        raise card.error(f"'{','.join(words)[:60]}' are no directions") from None
    return range(first, min(last, ALL) + 1)


def follower_of(state: Reading, node: int) -> tuple[Coupling, int] | None:
    """What follows a node, and 3 if directions 1 to 3 of the node are rotations, else 0."""
    if node in state.turning:
        return state.turning[node], 3
    return (state.couplings[node], 0) if node in state.couplings else None


def directions(card: Card, words: list[str], shift: int) -> list[int]:
    """Directions, 1 to 6, of a line at a reference node.

    Args:
        shift: See `follower_of`.
    """
    boundary, word = card.word == "BOUNDARY", words[1].upper() if len(words) > 1 else ""
    if boundary and word in FIXED:
        held = FIXED[word] if shift else (*FIXED[word], *_ROTATIONS.get(word, ()))
    else:
        held = (*_range(card, words[1:3] if boundary else words[1:2]),)
    return [i + shift for i in held if i + shift <= ALL]


def _is_turned(
    state: Reading, card: Card, nodes: list[int], one: Coupling, held: list[int]
) -> bool:
    """Whether a line is in local directions, and would be another one in those of the body.

    What is 0 in all three directions is so in any.

    Args:
        nodes: Rows of the nodes that the line names.
        held: Directions, 1 to 6, that it has prescribed.
    """
    local = any(np.isin(nodes, other.nodes).any() for other in state.transforms)
    triples = [set(held) & three for three in ({1, 2, 3}, {4, 5, 6})]
    still = card.word == "BOUNDARY" and not any(one.moved[i] for i in held)
    return local and not (still and all(len(some) in (0, 3) for some in triples))


def _prescribe(one: Coupling, card: Card, row: int, words: list[str], shift: int) -> None:
    """One line.

    Args:
        shift: See `follower_of`.
    """
    boundary, held = card.word == "BOUNDARY", directions(card, words, shift)
    at = 3 if boundary else 2
    try:
        value = float((words[at] if len(words) > at else "").upper().replace("D", "E") or "0")
    except ValueError:
        raise card.error(f"'{words[at][:40]}' is no number", row=row) from None
    if not abs(value) < float("inf"):
        raise card.error(f"'{words[at][:40]}' is no finite number", row=row)
    (one.moved if boundary else one.forces).update(dict.fromkeys(held, value))
