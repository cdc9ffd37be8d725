"""`Deck`: what an input file defines, in its own numbers and names, part by part."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from dolfin_elastic.core.errors import nearest
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.formats.abaqus.cards import Card
from dolfin_elastic.mesh.formats.abaqus.elements import Elements
from dolfin_elastic.mesh.formats.abaqus.motions import Motion
from dolfin_elastic.mesh.formats.raw import joined

STRIDE = 1 << 40
"""Offset of the numbers of an instance to those of the next: those of each begin at 1."""
_OWN = 1 << 62
"""Offset of the numbers of nodes and elements that belong to an assembly itself, such as reference
points."""


@dataclass(frozen=True)
class Scope:
    """Where numbers and names of a file are valid.

    Attributes:
        instance: Name of an instance; empty outside of them.
        offset: Added to numbers.
        in_assembly: In an assembly, outside of its instances.
    """

    instance: str = ""
    offset: int = 0
    in_assembly: bool = False

    def key(self, name: str) -> str:
        """Key of a set or surface of this scope."""
        return f"{self.instance}.{name}".upper() if self.instance else name.upper()


Sets = dict[str, list[IntArray]]


@dataclass
class Deck:
    """Content of the file; keys of sets are in capitals, behind the instance and a point.

    Attributes:
        numbers: Of the nodes.
        points: Their coordinates, shape (n, 3) each.
        elements: Kind, numbers and nodes of the elements of each *ELEMENT.
        nsets: Nodes of each *NSET.
        elsets: Elements of each *ELSET.
        surfaces: Each *SURFACE, and where it stands.
        names: Key to the spelling that a name had first.
        owners: Key to the instance.
        lost: Key of an incomplete set to the reason.
        parts: Keywords of each *PART.
        used: Names of the parts that have instances.
        instances: By their names in capitals.
        assemblies: Names in capitals.
        scope: That of the present keyword.
        motion: That of the present instance.
        moved: Number of arrays in `points` that are in their final positions.
        system: That of the present nodes.
        own: NSET and ELSET to the numbers of nodes and elements of the assembly itself.
        others: Keywords that are not read, because the case file takes their place.
        unread: Other keywords that are not read, to their number.
        unsorted: Keys of the sets of nodes whose order counts.
        left: Type to the numbers of elements that have no shape.
    """

    numbers: list[IntArray] = field(default_factory=list)
    points: list[FloatArray] = field(default_factory=list)
    elements: list[Elements] = field(default_factory=list)
    nsets: Sets = field(default_factory=dict)
    elsets: Sets = field(default_factory=dict)
    surfaces: dict[str, tuple[Card, Scope]] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    owners: dict[str, str] = field(default_factory=dict)
    lost: dict[str, str] = field(default_factory=dict)
    parts: dict[str, list[Card]] = field(default_factory=dict)
    used: set[str] = field(default_factory=set)
    instances: dict[str, Scope] = field(default_factory=dict)
    assemblies: set[str] = field(default_factory=set)
    scope: Scope = field(default_factory=Scope)
    motion: Motion | None = None
    moved: int = 0
    system: Motion | None = None
    own: dict[str, list[IntArray]] = field(default_factory=lambda: {"NSET": [], "ELSET": []})
    others: list[str] = field(default_factory=list)
    unread: Counter[str] = field(default_factory=Counter)
    unsorted: set[str] = field(default_factory=set)
    left: dict[str, list[IntArray]] = field(default_factory=dict)

    @staticmethod
    def label(number: int) -> int:
        """A number of a node or an element as the file has it."""
        return int(number) % STRIDE

    def name(self, name: str) -> str:
        """Key of a set or surface that the present keyword defines."""
        key = self.scope.key(name)
        self.names.setdefault(key, name)
        if self.scope.instance:
            self.owners[key] = self.scope.instance
        return key

    def add(self, sets: Sets, name: str, numbers: IntArray) -> None:
        """Adds members to a set."""
        sets.setdefault(self.name(name), []).append(numbers)

    def mark_incomplete(self, key: str, reason: str) -> None:
        """Records why a set is incomplete.

        Args:
            reason: Why; empty where it is complete.
        """
        if reason:
            self.lost[key] = reason

    def enter(self, scope: Scope, motion: Motion | None = None) -> None:
        """Moves the nodes of the instance that ends here, and begins another part of the file."""
        if self.motion is not None:
            self.points[self.moved :] = [self.motion(x) for x in self.points[self.moved :]]
        self.scope, self.motion, self.moved, self.system = scope, motion, len(self.points), None

    def new_numbers(self, what: str, numbers: IntArray) -> IntArray:
        """Numbers of nodes (what: NSET) or elements (ELSET) that the present keyword defines."""
        if not self.scope.in_assembly or not self.points:
            return numbers + self.scope.offset
        self.own[what].append(numbers)
        return numbers + _OWN

    def scope_of(self, card: Card) -> Scope:
        """Where the numbers of a set are valid: INSTANCE= names an instance."""
        if self.scope.instance or "INSTANCE" not in card.options or not self.instances:
            return self.scope
        name = card.option("INSTANCE").rpartition(".")[2].upper()
        if name not in self.instances:
            hint = nearest(name, self.instances)
            raise card.error(f"there is no instance '{name}' before it", expected=hint)
        return self.instances[name]

    def resolved(self, card: Card, scope: Scope, what: str, numbers: IntArray) -> IntArray:
        """Numbers of nodes or elements that a keyword refers to."""
        if scope.instance:
            return numbers + scope.offset
        own = np.isin(numbers, joined(self.own[what])) & scope.in_assembly
        if len(self.instances) > 1 and not own.all():
            raise card.error(
                f"{numbers[~own][0]} is a number in one of {len(self.instances)} instances",
                expected="INSTANCE= behind the keyword, or INSTANCE.NUMBER",
            )
        return np.where(own, numbers + _OWN, numbers)

    def members(self, card: Card, scope: Scope, what: str, word: str, row: int) -> IntArray:
        """Nodes or elements of an entry: a number, a set, or one of them behind an instance."""
        if word.isdigit():
            return self.resolved(card, scope, what, np.array([int(word)], dtype=np.int64))
        path = word.strip('"').upper().split(".")
        if len(path) > 1 and path[-1].isdigit() and path[-2] in self.instances:
            return np.array([int(path[-1]) + self.instances[path[-2]].offset], dtype=np.int64)
        return self.known(card, scope, what, word, row)

    def known(
        self, card: Card, scope: Scope, what: str, word: str, row: int | None = None
    ) -> IntArray:
        """Members of a set that a line names."""
        sets = self.nsets if what == "NSET" else self.elsets
        name = word.strip('"').upper()
        first, _, rest = name.partition(".")
        if rest and first in self.assemblies:
            name = rest
        last = name.rpartition(".")[2] if len(self.instances) < 2 else name
        only = [one.key(last) for one in self.instances.values() if len(self.instances) == 1]
        for key in (scope.key(name), name, last, *only):
            if key in sets:
                return joined(sets[key])
        hint = nearest(name, sets)
        raise card.error(f"the {what} '{word}' does not exist", row=row, expected=hint)

    def titles(self) -> dict[str, str]:
        """Key to the name of a set in the mesh; of several instances it begins with theirs."""
        apart = len(self.instances) > 1
        return {
            key: f"{self.owners[key]}.{name}"
            if key in self.owners and (apart or name.upper() in self.names)
            else name
            for key, name in self.names.items()
        }
