"""Materials of Nastran that tetrahedra have: MAT1, and MAT11 by way of PSOLID.

Source: MSC Nastran 2021, Quick Reference Guide, entries MAT1, MAT11, PSOLID.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from dolfin_elastic.case.decks.deck import Deck, Entry, Quantity
from dolfin_elastic.case.decks.nastran.table import Table, place
from dolfin_elastic.mesh.formats.nastran.entries import Entry as Card

Keys = dict[str, object]


def take_materials(table: Table, deck: Deck) -> dict[str, float]:
    """Writes the material of each property; returns their temperatures of reference by name."""
    used = table.solids()
    properties = {card.integer(0): card for card in table.of("PSOLID")}
    materials = {card.integer(0): card for name in ("MAT1", "MAT11") for card in table.of(name)}
    others = {c.integer(0): c for n in ("MAT9", "MAT2", "MAT8", "MAT10") for c in table.of(n)}
    parts = dict[tuple[int, str], list[str]]()
    for number, card in used.items():
        solid = properties.get(number)
        if solid is None:
            raise card.error(f"there is no PSOLID {number}")
        found = materials.get(solid.integer(1))
        turns = found is not None and found.name == "MAT11"
        key = solid.integer(1), solid.text(2) if turns else ""
        parts.setdefault(key, []).append(str(number))
    references = dict[str, float]()
    for (number, system), on in parts.items():
        found = materials.get(number)
        if found is None:
            other = others.get(number)
            if other is None:
                raise properties[int(on[0])].error(f"there is no material {number}")
            deck.leave_out(place(other), "no law here has this stiffness", "changes the answer")
            continue
        name = f"material {number}" + (f" in {system}" if system else "")
        keys = _isotropic(found) if found.name == "MAT1" else _orthotropic(found, system, table)
        density, expansion, reference = _rest(found)
        keys |= _given(density * table.mass_factor, expansion)
        keys["on"] = on[0] if len(on) == 1 else on
        deck.materials[name] = Entry(place(found), keys)
        references[name] = reference
    return references


def _rest(card: Card) -> tuple[float, float, float]:
    """Density, coefficient of expansion, and temperature of reference."""
    if card.name == "MAT1":
        return card.real(4), card.real(5), card.real(6)
    expansions = {card.real(i) for i in (11, 12, 13)}
    if len(expansions) > 1:
        raise card.error("the expansion differs between its directions")
    return card.real(10), card.real(11), card.real(14)


def _given(density: float, expansion: float) -> Mapping[str, object]:
    keys = dict[str, object]()
    if density:
        keys["density"] = Quantity(density, "density")
    if expansion:
        keys["expansion"] = Quantity(expansion, "expansion")
    return keys


def _isotropic(card: Card) -> Keys:
    """Two of E, G and NU; the third is E = 2 G (1 + NU)."""
    E, G, nu = (card.real(i) if card.text(i) else None for i in (1, 2, 3))
    if E is not None and nu is None:
        nu = E / (2 * G) - 1 if G else 0.0
    elif E is None and G is not None:
        E = 2 * G * (1 + (nu or 0.0))
    if E is None or nu is None:
        raise card.error("two of E, G and NU are needed")
    return {"law": "linear-elastic", "E": Quantity(E, "stress"), "nu": nu}


def _orthotropic(card: Card, system: str, table: Table) -> Keys:
    names = ("E1", "E2", "E3", "nu12", "nu13", "nu23", "G12", "G13", "G23")
    keys: Keys = {"law": "orthotropic"}
    for i, name in enumerate(names, start=1):
        value = card.real(i)
        keys[name] = value if name.startswith("nu") else Quantity(value, "stress")
    if system not in ("", "0"):
        first, second = np.eye(3)[:2]
        axes = [
            table.groups.direction(card, int(system) if system.isdecimal() else -1, axis)
            for axis in (first, second)
        ]
        keys |= {f"axis{i}": axis.tolist() for i, axis in enumerate(axes, start=1)}
    return keys


def rotation_speed(turns: float) -> Quantity:
    """Revolutions per unit of time as an angular velocity."""
    return Quantity(2 * math.pi * turns, "rotation")
