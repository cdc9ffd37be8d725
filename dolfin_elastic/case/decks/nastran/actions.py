"""Supports and loads that a subcase of Nastran selects.

Source: MSC Nastran 2021, Quick Reference Guide, entries SPC, SPCADD, SPCD, LOAD, GRAV, RFORCE,
TEMPD.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from dolfin_elastic.case.decks.deck import Deck, Entry, Place, Quantity, Step
from dolfin_elastic.case.decks.nastran.followers import Followers
from dolfin_elastic.case.decks.nastran.materials import rotation_speed
from dolfin_elastic.case.decks.nastran.table import Table, place
from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.mesh.formats.nastran.entries import Entry as Card
from dolfin_elastic.mesh.formats.nastran.groups import Group

_MOST_SETS = 10_000
_OTHERS = (
    *("MOMENT1", "MOMENT2", "FORCE2", "PLOAD1", "PLOAD2", "PLOADX1", "ACCEL"),
    *("ACCEL1", "SLOAD", "DEFORM", "PLOADB3", "QBDY1", "QHBDY"),
)


class Actions:
    """Of one subcase after the other.

    Args:
        deck: Which learns what has no equal.
        references: Temperatures of reference of the materials.
    """

    def __init__(self, table: Table, deck: Deck, references: Mapping[str, float]) -> None:
        self._table, self._deck, self._references = table, deck, references
        self._followers = Followers(table, deck)

    def leave_out(self, place: Place, text: str) -> None:
        """Records what changes the answer."""
        self._deck.leave_out(place, text, "changes the answer")

    # --- supports ---

    def support(self, step: Step, number: int, load: int) -> None:
        """Adds the supports of a set, and of the nodes themselves.

        Args:
            number: Of the set; 0: none is selected.
            load: Set of loads, in which displacements of supports may be.
        """
        sets = [*(self._added(number) if number else ()), 0]
        groups = [g for one in sets for g in self._table.in_set("spc", one)]
        if number and not any(g.number for g in groups):
            text = f"the set SPC {number} has no supports"
            self._deck.leave_out(step.place, text, "changes the answer")
        moved = [
            (group, factor)
            for one, factor in self._combined(load)
            for group in self._table.in_set("spcd", one)
        ]
        self._followers.begin()
        for group, factor in [*((g, 1.0) for g in groups), *moved]:
            if group.reference:
                self._followers.hold(group, factor)
            elif (entry := self._supported(group, factor)) is not None:
                step.supports.append(entry)
        step.supports += self._followers.springs()

    def finish(self, step: Step) -> None:
        """Adds surfaces that follow a node, with all that acts there."""
        self._followers.finish(step)

    def _added(self, number: int) -> list[int]:
        """Numbers of the sets that a set consists of."""
        for card in self._table.of("SPCADD"):
            if card.integer(0) == number:
                return [card.integer(i) for i in range(1, len(card.fields)) if card.text(i)]
        return [number]

    def _supported(self, group: Group, factor: float) -> Entry | None:
        value = group.value[0] * factor
        where = place(group.entry)
        if group.components == "123" and not value:
            return Entry(where, {"on": group.name, "kind": "fixed"})
        axes = np.eye(3)
        if group.system:
            node = min(group.nodes)
            rows = [self._table.groups.direction(group.entry, group.system, a, node) for a in axes]
            axes = np.array(rows)
            turned = self._table.bulk.systems[group.system].kind != "R" and len(group.nodes) > 1
            if turned or not np.isclose(np.abs(axes).max(axis=1), 1.0, atol=1e-9).all():
                text = f"directions of the coordinate system {group.system}: here x, y and z alone"
                self._deck.leave_out(where, text, "changes the answer")
                return None
        values: list[object] = ["free"] * 3
        for digit in group.components:
            axis = axes[int(digit) - 1]
            i = int(np.abs(axis).argmax())
            size = math.copysign(1.0, axis[i]) * value
            values[i] = Quantity(size, "length") if value else 0
        return Entry(where, {"on": group.name, "displacement": values})

    # --- loads ---

    def _combined(self, number: int) -> Iterator[tuple[int, float]]:
        """Numbers of the sets that a set of loads consists of, and their factors."""
        cards = [c for c in self._table.of("LOAD") if c.integer(0) == number]
        if not cards:
            yield number, 1.0
        for card in cards:
            scale = card.real(1)
            for i in range(2, len(card.fields) - 1, 2):
                if card.text(i + 1):
                    yield card.integer(i + 1), scale * card.real(i)

    def load(self, step: Step, number: int, *, dead: bool = False) -> None:
        """Adds the loads of a set.

        Args:
            dead: Pressures keep their direction, as buckling of a linear law needs it.
        """
        for one, factor in self._combined(number):
            before = len(step.loads)
            found = bool(self._at_references(one, factor))
            for group in self._table.groups.all:
                loads = group.kind in ("force", "pload") and not group.reference
                if group.number == one and loads:
                    step.loads.append(self._acting(group, factor, dead=dead))
            for name, take in (("GRAV", self._gravity), ("RFORCE", self._rotation)):
                for card in self._table.of(name):
                    if card.integer(0) == one:
                        step.loads.append(take(card, factor))
            for name in _OTHERS:
                for card in self._table.of(name)[:_MOST_SETS]:
                    if card.integer(0) == one:
                        self._deck.leave_out(place(card), "this load", "changes the answer")
            if len(step.loads) == before and not found and not self._table.in_set("spcd", one):
                text = f"the set LOAD {one} has no loads that are known here"
                self._deck.leave_out(step.place, text, "changes the answer")

    def _at_references(self, number: int, factor: float) -> int:
        """Adds forces and moments at reference nodes; returns how many there are."""
        count = 0
        for group in self._table.groups.all:
            if group.kind == "force" and group.number == number and group.reference:
                self._followers.push(group.reference, 1, factor * np.array(group.value))
                count += 1
        for card in self._table.of("MOMENT"):
            if card.integer(0) == number:
                node, vector = card.integer(1), np.array([card.real(i) for i in (4, 5, 6)])
                basic = self._table.groups.direction(card, card.integer(2, 0), vector, node)
                if not self._followers.push(node, 4, factor * card.real(3) * basic):
                    text = "a moment at a node of a solid, which has no rotation"
                    self._deck.leave_out(place(card), text, "changes the answer")
                count += 1
        return count

    def _acting(self, group: Group, factor: float, *, dead: bool) -> Entry:
        where = place(group.entry)
        if group.kind == "force":
            value = [Quantity(factor * v, "force") if v else 0 for v in group.value]
            return Entry(where, {"kind": "point-force", "on": group.name, "value": value})
        pressure, *direction = group.value
        if dead and not direction:
            normal = self._table.groups.outwards(group)
            if normal is None:
                text = "a pressure on a curved surface in buckling"
                self._deck.leave_out(where, text, "changes the answer")
            else:
                direction = [-float(x) for x in normal]
        if direction:
            value = [Quantity(factor * pressure * d, "stress") if d else 0 for d in direction]
            return Entry(where, {"kind": "traction", "on": group.name, "value": value})
        one = Quantity(factor * pressure, "stress")
        return Entry(where, {"kind": "pressure", "on": group.name, "value": one})

    def _gravity(self, card: Card, factor: float) -> Entry:
        vector = np.array([card.real(i) for i in (3, 4, 5)])
        basic = self._table.groups.direction(card, card.integer(1, 0), vector)
        value = factor * card.real(2) * basic
        quantities = [Quantity(float(v), "acceleration") if v else 0 for v in value]
        return Entry(place(card), {"kind": "gravity", "value": quantities})

    def _rotation(self, card: Card, factor: float) -> Entry:
        vector = np.array([card.real(i) for i in (4, 5, 6)])
        axis = self._table.groups.direction(card, card.integer(2, 0), vector)
        size = float(np.linalg.norm(axis))
        if not size > 0 or factor < 0:
            raise card.error("its axis has no direction, or its factor is negative")
        if card.real(8):
            text = "an angular acceleration (RACC)"
            self._deck.leave_out(place(card), text, "changes the answer")
        speed = rotation_speed(card.real(3) * size * math.sqrt(factor))
        keys: dict[str, object] = {
            "kind": "centrifugal",
            "value": speed,
            "axis": (axis / size).tolist(),
        }
        if node := card.integer(1, 0):
            keys["point"] = self._table.groups.place(card, node).tolist()
        return Entry(place(card), keys)

    # --- temperatures ---

    def warm(self, step: Step, number: int) -> None:
        """Adds the change of temperature of a set."""
        for name in ("TEMP", "TEMPP1", "TEMPRB", "TEMPF"):
            for card in self._table.of(name):
                if card.integer(0) == number:
                    text = "temperatures that vary in space: write them as a field"
                    self._deck.leave_out(place(card), text, "changes the answer")
                    return
        for card in self._table.of("TEMPD"):
            for i in (0, 2, 4, 6):
                if card.text(i) and card.integer(i) == number:
                    step.loads.append(self._uniform(card, card.real(i + 1)))
                    return
        text = f"the set TEMPERATURE {number} has no temperatures that are known here"
        self._deck.leave_out(step.place, text, "changes the answer")

    def _uniform(self, card: Card, temperature: float) -> Entry:
        references = set(self._references.values()) or {0.0}
        if len(references) > 1:
            text = "the temperatures of reference (TREF) of the materials differ"
            self._deck.leave_out(place(card), text, "changes the answer")
        value = Quantity(temperature - min(references), "temperature")
        return Entry(place(card), {"kind": "thermal", "value": value})


def method_of(table: Table, number: int, *, buckling: bool) -> dict[str, object]:
    """Keys of [modal] or [buckling] from EIGRL, EIGR or EIGB.

    Raises:
        MeshError: There is no such entry.
    """
    for name, low, high, count in (("EIGRL", 1, 2, 3), ("EIGR", 2, 3, 5), ("EIGB", 2, 3, 5)):
        for card in table.of(name):
            if card.integer(0) == number:
                if card.text(count):
                    return {"count": card.integer(count)}
                if card.text(high) and not card.real(low) and not buckling:
                    return {"below": Quantity(card.real(high), "frequency")}
                return {}
    raise MeshError(f"there is no EIGRL, EIGR or EIGB {number}", where="METHOD")
