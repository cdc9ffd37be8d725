"""`read_abaqus`: from the keywords of an input file to its mesh with named sets.

Read here rather than through meshio 5.3, which loses every *SURFACE, fails on *INCLUDE, ignores
*NGEN, and ends the process at element types that it does not know.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import MeshError, nearest
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.formats.abaqus import commands
from dolfin_elastic.mesh.formats.abaqus.cards import Card, read_cards
from dolfin_elastic.mesh.formats.abaqus.deck import STRIDE, Deck, Scope
from dolfin_elastic.mesh.formats.abaqus.elements import (
    Elements,
    Facets,
    element_kind,
    has_no_shape,
    stem,
)
from dolfin_elastic.mesh.formats.abaqus.motions import displaced, system
from dolfin_elastic.mesh.formats.abaqus.numbered import Numbered
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
_OPTIONS = {
    "NODE": ("NSET", "SYSTEM", "INPUT"),
    "ELEMENT": ("TYPE", "ELSET", "INPUT", "SOLID ELEMENT NUMBERING"),
    "INSTANCE": ("NAME", "PART"),
    "PART": ("NAME",),
    **commands.OPTIONS,
}
"""Parameters that are understood."""
_ALIKE = 0.8
"""Likeness from which on an unknown keyword is one of the mesh, misspelt."""


def read_abaqus(path: Path) -> MeshFile:
    """Reads an input file and what it includes. Local: one rank reads.

    Raises:
        MeshError: The file is damaged, or makes its mesh by commands instead of listing it.
    """
    deck, stray, seen = Deck(), "", set[tuple[str, int]]()
    numbered = Numbered(path.name)
    for card in with_parts(deck, read_cards(path)):
        if not card.word and card.lines:
            stray = stray or f"{card.file}:{card.at[0]}"
        _check_understood(card)
        if card.word in _TAKE:
            _TAKE[card.word](deck, card)
            numbered.take(deck, card)
        elif card.word in OF_A_CASE:
            deck.others.append(f"*{card.word}")
            numbered.take(deck, card)
        elif card.word not in SILENT and (card.file, card.line) not in seen:
            seen.add((card.file, card.line))  # once, however many instances its part has
            deck.unread[f"*{card.word}"] += 1
    deck.enter(Scope())
    if not deck.points or not deck.elements:
        raise MeshError(
            "there are no *NODE or no *ELEMENT lines of a body",
            where=path.name,
            expected="an input file of Abaqus or CalculiX with the mesh, or a text of AVS (UCD)",
        )
    if stray:
        raise MeshError(
            "numbers stand before the first keyword",
            where=stray,
            expected="for example *NODE above them",
        )
    numbers, points = _points(deck, path)
    _name_instances(deck)
    blocks = [*_blocks(deck, numbers), *_surfaces(deck, numbers, numbered.pressed)]
    titles = deck.titles()
    sets = {
        titles[key]: _node_rows(deck, key, numbers, joined(rows))
        for key, rows in deck.nsets.items()
    }
    return MeshFile(
        points,
        blocks,
        _notes(deck),
        information=_information(deck),
        point_sets={**numbered.point_sets(numbers), **sets},
        point_data=numbered.point_data(numbers),
        incomplete={titles[key]: reason for key, reason in deck.lost.items()},
        numbers=numbers % STRIDE if len(deck.instances) < 2 else None,
    )


def with_parts(deck: Deck, cards: Iterator[Card]) -> Iterator[Card]:
    """The keywords of a file, and behind each *INSTANCE those of its part."""
    part, card = None, None
    for card in cards:
        if card.word == "PART":
            _check_understood(card)
            name = card.option("NAME")
            if name.upper() in deck.parts:
                raise card.error(f"there is a part '{name}' before it")
            part = deck.parts[name.upper()] = []
            continue
        part = None if card.word in ("END PART", "ASSEMBLY") else part
        if part is not None:
            _check_understood(card)
            part.append(card)
            continue
        yield card
        if card.word == "INSTANCE" and "PART" in card.options:
            name = card.option("PART").upper()
            if name not in deck.parts:
                hint = nearest(name, deck.parts)
                raise card.error(f"there is no part '{name}' before it", expected=hint)
            deck.used.add(name)
            yield from deck.parts[name]
    if deck.parts and card is not None and not deck.instances:
        if len(deck.parts) > 1:
            raise card.error(
                f"the file has {len(deck.parts)} parts without an instance",
                expected="an *ASSEMBLY with an *INSTANCE of each",
            )
        deck.used.update(deck.parts)
        yield from next(iter(deck.parts.values()))


def _name_instances(deck: Deck) -> None:
    """Makes a set of the elements of each instance, where there are several."""
    for key, scope in deck.instances.items():
        index = scope.offset // STRIDE
        labels = joined([e.labels[e.labels // STRIDE == index] for e in deck.elements])
        if len(deck.instances) > 1 and len(labels) and key not in deck.names:
            deck.add(deck.elsets, scope.instance, labels)


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


def _information(deck: Deck) -> list[str]:
    """Elements without stiffness, and keywords that are not read."""
    types, dims = Counter[str](), dict[str, int]()
    for elements in deck.elements:
        types[elements.type] += len(elements.labels)
        dims[elements.type] = Block(elements.kind, _NO_NODES).dim
    low = [f"{types[name]} {name}" for name in dims if dims[name] < max(dims.values())]
    result = (
        [f"elements that name parts only and have no stiffness: {', '.join(low)}"] if low else []
    )
    if unused := ", ".join(name for name in deck.parts if name not in deck.used):
        result.append(f"parts without an instance, which are left out: {unused}")
    if others := ", ".join(dict.fromkeys(deck.others)):
        result.append(f"for the case file, no part of the mesh: {others}")
    if unread := _counted(deck.unread):
        result.append(f"unknown to the reader of meshes: {unread}")
    return result


def _notes(deck: Deck) -> list[str]:
    """Elements that are left out, although they may hold or load the body."""
    left = _counted({name: len(joined(labels)) for name, labels in deck.left.items()})
    return [f"elements that are left out; the case file states such: {left}"] if left else []


def _counted(numbers: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {name}" for name, count in numbers.items())


# --- keywords ---


def _take_nodes(deck: Deck, card: Card) -> None:
    if not card.lines:
        return
    rows = card.numbers(4)
    numbers = rows[:, 0].astype(np.int64)
    bad = np.flatnonzero((numbers != rows[:, 0]) | (numbers < 1) | (numbers >= STRIDE))
    if len(bad):
        raise card.error(f"{rows[bad[0], 0]:g} is no number of a node", row=int(bad[0]))
    numbers = deck.new_numbers("NSET", numbers)
    deck.numbers.append(numbers)
    points = _cartesian(card, rows[:, 1:])
    deck.points.append(points if deck.system is None else deck.system(points))
    if "NSET" in card.options:
        deck.add(deck.nsets, card.option("NSET"), numbers)


def _take_system(deck: Deck, card: Card) -> None:
    deck.system = system(card)


def _cartesian(card: Card, x: FloatArray) -> FloatArray:
    """Coordinates of *NODE, SYSTEM=R (rectangular) or C (radius, angle in degrees, z)."""
    system = card.options.get("SYSTEM", "R").upper()
    if system == "R":
        return x
    if system != "C":
        raise card.error(f"SYSTEM={system} is not understood", expected="R or C")
    angle = np.radians(x[:, 1])
    return np.stack([x[:, 0] * np.cos(angle), x[:, 0] * np.sin(angle), x[:, 2]], axis=1)


def _take_elements(deck: Deck, card: Card) -> None:
    name = card.option("TYPE").upper()
    known = element_kind(name)
    if has_no_shape(name):
        labels = deck.new_numbers("ELSET", card.first_integers())
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
    labels, nodes = _element_rows(deck, card, kind, size)
    deck.elements.append(Elements(kind, labels, nodes, name))
    if "ELSET" in card.options:
        deck.add(deck.elsets, card.option("ELSET"), labels)


def _element_rows(deck: Deck, card: Card, kind: str, size: int) -> tuple[IntArray, IntArray]:
    """Numbers of elements and of their nodes, which in an assembly may be of any instance."""
    scope = deck.scope
    if not scope.in_assembly or not deck.instances:
        first = sum(bool(word.strip()) for word in next(iter(card.lines), "").split(","))
        turned = stem(kind) == "line" and first == size + 2  # a further node turns the section
        rows = card.integers(size + 1 + turned) + scope.offset
        return rows[:, 0], rows[:, 1 : size + 1]
    words = list(card.fields())
    if len(words) % (size + 1):
        raise card.error(f"{len(words)} entries do not make rows of {size + 1}")
    nodes = [
        deck.members(card, scope, "NSET", word, row)
        for i, (row, word) in enumerate(words)
        if i % (size + 1)
    ]
    numbers = [card.integer(row, word) for row, word in words[:: size + 1]]
    labels = deck.new_numbers("ELSET", np.array(numbers, dtype=np.int64))
    if any(len(one) != 1 for one in nodes):
        raise card.error("an element has a set in place of a node")
    return labels, joined(nodes).reshape(-1, size)


def _take_set(deck: Deck, card: Card) -> None:
    sets, scope = deck.nsets if card.word == "NSET" else deck.elsets, deck.scope_of(card)
    name = card.option(card.word)
    if card.word == "NSET" and "UNSORTED" in card.options:
        deck.unsorted.add(deck.name(name))
    if "GENERATE" in card.options:
        deck.add(sets, name, deck.resolved(card, scope, card.word, _generated(card)))
        return
    if card.word == "NSET" and "ELSET" in card.options:
        members = deck.known(card, scope, "ELSET", card.option("ELSET"))
        deck.add(sets, name, _nodes_of(deck, members))
    numbers, others = [], []
    for row, word in card.fields():
        if word.isdigit():
            numbers.append(int(word))
        else:
            others.append(deck.members(card, scope, card.word, word, row))
    own = deck.resolved(card, scope, card.word, np.array(numbers, dtype=np.int64))
    deck.add(sets, name, joined([own, *others]))


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


def _nodes_of(deck: Deck, members: IntArray) -> IntArray:
    return np.unique(
        joined([e.nodes[np.isin(e.labels, members)].reshape(-1) for e in deck.elements])
    )


def _take_surface(deck: Deck, card: Card) -> None:
    deck.surfaces[deck.name(card.option("NAME"))] = card, deck.scope_of(card)


def _take_assembly(deck: Deck, card: Card) -> None:
    if card.word == "ASSEMBLY":
        deck.assemblies.add(card.options.get("NAME", "").upper())
    deck.enter(Scope(in_assembly=card.word != "END ASSEMBLY"))


def _take_instance(deck: Deck, card: Card) -> None:
    name = card.option("NAME")
    if name.upper() in deck.instances:
        raise card.error(f"there is an instance '{name}' before it")
    scope = Scope(name, len(deck.instances) * STRIDE)
    deck.instances[name.upper()] = scope
    deck.enter(scope, displaced(card))


_TAKE: dict[str, Callable[[Deck, Card], None]] = {
    "NODE": _take_nodes,
    "ELEMENT": _take_elements,
    "NSET": _take_set,
    "ELSET": _take_set,
    "SURFACE": _take_surface,
    "SYSTEM": _take_system,
    **dict.fromkeys(commands.OPTIONS, commands.generate),
    "INSTANCE": _take_instance,
    "END INSTANCE": _take_assembly,
    "ASSEMBLY": _take_assembly,
    "END ASSEMBLY": _take_assembly,
}
MESH_WORDS = frozenset((*_TAKE, "PART", "END PART"))
"""Keywords of the mesh."""


# --- the mesh ---


def _points(deck: Deck, path: Path) -> tuple[IntArray, FloatArray]:
    """Numbers of the nodes in ascending order, and their coordinates."""
    every, points = np.concatenate(deck.numbers), np.concatenate(deck.points)
    numbers, first, row = np.unique(every, return_index=True, return_inverse=True)
    other = (points != points[first[row.reshape(-1)]]).any(axis=1) & ~np.isnan(points).any(axis=1)
    if other.any():
        raise MeshError(
            f"{len(np.unique(every[other]))} nodes stand twice, at different positions, for "
            f"example {every[other][0] % STRIDE}",
            where=path.name,
        )
    return numbers, points[first]


def _node_rows(deck: Deck, key: str, numbers: IntArray, wanted: IntArray) -> IntArray:
    wanted = np.unique(wanted)
    rows = find(numbers, wanted)
    deck.mark_incomplete(key, "" if len(wanted) else "it has no nodes")
    deck.mark_incomplete(key, missing(wanted[rows < 0] % STRIDE, len(wanted), "nodes"))
    return rows[rows >= 0]


def _blocks(deck: Deck, numbers: IntArray) -> Iterator[Block]:
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
        lost = np.setdiff1d(members, np.append(every, left))
        deck.mark_incomplete(key, missing(lost % STRIDE, len(members), "elements"))
    titles = deck.titles()
    for elements in deck.elements:
        _check_nodes(elements, numbers)
        parts = {
            titles[key]: np.flatnonzero(np.isin(elements.labels, members))
            for key, members in sets.items()
        }
        yield Block(elements.kind, find_all(numbers, elements.nodes), parts)


def _check_nodes(elements: Elements, numbers: IntArray) -> None:
    """Refuses nodes that do not exist, by their numbers in the file."""
    lost = elements.nodes[find(numbers, elements.nodes) < 0]
    if len(lost):
        find_all(np.empty(0, dtype=np.int64), np.unique(lost) % STRIDE)


def _surfaces(deck: Deck, numbers: IntArray, pressed: Collection[str]) -> Iterator[Block]:
    """Facets of each *SURFACE as blocks of elements; those of type NODE become sets of nodes.

    Args:
        pressed: Keys of those that loads make: without them the mesh is whole.
    """
    facets = Facets(deck.elements)
    result: dict[str, list[tuple[str, IntArray]]] = {}
    titles = deck.titles()
    for key, (card, scope) in deck.surfaces.items():
        kind = card.options.get("TYPE", "ELEMENT").upper()
        if kind == "NODE":
            deck.nsets.setdefault(key, [_nodes_of_surface(deck, card, scope)])
            continue
        if kind != "ELEMENT":  # rigid ones by formulas, cuts
            deck.lost[key], result[key] = f"TYPE={kind} is not read", []
            continue
        try:
            result[key] = list(_facets(deck, key, facets, result))
        except MeshError:
            if key not in pressed:
                raise
            continue
        for kind, nodes in result[key]:
            rows = find_all(numbers, nodes)
            yield Block(kind, rows, {titles[key]: np.arange(len(rows))})


def _nodes_of_surface(deck: Deck, card: Card, scope: Scope) -> IntArray:
    """Nodes of a *SURFACE of type NODE: of each line the first entry, a set or a node."""
    firsts = [(row, line.split(",")[0].strip()) for row, line in enumerate(card.lines)]
    return joined([deck.members(card, scope, "NSET", word, row) for row, word in firsts if word])


def _facets(
    deck: Deck,
    key: str,
    facets: Facets,
    before: dict[str, list[tuple[str, IntArray]]],
) -> Iterator[tuple[str, IntArray]]:
    """Kind and nodes of the facets that the lines of a *SURFACE name."""
    card, scope = deck.surfaces[key]
    combine = card.options.get("COMBINE", "").upper()
    if combine not in ("", "UNION"):
        deck.lost[key] = f"COMBINE={combine} is not read"
        return
    lost = count = 0
    for row, line in enumerate(card.lines):
        name, side = ([*line.split(","), ""])[:2]
        name, side = name.strip(), side.strip().upper()
        if combine:
            other = scope.key(name.strip('"'))
            if other not in before:
                hint = nearest(other, before)
                raise card.error(f"there is no surface '{name}' before it", row=row, expected=hint)
            yield from before[other]
            continue
        members = deck.members(card, scope, "ELSET", name, row)
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
