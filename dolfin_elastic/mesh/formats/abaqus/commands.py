"""Commands that make nodes and elements from others: *NGEN, *NFILL, *NCOPY, *ELGEN, *ELCOPY."""

from __future__ import annotations

from itertools import product

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.formats.abaqus.cards import Card
from dolfin_elastic.mesh.formats.abaqus.deck import STRIDE, Deck
from dolfin_elastic.mesh.formats.abaqus.elements import Elements
from dolfin_elastic.mesh.formats.abaqus.motions import displaced
from dolfin_elastic.mesh.formats.raw import find, joined

OPTIONS = {
    "NGEN": ("NSET", "LINE"),
    "NFILL": ("NSET",),
    "NCOPY": ("CHANGE NUMBER", "OLD SET", "SHIFT", "MULTIPLE", "NEW SET"),
    "ELGEN": ("ELSET",),
    "ELCOPY": ("ELEMENT SHIFT", "OLD SET", "SHIFT NODES", "NEW SET"),
}
"""Parameters that are understood."""
_SAME_RADIUS = 1e-3
"""Relative difference of the radii of both ends of an arc."""
_LARGEST, _MOST = 1 << 32, 1 << 27
"""Of numbers in commands, and of copies that one line makes."""


def generate(deck: Deck, card: Card) -> None:
    """Carries out one of the commands."""
    commands = {"NGEN": _ngen, "NFILL": _nfill, "NCOPY": _ncopy, "ELGEN": _elgen}
    commands.get(card.word, _elcopy)(deck, card)


def _ngen(deck: Deck, card: Card) -> None:
    """Nodes on a line between two nodes: straight, LINE=P a parabola, LINE=C an arc."""
    kind = card.options.get("LINE", "").upper()
    for row, line in enumerate(card.lines):
        words = [*(word.strip() for word in line.split(",")), *[""] * 7][:7]
        rest = line.split(",")[7:]
        if kind not in ("", "P", "C") or any(word.strip() for word in rest):
            raise _nothing(card, row, "first, last, step, and for LINE=C or P a third node")
        first, last, step = _whole(card, row, [*words[:2], words[2] or "1"])
        count, left = divmod(abs(last - first), max(step, 1))
        if step < 1 or left or not count:
            raise _nothing(card, row, "first, last, step")
        _count(card, row, count)
        ends = np.array([first, last], dtype=np.int64)
        a, b = _positions(deck, card, row, ends + deck.scope.offset)
        t = np.arange(1, count)[:, None] / count
        x = (1 - t) * a + t * b
        if kind:
            c = _third(deck, card, row, words[3:])
            # The quadratic through a, c and b at t = 0, 1/2, 1.
            bow = 4 * t * (1 - t) * (c - (a + b) / 2)
            x = x + bow if kind == "P" else _arc(card, row, a, b, c, t)
        numbers = first + np.sign(last - first) * step * np.arange(1, count) + deck.scope.offset
        _add_nodes(deck, card, numbers, x, "NSET", ends + deck.scope.offset)


def _third(deck: Deck, card: Card, row: int, words: list[str]) -> FloatArray:
    """The third point of a line: a node, or coordinates in the present system."""
    if words[0]:
        (number,) = _whole(card, row, words[:1])
        return _positions(deck, card, row, np.array([number + deck.scope.offset]))[0]
    try:
        point = np.array([float(word or 0) for word in words[1:]])
    except ValueError:
        raise _nothing(card, row, "coordinates of the third point") from None
    return point if deck.system is None else deck.system(point[None])[0]


def _arc(
    card: Card, row: int, a: FloatArray, b: FloatArray, centre: FloatArray, t: FloatArray
) -> FloatArray:
    """Points of the arc from a to b at the fractions t of its angle."""
    a, b = a - centre, b - centre
    radii = np.linalg.norm(a), np.linalg.norm(b)
    sine = np.linalg.norm(np.cross(a, b))
    if abs(radii[0] - radii[1]) > _SAME_RADIUS * radii[0] or not sine > 1e-9 * radii[0] ** 2:
        raise _nothing(card, row, "an arc of less than 180 degrees round the third point")
    angle = np.arctan2(sine, a @ b)
    return np.asarray(
        centre + (np.sin((1 - t) * angle) * a + np.sin(t * angle) * b) / np.sin(angle)
    )


def _nfill(deck: Deck, card: Card) -> None:
    """Nodes between those of two sets, in the order of their numbers."""
    for row, line in enumerate(card.lines):
        words = [*(word.strip() for word in line.split(",")), *[""] * 4][:4]
        count, step = _whole(card, row, [words[2], words[3] or "1"])
        keys = [deck.scope.key(word) for word in words[:2]]
        sets = [deck.known(card, deck.scope, "NSET", word, row) for word in words[:2]]
        a, b = (
            numbers if key in deck.unsorted else np.unique(numbers)
            for key, numbers in zip(keys, sets, strict=True)
        )
        if count < 1 or len(a) != len(b):
            raise _nothing(card, row, "two sets of as many nodes, and the number of intervals")
        x, y = _positions(deck, card, row, a), _positions(deck, card, row, b)
        for k in range(1, _count(card, row, count)):
            _add_nodes(deck, card, a + k * step, x + (y - x) * k / count, "NSET")
        if "NSET" in card.options:
            deck.add(deck.nsets, card.option("NSET"), np.concatenate([a, b]))


