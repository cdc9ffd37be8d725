"""`read_deck`: the reader that a deck's suffix asks for."""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import cast

from dolfin_elastic.case.decks.deck import Deck
from dolfin_elastic.core.errors import MeshError, nearest_file, not_shown, why_no_file
from dolfin_elastic.core.types import FloatArray

MOST_BYTES = 1 << 31
READERS = {
    ".inp": "abaqus.reader",
    **dict.fromkeys((".bdf", ".nas", ".dat", ".fem"), "nastran.reader"),
    ".feb": "febio.reader",
}
"""Suffix to the module of `case/decks` whose `read` makes a `Deck` of a path."""


def read_deck(path: Path) -> Deck:
    """A deck of another program. Not collective.

    Raises:
        MeshError: There is none, its suffix is not known, or it is damaged.
    """
    known = ", ".join(READERS)
    if path.suffix.lower() not in READERS:
        raise MeshError("this is no deck by its suffix", where=str(path), expected=known)
    if fault := why_no_file(path, MOST_BYTES):
        raise MeshError(fault, where=str(path))
    if not path.is_file():
        beside = [str(p) for p in path.parent.glob("*") if p.suffix.lower() in READERS]
        hint = not_shown(path) or (nearest_file(str(path), beside) if beside else "")
        raise MeshError("there is no such deck", where=str(path), expected=hint)
    name = READERS[path.suffix.lower()]
    module = import_module(f"dolfin_elastic.case.decks.{name}")
    return cast("Deck", module.read(path))


@dataclass(frozen=True)
class Nodes:
    """The nodes of a deck by their numbers; empty where results cannot name them.

    Attributes:
        places: Number to place, in the deck's unit.
        sets: Name of a set to numbers.
    """

    places: dict[int, FloatArray] = field(default_factory=dict)
    sets: dict[str, set[int]] = field(default_factory=dict)


def nodes_of(path: Path) -> Nodes:
    """The nodes of a deck by their numbers. Not collective."""
    if path.suffix.lower() != ".inp":
        return Nodes()
    from dolfin_elastic.mesh.formats.abaqus.reader import read_abaqus

    mesh = read_abaqus(path)
    if mesh.numbers is None:
        return Nodes()
    numbers = [int(number) for number in mesh.numbers]
    sets = {name: {numbers[row] for row in rows} for name, rows in mesh.point_sets.items()}
    return Nodes(dict(zip(numbers, mesh.points, strict=True)), sets)
