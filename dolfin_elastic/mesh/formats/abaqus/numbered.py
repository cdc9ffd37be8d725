"""Parts and fields that a deck makes where it states supports and loads, without a name of its own.

A line such as ``17, 2, -5.`` below *CLOAD names a node by its number, ``33, P2, 1.`` below *DLOAD
a face of an element.  A case needs a name for them: it is that of the keyword with its line, as
``CLOAD line 57``.  Forces and temperatures that differ from node to node are fields of this name.
Nodes of springs to the ground are ``ELEMENT line 70``, those that *EQUATION makes equal are
``EQUATION line 80``, and those that they follow this with ``to``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.formats.abaqus.cards import Card
from dolfin_elastic.mesh.formats.abaqus.deck import Deck, Scope
from dolfin_elastic.mesh.formats.raw import find

AXES = "xyz"
FIXED = {
    "ENCASTRE": (1, 2, 3),
    "PINNED": (1, 2, 3),
    "FIXED": (1, 2, 3),
    "XSYMM": (1,),
    "YSYMM": (2,),
    "ZSYMM": (3,),
    "XASYMM": (2, 3),
    "YASYMM": (1, 3),
    "ZASYMM": (1, 2),
}
"""Words of *BOUNDARY to the displacements that they fix; rotations do not exist in solids."""


def part_name(card: Card, file: str) -> str:
    """Name of what a keyword names by numbers.

    Args:
        file: Name of the whole deck; only another one becomes a part of the name.
    """
    inside = f" of {card.file}" if card.file != file else ""
    return f"{card.word} line {card.line}{inside}"


@dataclass
class Numbered:
    """What some keywords name by numbers.

    Attributes:
        file: Name of the deck.
        sets: Name to the numbers of nodes.
        values: Name to a number of each node of a field, by the node's number.
        columns: Name to the columns of this field.
        pressed: Names of surfaces.
        equal: Name of the first *EQUATION of two terms.
    """

    file: str
    sets: dict[str, list[int]] = field(default_factory=dict)
    values: dict[str, dict[int, FloatArray]] = field(default_factory=dict)
    columns: dict[str, int] = field(default_factory=dict)
    pressed: list[str] = field(default_factory=list)
    equal: str = ""

    def take(self, deck: Deck, card: Card) -> None:
        """Takes a keyword of supports or loads; what it does not understand it leaves."""
        action = _TAKE.get(card.word)
        if action is None or "INPUT" in card.options:
            return
        try:
            action(self, deck, card)
        except (MeshError, ValueError, IndexError):
            return  # a mesh has no need of it; `import` says what is wrong

    def point_sets(self, numbers: IntArray) -> dict[str, IntArray]:
        """Name to rows of the nodes.

        Args:
            numbers: Of all nodes, ascending.
        """
        result = {}
        for name, members in self.sets.items():
            rows = find(numbers, np.unique(np.array(members, dtype=np.int64)))
            if (rows >= 0).all():
                result[name] = rows
        return result

    def point_data(self, numbers: IntArray) -> dict[str, FloatArray]:
        """Name to a field at all nodes, 0 where the keyword says nothing.

        Args:
            numbers: Of all nodes, ascending.
        """
        result: dict[str, FloatArray] = {}
        for name, values in self.values.items():
            rows = find(numbers, np.array(list(values), dtype=np.int64))
            table = np.zeros((len(numbers), self.columns[name]))
            if (rows >= 0).all():
                table[rows] = np.array(list(values.values()))
                result[name] = table
        return result


def numbered_rows(card: Card) -> Iterator[tuple[int, list[str]]]:
    """Lines whose first entry is a number, with their entries, after the index of the line."""
    for row, line in enumerate(card.lines):
        words = [word.strip() for word in line.split(",")]
        if words[0].isdecimal():
            yield row, words


def components(words: list[str]) -> Mapping[int, float]:
    """Displacements, 1 to 3, of a line of *BOUNDARY behind its node, and their values.

    Raises:
        ValueError: The line is none of these.
    """
    if words and words[0].upper() in FIXED:
        return dict.fromkeys(FIXED[words[0].upper()], 0.0)
    first = int(words[0])
    last = int(words[1]) if len(words) > 1 and words[1] else first
    value = float(words[2].upper().replace("D", "E")) if len(words) > 2 and words[2] else 0.0
    return dict.fromkeys(range(first, min(last, 3) + 1), value)


def support_words(card: Card, words: list[str]) -> list[str]:
    """What a line of *BOUNDARY says behind its node: no value where it is FIXED."""
    return words[1:3] if "FIXED" in card.options else words[1:]


def _boundary(numbered: Numbered, deck: Deck, card: Card) -> None:
    held: dict[int, dict[int, float]] = {}
    for row, words in numbered_rows(card):
        node = int(deck.members(card, deck.scope_of(card), "NSET", words[0], row)[0])
        held.setdefault(node, {}).update(components(support_words(card, words)))
    name = part_name(card, numbered.file)
    for node, values in held.items():
        if values:
            axes = "".join(AXES[i - 1] for i in sorted(values))
            numbered.sets.setdefault(f"{name} {axes}", []).append(node)
    for i, axis in enumerate(AXES, start=1):
        moved = {node: np.array([values.get(i, 0.0)]) for node, values in held.items()}
        if any(value[0] for value in moved.values()):
            numbered.columns[f"{name} {axis}"] = 1
            numbered.values[f"{name} {axis}"] = moved


def _cload(numbered: Numbered, deck: Deck, card: Card) -> None:
    forces: dict[int, FloatArray] = {}
    for row, words in numbered_rows(card):
        node = int(deck.members(card, deck.scope_of(card), "NSET", words[0], row)[0])
        axis = int(words[1])
        if axis <= 3:
            value = float(words[2].upper().replace("D", "E"))
            forces.setdefault(node, np.zeros(3))[axis - 1] += value
    if forces:
        name = part_name(card, numbered.file)
        numbered.sets[name] = list(forces)
        numbered.values[name], numbered.columns[name] = forces, 3


def _temperature(numbered: Numbered, deck: Deck, card: Card) -> None:
    values: dict[int, FloatArray] = {}
    for row, line in enumerate(card.lines):
        words = [word.strip() for word in line.split(",")]
        members = deck.members(card, deck.scope_of(card), "NSET", words[0], row)
        number = np.array([float(words[1].upper().replace("D", "E"))])
        values.update(dict.fromkeys(map(int, members), number))
    if values:
        name = part_name(card, numbered.file)
        numbered.sets[name] = list(values)
        numbered.values[name], numbered.columns[name] = values, 1


def pressures(card: Card) -> dict[float, list[tuple[int, str, str]]]:
    """Pressure to lines of *DLOAD with faces: index, element or set, and number of the face."""
    result: dict[float, list[tuple[int, str, str]]] = {}
    for row, line in enumerate(card.lines):
        words = [word.strip() for word in line.split(",")]
        if len(words) > 2 and words[1][:1].upper() == "P" and words[1][1:].isdecimal():
            value = float(words[2].upper().replace("D", "E"))
            result.setdefault(value, []).append((row, words[0], words[1][1:]))
    return result


def pressure_names(card: Card, file: str) -> dict[float, str]:
    """Pressure to the name of the surface that it acts on."""
    name, every = part_name(card, file), list(pressures(card))
    return {p: name if len(every) == 1 else f"{name} ({i + 1})" for i, p in enumerate(every)}


def _dload(numbered: Numbered, deck: Deck, card: Card) -> None:
    names = pressure_names(card, numbered.file)
    for value, rows in pressures(card).items():
        surface = Card("SURFACE", {"NAME": names[value]}, card.file, card.line)
        surface.lines = [f"{element}, S{face}" for _, element, face in rows]
        surface.at = [card.at[row] for row, _, _ in rows]
        key = names[value].upper()
        deck.names.setdefault(key, names[value])
        deck.surfaces[key] = surface, deck.scope_of(card) if deck.instances else Scope()
        numbered.pressed.append(key)


def equations(card: Card) -> Iterator[tuple[int, list[tuple[str, int, float]]]]:
    """Each equation below an *EQUATION, after the index of its first line.

    Returns:
        Node or set of nodes, direction from 1, and coefficient of each term.

    Raises:
        ValueError: A line is no part of an equation.
        IndexError: The last one is cut short.
    """
    row = 0
    while row < len(card.lines):
        first, count = row, int(card.lines[row].split(",")[0])
        words = list[str]()
        while len(words) < 3 * count:
            row += 1
            words += [word.strip() for word in card.lines[row].rstrip(", \t").split(",")]
        row += 1
        numbers = [float(word.upper().replace("D", "E")) for word in words[2::3]]
        if count < 2 or len(words) != 3 * count or not all(map(math.isfinite, numbers)):
            raise ValueError(card.lines[first])
        yield first, [*zip(words[::3], map(int, words[1::3]), numbers, strict=True)]


def _equation(numbered: Numbered, deck: Deck, card: Card) -> None:
    for row, terms in equations(card):
        if len(terms) == 2:
            numbered.equal = numbered.equal or part_name(card, numbered.file)
            for name, (word, *_) in zip(
                (numbered.equal, f"{numbered.equal} to"), terms, strict=True
            ):
                members = deck.members(card, deck.scope_of(card), "NSET", word, row)
                numbered.sets.setdefault(name, []).extend(map(int, members))


def _element(numbered: Numbered, deck: Deck, card: Card) -> None:
    """Elements of one node, which have no shape."""
    if card.option("TYPE").upper() == "SPRING1":
        nodes = [
            deck.members(card, deck.scope, "NSET", words[1], row)
            for row, words in numbered_rows(card)
        ]
        numbered.sets[part_name(card, numbered.file)] = [int(n) for one in nodes for n in one]


_TAKE = {
    "ELEMENT": _element,
    "EQUATION": _equation,
    "BOUNDARY": _boundary,
    "CLOAD": _cload,
    "TEMPERATURE": _temperature,
    "DLOAD": _dload,
}
