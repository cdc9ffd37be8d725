"""*EQUATION, where it ties coincident nodes, or joins opposite nodes of a periodic cell."""

from __future__ import annotations

import numpy as np

from dolfin_elastic.case.decks.abaqus.couplings import rows_of
from dolfin_elastic.case.decks.abaqus.equation import NEAR, Equation
from dolfin_elastic.case.decks.abaqus.materials import place
from dolfin_elastic.case.decks.abaqus.state import Reading
from dolfin_elastic.case.decks.coupling import Coupling
from dolfin_elastic.case.decks.deck import Entry
from dolfin_elastic.mesh.formats.abaqus.cards import Card
from dolfin_elastic.mesh.formats.abaqus.numbered import equations, part_name

_OTHER = "equations between nodes are there where they tie coincident nodes, or opposite faces"


def take_equation(state: Reading, card: Card) -> None:
    """The equations of a keyword, one for each node of its sets."""
    if card.options or state.mesh.numbers is None:
        state.fault(card, f"{_OTHER}, without options and in one instance")
        return
    for row, terms in equations(card):
        if not all(1 <= i <= state.dim for _, i, _ in terms):
            state.fault(card, f"{_OTHER}, in directions 1 to {state.dim} only", row)
            continue
        sides = [rows_of(state, word) for word, *_ in terms]
        count = len(sides[0])
        if not all(len(side) in (1, count) and side for side in sides):
            raise card.error("a node of these numbers does not exist", row=row)
        for i in range(count):
            nodes = [side[i % len(side)] for side in sides]
            parts = [(n, i, c) for n, (_, i, c) in zip(nodes, terms, strict=True)]
            _take(state, card, row, parts)


def _take(state: Reading, card: Card, row: int, terms: list[tuple[int, int, float]]) -> None:
    """One equation; nodes of the body are its first ones."""
    (a, i, c), (b, j, d), *others = sorted(terms, key=lambda term: not state.body[term[0]])
    if i != j or not c or c + d or not (state.body[a] and state.body[b]):
        state.fault(card, f"{_OTHER}; this is no difference of two nodes in one direction", row)
        return
    form = {(node, direction): -factor / c for node, direction, factor in others}
    one = Equation(card, row, (a, b), i - 1, form)
    distance = np.linalg.norm(state.mesh.points[a] - state.mesh.points[b])
    size = np.linalg.norm(np.ptp(state.mesh.points[state.body], axis=0))
    if not form and distance <= NEAR * size:
        state.equal.append(one)
        return
    state.equations.append(one)
    for node, _ in form:
        if node in state.couplings and state.couplings[node].kind != "PERIODIC":
            state.fault(card, "it has the reference node of a *COUPLING or *RIGID BODY", row)
            return
        point = [float(x) for x in state.mesh.points[node]]
        state.couplings.setdefault(node, Coupling(place(card), "", point, kind="PERIODIC"))


def tie(state: Reading) -> None:
    """Coincident nodes as one tie, which holds all directions."""
    if not state.equal:
        return
    held: dict[tuple[int, int], int] = {}
    for one in state.equal:
        held[one.nodes] = held.get(one.nodes, 0) | 1 << one.direction
    first = state.equal[0]
    name = part_name(first.card, state.file)
    sides = [np.unique(side) for side in np.array(list(held)).T]
    names = {"on": name, "to": f"{name} to"}
    if any(held[one.nodes] != (1 << state.dim) - 1 for one in state.equal):
        text = "not all directions of its nodes are equal"
    elif not all(
        np.array_equal(state.mesh.point_sets.get(key, ()), side)
        for key, side in zip(names.values(), sides, strict=True)
    ):
        text = "other equations of two terms are among them"
    elif len(np.intersect1d(*sides)) or not all(map(state.skin.covered_by, sides)):
        text = "its nodes are not those of faces of two sides"
    else:
        state.deck.ties.append(Entry(place(first.card), dict(names)))
        return
    state.fault(
        first.card, f"equations between nodes, which are no tie of faces: {text}", first.row
    )
