"""`Deck`: what a deck of another program says beside its mesh, in the words of a case.

A reader fills it (`abaqus.py` and others), `writer.py` makes case files of it.  Numbers with a
dimension are `Quantity`: decks have no units, so that these come at the end, from the system of
units in which the whole deck is.  Coordinates stay bare: they are in the unit of the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

Dimension = Literal[
    "length",
    "stress",
    "force",
    "moment",
    "density",
    "mass",
    "acceleration",
    "velocity",
    "time",
    "frequency",
    "rotation",
    "temperature",
    "expansion",
    "body force",
    "stiffness",
    "viscosity",
]
Kind = Literal["statics", "modal", "buckling", "dynamics"]
Severity = Literal["changes the answer", "note"]


@dataclass(frozen=True)
class Quantity:
    """A number of the deck with what it measures; "rotation" is rad per unit of time."""

    value: float
    dimension: Dimension


@dataclass(frozen=True)
class FieldValue:
    """Numbers that differ from node to node: a field of the mesh, in units of the deck.

    Attributes:
        field: Its name in the mesh.
        dimension: What it measures.
        reference: What is subtracted from each value.
    """

    field: str
    dimension: Dimension
    reference: float = 0.0


@dataclass(frozen=True)
class Place:
    """Where something stands in a deck.

    Attributes:
        file: Name of the file.
        line: From 1; 0 for the file as a whole.
        word: What the line begins with, such as ``*BOUNDARY``; for people.
    """

    file: str
    line: int
    word: str = ""

    def __str__(self) -> str:
        where = f"{self.file}:{self.line}" if self.line else self.file
        return f"{where} {self.word}".rstrip()


@dataclass
class Entry:
    """One table of the case.

    Attributes:
        place: Where it stands in the deck.
        keys: Keys of the case's table, such as kind, on and value; numbers with a dimension are
            `Quantity` or `FieldValue`, also in lists and tables.  No `curve`: see `ramp`.
        remark: What there is to say of it, behind the place in the comment.
        ramp: Rows of time in the step, as a fraction of its length (in motion: as in the deck), and
            factor; None: in statics in proportion to the load of the step, in motion constant.
    """

    place: Place
    keys: dict[str, object]
    remark: str = ""
    ramp: tuple[tuple[float, float], ...] | None = None


@dataclass
class Step:
    """One analysis of the deck.

    Attributes:
        kind: Which table of the case it is.
        place: Where it begins in the deck.
        settings: Keys of that table.
        nonlinear: With large displacements.
        supports: All that hold at its end, also those of earlier steps.
        loads: All that act at its end, also those of earlier steps.
        preloaded: It is about the equilibrium of the static step before it.
        periodic: Table [periodic].
        increments: Keys of [statics] about the size of load steps, as fractions of this step, of
            use where materials yield.
    """

    kind: Kind
    place: Place
    settings: dict[str, object] = field(default_factory=dict)
    nonlinear: bool = False
    supports: list[Entry] = field(default_factory=list)
    loads: list[Entry] = field(default_factory=list)
    preloaded: bool = False
    periodic: Entry | None = None
    increments: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class LeftOut:
    """Something of the deck that the case does not have.

    Attributes:
        place: Where it stands in the deck.
        text: What, and why.
        severity: Whether the answer would be another one with it.
    """

    place: Place
    text: str
    severity: Severity

    def __str__(self) -> str:
        return f"{self.place}: {self.text}"


@dataclass
class Deck:
    """A whole deck.

    Attributes:
        program: For people, as "Abaqus or CalculiX".
        file: Name of the deck, which is the file of the mesh; it is beside the case.
        title: One line.
        mesh: Keys of [mesh] beside `file` and `unit`, such as degree or formulation.
        materials: Name to keys of [materials.NAME], with `law` and `on`.
        surfaces: Name to [surfaces]; its `keys` have one entry "any", a list of selectors.
        regions: The same for [regions].
        points: The same for [points]; nodes by number are ``{"nearest": [x, y, z]}``.
        ties: Tables [[tie]].
        masses: Tables [[mass]].
        steps: In the order of the deck.
        left_out: All that is in no table.
        units: Name of the system of units if the deck tells it, see `units.SYSTEMS`.
    """

    program: str
    file: str
    title: str = ""
    mesh: dict[str, object] = field(default_factory=dict)
    materials: dict[str, Entry] = field(default_factory=dict)
    surfaces: dict[str, Entry] = field(default_factory=dict)
    regions: dict[str, Entry] = field(default_factory=dict)
    points: dict[str, Entry] = field(default_factory=dict)
    ties: list[Entry] = field(default_factory=list)
    masses: list[Entry] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)
    left_out: list[LeftOut] = field(default_factory=list)
    units: str = ""

    def leave_out(self, place: Place, text: str, severity: Severity = "note") -> None:
        """Records something that no table has, once."""
        one = LeftOut(place, text, severity)
        if one not in self.left_out:
            self.left_out.append(one)

    @property
    def faults(self) -> list[LeftOut]:
        """What is left out and would change the answer."""
        return [one for one in self.left_out if one.severity == "changes the answer"]
