"""`read_abaqus`: from the keywords of an input file to its mesh with named sets.

Read here rather than through meshio 5.3, which loses every *SURFACE, fails on *INCLUDE, ignores
*NGEN, and ends the process at element types that it does not know.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import MeshError, nearest
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.formats.abaqus.cards import Card, read_cards
from dolfin_elastic.mesh.formats.abaqus.elements import (
    Elements,
    Facets,
    element_kind,
    has_no_shape,
)
from dolfin_elastic.mesh.formats.abaqus.words import (
    OF_A_CASE,
    REFUSED,
    SILENT,
    speaks_of_the_mesh,
)
from dolfin_elastic.mesh.formats.raw import (
    Block,
    MeshFile,
    find,
    find_all,
    joined,
    kind_name,
    missing,
)

_NO_NODES = np.empty((0, 0), dtype=np.int64)
_ASSEMBLY = 1 << 40
"""Offset of the numbers of nodes that belong to an assembly itself, such as reference points: they
begin at 1, as those of the part do."""
_OPTIONS = {
    "NODE": ("NSET", "SYSTEM", "INPUT"),
    "ELEMENT": ("TYPE", "ELSET", "INPUT", "SOLID ELEMENT NUMBERING"),
    "INSTANCE": ("NAME", "PART"),
    "PART": ("NAME",),
}
"""Parameters that are understood."""
_ALIKE = 0.8
"""Likeness from which on an unknown keyword is one of the mesh, misspelt."""


@dataclass
class _Deck:
    """Content of the file in its own numbering; keys of sets are in capitals.

    Attributes:
        numbers: Of the nodes.
        points: Their coordinates, shape (n, 3) each.
        elements: Kind, numbers and nodes of the elements of each *ELEMENT.
        nsets: Nodes of each *NSET.
        elsets: Elements of each *ELSET.
        surfaces: Each *SURFACE.
        names: The spelling that a name had first.
        lost: Name of an incomplete set to the reason.
        parts: Number of *PART keywords.
        scope: ASSEMBLY in an assembly outside of its instances; else empty.
        references: Numbers of nodes of the assembly itself, beside those of its part.
        others: Keywords that are not read, because the case file takes their place.
        unread: Other keywords that are not read, to their number.
        types: Type to number of elements.
        left: Type to the numbers of elements that have no shape.
    """

    numbers: list[IntArray] = field(default_factory=list)
    points: list[FloatArray] = field(default_factory=list)
    elements: list[Elements] = field(default_factory=list)
    nsets: dict[str, list[IntArray]] = field(default_factory=dict)
    elsets: dict[str, list[IntArray]] = field(default_factory=dict)
    surfaces: dict[str, Card] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    lost: dict[str, str] = field(default_factory=dict)
    parts: int = 0
    scope: str = ""
    references: list[IntArray] = field(default_factory=list)
    others: list[str] = field(default_factory=list)
    unread: Counter[str] = field(default_factory=Counter)
    types: Counter[str] = field(default_factory=Counter)
    left: dict[str, list[IntArray]] = field(default_factory=dict)

    def add(self, sets: dict[str, list[IntArray]], name: str, numbers: IntArray) -> None:
        """Adds members to a set."""
        self.names.setdefault(name.upper(), name)
        sets.setdefault(name.upper(), []).append(numbers)

    def mark_incomplete(self, key: str, reason: str) -> None:
        """Records why a set is incomplete.

        Args:
            reason: Why; empty where it is complete.
        """
        if reason:
            self.lost[key] = reason


def read_abaqus(path: Path) -> MeshFile:
    """Reads an input file and what it includes. Local: one rank reads.

    Raises:
        MeshError: The file is damaged, or makes its mesh by commands instead of listing it.
    """
    deck, stray = _Deck(), ""
    for card in read_cards(path):
        if not card.word and card.lines:
            stray = stray or f"{card.file}:{card.at[0]}"
        _check_understood(card)
        if card.word in _TAKE:
            _TAKE[card.word](deck, card)
        elif card.word in OF_A_CASE:
            deck.others.append(f"*{card.word}")
        elif card.word not in SILENT:
            deck.unread[f"*{card.word}"] += 1
    if not deck.points or not deck.elements:
        raise MeshError("there are no *NODE or no *ELEMENT lines", where=path.name)
    if stray:
        raise MeshError(
            "numbers stand before the first keyword",
            where=stray,
            expected="for example *NODE above them",
        )
    numbers, points = _points(deck, path)
    blocks = [*_blocks(deck, numbers), *_surfaces(deck, numbers)]
    sets = {
        deck.names[key]: _node_rows(deck, key, numbers, joined(rows))
        for key, rows in deck.nsets.items()
    }
    lost = {deck.names[key]: reason for key, reason in deck.lost.items()}
    information = _information(deck)
    return MeshFile(
        points, blocks, _notes(deck), information=information, point_sets=sets, incomplete=lost
    )


def _check_understood(card: Card) -> None:
    """Refuses what would define nodes, elements or coordinates and is not understood."""
    if card.word in REFUSED:
        raise card.error("this is not understood", expected="write the mesh out in full")
    unknown = [key for key in card.options if key not in _OPTIONS.get(card.word, card.options)]
    if unknown:
        known = ", ".join(_OPTIONS[card.word])
        raise card.error(f"{unknown[0]} is not understood", expected=f"known: {known}")
    if card.word in _TAKE or card.word in SILENT or card.word in OF_A_CASE:
        return
    alike = get_close_matches(card.word, _TAKE, n=1, cutoff=_ALIKE)
    if alike or speaks_of_the_mesh(card.word):
        hint = f"did you mean *{alike[0]}?" if alike else "*NODE, *ELEMENT"
        raise card.error("this keyword is not understood", expected=hint)


def _information(deck: _Deck) -> list[str]:
    """Elements without stiffness, and keywords that are not read."""
    dims = {
        name: Block(kind[0], _NO_NODES).dim for name in deck.types if (kind := element_kind(name))
    }
    low = [f"{deck.types[name]} {name}" for name in dims if dims[name] < max(dims.values())]
    result = (
        [f"elements that name parts only and have no stiffness: {', '.join(low)}"] if low else []
    )
    if others := ", ".join(dict.fromkeys(deck.others)):
        result.append(f"not read, because the case file states it: {others}")
    if unread := _counted(deck.unread):
        result.append(f"keywords that are not read: {unread}")
    return result


def _notes(deck: _Deck) -> list[str]:
    """Elements that are left out, although they may hold or load the body."""
    left = _counted({name: len(joined(labels)) for name, labels in deck.left.items()})
    return [f"elements that are left out; the case file states such: {left}"] if left else []


def _counted(numbers: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {name}" for name, count in numbers.items())


# --- keywords ---


def _take_nodes(deck: _Deck, card: Card) -> None:
    if not card.lines:
        return
    rows = card.numbers(4)
    numbers = rows[:, 0].astype(np.int64)
    bad = np.flatnonzero((numbers != rows[:, 0]) | (numbers < 1))
    if len(bad):
        raise card.error(f"{rows[bad[0], 0]:g} is no number of a node", row=int(bad[0]))
    if deck.scope and deck.points:
        deck.references.append(numbers)
        numbers = numbers + _ASSEMBLY
    deck.numbers.append(numbers)
    deck.points.append(_cartesian(card, rows[:, 1:]))
    if "NSET" in card.options:
        deck.add(deck.nsets, card.option("NSET"), numbers)


def _cartesian(card: Card, x: FloatArray) -> FloatArray:
    """Coordinates of *NODE, SYSTEM=R (rectangular) or C (radius, angle in degrees, z)."""
    system = card.options.get("SYSTEM", "R").upper()
    if system == "R":
        return x
    if system != "C":
        raise card.error(f"SYSTEM={system} is not understood", expected="R or C")
    angle = np.radians(x[:, 1])
    return np.stack([x[:, 0] * np.cos(angle), x[:, 0] * np.sin(angle), x[:, 2]], axis=1)


def _take_elements(deck: _Deck, card: Card) -> None:
    name = card.option("TYPE").upper()
    known = element_kind(name)
    if has_no_shape(name):
        labels = card.first_integers()
        deck.left.setdefault(name, []).append(labels)
        if "ELSET" in card.options:
            deck.add(deck.elsets, card.option("ELSET"), labels)
        return
    if known is None:
        raise card.error(
            f"the element type {name} is unknown",
            expected="C3D4 and C3D10 (tetrahedra), CPE3 and CPE6 (plane) are read",
        )
    kind, size = known
    rows = card.integers(size + 1)
    deck.types[name] += len(rows)
    deck.elements.append(Elements(kind, rows[:, 0], rows[:, 1:]))
    if "ELSET" in card.options:
        deck.add(deck.elsets, card.option("ELSET"), rows[:, 0])


def _take_set(deck: _Deck, card: Card) -> None:
    sets = deck.nsets if card.word == "NSET" else deck.elsets
    name = card.option(card.word)
    if "GENERATE" in card.options:
        deck.add(sets, name, _in_scope(deck, card, _generated(card)))
        return
    if card.word == "NSET" and "ELSET" in card.options:
        members = _known(card, deck.elsets, card.option("ELSET"), "ELSET")
        deck.add(sets, name, _nodes_of(deck, members))
    numbers, others = [], []
    for row, word in card.fields():
        if word.isdigit():
            numbers.append(int(word))
        else:
            others.append(_known(card, sets, word, card.word, row))
    own = _in_scope(deck, card, np.array(numbers, dtype=np.int64))
    deck.add(sets, name, joined([own, *others]))


def _in_scope(deck: _Deck, card: Card, numbers: IntArray) -> IntArray:
    """Numbers of a *NSET: those of the assembly itself mean its own nodes, if there are such."""
    if card.word != "NSET" or not deck.scope or "INSTANCE" in card.options:
        return numbers
    own = np.isin(numbers, joined(deck.references))
    return np.where(own, numbers + _ASSEMBLY, numbers)


def _generated(card: Card) -> IntArray:
    """Numbers of lines "first, last, step"."""
    result = []
    for row, line in enumerate(card.lines):
        words = [word.strip() for word in line.split(",") if word.strip()]
        if not 2 <= len(words) <= 3 or not all(word.isdigit() for word in words):
            raise card.error(
                f"'{line.strip()}' generates nothing", row=row, expected="first, last, step"
            )
        first, last, step = [*(int(word) for word in words), 1][:3]
        if step < 1 or (last - first) // step > 1 << 31:
            raise card.error(f"'{line.strip()}' generates nothing", row=row)
        result.append(np.arange(first, last + 1, step, dtype=np.int64))
    return joined(result)


def _nodes_of(deck: _Deck, members: IntArray) -> IntArray:
    return np.unique(
        joined([e.nodes[np.isin(e.labels, members)].reshape(-1) for e in deck.elements])
    )


def _known(
    card: Card, sets: dict[str, list[IntArray]], word: str, what: str, row: int | None = None
) -> IntArray:
    """Members of a set that a data line names."""
    name = word.strip('"').rpartition(".")[2]  # "Part-1.Set" within an assembly
    if name.upper() not in sets:
        hint = nearest(name.upper(), sets)
        raise card.error(f"the {what} '{word}' does not exist", row=row, expected=hint)
    return joined(sets[name.upper()])


def _take_surface(deck: _Deck, card: Card) -> None:
    name = card.option("NAME")
    deck.names.setdefault(name.upper(), name)
    deck.surfaces[name.upper()] = card


def _take_part(deck: _Deck, card: Card) -> None:
    deck.parts += 1
    if deck.parts > 1:
        raise card.error("the file has more than one part", expected="merge them into one")


def _enter(deck: _Deck, card: Card) -> None:
    deck.scope = "ASSEMBLY" if card.word in ("ASSEMBLY", "END INSTANCE") else ""


def _take_instance(deck: _Deck, card: Card) -> None:
    _enter(deck, card)
    if card.lines and card.numbers(7).any():  # a translation, and a rotation in a second line
        raise card.error("the instance is moved or turned", expected="save the mesh in place")


_TAKE: dict[str, Callable[[_Deck, Card], None]] = {
    "NODE": _take_nodes,
    "ELEMENT": _take_elements,
    "NSET": _take_set,
    "ELSET": _take_set,
    "SURFACE": _take_surface,
    "PART": _take_part,
    "INSTANCE": _take_instance,
    "END INSTANCE": _enter,
    "ASSEMBLY": _enter,
    "END ASSEMBLY": _enter,
}


# --- the mesh ---


def _points(deck: _Deck, path: Path) -> tuple[IntArray, FloatArray]:
    """Numbers of the nodes in ascending order, and their coordinates."""
    every, points = np.concatenate(deck.numbers), np.concatenate(deck.points)
    numbers, first, row = np.unique(every, return_index=True, return_inverse=True)
    other = (points != points[first[row.reshape(-1)]]).any(axis=1) & ~np.isnan(points).any(axis=1)
    if other.any():
        raise MeshError(
            f"{len(np.unique(every[other]))} nodes stand twice, at different positions, for "
            f"example {every[other][0]}",
            where=path.name,
        )
    return numbers, points[first]


def _node_rows(deck: _Deck, key: str, numbers: IntArray, wanted: IntArray) -> IntArray:
    wanted = np.unique(wanted)
    rows = find(numbers, wanted)
    deck.mark_incomplete(key, "" if len(wanted) else "it has no nodes")
    deck.mark_incomplete(key, missing(wanted[rows < 0], len(wanted), "nodes"))
    return rows[rows >= 0]


def _blocks(deck: _Deck, numbers: IntArray) -> Iterator[Block]:
    sets = {key: np.unique(joined(rows)) for key, rows in deck.elsets.items()}
    labels = np.concatenate([elements.labels for elements in deck.elements])
    every, times = np.unique(labels, return_counts=True)
    left = joined([rows for labels in deck.left.values() for rows in labels])
    for key, members in sets.items():
        if len(members) and np.isin(members, left).all():
            deck.mark_incomplete(key, "its elements are left out")
            continue
        twice = np.count_nonzero(np.isin(members, every[times > 1]))
        if twice:
            deck.mark_incomplete(
                key, f"{twice} of its {len(members)} elements stand twice in the file"
            )
        deck.mark_incomplete(key, "" if len(members) else "it has no elements")
        deck.mark_incomplete(
            key, missing(np.setdiff1d(members, np.append(every, left)), len(members), "elements")
        )
    for elements in deck.elements:
        parts = {
            deck.names[key]: np.flatnonzero(np.isin(elements.labels, members))
            for key, members in sets.items()
        }
        yield Block(elements.kind, find_all(numbers, elements.nodes), parts)


def _surfaces(deck: _Deck, numbers: IntArray) -> Iterator[Block]:
    """Facets of each *SURFACE as blocks of elements; those of type NODE become sets of nodes."""
    facets = Facets(deck.elements)
    result: dict[str, list[tuple[str, IntArray]]] = {}
    for key, card in deck.surfaces.items():
        if card.options.get("TYPE", "ELEMENT").upper() == "NODE":
            deck.nsets.setdefault(key, [_members(deck, card, "NSET")])
            continue
        result[key] = list(_facets(deck, key, card, facets, result))
        for kind, nodes in result[key]:
            rows = find_all(numbers, nodes)
            yield Block(kind, rows, {deck.names[key]: np.arange(len(rows))})


def _members(deck: _Deck, card: Card, what: str) -> IntArray:
    """Nodes of a *SURFACE of type NODE: of each line the first entry, a set or a node."""
    firsts = [(row, line.split(",")[0].strip()) for row, line in enumerate(card.lines)]
    return joined(
        [
            np.array([int(word)]) if word.isdigit() else _known(card, deck.nsets, word, what, row)
            for row, word in firsts
            if word
        ]
    )


def _facets(
    deck: _Deck,
    key: str,
    card: Card,
    facets: Facets,
    before: dict[str, list[tuple[str, IntArray]]],
) -> Iterator[tuple[str, IntArray]]:
    """Kind and nodes of the facets that the lines of a *SURFACE name."""
    combine = card.options.get("COMBINE", "").upper()
    if combine not in ("", "UNION"):
        deck.lost[key] = f"COMBINE={combine} is not read"
        return
    lost = count = 0
    for row, line in enumerate(card.lines):
        name, side = ([*line.split(","), ""])[:2]
        name, side = name.strip(), side.strip().upper()
        if combine:
            other = name.strip('"').upper()
            if other not in before:
                hint = nearest(other, before)
                raise card.error(f"there is no surface '{name}' before it", row=row, expected=hint)
            yield from before[other]
            continue
        one = name.isdigit()
        members = np.array([int(name)]) if one else _known(card, deck.elsets, name, "ELSET", row)
        picked = facets.pick(np.unique(members), side)
        if picked.unsupported:
            raise card.error(
                f"'{key}' asks for faces of {kind_name(picked.unsupported)}, which are not "
                "supported",
                row=row,
                expected="mesh with tetrahedra, or with triangles in 2D",
            )
        if picked.unknown_side:
            raise card.error(f"'{key}' asks for the face '{side}', which no element has", row=row)
        count, lost = count + picked.asked, lost + picked.missing
        yield from picked.found
    if lost:
        deck.lost[key] = f"{lost} of its {count} elements do not exist, or have no such face"
