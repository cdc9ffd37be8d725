"""Nastran decks as cases: closed forms after import, and what is named as missing."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.decks import box, quadratic

from dolfin_elastic import Case, run
from dolfin_elastic.case.decks.deck import Deck
from dolfin_elastic.case.decks.reading import read_deck
from dolfin_elastic.case.decks.writer import case_texts
from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.mesh.formats.nastran import read_nastran

LENGTH, WIDTH, CUBES = 8.0, 1.0, 4
POINTS, CELLS = quadratic(*box((LENGTH, WIDTH, WIDTH), (CUBES, 1, 1)))
E, RHO = 1000.0, 2.0
FACES = ((0, 1, 2), (0, 1, 3), (1, 2, 3), (0, 2, 3))
HEAD = "SOL {}\nCEND\nTITLE = a bar\n"
MATERIAL = f"PSOLID,7,5\nMAT1,5,{E},,0.,{RHO},1.-3,20."


def mesh_text(points: AnyArray = POINTS, cells: AnyArray = CELLS) -> str:
    """Nodes in free fields, elements with their continuation."""
    lines = [f"GRID,{i},,{x!r},{y!r},{z!r}" for i, (x, y, z) in enumerate(points.tolist(), 1)]
    for i, cell in enumerate(cells + 1, 1):
        words = list(map(str, cell))
        lines.append(f"CTETRA,{i},7,{','.join(words[:6])}")
        if len(words) > 6:
            lines.append(f",{','.join(words[6:])}")
    return "\n".join(lines)


def nodes(x: float) -> list[int]:
    return [int(i) + 1 for i in np.flatnonzero(POINTS[:, 0] == x)]


def held(number: int, components: str, numbers: list[int]) -> str:
    return "\n".join(f"SPC1,{number},{components},{node}" for node in numbers)


def pressed(number: int, value: float, more: str = "") -> str:
    """PLOAD4 on the end of the bar: a corner on each face, and the corner that is not on it."""
    lines = []
    for i, cell in enumerate(CELLS[:, :4], 1):
        for face in FACES:
            if (POINTS[cell[list(face)], 0] == LENGTH).all():
                (other,) = set(cell.tolist()) - set(cell[list(face)].tolist())
                lines.append(
                    f"PLOAD4,{number},{i},{value},,,,{cell[face[0]] + 1},{other + 1}{more}"
                )
    return "\n".join(lines)


# Axial support and two nodes against the rest: no cross contraction, so nothing is constrained.
WALL = held(1, "1", nodes(0.0)) + "\nSPC1,1,23,1\n" + held(1, "3", [CUBES + 2])
LOADED = f"{mesh_text()}\n{MATERIAL}\n{WALL}\n"


def read(folder: Path, control: str, bulk: str, name: str = "bar.bdf") -> Deck:
    (folder / name).write_text(f"{control}BEGIN BULK\n{bulk}\nENDDATA\n")
    return read_deck(folder / name)


def tables(deck: Deck) -> list[dict[str, Any]]:
    return [tomllib.loads(text) for text in case_texts(deck, "bar", "m-kg-s").values()]


def states(folder: Path, table: dict[str, Any]) -> list[Any]:
    return list(run(Case.from_dict(table, folder), output=folder / "out"))


@pytest.mark.long
def test_tension_gravity_temperature_and_rotation(tmp_path: Path) -> None:
    """Exact for quadratic displacements: F L/(E A), rho g L^2/(2 E), alpha dT L; to the solver's
    tolerance.  A bar that turns has rho w^2 L^3/(3 E), cubic in x: 1 % with four elements."""
    control = HEAD.format(101) + (
        "SPC = 1\nSUBCASE 1\nLOAD = 10\nSUBCASE 2\nLOAD = 11\nSUBCASE 3\nTEMP(LOAD) = 12\n"
        "SUBCASE 4\nLOAD = 13\n"
    )
    middle = int(np.flatnonzero((POINTS == [0, 0.5, 0.5]).all(axis=1))[0]) + 1
    bulk = (
        f"{LOADED}{pressed(2, -3.0)}\nLOAD,10,2.,2.,2\nGRAV,3,,5.,1.,0.,0.\nLOAD,11,1.,2.,3\n"
        f"TEMPD,12,50.\nRFORCE,13,{middle},,{0.5 / math.pi},0.,0.,1."
    )
    every = tables(read(tmp_path, control, bulk))
    known = [
        2 * 2 * 3 * LENGTH / E,
        RHO * 10 * LENGTH**2 / (2 * E),
        1e-3 * 30 * LENGTH,
        RHO * LENGTH**3 / (3 * E),
    ]
    for table, value, near in zip(every, known, (1e-9, 1e-9, 1e-9, 1e-2), strict=True):
        *_, state = states(tmp_path, table)
        u = state.max_displacement
        tip = u if value != known[2] else u / math.hypot(1, WIDTH / LENGTH, WIDTH / LENGTH)
        assert tip == pytest.approx(value, rel=near)


def test_modes_of_a_rod(tmp_path: Path) -> None:
    """Held along its axis in the middle of nothing else: the first axial mode c/(4 L); quadratic
    elements of a quarter of the rod, whose error is (pi/2/4)^4/720 of the frequency."""
    sides = held(1, "23", [i + 1 for i in range(len(POINTS))])
    control = HEAD.format("SEMODES") + "SPC = 1\nMETHOD = 9\n"
    (table,) = tables(read(tmp_path, control, f"{LOADED}{sides}\nEIGRL,9,,,2"))
    assert table["modal"] == {"count": 2}
    first, *_ = states(tmp_path, table)
    assert first.frequency == pytest.approx(math.sqrt(E / RHO) / (4 * LENGTH), rel=1e-4)


def test_buckling_of_a_column(tmp_path: Path) -> None:
    """Euler's load of a column that is fixed at one end, within the part of shear, 1.2 P/(G A),
    and the error of four quadratic elements."""
    control = HEAD.format(105) + "SPC = 1\nSUBCASE 1\nLOAD = 2\nSUBCASE 2\nMETHOD = 9\n"
    wall = held(1, "123", nodes(0.0))
    bulk = f"{mesh_text()}\n{MATERIAL}\n{wall}\n{pressed(2, 1.0)}\nEIGRL,9,,,1"
    (table,) = tables(read(tmp_path, control, bulk))
    assert table["buckling"] == {"count": 1} and "statics" not in table
    first, *_ = states(tmp_path, table)
    euler = math.pi**2 * E * WIDTH**4 / 12 / (2 * LENGTH) ** 2
    assert first.load_factor == pytest.approx(euler / (1 + 1.2 * euler / (E / 2)), rel=0.02)


def test_two_bucklings_of_one_state(tmp_path: Path) -> None:
    """Both have its loads, where the second one had none; a state that none needs stays."""
    control = HEAD.format(105) + (
        "SPC = 1\nSUBCASE 1\nLOAD = 2\nSUBCASE 2\nLOAD = 3\nSUBCASE 3\nMETHOD = 9\nSTATSUB = 1\n"
        "SUBCASE 4\nMETHOD = 8\nSTATSUB = 1\nSUBCASE 5\nMETHOD = 8\nSTATSUB = 7\n"
    )
    loads = f"{pressed(2, 1.0)}\nFORCE,3,3,,1.,1."
    deck = read(tmp_path, control, f"{LOADED}{loads}\nEIGRL,9,,,1\nEIGRL,8,,,2")
    assert [step.kind for step in deck.steps] == ["statics", *["buckling"] * 3]
    assert [len(step.loads) for step in deck.steps] == [1, 1, 1, 0]
    assert ["there is no subcase 7 before it" in str(one) for one in deck.faults] == [True]


# --- texts ---


def one(folder: Path, bulk: str, control: str = "SPC = 1\nLOAD = 2\n") -> dict[str, Any]:
    deck = read(folder, HEAD.format(101) + control, f"{mesh_text()}\n{bulk}")
    (table,) = tables(deck)
    return table | {"faults": [str(fault) for fault in deck.faults]}


def test_forces_in_their_systems(tmp_path: Path) -> None:
    """A system about x, turned by 90 degrees, and a cylindrical one, whose first direction is
    away from its axis; two nodes with the same force are one part, and a force that stands twice
    at one of them acts twice: it would be lost in a set of nodes."""
    systems = "CORD2R,4,,0.,0.,0.,1.,0.,0.\n,0.,1.,0.\nCORD2C,6,,0.,0.,0.,1.,0.,0.\n,0.,1.,0."
    corner = int(np.flatnonzero((POINTS == [0, 1, 1]).all(axis=1))[0]) + 1
    bulk = (
        f"{MATERIAL}\n{held(1, '123', [1])}\n{systems}\nFORCE,2,3,4,2.,1.,0.,0.\n"
        f"FORCE,2,4,4,2.,1.,0.,0.\nFORCE,2,{corner},6,2.,1.,0.,0.\nFORCE1,2,5,3.,1,2\n"
        "FORCE,2,3,4,2.,1.,0.,0."
    )
    table = one(tmp_path, bulk)
    r = math.sqrt(2)
    values = {load["on"]: load["value"] for load in table["load"]}
    assert values == {
        "force_2": [0, "2 N", 0],
        "force_2_2": [
            0,
            f"{r:.12f} N".replace("1.414213562373", values["force_2_2"][1][:-2]),
            values["force_2_2"][2],
        ],
        "force_2_3": ["3 N", 0, 0],
        "force_2_4": [0, "2 N", 0],
    }
    assert float(values["force_2_2"][1].split()[0]) == pytest.approx(r, rel=1e-11)
    sets = read_nastran(tmp_path / "bar.bdf").point_sets
    assert sets["force_2"].tolist() == [2, 3] and sets["force_2_4"].tolist() == [2]
    assert table["faults"] == []


def test_supports_by_values_and_systems(tmp_path: Path) -> None:
    turned = "CORD2R,4,,0.,0.,0.,1.,0.,0.\n,0.,1.,0.\nCORD2R,5,,0.,0.,0.,1.,1.,0.\n,0.,0.,1."
    text = mesh_text().replace("GRID,9,,", "GRID,9,,").splitlines()
    text[8] += ",4"
    text[9] += ",5"
    text[10] += ",,13"
    bulk = "\n".join(text) + (
        f"\n{MATERIAL}\n{turned}\nSPCADD,1,20,21\nSPC,20,1,123,,2,1,0.5\n"
        "SPC1,21,2,9,THRU,10\nFORCE,2,3,,1.,1.\nSPCD,2,2,1,0.25"
    )
    deck = read(tmp_path, HEAD.format(101) + "SPC = 1\nLOAD = 2\n", bulk)
    (table,) = tables(deck)
    assert table["support"] == [
        {"on": "spc_20_123", "kind": "fixed"},
        {"on": "spc_20_1", "displacement": ["0.5 m", "free", "free"]},
        {"on": "spc_21_2", "displacement": ["free", "free", 0]},
        {"on": "spc_13", "displacement": [0, "free", 0]},
        {"on": "spcd_2_1", "displacement": ["0.25 m", "free", "free"]},
    ]
    (fault,) = deck.faults
    assert "directions of the coordinate system 5: here x, y and z alone" in str(fault)


def test_pressures_along_a_direction_and_by_nodes(tmp_path: Path) -> None:
    """PLOAD acts by the right-hand rule of its nodes, PLOAD4 into the element; what stands twice
    acts twice."""
    cell = next(c for c in CELLS[:, :4] if (POINTS[c, 0] == LENGTH).sum() == 3)
    a, b, c = (int(n) + 1 for n in cell if POINTS[n, 0] == LENGTH)
    x = POINTS[[a - 1, b - 1, c - 1]]
    outwards = np.cross(x[1] - x[0], x[2] - x[0])[0] > 0
    along = pressed(2, 3.0, "\n,0,0.,2.,0.")
    pload = f"PLOAD,2,4.,{a},{b},{c}"
    found = one(tmp_path, f"{MATERIAL}\n{WALL}\n{along}\n{pload}\n{pload}")["load"]
    assert [load["on"] for load in found] == ["pload_2", "pload_2_2", "pload_2_3"]
    loads = {load["kind"]: load for load in found}
    assert loads["traction"]["value"] == [0, "3 Pa", 0]
    assert loads["pressure"]["value"] == ("-4 Pa" if outwards else "4 Pa")


def test_orthotropic_axes_and_wtmass(tmp_path: Path) -> None:
    bulk = (
        "PSOLID,7,5,4\nCORD2R,4,,0.,0.,0.,1.,0.,0.\n,0.,1.,0.\nPARAM,WTMASS,0.5\n"
        "MAT11,5,10.,9.,8.,.1,.2,.3,3.\n,2.,1.,4.,1.-5,1.-5,1.-5"
    )
    deck = read(tmp_path, "SOL 101\nCEND\n", f"{mesh_text()}\n{bulk}")
    assert case_texts(deck, "bar", "m-kg-s")
    (material,) = deck.materials.values()
    numbers = {k: getattr(v, "value", v) for k, v in material.keys.items()}
    assert numbers.pop("axis1") == pytest.approx([0, 1, 0], abs=1e-15)
    assert numbers.pop("axis2") == pytest.approx([0, 0, 1], abs=1e-15)
    assert numbers == {
        **{"law": "orthotropic", "E1": 10, "E2": 9, "E3": 8, "nu12": 0.1, "nu13": 0.2},
        **{"nu23": 0.3, "G12": 3, "G13": 2, "G23": 1, "density": 2, "expansion": 1e-5, "on": "7"},
    }


LISTED = {
    "solution": ("SOL 106\nCEND\n", "", "bar.bdf:1: the solution 106: 101, 103 and 105"),
    "moment": ("", "MOMENT,2,3,,1.,1.", "MOMENT: a moment at a node of a solid"),
    "spring": ("", "CELAS2,99,1.,1,1,2,1", "CELAS2: no spring from one node"),
    "rigid": ("", "RBE2,99,1,123,2", "RBE2: nodes that are no corners of faces"),
    "directions": ("", "RBE2,99,1,12,2", "RBE2: components 1, 2 and 3 together"),
    "chain": ("", "RBE2,98,1,123,2\nRBE2,99,2,123,3", "a reference node, or a chain"),
    "mass": (HEAD.format(103), "CONM2,99,1,,2.", "CONM2: a mass at a node: [[mass]] spreads"),
    "joint": ("", "RBAR,99,1,2,123456", "RBAR: this entry is not known here"),
    "bar": ("", "CBAR,99,1,1,2", "CBAR: 1 elements that have no stiffness here"),
    "stiffness": ("", "MAT9,5", "MAT9: no law here has this stiffness"),
    "relief": ("", "PARAM,INREL,-1", "PARAM: inertia relief"),
    "preload": (HEAD.format(103) + "STATSUB=1\nMETHOD=9\n", "EIGRL,9,,,1", "(STATSUB), about"),
    "initial": (HEAD.format(101) + "TEMP(INIT) = 4\n", "", "temperatures of INIT: those of"),
    "word": (HEAD.format(101) + "MPC = ALL\n", "", "MPC = ALL, no number"),
    "empty": ("", "", "the set LOAD 2 has no loads that are known here"),
}


@pytest.mark.parametrize("what", LISTED)
def test_what_is_not_carried_over_has_its_line(tmp_path: Path, what: str) -> None:
    head, bulk, said = LISTED[what]
    material = MATERIAL if what != "stiffness" else "PSOLID,7,5"
    force = "FORCE,2,3,,1.,1." if what not in ("empty", "moment") else ""
    control = (head or HEAD.format(101)) + "SPC = 1\nLOAD = 2\n"
    deck = read(tmp_path, control, f"{mesh_text()}\n{material}\n{WALL}\n{force}\n{bulk}")
    assert any(said in str(fault) for fault in deck.faults), deck.faults
    assert all(fault.place.line for fault in deck.faults)


BROKEN = {
    "PLOAD4,2,999,1.,,,,1,2": "there is no CTETRA 999",
    "PLOAD4,2,1,1.,,,,1,1": "1 and 1 name no face of CTETRA 1",
    "PLOAD4,2,1,1.,2.,,,1,2": "the pressure varies over the face",
    "FORCE,2,999,,1.,1.": "there is no GRID 999",
    "SPC1,1,7,1": "'7' are no directions",
    "FORCE,2,3,,1.,1.E999": "field 6 is '1.E999', no finite number",
    "SPC1,1,1,1,THRU,99999999": "more nodes than a file has",
}


@pytest.mark.parametrize("line", BROKEN)
def test_lines_that_cannot_be_read(tmp_path: Path, line: str) -> None:
    """Errors of a case; as a mesh alone such a file is read."""
    with pytest.raises(MeshError, match=rf"bar.bdf:\d+: .*{BROKEN[line]}"):
        read(tmp_path, HEAD.format(101) + "SPC = 1\nLOAD = 2\n", f"{LOADED}{line}")
    assert len(read_nastran(tmp_path / "bar.bdf").points) == len(POINTS)