def _ncopy(deck: Deck, card: Card) -> None:
    """Copies of a set of nodes, each moved and turned from the one before."""
    if "SHIFT" not in card.options:
        raise card.error("SHIFT is missing", expected="copies by SHIFT are read, no others")
    old = np.unique(deck.known(card, deck.scope, "NSET", card.option("OLD SET")))
    (change,) = _whole(card, None, [card.option("CHANGE NUMBER")])
    (times,) = _whole(card, None, [card.options.get("MULTIPLE", "1")])
    move = displaced(card)
    x = _positions(deck, card, None, old)
    for k in range(1, _count(card, None, times) + 1):
        x = move(x)
        _add_nodes(deck, card, old + k * change, x, "NEW SET")


def _elgen(deck: Deck, card: Card) -> None:
    """Rows of copies of an element, layers of rows, and blocks of layers."""
    for row, line in enumerate(card.lines):
        words = [*(word.strip() or "1" for word in line.split(",")), *["1"] * 10][:10]
        first, *steps = _whole(card, row, words)
        if min(steps[::3]) < 1:
            raise _nothing(card, row, "element, count, steps of nodes and elements, count ...")
        _count(card, row, steps[0] * steps[3] * steps[6])
        counts = np.array(list(product(*(range(n) for n in steps[::3]))), dtype=np.int64)
        of_nodes, of_elements = counts @ steps[1::3], counts @ steps[2::3]
        label = first + deck.scope.offset
        one = next((e for e in deck.elements if label in e.labels), None)
        if one is None:
            raise card.error(f"the element {first} does not exist before it", row=row)
        nodes = one.nodes[one.labels == label][:1] + of_nodes[:, None]
        labels = _checked(deck, card, label + of_elements)
        deck.elements.append(Elements(one.kind, labels[1:], nodes[1:], one.type))
        if "ELSET" in card.options:
            deck.add(deck.elsets, card.option("ELSET"), labels)


def _elcopy(deck: Deck, card: Card) -> None:
    """A copy of a set of elements with other numbers of elements and nodes."""
    old = np.unique(deck.known(card, deck.scope, "ELSET", card.option("OLD SET")))
    keys = ("ELEMENT SHIFT", "SHIFT NODES")
    shift, of_nodes = _whole(card, None, [card.option(key) for key in keys])
    for one in list(deck.elements):
        inside = np.isin(one.labels, old)
        if inside.any():
            labels, nodes = one.labels[inside] + shift, one.nodes[inside] + of_nodes
            labels = _checked(deck, card, labels)
            deck.elements.append(Elements(one.kind, labels, nodes, one.type))
    if "NEW SET" in card.options:
        deck.add(deck.elsets, card.option("NEW SET"), old + shift)


def _positions(deck: Deck, card: Card, row: int | None, wanted: IntArray) -> FloatArray:
    """Coordinates of nodes of the present part."""
    numbers = joined(deck.numbers[deck.moved :])
    order = np.argsort(numbers, kind="stable")
    at = find(numbers[order], wanted)
    if (at < 0).any():
        number = deck.label(wanted[at < 0][0])
        raise card.error(f"the node {number} does not exist before it", row=row)
    return np.asarray(np.concatenate(deck.points[deck.moved :])[order[at]])


def _add_nodes(
    deck: Deck, card: Card, numbers: IntArray, x: FloatArray, key: str, ends: IntArray | None = None
) -> None:
    deck.numbers.append(_checked(deck, card, numbers))
    deck.points.append(x)
    if key in card.options:
        more = [] if ends is None else [ends]
        deck.add(deck.nsets, card.option(key), joined([numbers, *more]))


def _whole(card: Card, row: int | None, words: list[str]) -> list[int]:
    """Entries of a line as integers that no sum of products with counts lets overflow."""
    numbers = [card.integer(row, word) for word in words]
    for number in numbers:
        if abs(number) >= _LARGEST:
            raise card.error(f"the number {number} is too large", row=row)
    return numbers


def _count(card: Card, row: int | None, count: int) -> int:
    if not 1 <= count <= _MOST:
        raise card.error(f"{count} is no number of copies", row=row, expected=f"1 to {_MOST}")
    return count


def _checked(deck: Deck, card: Card, numbers: IntArray) -> IntArray:
    """New numbers, which may not be those of another instance."""
    offset = numbers - deck.scope.offset
    wrong = offset[(offset < 1) | (offset >= STRIDE)]
    if len(wrong):
        raise card.error(f"{wrong[0]} is no number of a node or an element")
    return numbers


def _nothing(card: Card, row: int, expected: str) -> MeshError:
    return card.error(f"'{card.lines[row].strip()}' generates nothing", row=row, expected=expected)
