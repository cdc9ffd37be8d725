"""RBE2 and RBE3 as rigid surfaces and remote forces, grounded springs as supports.

Source: MSC Nastran 2021, Quick Reference Guide, entries RBE2, RBE3, CELAS1, CELAS2, PELAS.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dolfin_elastic.case.decks.coupling import Coupling, Skin
from dolfin_elastic.case.decks.deck import Deck, Entry, Quantity, Severity, Step
from dolfin_elastic.case.decks.nastran.table import SOLIDS, Table, place
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.formats.nastran.groups import Group, expansion

_KINDS = {"rbe2": "KINEMATIC", "rbe3": "DISTRIBUTING"}


class Followers:
    """Nodes that follow reference nodes, in one subcase after the other.

    Args:
        deck: Which learns what has no equal.
    """

    def __init__(self, table: Table, deck: Deck) -> None:
        self._table, self._deck = table, deck
        self._couplings = dict[int, Coupling]()
        solids = map(table.bulk.elements.get, SOLIDS)
        self._cells = [np.array(elements.nodes) for elements in solids if elements is not None]
        self._skin = Skin([cell[:, :4] for cell in self._cells])

    def _leave_out(self, group: Group, text: str) -> None:
        self._deck.leave_out(place(group.entry), text, "changes the answer")

    def begin(self) -> None:
        """All reference nodes are free and without a load."""
        groups = self._table.groups
        self._couplings = {}
        for group in groups.all:
            if group.kind not in _KINDS:
                continue
            if group.reference in self._couplings or group.nodes & groups.references:
                self._leave_out(group, "rigid elements that share a reference node, or a chain")
            elif not {"1", "2", "3"} <= set(group.components):
                self._leave_out(group, "components 1, 2 and 3 together alone are read")
            elif not self._cells or not self._skin.covered_by(np.array(sorted(group.nodes))):
                self._leave_out(group, "nodes that are no corners of faces within them")
            elif any((cell == group.reference).any() for cell in self._cells):
                self._leave_out(group, "a reference node of the solid: here it is one beside it")
            else:
                point = [float(x) for x in groups.place(group.entry, group.reference)]
                self._couplings[group.reference] = Coupling(
                    place(group.entry),
                    group.name,
                    point,
                    _KINDS[group.kind],
                    turns=group.kind == "rbe2" or set("456") <= set(group.components),
                )
                if group.kind == "rbe3":
                    text = "its forces are spread over the area, not over the nodes"
                    self._deck.leave_out(place(group.entry), text)

    def hold(self, group: Group, factor: float) -> None:
        """Prescribes displacements and rotations of a reference node."""
        if group.system:
            text = f"directions of the coordinate system {group.system} at a reference node"
            self._leave_out(group, text)
        elif (one := self._couplings.get(group.reference)) is not None:
            one.moved |= {int(digit): factor * group.value[0] for digit in group.components}

    def push(self, node: int, first: int, vector: FloatArray) -> bool:
        """Adds a force or a moment at a reference node.

        Args:
            first: 1 of a force, 4 of a moment.

        Returns:
            Whether the node is one.
        """
        if (one := self._couplings.get(node)) is not None:
            for i, value in enumerate(vector, start=first):
                one.forces[i] = one.forces.get(i, 0.0) + float(value)
        return node in self._table.groups.references

    def finish(self, step: Step) -> None:
        """Adds what follows reference nodes to an analysis."""
        for one in self._couplings.values():
            if one.fault:
                self._deck.leave_out(one.place, one.fault, "changes the answer")
            step.supports += filter(None, [one.support()])
            step.loads += filter(None, [one.load()])
        self._couplings = {}
        warm = any(load.keys["kind"] == "thermal" for load in step.loads)
        for group in self._table.groups.all:
            if group.kind in _KINDS and expansion(group.entry):
                text = "thermal expansion of a rigid element (ALPHA)"
                severity: Severity = "changes the answer" if warm else "note"
                self._deck.leave_out(place(group.entry), text, severity)
        for entry in step.supports:
            if step.kind != "statics" and entry.keys.get("kind") == "rigid":
                text = "a rigid surface that moves exists in statics only"
                self._deck.leave_out(entry.place, text, "changes the answer")

    def springs(self) -> Iterator[Entry]:
        """Supports by springs to the ground; others are left out."""
        pairs = [(c, i) for c in self._table.of("PELAS") for i in (0, 4) if c.text(i)]
        properties = {card.integer(i): card.real(i + 1) for card, i in pairs}
        grounded = {id(group.entry): group for group in self._table.groups.all}
        for name in ("CELAS1", "CELAS2"):
            for card in self._table.of(name):
                where, group = place(card), grounded.get(id(card))
                if group is None or group.components not in ("1", "2", "3"):
                    text = "no spring from one node to the ground in component 1, 2 or 3"
                    self._deck.leave_out(where, text, "changes the answer")
                    continue
                if self._turned(min(group.nodes)) or group.nodes & self._table.groups.references:
                    text = "a spring along directions of a node's own, or at a reference node"
                    self._deck.leave_out(where, text, "changes the answer")
                    continue
                value = card.real(1) if name == "CELAS2" else 0.0
                if name == "CELAS1":
                    number = card.integer(1, card.integer(0))
                    if number not in properties:
                        raise card.error(f"there is no PELAS {number}")
                    value = properties[number]
                stiffness: list[object] = [0, 0, 0]
                stiffness[int(group.components) - 1] = Quantity(value, "stiffness")
                yield Entry(where, {"on": group.name, "kind": "spring", "stiffness": stiffness})

    def _turned(self, node: int) -> bool:
        return self._table.bulk.system_of(self._table.bulk.grids[node], 5) != 0
