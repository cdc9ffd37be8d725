"""What is known of a deck of Abaqus while its keywords are read, one after the other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from dolfin_elastic.case.decks.abaqus.equation import Equation, Nodes, OtherEquationError, cell_of
from dolfin_elastic.case.decks.abaqus.materials import Material, place
from dolfin_elastic.case.decks.coupling import Coupling, Skin
from dolfin_elastic.case.decks.deck import (
    Deck,
    Entry,
    FieldValue,
    Place,
    Quantity,
    Severity,
    Step,
)
from dolfin_elastic.core.errors import nearest
from dolfin_elastic.core.types import BoolArray, FloatArray, IntArray
from dolfin_elastic.mesh.formats.abaqus.cards import Card
from dolfin_elastic.mesh.formats.raw import MeshFile

Key = tuple[str, ...]
"""What a load acts on: a later one with the same key takes its place."""
Ramp = tuple[tuple[float, float], ...] | None


@dataclass(frozen=True)
class Part:
    """One component of a support, or of forces at nodes.

    Attributes:
        value: Its number, or field.
        place: Where it stands.
        ramp: See `Entry`.
    """

    value: Quantity | FieldValue
    place: Place
    ramp: Ramp = None


Parts = dict[tuple[str, int], Part]
"""Name of a set of nodes and component, 0 to 2, to what is prescribed there."""


@dataclass(frozen=True)
class Transform:
    """Local directions of some nodes.

    Attributes:
        nodes: Rows of the nodes.
        axes: The directions 1 to 3, shape (3, 3); None: they differ from node to node.
    """

    nodes: IntArray
    axes: FloatArray | None


@dataclass
class Reading:
    """The deck so far.

    Attributes:
        deck: What it says, in the words of a case.
        mesh: Its mesh, with the names of all parts.
        file: Name of the deck.
        materials: Name in capitals to material.
        material: The one whose keywords are being read.
        orientations: Name in capitals to keyword.
        amplitudes: Name in capitals to keyword.
        types: Types of elements, to their number.
        start: Set of nodes to its initial temperature.
        velocity: Initial velocity of the whole body.
        step: The present step.
        card: That of *STEP.
        supports: What holds now.
        forces: What acts at nodes now.
        loads: What else acts now.
        large: NLGEOM holds, as it does for all later steps.
        period: Length of the present step.
        damping: Rayleigh's alpha and beta of materials.
        names: Kind of part to its names, without upper case to as they are.
        dim: Dimension of the body.
        instance: The present one.
        sections: Each *SOLID SECTION and its region.
        fresh: Keys of forces that the present step has stated: further ones there add up.
        couplings: Row of a reference node to its coupling.
        turning: Row of a node to the coupling whose rotations are its displacements.
        coupling: The one whose keywords are being read.
        transforms: Local directions of nodes.
        equations: Those between opposite nodes of a periodic cell.
        equal: Those of coincident nodes.
        grounded: Set of springs to the ground, in capitals, to its *ELEMENT that no *SPRING has
            taken.
        springs: Supports by springs.
    """

    deck: Deck
    mesh: MeshFile
    file: str
    materials: dict[str, Material] = field(default_factory=dict)
    material: Material | None = None
    orientations: dict[str, Card] = field(default_factory=dict)
    amplitudes: dict[str, Card] = field(default_factory=dict)
    types: Counter[str] = field(default_factory=Counter)
    start: dict[str, float] = field(default_factory=dict)
    velocity: list[float] = field(default_factory=list)
    step: Step | None = None
    card: Card | None = None
    supports: Parts = field(default_factory=dict)
    forces: Parts = field(default_factory=dict)
    loads: dict[Key, Entry] = field(default_factory=dict)
    large: bool = False
    period: float = 1.0
    damping: dict[str, tuple[float, float]] = field(default_factory=dict)
    names: dict[str, dict[str, str]] = field(default_factory=dict)
    dim: int = 3
    instance: str = ""
    sections: list[tuple[Card, str]] = field(default_factory=list)
    fresh: set[object] = field(default_factory=set)
    couplings: dict[int, Coupling] = field(default_factory=dict)
    turning: dict[int, Coupling] = field(default_factory=dict)
    coupling: Coupling | None = None
    transforms: list[Transform] = field(default_factory=list)
    equations: list[Equation] = field(default_factory=list)
    equal: list[Equation] = field(default_factory=list)
    grounded: dict[str, list[Card]] = field(default_factory=dict)
    springs: list[Entry] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.dim = dim = max(block.dim for block in self.mesh.blocks)
        regions, flat = set[str](), set[str]()
        for block in self.mesh.blocks:
            named = {name for name, rows in block.parts.items() if len(rows)}
            (regions if block.dim == dim else flat).update(named)
        sets = {"region": regions, "surface": flat, "point": set(self.mesh.point_sets)}
        self.names = {kind: {n.casefold(): n for n in every} for kind, every in sets.items()}

    def fault(self, card: Card, text: str, row: int | None = None) -> None:
        """Something that the case does not have, and that changes the answer."""
        self.deck.leave_out(place(card, row), text, "changes the answer")

    def note(self, card: Card, text: str, row: int | None = None) -> None:
        """Something that the case does not have, or has in another way."""
        self.deck.leave_out(place(card, row), text, "note")

    def name(self, card: Card, kind: str, word: str, row: int | None = None) -> str:
        """The name in the mesh of a set or surface that a line names.

        Args:
            kind: "region", "surface" or "point".

        Raises:
            MeshError: There is none.
        """
        known, word = self.names[kind], word.strip().strip('"')
        tail = word.rpartition(".")[2]
        inside = f"{self.instance}.{word}" if self.instance else ""
        for name in (inside, word, word.partition(".")[2], tail):
            if name and name.casefold() in known:
                return known[name.casefold()]
        raise card.error(
            f"there is no {_KINDS[kind]} '{word[:60]}'",
            row=row,
            expected=nearest(word, known.values()),
        )

    @cached_property
    def body(self) -> BoolArray:
        """Whether a row is a node of the body, and not beside it."""
        result = np.zeros(len(self.mesh.points), dtype=bool)
        for block in self.mesh.blocks:
            if block.dim == self.dim:
                result[block.nodes] = True
        return result

    @cached_property
    def skin(self) -> Skin:
        """The faces of the body, by rows of the nodes."""
        return Skin([b.nodes[:, : self.dim + 1] for b in self.mesh.blocks if b.dim == self.dim])

    def finish_step(self) -> None:
        """Ends the present step with all that holds and acts at its end."""
        if self.step is not None:
            self.step.supports = [*self.springs, *_supports(self.supports, self.dim)]
            self.step.loads = [*_forces(self.forces, self.dim), *self.loads.values()]
            for one in self.couplings.values():
                self._couple(one, self.step)
            if self.equations:
                self._repeat(self.step)
            self.step.nonlinear = self.large and self.step.kind != "buckling"
            self.deck.steps.append(self.step)
        self.step = self.card = None

    def _couple(self, one: Coupling, step: Step) -> None:
        """Adds a surface that follows a node to the present step."""
        text = one.fault
        if (support := one.support()) is not None:
            step.supports.append(support)
            if not one.still and (step.kind != "statics" or (self.large and self.deck.steps)):
                text = "a rigid surface that moves exists in statics of one step only"
        elif (load := one.load()) is not None:
            step.loads.append(load)
        if text:
            self.deck.leave_out(one.place, text, "changes the answer")

    def _repeat(self, step: Step) -> None:
        """Makes a step one of a periodic cell, in which one node is at rest."""
        points, thickness = self.mesh.points[:, : self.dim], self.deck.mesh.get("thickness", 1.0)
        assert isinstance(thickness, float)
        held, still = self.held()
        first = self.equations[0].card
        try:
            cell = cell_of(
                Nodes(points, self.body, still), thickness, self.equations, self.couplings
            )
        except OtherEquationError as error:
            self.fault(error.equation.card, error.text, error.equation.row)
            return
        self.deck.surfaces |= {
            name: Entry(place(first), {"any": [{"plane": name[0], "at": name[2:]}]})
            for pair in cell.pairs
            for name in pair
        }
        step.periodic = Entry(place(first), cell.keys)
        whole = (held & self.body[:, None]).sum(axis=0).max() <= 1
        text = "a support in a periodic cell, of which one corner is at rest"
        for entry in step.supports:
            single = whole and any(entry.keys["on"] == name for name, _ in self.supports)
            severity: Severity = "note" if single else "changes the answer"
            self.deck.leave_out(entry.place, text, severity)
        for entry in step.loads:
            self.deck.leave_out(entry.place, "a load in a periodic cell", "changes the answer")
        step.supports, step.loads = [], []
        if step.kind != "statics" or (self.large and self.deck.steps):
            self.fault(first, "a periodic cell exists in statics of one step only")

    def held(self) -> tuple[BoolArray, BoolArray]:
        """Which components of nodes are prescribed, and which of them are 0; shape (n, dim)."""
        held = np.zeros((len(self.mesh.points), self.dim), dtype=bool)
        still = held.copy()
        for (name, i), part in self.supports.items():
            rows, value = self.mesh.point_sets[name], part.value
            held[rows, i] = True
            if isinstance(value, FieldValue):
                still[rows, i] = self.mesh.point_data[value.field][rows, 0] == 0.0
            else:
                still[rows, i] = value.value == 0.0
        for node, one in self.couplings.items():
            for i in range(self.dim):
                if i + 1 in one.moved:  # later than what a set of nodes by number has of it
                    still[node, i] = one.moved[i + 1] == 0.0
        return held, still


_KINDS = {"region": "set of elements", "surface": "surface", "point": "set of nodes"}


def _together(parts: Parts) -> Iterator[tuple[str, dict[int, Part]]]:
    """Components of the same nodes with the same ramp."""
    groups: dict[tuple[str, Ramp], dict[int, Part]] = {}
    for (name, i), part in parts.items():
        groups.setdefault((name, part.ramp), {})[i] = part
    for (name, _), every in groups.items():
        yield name, every


def _supports(parts: Parts, dim: int) -> Iterator[Entry]:
    for name, every in _together(parts):
        first = next(iter(every.values()))
        values = [every[i].value if i in every else "free" for i in range(dim)]
        still = all(isinstance(v, Quantity) and not v.value for v in values)
        keys: dict[str, object] = {"on": name}
        keys |= {"kind": "fixed"} if still else {"displacement": values}
        yield Entry(first.place, keys, ramp=None if still else first.ramp)


def _forces(parts: Parts, dim: int) -> Iterator[Entry]:
    for name, every in _together(parts):
        first = next(iter(every.values()))
        values = [every[i].value if i in every else Quantity(0.0, "force") for i in range(dim)]
        fields = {v.field for v in values if isinstance(v, FieldValue)}
        value = values[0] if fields else values
        keys: dict[str, object] = {"kind": "point-force", "on": name, "value": value}
        yield Entry(first.place, keys, ramp=first.ramp)
