"""Abaqus input files (.inp), as CalculiX, Cubit, Salome and others write them too.

Read here rather than through meshio 5.3, which loses every *SURFACE, fails on *INCLUDE, ignores
*NGEN, and ends the process at element types that it does not know.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.formats.raw import Block, MeshFile, boundary, match_rows

# An element type starts with one of these; what follows (H, R, M, T ...) is its formulation.
_KINDS = {
    ("tetra", 4): "C3D4 DC3D4 AC3D4",
    ("tetra10", 10): "C3D10 DC3D10 AC3D10",
    ("triangle", 3): "CPE3 CPS3 CAX3 S3 M3D3 R3D3 SFM3D3 STRI3 DC2D3",
    ("triangle6", 6): "CPE6 CPS6 CAX6 STRI65 M3D6 SFM3D6 DC2D6 S6",
    ("quad", 4): "CPE4 CPS4 CAX4 S4 M3D4 R3D4 SFM3D4",
    ("quad8", 8): "CPE8 CPS8 CAX8 S8 M3D8",
    ("hexahedron", 8): "C3D8 DC3D8 SC8",
    ("hexahedron20", 20): "C3D20 DC3D20",
    ("hexahedron27", 27): "C3D27",
    ("wedge", 6): "C3D6 DC3D6 SC6",
    ("wedge15", 15): "C3D15",
    ("pyramid", 5): "C3D5",
    ("line", 2): "T3D2 T2D2 B21 B31 B33 R2D2 CONN3D2",
    ("line3", 3): "T3D3 T2D3 B22 B32",
    ("vertex", 1): "MASS ROTARYI SPRING1 DASHPOT1",
}
# Vertices of the faces S1, S2 ... in the order of the Abaqus manual.
_FACES = {
    "tetra": ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)),
    "triangle": ((0, 1), (1, 2), (2, 0)),
}
_UNREAD = ("NGEN", "NFILL", "NCOPY", "ELGEN", "ELCOPY", "NMAP", "SYSTEM")


@dataclass
class _Card:
    """One keyword line and the data lines below it."""

    word: str
    options: dict[str, str]
    lines: list[str] = field(default_factory=list)

    def option(self, key: str) -> str:
        """Value of a required option."""
        if key not in self.options:
            raise MeshError(f"*{self.word} without {key}=")
        return self.options[key]

    def words(self) -> list[str]:
        """All comma-separated entries of the data lines."""
        return [w.strip() for line in self.lines for w in line.split(",") if w.strip()]

    def rows(self, width: int) -> IntArray:
        """All entries as integers, shape (n, width)."""
        try:
            numbers = np.array(self.words(), dtype=np.int64)
        except ValueError:
            raise MeshError(f"*{self.word} holds something that is no whole number") from None
        if len(numbers) % width:
            raise MeshError(
                f"*{self.word}: {len(numbers)} numbers do not make rows of {width}; "
                "the file is damaged or cut short"
            )
        return numbers.reshape(-1, width)


@dataclass
class _Deck:
    """Content of the file in its own numbering; keys of sets are in capitals."""

    numbers: list[IntArray] = field(default_factory=list)
    points: list[FloatArray] = field(default_factory=list)
    elements: list[tuple[str, IntArray, IntArray]] = field(default_factory=list)
    nsets: dict[str, list[IntArray]] = field(default_factory=dict)
    elsets: dict[str, list[IntArray]] = field(default_factory=dict)
    surfaces: dict[str, _Card] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    parts: int = 0

    def add(self, sets: dict[str, list[IntArray]], name: str, numbers: IntArray) -> None:
        """Adds members to a set; names keep the spelling they first had.

        Args:
            sets: The sets of one kind, `nsets` or `elsets`.
            name: The set's name in any case.
            numbers: Its new members in the file's numbering, of shape (n,).
        """
        self.names.setdefault(name.upper(), name)
        sets.setdefault(name.upper(), []).append(numbers)


def read_abaqus(path: Path) -> MeshFile:
    """Reads an input file and what it includes. Local: one rank reads.

    Raises:
        MeshError: The file is damaged, or makes its mesh by commands instead of listing it.
    """
    deck = _Deck()
    for card in _cards(path, depth=0):
        if card.word in _UNREAD:
            raise MeshError(
                f"*{card.word} is not understood",
                where=path.name,
                expected="write the mesh out in full",
            )
        if card.word in _TAKE:
            _TAKE[card.word](deck, card)
    if not deck.points or not deck.elements:
        raise MeshError("there are no *NODE or no *ELEMENT lines", where=path.name)
    numbers, order = np.unique(np.concatenate(deck.numbers), return_index=True)
    points = np.concatenate(deck.points)[order]
    blocks = [*_blocks(deck, numbers), *_surfaces(deck, numbers)]
    sets = {
        deck.names[key]: _rows_of(numbers, np.concatenate(rows)) for key, rows in deck.nsets.items()
    }
    return MeshFile(points, blocks, _notes(deck), sets)


def _cards(path: Path, depth: int) -> Iterator[_Card]:
    if depth > 5:
        raise MeshError("*INCLUDE goes round in a circle", where=path.name)
    card = _Card("", {})
    for line in path.read_text("latin-1").splitlines():
        if line.startswith("**") or not line.strip():
            continue
        if not line.lstrip().startswith("*"):
            card.lines.append(line)
            continue
        yield card
        card = _card(line)
        if card.word == "INCLUDE":
            inner = path.parent / card.option("INPUT")
            if not inner.is_file():
                raise MeshError(f"*INCLUDE: there is no file '{inner}'", where=path.name)
            yield from _cards(inner, depth + 1)
    yield card


def _card(line: str) -> _Card:
    word, *options = (part.strip() for part in line.strip().lstrip("*").split(","))
    pairs = (option.partition("=") for option in options)
    return _Card(
        word.upper(), {key.strip().upper(): value.strip().strip('"') for key, _, value in pairs}
    )


def _take_nodes(deck: _Deck, card: _Card) -> None:
    width = card.lines[0].rstrip().rstrip(",").count(",") + 1 if card.lines else 0
    try:
        rows = np.array([line.rstrip().rstrip(",").split(",") for line in card.lines], dtype=float)
    except ValueError:
        raise MeshError(f"*NODE: not all lines are {width} numbers") from None
    if not len(rows):
        return
    numbers = rows[:, 0].astype(np.int64)
    deck.numbers.append(numbers)
    xyz = np.zeros((len(rows), 3))
    xyz[:, : min(3, width - 1)] = rows[:, 1:4]
    deck.points.append(xyz)
    if "NSET" in card.options:
        deck.add(deck.nsets, card.options["NSET"], numbers)


def _take_elements(deck: _Deck, card: _Card) -> None:
    kind, size = _kind(card.option("TYPE").upper())
    rows = card.rows(size + 1)
    deck.elements.append((kind, rows[:, 0], rows[:, 1:]))
    if "ELSET" in card.options:
        deck.add(deck.elsets, card.options["ELSET"], rows[:, 0])


def _kind(name: str) -> tuple[str, int]:
    fits = [
        (len(base), kind)
        for kind, bases in _KINDS.items()
        for base in bases.split()
        if name.startswith(base) and not name[len(base) :][:1].isdigit()
    ]
    if not fits:
        raise MeshError(
            f"the element type {name} is unknown",
            expected="C3D4 and C3D10 (tetrahedra), CPE3 and CPE6 (plane) are read",
        )
    return max(fits)[1]


def _take_set(deck: _Deck, card: _Card) -> None:
    sets = deck.nsets if card.word == "NSET" else deck.elsets
    name = card.option(card.word)
    if "GENERATE" in card.options:
        for line in card.lines:
            start, stop, step = [*(int(w) for w in line.split(",") if w.strip()), 1][:3]
            deck.add(sets, name, np.arange(start, stop + 1, step))
        return
    words = card.words()
    numbers = [int(w) for w in words if w.isdigit()]
    deck.add(sets, name, np.array(numbers, dtype=np.int64))
    for word in (w for w in words if not w.isdigit()):
        for members in _known(sets, word, card.word):
            deck.add(sets, name, members)


def _known(sets: dict[str, list[IntArray]], word: str, what: str) -> list[IntArray]:
    key = word.strip('"').upper().rpartition(".")[2]  # "Part-1.Set" within an assembly
    if key not in sets:
        raise MeshError(f"the {what} '{word}' does not exist")
    return list(sets[key])


def _take_surface(deck: _Deck, card: _Card) -> None:
    name = card.option("NAME")
    deck.names.setdefault(name.upper(), name)
    deck.surfaces[name.upper()] = card


def _take_part(deck: _Deck, card: _Card) -> None:
    deck.parts += 1
    if deck.parts > 1:
        raise MeshError("the file has more than one *PART", expected="merge them into one")


def _take_instance(deck: _Deck, card: _Card) -> None:
    if any(float(w) for w in card.words()):
        raise MeshError("the *INSTANCE is moved or turned", expected="save the mesh in place")


_TAKE: dict[str, Callable[[_Deck, _Card], None]] = {
    "NODE": _take_nodes,
    "ELEMENT": _take_elements,
    "NSET": _take_set,
    "ELSET": _take_set,
    "SURFACE": _take_surface,
    "PART": _take_part,
    "INSTANCE": _take_instance,
}


def _rows_of(numbers: IntArray, wanted: IntArray) -> IntArray:
    """Rows of the points with the given numbers; `numbers` is sorted."""
    rows = np.minimum(np.searchsorted(numbers, wanted), len(numbers) - 1)
    missing = np.unique(wanted[numbers[rows] != wanted])
    if len(missing):
        raise MeshError(
            f"elements or sets refer to {len(missing)} points that do not exist, "
            f"for example {missing[0]}"
        )
    return np.asarray(rows)


def _blocks(deck: _Deck, numbers: IntArray) -> Iterator[Block]:
    sets = {deck.names[key]: np.concatenate(rows) for key, rows in deck.elsets.items()}
    for kind, labels, nodes in deck.elements:
        parts = {name: np.flatnonzero(np.isin(labels, rows)) for name, rows in sets.items()}
        yield Block(kind, _rows_of(numbers, nodes), parts)


def _surfaces(deck: _Deck, numbers: IntArray) -> Iterator[Block]:
    """Facets of each *SURFACE as a block of elements; those of type NODE become sets of nodes."""
    for key, card in deck.surfaces.items():
        if card.options.get("TYPE", "ELEMENT").upper() == "NODE":
            for word in card.words()[:1]:
                deck.nsets.setdefault(key, _known(deck.nsets, word, "NSET"))
            continue
        for line in card.lines:
            words = [w.strip() for w in line.split(",")]
            members = (
                np.array([int(words[0])])
                if words[0].isdigit()
                else np.concatenate(_known(deck.elsets, words[0], "ELSET"))
            )
            yield from _faces(deck, numbers, deck.names[key], members, words[1:2])


def _faces(
    deck: _Deck, numbers: IntArray, name: str, members: IntArray, face: list[str]
) -> Iterator[Block]:
    free = None if face and face[0] else _boundary_faces(deck)
    for kind, labels, nodes in deck.elements:
        picked = nodes[np.isin(labels, members)]
        faces = _FACES.get(kind.rstrip("0123456789"), ())
        side = face[0].upper() if face else ""
        if len(picked) == 0 or side in ("SPOS", "SNEG"):
            continue
        if side[:1] not in ("S", "") or (side and not 1 <= int(side[1:]) <= max(len(faces), 1)):
            raise MeshError(f"the *SURFACE '{name}' asks for the face '{side}'")
        for corners in faces if not side else faces[int(side[1:]) - 1 : int(side[1:])]:
            found = picked[:, list(corners)]
            if free is not None:
                found = found[match_rows(free, np.sort(found, axis=1)) >= 0]
            rows = _rows_of(numbers, found)
            yield Block(
                "triangle" if rows.shape[1] == 3 else "line", rows, {name: np.arange(len(rows))}
            )


def _boundary_faces(deck: _Deck) -> IntArray:
    """Faces on the boundary, sorted vertices: those of a *SURFACE that names no faces."""
    solid = any(kind.startswith("tetra") for kind, _, _ in deck.elements)
    start, width = ("tetra", 4) if solid else ("triangle", 3)
    return boundary(
        [nodes[:, :width] for kind, _, nodes in deck.elements if kind.startswith(start)]
        or [np.empty((0, width), dtype=np.int64)]
    )


def _notes(deck: _Deck) -> list[str]:
    empty = [
        deck.names[key]
        for sets in (deck.nsets, deck.elsets)
        for key, rows in sets.items()
        if not sum(len(r) for r in rows)
    ]
    return [f"empty sets (left out): {', '.join(sorted(empty))}"] if empty else []
