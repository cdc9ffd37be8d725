"""Materials by name: what the library holds, and what a case makes of it."""

from __future__ import annotations

import re
from typing import Any

import pytest

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.report import report
from dolfin_elastic.case.tables import Material
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.library import check_library, completed, library

BOX = {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}}


def named(name: object, **keys: Any) -> Any:
    """The law of a material."""
    return Material.read({"material": name, **keys}).law


def case(material: dict[str, Any], **tables: Any) -> Case:
    return Case(mesh=BOX, materials={"m": material}, support=[{"on": "left"}], **tables)


@pytest.mark.parametrize("name", library())
def test_every_entry(name: str) -> None:
    """It is a stable material with a source of a year, or says what is to be given."""
    entry, given = library()[name], {}
    if not entry.keys() & {"E", "mu"}:
        with pytest.raises(
            InputError, match="E: this key is missing; give E, 10|E: .*; give E, 0.1"
        ):
            named(name)
        given = {"E": "1 MPa"}
    law = named(name, **given)
    assert isinstance(law, Law)
    moduli = law.small_strain()
    assert moduli is not None
    assert 100 < moduli.E < 300e9
    assert moduli.mu > 0
    assert re.search(r"(19|20)\d\d", entry["source"] + entry.get("note", ""))
    assert law.density is None or 400 < law.density < 9000
    assert (law.allowable is None) is ("yield" not in entry)
    assert Material.read({"material": name, **given}).source == f"{name}: {entry['source']}"


def test_keys_and_names_of_the_library() -> None:
    check_library(library())
    names = [n.casefold() for known, e in library().items() for n in (known, *e.get("also", ()))]
    assert len(names) == len(set(names))
    twice = {"My steel": {"E": 2e11}, "my  STEEL": {"E": 1e9}, "wood": {"also": ["My steel"]}}
    with pytest.raises(InputError) as caught:
        check_library(twice)
    found = [(one.where, one.what.partition(" is ")[0]) for one in caught.value.each]
    assert found == [('"my  STEEL"', "the name 'my  STEEL'"), ('"wood"', "the name 'My steel'")]


def test_values() -> None:
    steel = named("steel S235")
    assert (steel.E, steel.nu, steel.density) == (210e9, 0.3, 7850)
    assert (steel.allowable, steel.expansion) == (235e6, pytest.approx(12e-6))
    assert named("s235jr") == named("  Steel  S235 ") == steel
    rubber = named("rubber NR 50 Shore A")
    assert (rubber.name(), rubber.mu, rubber.K) == ("neo-hookean-split", 0.64e6, 1030e6)


def test_a_law_that_yields_takes_the_yield_stress() -> None:
    law = named("steel S235", law="j2", hardening="1 GPa")
    assert law.yield_stress == 235e6
    assert law.allowable is None
    table = named("steel S235", law="j2", hardening=[[0, "250 MPa"], [0.1, "300 MPa"]])
    assert table.first_yield == 250e6
    assert named("steel S235", law="j2", **{"yield": "240 MPa"}).yield_stress == 240e6


def test_what_the_case_gives_wins() -> None:
    law = named("steel S235", allowable="150 MPa", E="200 GPa", law="st-venant-kirchhoff")
    assert (law.name(), law.E, law.nu, law.allowable) == ("st-venant-kirchhoff", 200e9, 0.3, 150e6)
    law = named("steel S235", K="160 GPa", mu="80 GPa")
    assert (law.K, law.mu, law.density) == (160e9, 80e9, 7850)
    assert named("steel S235", rho="7.9 g/cm^3").density == 7900
    own = {"ours": {"E": 1e9, "nu": 0.3, "rho": 1000}}
    assert completed({"material": "ours", "density": 900}, own)["density"] == 900
    assert "rho" not in completed({"material": "ours", "density": 900}, own)


