"""`Coupling`: a surface that follows a reference node, as a support or a load."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from dolfin_elastic.case.decks.deck import Entry, Place, Quantity
from dolfin_elastic.core.types import IntArray
from dolfin_elastic.mesh.formats.raw import boundary

ALL = 6
"""Directions of a reference node: three displacements, three rotations."""


@dataclass
class Coupling:
    """One surface and its reference node.

    Attributes:
        place: Where it stands in the deck, such as at its *COUPLING or RBE2.
        surface: Its name in the mesh, or several.
        point: Coordinates of the node, in the deck's unit; None: in the middle of the surface.
        kind: "KINEMATIC" of a rigid surface, "DISTRIBUTING" of an average, "PERIODIC" of a node
            in equations; "" until the deck says it.
        turns: Directions 4 to 6 are among those that it lists.
        moved: Direction, 1 to 6, to its displacement or rotation.
        forces: Direction to its force or moment.
        ramp: See `Entry.ramp`.
    """

    place: Place
    surface: str | list[str]
    point: list[float] | None
    kind: str = ""
    turns: bool = True
    moved: dict[int, float] = field(default_factory=dict)
    forces: dict[int, float] = field(default_factory=dict)
    ramp: tuple[tuple[float, float], ...] | None = None

    @property
    def fault(self) -> str:
        """Why a case does not have it; empty: it has."""
        if self.kind != "DISTRIBUTING":
            return ""
        if not self.turns and any(self.forces.get(i) for i in (4, 5, 6)):
            return "a moment, but the average has directions 1 to 3 only"
        return "a prescribed motion of an average" if self.moved else ""

    @property
    def still(self) -> bool:
        """Whether the surface is fixed."""
        held = self.kind == "KINEMATIC" and len(self.moved) == ALL
        return held and not any(self.moved.values())

    def load(self) -> Entry | None:
        """The force and the moment of an average."""
        if self.kind != "DISTRIBUTING" or not any(self.forces.values()):
            return None
        return Entry(self.place, {"kind": "remote-force", **self._keys(self.forces)})

    def support(self) -> Entry | None:
        """The rigid surface, with its forces where it is free."""
        if self.kind != "KINEMATIC":
            return None
        if self.still:
            return Entry(self.place, {"on": self.surface, "kind": "fixed"})
        free = {i: x for i, x in self.forces.items() if i not in self.moved}
        keys: dict[str, object] = {"kind": "rigid", **self._keys(free)}
        for name, first in (("displacement", 1), ("rotation", 4)):
            keys[name] = [self._moved(i) for i in range(first, first + 3)]
        return Entry(self.place, keys, ramp=self.ramp)

    def _moved(self, i: int) -> object:
        value = self.moved.get(i)
        if value is None:
            return "free"
        return Quantity(value, "length") if value and i <= 3 else value

    def _keys(self, forces: dict[int, float]) -> dict[str, object]:
        keys: dict[str, object] = {"on": self.surface}
        if self.point is not None:
            keys["point"] = self.point
        if any(forces.get(i) for i in (1, 2, 3)):
            keys["force"] = [Quantity(forces.get(i, 0.0), "force") for i in (1, 2, 3)]
        if any(forces.get(i) for i in (4, 5, 6)):
            keys["moment"] = [Quantity(forces.get(i, 0.0), "moment") for i in (4, 5, 6)]
        return keys


@dataclass(frozen=True)
class Skin:
    """The faces of a body, found once.

    Attributes:
        cells: Corners of the elements of the body, each of shape (n, dim + 1).
    """

    cells: list[IntArray]

    @cached_property
    def facets(self) -> IntArray:
        """Corners of the faces, ascending, shape (n, dim)."""
        return boundary(self.cells)

    @cached_property
    def corners(self) -> IntArray:
        """All corners of the elements, ascending."""
        return np.unique(np.concatenate([cell.ravel() for cell in self.cells]))

    def covered_by(self, nodes: IntArray) -> bool:
        """Whether faces have all corners among nodes, and these are all of them.

        Args:
            nodes: In the numbers of the cells, with midside nodes.
        """
        within = self.facets[np.isin(self.facets, nodes).all(axis=1)]
        own = nodes[np.isin(nodes, self.corners)]
        return len(within) > 0 and not len(np.setdiff1d(own, within))