@pytest.mark.parametrize("name", ["steel S235", "Steel s235", "S235", "mild steel"])
def test_a_name_of_ones_own_wins_however_it_is_written(name: str) -> None:
    own = {name: {"E": 1e9, "nu": 0.2}}
    for written in (name, name.upper()):
        assert completed({"material": written}, own)["E"] == 1e9
    own = {"ours": {"also": [name], "E": 1e9, "nu": 0.2}}
    assert completed({"material": name}, own)["source"] == "ours"


def test_more_that_the_case_gives() -> None:
    law = named("rubber NR 50 Shore A", law="mooney-rivlin", c10="0.2 MPa", c01="0.1 MPa")
    assert (law.K, law.density) == (1030e6, 1100)
    law = named("bone, trabecular", E="300 MPa", density=500)
    assert (law.E, law.nu, law.density) == (300e6, 0.3, 500)
    own = named("steel S235", energy="mu/2*(I1 - 3) - mu*ln(J)", parameters={"mu": 1e9})
    assert (own.density, own.allowable) == (7850, 235e6)
    assert Material.read({"material": "PLA", "on": "a", "source": "mine"}).on == "a"
    assert Material.read({"material": "PLA", "source": "mine"}).source == "mine"


@pytest.mark.parametrize(
    ("table", "says"),
    [
        (
            {"material": "steel"},
            "there is no material 'steel' in the library; known: \"steel S235\", ",
        ),
        ({"material": "steel S234"}, "did you mean 'steel S235'? (dolfin-elastic materials lists"),
        ({"material": "6061"}, 'known: "aluminium 6061-T6" ('),
        ({"material": 3}, "materials.m.material: 3 is wrong; expected the name of a material"),
        ({"material": "PLA", "yield": 3}, "materials.m: unknown key 'yield'; did you mean 'allow"),
        ({"material": "PLA", "mu": 3}, "3 given (E, mu, nu); 'PLA' has E and nu: give one of"),
        ({"law": "steel"}, 'a material of the library is material = "..."; known: "steel S235", '),
        ({"E": 1}, "for one of the library"),
        ({"materal": "PLA", "law": "hencky"}, "unknown key 'materal'; did you mean 'material'?"),
    ],
)
def test_what_is_no_material(table: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError) as caught:
        case(table)
    assert says in str(caught.value)


def test_a_material_beside_the_tables() -> None:
    with pytest.raises(InputError, match=r"'material'; did you mean 'materials'\? As in \[mat"):
        Case(mesh=BOX, material="steel S235")


def test_a_case_keeps_values_and_source() -> None:
    """It is read back from its own text, without any library; check names the source."""
    made = case({"material": "steel S235"}, output={"fields": ["safety_factor"]})
    assert "material" not in made.to_dict()["materials"]["m"]
    assert Case.from_dict(made.to_dict()) == made
    found = report(made)
    assert any("E = 210 GPa" in one and "density = 7850" in one for one in found.constants)
    assert any("source: steel S235: E, nu" in one for one in found.constants)


def test_check_shows_constants_and_whose_they_are() -> None:
    """Bare numbers of a strength are in Pa; what a case gives is no value of the library."""
    made = case({"material": "steel S235", "allowable": 235, "E": "200 GPa"})
    found = report(made)
    (line, source) = found.constants
    assert line.startswith("m: linear-elastic, E = 200 GPa, nu = 0.3, ")
    assert source.startswith("  source: steel S235, but allowable, E of the case: ")
    (note,) = [one for one in found.notes if "allowable" in one]
    assert note.endswith('Young\'s modulus of 200 GPa: did you mean "235 MPa"?')
    given = case({"material": "steel S235", "allowable": "235 MPa"})
    assert not [one for one in report(given).notes if "allowable" in one]


def test_two_materials_of_textbooks() -> None:
    """By their plain names, which no grade has; what they are good for is said in their notes."""
    steel, rubber = named("stainless steel"), named("Rubber")
    assert (steel.E, steel.nu, steel.allowable) == (180e9, 0.3, None)
    assert (rubber.E, rubber.nu) == (10e6, 0.4999)
    assert named("stainless steel 304").E == 200e9
    for name in ("stainless steel", "rubber"):
        assert library()[name]["note"].startswith("for exercises")
