"""Decks of Abaqus and CalculiX as cases: each word, what is left out, and closed forms."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.decks import box, inp_text, numbers, quadratic

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.decks.deck import Deck
from dolfin_elastic.case.decks.reading import read_deck
from dolfin_elastic.case.decks.writer import case_texts
from dolfin_elastic.core.errors import InputError, MeshError

POINTS, CELLS = box((10, 10, 10), (1, 1, 1))
STEEL = (
    "*MATERIAL, NAME=steel\n*ELASTIC\n210000., 0.3\n*DENSITY\n7.85e-9\n"
    "*SOLID SECTION, ELSET=ALL, MATERIAL=steel\n"
)
STATIC = "*STEP\n*STATIC\n{}*END STEP\n"
SETS = "".join(
    f"*NSET, NSET={name}\n{numbers(np.flatnonzero(POINTS[:, axis] == level))}\n"
    for name, axis, level in (("left", 0, 0), ("back", 1, 0), ("bottom", 2, 0), ("top", 2, 10))
)
EVERY = "*NSET, NSET=every, GENERATE\n1, 8\n"


def read(folder: Path, text: str) -> Deck:
    """A deck of the cube with more lines."""
    (folder / "deck.inp").write_text(text, encoding="latin-1")
    return read_deck(folder / "deck.inp")


def cube(more: str, sets: str = SETS + EVERY) -> str:
    return inp_text(POINTS, CELLS, sets + more)


def tables(folder: Path, text: str, count: int = 1) -> list[dict[str, Any]]:
    """The cases of a deck, which can be read as such."""
    texts = case_texts(read(folder, text), "deck", "mm-t-s")
    assert len(texts) == count
    result = [tomllib.loads(one) for one in texts.values()]
    for one in result:
        Case.from_dict(one, folder)
    return result


def one(folder: Path, text: str) -> dict[str, Any]:
    return tables(folder, text)[0]


def faults(folder: Path, text: str) -> list[str]:
    return [str(fault) for fault in read(folder, text).faults]


# --- materials ---

LAWS = {
    "iso": ("*ELASTIC\n210000., 0.3\n", {"law": "linear-elastic", "E": "210000 MPa", "nu": 0.3}),
    "neo": (
        "*HYPERELASTIC, NEO HOOKE\n0.5, 0.1\n",
        {"law": "neo-hookean-split", "mu": "1 MPa", "K": "20 MPa", "volumetric": "quadratic"},
    ),
    "mooney": (
        "*HYPERELASTIC, MOONEY-RIVLIN\n0.5, 0.2, 0.1\n",
        {"law": "mooney-rivlin", "c10": "0.5 MPa", "c01": "0.2 MPa", "K": "20 MPa"},
    ),
    "polynomial": (
        "*HYPERELASTIC, N=1\n0.5, 0.2, 0.1\n",
        {"law": "mooney-rivlin", "c10": "0.5 MPa", "c01": "0.2 MPa", "K": "20 MPa"},
    ),
    "yeoh": (
        "*HYPERELASTIC, YEOH\n0.5, -0.02, 0.01, 0.1\n",
        {"law": "yeoh", "c10": "0.5 MPa", "c20": "-0.02 MPa", "c30": "0.01 MPa", "K": "20 MPa"},
    ),
    "reduced": (
        "*HYPERELASTIC, REDUCED POLYNOMIAL, N=2\n0.5, 0.02, 0.1, 0.\n",
        {"law": "yeoh", "c10": "0.5 MPa", "c20": "0.02 MPa", "c30": 0, "K": "20 MPa"},
    ),
    "ogden": (
        "*HYPERELASTIC, OGDEN, N=2\n1., 2., 0.5, 4., 0.1, 0.\n",
        {"law": "ogden", "mu": ["1 MPa", "0.25 MPa"], "alpha": [2.0, 4.0], "K": "20 MPa"},
    ),
    "arruda": (
        "*HYPERELASTIC, ARRUDA-BOYCE\n0.35, 2.8, 0.1\n",
        {"law": "arruda-boyce", "mu": "0.35 MPa", "limit": 2.8, "volumetric": "simo-taylor"},
    ),
    "no D1": ("*HYPERELASTIC, NEO HOOKE\n0.5\n", {"mu": "1 MPa", "K": "20 MPa"}),
    "ideal": (
        "*ELASTIC\n9., 0.3\n*PLASTIC\n2., 0.\n",
        {"law": "j2", "E": "9 MPa", "yield": "2 MPa"},
    ),
    "table": (
        "*PLASTIC\n2., 0.\n3., 0.1, 0.\n*ELASTIC\n9., 0.3\n",
        {"law": "j2", "hardening": [[0.0, "2 MPa"], [0.1, "3 MPa"]]},
    ),
    "kinematic": (
        "*ELASTIC\n9., 0.3\n*PLASTIC, HARDENING=KINEMATIC\n2., 0.\n3., 0.1\n",
        {"law": "j2", "yield": "2 MPa", "kinematic": "10 MPa"},
    ),
    "constants": (
        "*ELASTIC, TYPE=ENGINEERING CONSTANTS\n3., 2., 1., .1, .2, .3, 4., 5.,\n6.\n",
        {"law": "orthotropic", "E1": "3 MPa", "nu23": 0.3, "G13": "5 MPa", "G23": "6 MPa"},
    ),
}


@pytest.mark.parametrize("name", LAWS)
def test_laws(tmp_path: Path, name: str) -> None:
    """Constants as the manuals of Abaqus and CalculiX define them."""
    text, keys = LAWS[name]
    more = STEEL.replace("*ELASTIC\n210000., 0.3\n", text) + STATIC.format("")
    material = one(tmp_path, cube(more))["materials"]["steel"]
    assert keys.items() <= material.items()
    assert material["on"] == "ALL"
    assert material["density"] == "7.85e-09 t/mm^3"


def test_the_line_of_a_yield_stress_is_told(tmp_path: Path) -> None:
    more = STEEL.replace("*DENSITY", "*PLASTIC\n2., 0.\n*DENSITY") + STATIC.format("")
    (text,) = case_texts(read(tmp_path, cube(more)), "deck", "mm-t-s").values()
    assert "*PLASTIC of line" in text.partition("[materials.steel]")[0].splitlines()[-1]


def test_stiffnesses_of_ortho(tmp_path: Path) -> None:
    """D1111 ... of an isotropic body give back its E and nu."""
    E, nu = 210000.0, 0.3
    diagonal, other = (E * x / (1 + nu) / (1 - 2 * nu) for x in (1 - nu, nu))
    D = [diagonal, other, diagonal, other, other, diagonal, *[E / 2 / (1 + nu)] * 3]
    text = ", ".join(map(repr, D[:8])) + f",\n{D[8]!r}"
    more = STEEL.replace("*ELASTIC\n210000., 0.3", f"*ELASTIC, TYPE=ORTHO\n{text}")
    axes = "*ORIENTATION, NAME=turned\n0., 1., 0., -1., 0., 0.\n"
    more = axes + more + STATIC.format("")
    more = more.replace("MATERIAL=steel", "MATERIAL=steel, ORIENTATION=turned")
    material = one(tmp_path, cube(more))["materials"]["steel"]
    assert float(material["E2"].split()[0]) == pytest.approx(E, rel=1e-12)
    assert material["nu13"] == pytest.approx(nu, rel=1e-12)
    assert material["axis1"] == [0, 1, 0]
    assert material["axis2"] == [-1, 0, 0]


LACKING = {
    "*PLASTIC, HARDENING=COMBINED\n200., 0.\n": "PLASTIC: HARDENING=COMBINED is not there",
    "*PLASTIC\n200., 0., 20.\n100., 0., 300.\n": "PLASTIC: constants that depend on the temper",
    "*PLASTIC\n200., 0.\n*PLASTIC\n300., 0.\n": "PLASTIC: a second table",
    "*PLASTIC, RATE=2.\n200., 0.\n": "PLASTIC: RATE is not there",
    "*PLASTIC\n200., 0.1\n": "PLASTIC: its first row needs a yield stress above 0",
    "*PLASTIC\n200., 0.\n100., 0.1\n": "PLASTIC: plastic strains must grow",
    "*PLASTIC, HARDENING=KINEMATIC\n200., 0.\n300., 0.\n": "PLASTIC: plastic strains must grow",
    "*VISCOELASTIC, TIME=PRONY\n.1, 0., 1.\n": "VISCOELASTIC: state it as `viscous`",
    "*EXPANSION, TYPE=ORTHO\n1., 2., 3.\n": "EXPANSION: it is not the same everywhere",
    "*USER MATERIAL, CONSTANTS=1\n1.\n": "its subroutine cannot be read",
    "*GHOST\n1.\n": "GHOST: this keyword is not known",
}


@pytest.mark.parametrize("text", LACKING)
def test_laws_that_are_lacking(tmp_path: Path, text: str) -> None:
    """They change the answer, and are named with their line."""
    more = STEEL.replace("*DENSITY", text + "*DENSITY") + STATIC.format("")
    (fault,) = faults(tmp_path, cube(more))
    assert LACKING[text] in fault
    assert fault.startswith("deck.inp:")


# --- supports and loads ---


def test_supports(tmp_path: Path) -> None:
    """By set and word, by directions and value, and by number of node."""
    more = (
        "*BOUNDARY\nleft, XSYMM\nback, 2\nbottom, ENCASTRE\ntop, 3, 3, 0.5\n7, 1, 2\n8, 3,, .25\n"
    )
    case = one(tmp_path, cube(more + STEEL + STATIC.format("")))
    assert case["support"] == [
        {"on": "left", "displacement": [0, "free", "free"]},
        {"on": "back", "displacement": ["free", 0, "free"]},
        {"on": "bottom", "kind": "fixed"},
        {"on": "top", "displacement": ["free", "free", "0.5 mm"]},
        {"on": "BOUNDARY line 27 xy", "displacement": [0, 0, "free"]},
        {
            "on": "BOUNDARY line 27 z",
            "displacement": ["free", "free", {"field": "BOUNDARY line 27 z", "unit": "mm"}],
        },
    ]


def test_supports_that_are_fixed(tmp_path: Path) -> None:
    """Where the body has not moved they are supports at 0; later they keep those before them, and
    stop nothing that was free."""
    held = "*BOUNDARY, FIXED\nbottom, 1, 3, 7.\n"
    step = "*STEP, NLGEOM\n*STATIC\n{}*END STEP\n"
    first, second = step.format("*BOUNDARY\ntop, 3, 3, 0.5\n"), step.format("{}")
    again = "*BOUNDARY, FIXED\nbottom, 1, 3\ntop, 3\n8, 3\n"
    case = one(tmp_path, cube(held + STEEL + first + second.format(again)))
    assert case["support"] == [
        {"on": "bottom", "kind": "fixed"},
        {
            "on": "top",
            "displacement": ["free", "free", "0.5 mm"],
            "curve": [[0.0, 0.0], [1.0, 1.0], [2.0, 1.0]],
        },
    ]
    (fault,) = faults(tmp_path, cube(held + STEEL + first + second.format(again + "8, 2\n")))
    assert fault.startswith("deck.inp:46 *BOUNDARY: FIXED: it stops nodes")


SPRINGS = "*ELEMENT, TYPE=SPRING1, ELSET=S\n101, 7\n102, 8\n*SPRING, ELSET=S{}\n{}\n300.,\n"


def test_springs_to_the_ground(tmp_path: Path) -> None:
    """At each node of a set, in N/mm; others stay an error."""
    text = cube(SPRINGS.format("", 3) + STEEL + STATIC.format(""))
    assert not faults(tmp_path, text)
    case = one(tmp_path, text)
    stiffness = [0, 0, "300 N/mm"]
    spring = {"on": "ELEMENT line 27", "kind": "spring", "stiffness": stiffness}
    assert case["support"] == [spring]
    for words in (("", 4), (", NONLINEAR", 1)):
        (fault,) = faults(tmp_path, cube(SPRINGS.format(*words) + STEEL + STATIC.format("")))
        assert "SPRING: springs to the ground (SPRING1) along x, y or z" in fault
    (fault,) = faults(tmp_path, text.replace("102, 8", "102, 8\n103, 6\n104, 5"))
    assert "SPRING: springs at all corners of a face" in fault


def test_springs_of_several_keywords(tmp_path: Path) -> None:
    """Each has a support; only the last one would have one if the others were lost."""
    more = SPRINGS.format("", 3).replace("102, 8", "*ELEMENT, TYPE=SPRING1, ELSET=S\n102, 8")
    supports = one(tmp_path, cube(more + STEEL + STATIC.format("")))["support"]
    assert [support["on"] for support in supports] == ["ELEMENT line 27", "ELEMENT line 29"]


OTHER_SPRINGS = {
    SPRINGS.format("", 3).replace("102, 8", "102, 7"): "30 *SPRING: a node that has several",
    "*ELEMENT, TYPE=SPRING1, ELSET=S\n101, 7\n": "27 *ELEMENT: no *SPRING below it",
    "*SPRING, ELSET=S\n3\n300.,\n": "27 *SPRING: no *ELEMENT, TYPE=SPRING1 above it",
}


@pytest.mark.parametrize("text", OTHER_SPRINGS)
def test_springs_that_are_not_there(tmp_path: Path, text: str) -> None:
    """Of two at a node one would be lost, of a set without a keyword all."""
    (fault,) = faults(tmp_path, cube(text + STEEL + STATIC.format("")))
    assert f"deck.inp:{OTHER_SPRINGS[text]}" in fault


LOADS = {
    "*CLOAD\ntop, 2, 5.\ntop, 2, 1.\ntop, 3, -2.\n": {
        "kind": "point-force",
        "on": "top",
        "value": [0, "6 N", "-2 N"],
    },
    "*CLOAD\n8, 3, -2.\n7, 1, 1.\n": {
        "kind": "point-force",
        "on": "CLOAD line 37",
        "value": {"field": "CLOAD line 37", "unit": "N"},
    },
    "*DLOAD\n1, P2, 3.\n": {"kind": "pressure", "on": "DLOAD line 37", "value": "3 MPa"},
    "*DLOAD\nALL, GRAV, 9810., 0., 0., -2.\n": {
        "kind": "gravity",
        "value": [0, 0, "-9810 mm/s^2"],
        "on": "ALL",
    },
    "*DLOAD\nALL, CENTRIF, 4., 1., 2., 3., 0., 0., 1.\n": {
        "kind": "centrifugal",
        "value": "2 rad/s",
        "point": [1, 2, 3],
        "axis": [0, 0, 1],
        "on": "ALL",
    },
    "*DLOAD\nALL, BY, 4.\n": {"kind": "body-force", "value": [0, "4 N/mm^3", 0], "on": "ALL"},
    "*DSLOAD\nskin, P, 4.\n": {"kind": "pressure", "on": "skin", "value": "4 MPa"},
    "*DSLOAD\nskin, TRVEC, 4., 0., 3., 4.\n": {
        "kind": "traction",
        "on": "skin",
        "value": [0, "2.4 MPa", "3.2 MPa"],
    },
}


@pytest.mark.parametrize("text", LOADS)
def test_loads(tmp_path: Path, text: str) -> None:
    """Forces of a line add up within a step, as in both programs."""
    skin = "*SURFACE, NAME=skin\nALL, S1\n"
    case = one(tmp_path, cube(skin + STEEL + STATIC.format(text)))
    assert case["load"] == [LOADS[text]]


def test_temperatures(tmp_path: Path) -> None:
    """A uniform one is a number; those of nodes are a field."""
    hot = STEEL.replace("*DENSITY", "*EXPANSION\n1.2e-5\n*DENSITY")
    start = "*INITIAL CONDITIONS, TYPE=TEMPERATURE\nevery, 20.\n"
    more = start + hot + STATIC.format("*TEMPERATURE\nevery, 120.\n")
    assert one(tmp_path, cube(more))["load"] == [{"kind": "thermal", "value": "100 K"}]
    ramped = more.replace(
        "*TEMPERATURE", "*AMPLITUDE, NAME=A\n0., 0., 1., 1.\n*TEMPERATURE, AMPLITUDE=A"
    )
    assert "an amplitude beside an initial temperature" in faults(tmp_path, cube(ramped))[0]
    rows = "".join(f"{i}, {10 * i}\n" for i in range(1, 9))
    more = start + hot + STATIC.format(f"*TEMPERATURE\n{rows}")
    (load,) = one(tmp_path, cube(more))["load"]
    assert load["value"] == {"field": "TEMPERATURE line 39", "unit": "K", "reference": 20}


def test_amplitudes_are_curves(tmp_path: Path) -> None:
    """Over the length of the step, which is the load parameter 1."""
    amplitude = "*AMPLITUDE, NAME=A\n0., 0., 1., 1., 2., .5, 4., 0.\n"
    step = STATIC.format("1., 4.\n*CLOAD, AMPLITUDE=A\ntop, 3, 1.\n")
    (load,) = one(tmp_path, cube(amplitude + STEEL + step))["load"]
    assert load["curve"] == [[0, 0], [0.25, 1], [0.5, 0.5], [1, 0]]


# --- steps ---


@pytest.mark.parametrize(
    ("words", "line", "expected"),
    [
        ("", "0.1, 2., 1e-5, 0.5", {"first_step": 0.05, "max_step": 0.25}),
        ("", "0.1, 2.", {"first_step": 0.05}),
        ("", "1., 1.", {}),
        ("", "", {}),
        (", DIRECT", "0.1, 2.", {"steps": 20}),
        (", RIKS", "0.1, 2., 1e-5, 0.5", {"method": "arc-length"}),
    ],
)
def test_increments_are_those_of_materials_that_yield(words, line, expected, tmp_path):
    """Of elastic ones the result does not depend on them, so that the case chooses its own."""
    step = f"*STEP\n*STATIC{words}\n" + (f"{line}\n" if line else "") + "*END STEP\n"
    plastic = STEEL.replace("*DENSITY", "*PLASTIC\n200., 0.\n300., 0.1\n*DENSITY")
    assert one(tmp_path, cube(plastic + step)).get("statics", {}) == expected
    elastic = {k: v for k, v in expected.items() if k in ("steps", "method")}
    assert one(tmp_path, cube(STEEL + step)).get("statics", {}) == elastic


def test_increments_of_several_steps(tmp_path):
    """Fractions of all of them: the first increment of the first, the smallest largest one."""
    step = "*STEP, NLGEOM, INC=99\n*STATIC\n{}\n*BOUNDARY\ntop, 3, 3, {}\n*END STEP\n"
    plastic = STEEL.replace("*DENSITY", "*PLASTIC\n200., 0.\n300., 0.1\n*DENSITY")
    held = "*BOUNDARY\nbottom, 1, 3\ntop, 3, 3, 0.\n"
    both = step.format("0.1, 1., , 0.4", 1) + step.format("0.1, 2., , 0.4", 0)
    found = one(tmp_path, cube(held + plastic + both))["statics"]
    assert found == {"first_step": 0.05, "max_step": 0.1, "end": 2, "times": [1, 2]}
    both = both.replace("*STATIC", "*STATIC, DIRECT")
    found = one(tmp_path, cube(held + plastic + both))["statics"]
    assert found == {"steps": 40, "end": 2, "times": [1, 2]}


def test_steps_that_go_on_from_one_another(tmp_path: Path) -> None:
    """Nonlinear ones are one case with curves; frequencies are about its end."""
    held = "*BOUNDARY\nbottom, 1, 3\ntop, 3, 3, 0.\n"
    first = "*STEP, NLGEOM\n*STATIC\n*CLOAD\n8, 1, 5.\n*BOUNDARY\ntop, 3, 3, 1.\n*END STEP\n"
    second = "*STEP\n*STATIC\n*BOUNDARY\ntop, 3, 3, -1.\n*END STEP\n"
    third = "*STEP, PERTURBATION\n*FREQUENCY\n5\n*END STEP\n"
    case = one(tmp_path, cube(held + STEEL + first + second + third))
    assert case["materials"]["steel"]["law"] == "st-venant-kirchhoff"
    assert case["statics"] == {"end": 2, "times": [1, 2]}
    assert case["modal"] == {"count": 5, "preload": True}
    assert case["load"][0]["curve"] == [[0, 0], [1, 1], [2, 1]]
    assert case["support"][1] == {
        "on": "top",
        "displacement": ["free", "free", "1 mm"],
        "curve": [[0, 0], [1, 1], [2, -1]],
    }


def test_linear_steps_are_a_case_each(tmp_path: Path) -> None:
    """Loads of the first hold in the second, unless it says OP=NEW."""
    held = "*BOUNDARY\nbottom, 1, 3\n"
    first, second = STATIC.format("*CLOAD\ntop, 1, 5.\n"), STATIC.format("*CLOAD\ntop, 2, 3.\n")
    third = STATIC.format("*CLOAD, OP=NEW\ntop, 3, 1.\n")
    cases = tables(tmp_path, cube(held + STEEL + first + second + third), 3)
    values = [case["load"][0]["value"] for case in cases]
    assert values == [["5 N", 0, 0], ["5 N", "3 N", 0], [0, 0, "1 N"]]


def test_pressures_by_number_replace_those_of_earlier_steps(tmp_path: Path) -> None:
    """As OP=MOD has it: they end on the same faces; on some of them it is named, as of forces."""
    step = "*STEP\n*STATIC\n*DLOAD\n{}*END STEP\n"
    both, other = step.format("ALL, P1, 5.\n"), step.format("ALL, P1, 7.\n")
    first, second = tables(tmp_path, cube(STEEL + both + other), 2)
    assert [load["value"] for load in first["load"]] == ["5 MPa"]
    assert [load["value"] for load in second["load"]] == ["7 MPa"]
    (fault,) = faults(tmp_path, cube(STEEL + both + step.format("1, P1, 7.\n")))
    assert "DLOAD: it replaces the pressure of deck.inp:" in fault
    forces = STATIC.format("*CLOAD\ntop, 1, 5.\n") + STATIC.format("*CLOAD\nevery, 1, 3.\n")
    (fault,) = faults(tmp_path, cube(STEEL + forces))
    assert "CLOAD: it replaces forces of an earlier step at some nodes of 'top'" in fault


def test_amplitudes_longer_than_their_step(tmp_path: Path) -> None:
    """The step ends on the line between two rows; the next one begins there."""
    amplitude = "*AMPLITUDE, NAME=A\n0., 0., 0.5, 2., 2.5, 0.\n"
    step = "*STEP, NLGEOM\n*STATIC\n{}*END STEP\n"
    steps = step.format("*CLOAD, AMPLITUDE=A\ntop, 1, 5.\n") + step.format("")
    case = one(tmp_path, cube("*BOUNDARY\nbottom, 1, 3\n" + STEEL + amplitude + steps))
    assert case["load"][0]["curve"] == [[0, 0], [0.5, 2], [1, 1.5], [2, 1.5]]


ANALYSES = {
    "*FREQUENCY\n4\n": ("modal", {"count": 4}),
    "*FREQUENCY\n,, 500.\n": ("modal", {"below": "500 Hz"}),
    "*BUCKLE\n3\n": ("buckling", {"count": 3}),
    "*DYNAMIC, DIRECT\n0.001, 0.1\n": ("dynamics", {"end": "0.1 s", "dt": "0.001 s"}),
    "*STATIC, DIRECT\n.25, 1.\n": ("statics", {"steps": 4}),
}


@pytest.mark.parametrize("text", ANALYSES)
def test_analyses(tmp_path: Path, text: str) -> None:
    """The table of each, and its settings."""
    held = "*BOUNDARY\nbottom, 1, 3\n"
    step = f"*STEP\n{text}*CLOAD\ntop, 3, -1.\n*END STEP\n"
    case = one(tmp_path, cube(held + STEEL + step))
    name, settings = ANALYSES[text]
    assert case[name] == settings


# --- what is left out ---

OTHERS = {
    "*CONTACT PAIR, INTERACTION=I\na, b\n": "CONTACT PAIR: state it as",
    "*NSET, NSET=line\n1, 2\n*RIGID BODY, NSET=line, REF NODE=1\n": "no corners of faces",
    "*RIGID BODY, ELSET=ALL, NSET=top, REF NODE=1\n": "RIGID BODY: ELSET is not read",
    "*EQUATION\n2\n1, 1, 1., 2, 1, -1.\n": "EQUATION: equations between nodes",
    "*TRANSFORM, NSET=top, TYPE=C\n0., 0., 0., 0., 0., 1.\n*BOUNDARY\ntop, 1\n": "no table has",
    "*TRANSFORM, NSET=top\n1., 1., 0., -1., 1., 0.\n*BOUNDARY\ntop, 1\n": "no table has",
    "*TRANSFORM, NSET=top\n1., 1., 0., -1., 1., 0.\n*BOUNDARY\nleft, 1\n": "no table has",
    "*SHELL SECTION, ELSET=ALL\n1.\n": "SHELL SECTION: these elements",
    "*WHATEVER\n": "WHATEVER: this keyword is not known",
    "*INITIAL CONDITIONS, TYPE=STRESS\nALL, 1.\n": "TYPE=STRESS is not read",
    "*MATERIAL, NAME=m\n*DAMPING, STRUCTURAL=0.1\n": "STRUCTURAL is not understood",
    "*STEP, AMPLITUDE=RAMP\n*DYNAMIC\n.1, 1.\n*END STEP\n": "STEP: AMPLITUDE=RAMP",
    "*STEP, NLGEOM\n*STATIC\n*END STEP\n*STEP, PERTURBATION\n*STATIC\n*END STEP\n": "STEP: PERT",
}


@pytest.mark.parametrize("text", OTHERS)
def test_words_that_change_the_answer(tmp_path: Path, text: str) -> None:
    """Each is an error with its line."""
    before = text if "*STEP" not in text else ""
    step = text if "*STEP" in text else STATIC.format("")
    (fault,) = faults(tmp_path, cube(before + STEEL + step))
    assert OTHERS[text] in fault


def test_analyses_that_are_not_there(tmp_path: Path) -> None:
    """So are they."""
    step = "*STEP\n*HEAT TRANSFER\n1., 1.\n*END STEP\n"
    (fault,) = faults(tmp_path, cube(STEEL + step))
    assert "HEAT TRANSFER: this analysis is not there" in fault


def test_words_without_effect_are_notes(tmp_path: Path) -> None:
    """They are in the head of the case file, results are nowhere."""
    more = STEEL.replace("*DENSITY", "*CONDUCTIVITY\n1.\n*DENSITY") + STATIC.format(
        "*NODE PRINT, NSET=top\nU\n*CONTROLS, PARAMETERS=FIELD\n"
    )
    (text,) = case_texts(read(tmp_path, cube(more)), "deck", "mm-t-s").values()
    head = text.partition("[mesh]")[0]
    assert "CONDUCTIVITY: no displacement depends on it" in head
    assert "CONTROLS: settings of the solver" in head
    assert "NODE PRINT" not in text


WRONG = {
    "*CLOAD\nghost, 1, 1.\n": "there is no set of nodes 'ghost'",
    "*CLOAD\n99, 1, 1.\n": "does not exist",
    "*CLOAD\ntop, one, 1.\n": "is no force",
    "*CLOAD\ntop, 1, nan\n": "is no finite number",
    "*CLOAD, AMPLITUDE=B\ntop, 1, 1.\n": "there is no *AMPLITUDE 'B'",
    "*DLOAD\nALL, GRAV, 9.81\n": "the direction of gravity is missing",
    "*BOUNDARY\ntop, up\n": "is no support",
    "*CLOAD\ntop, \xb2, 1.\n": "is no force",
    f"*BOUNDARY\n{'9' * 5000}, 1\n": "cannot be read",
    "*HYPERELASTIC, OGDEN, N=1000000000\n1., 2., 0.\n": "is no whole number below 100",
}


@pytest.mark.parametrize("text", WRONG)
def test_damaged_lines(tmp_path: Path, text: str) -> None:
    """One message with the line."""
    with pytest.raises(MeshError, match=r"deck\.inp:\d+: ") as info:
        law = text if text.startswith("*HYPER") else ""
        material = STEEL.replace("*DENSITY", law + "*DENSITY")
        read(tmp_path, cube(material + STATIC.format("" if law else text)))
    assert WRONG[text] in str(info.value)


def test_units_are_asked_for(tmp_path: Path) -> None:
    """With what the modulus would be in each system."""
    deck = read(tmp_path, cube(STEEL + STATIC.format("")))
    with pytest.raises(InputError, match=r"mm-t-s \(210 GPa\) is the most plausible one"):
        case_texts(deck, "deck")
    with pytest.raises(InputError, match="mm-t-s"):
        case_texts(deck, "deck", "mm-s-t")


def test_names_of_strangers(tmp_path: Path) -> None:
    """Quotes, brackets and control characters stay inside of strings and comments."""
    name = "a\"] = '[[load]]\x07 # \\"
    more = STEEL.replace("steel", name) + STATIC.format("")
    text = f"*HEADING\n{name}\n*NODE" + cube(more).removeprefix("*NODE")
    case = one(tmp_path, text)
    assert "load" not in case
    assert len(case["materials"]) == 1


# --- closed forms ---


def test_hybrid_and_modified_elements(tmp_path: Path) -> None:
    """C3D10MH has a pressure; that it is taken as C3D10H is said."""
    text = inp_text(*quadratic(POINTS, CELLS), STEEL + STATIC.format("")).replace(
        "C3D10", "C3D10MH"
    )
    deck = read(tmp_path, text)
    assert deck.mesh == {"degree": 2, "formulation": "mixed"}
    assert "C3D10MH: C3D10H is used" in str(deck.left_out[0])


def test_tension_by_forces_of_nodes(tmp_path: Path) -> None:
    """Forces by number of node that are those of a uniform stress, from deck to displacement."""
    from dolfin_elastic import run

    top = np.flatnonzero(POINTS[:, 2] == 10)
    faces = [c for cell in CELLS for c in [[n for n in cell if n in top]] if len(c) == 3]
    shares = {n: sum(n in face for face in faces) * 50 / 3 for n in top}  # areas of 50 mm^2
    loads = "".join(f"{n + 1}, 3, {21 * share!r}\n" for n, share in shares.items())
    held = "*BOUNDARY\nleft, 1\nback, 2\nbottom, 3\n"
    text = cube(held + STEEL + STATIC.format(f"*CLOAD\n{loads}"))
    case = Case.from_dict({**one(tmp_path, text), "output": {"formats": ["csv"]}}, tmp_path)
    *_, state = run(case, output=tmp_path / "results")
    # 21 MPa over 210 GPa along 10 mm, and 0.3 of it across: exact in linear elements.
    expected = 1e-6 * np.sqrt(1 + 2 * 0.3**2)
    assert state.max_displacement == pytest.approx(expected, rel=1e-10)


@pytest.mark.long
def test_a_body_on_two_springs(tmp_path: Path) -> None:
    """Each carries its own force, F/k; without them the body would fly away."""
    from dolfin_elastic import run

    held = SPRINGS.format("", 3) + "*BOUNDARY\nevery, 1, 2\n" + STEEL
    text = cube(held + STATIC.format("*CLOAD\n7, 3, 3.\n8, 3, 3.\n"))
    case = Case.from_dict({**one(tmp_path, text), "output": {"formats": ["csv"]}}, tmp_path)
    *_, state = run(case, output=tmp_path / "results")
    assert state.max_displacement == pytest.approx(3e-3 / 300, rel=1e-9)


COUPLED = (
    "*COUPLING, CONSTRAINT NAME=c, REF NODE=9, SURFACE=lid\n*{}\n"
    "*BOUNDARY\nbottom, 1, 3\n{}" + STEEL + STATIC.format("*CLOAD\n{}")
)


def lidded(kind: str, boundary: str, forces: str) -> str:
    """The cube with a node above it, which its top follows."""
    top = [
        f"{i + 1}, S{side + 1}\n"
        for i, cell in enumerate(CELLS)
        for side, face in enumerate(((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)))
        if (POINTS[cell[list(face)], 2] == 10).all()
    ]
    sets = SETS + "*SURFACE, NAME=lid\n" + "".join(top)
    text = cube(COUPLED.format(kind, boundary, forces), sets)
    return text.replace("*ELEMENT", "9, 5., 5., 25.\n*ELEMENT", 1)


def test_couplings(tmp_path: Path) -> None:
    """A rigid surface, one that is fixed, and an average."""
    case = one(tmp_path, lidded("KINEMATIC\n1, 6", "9, 1\n9, 5, 5, 0.01\n", "9, 3, 2.\n9, 6, 4.\n"))
    assert "load" not in case
    assert case["support"][1] == {
        "kind": "rigid",
        "on": "lid",
        "point": [5, 5, 25],
        "force": [0, 0, "2 N"],
        "moment": [0, 0, "4 N*mm"],
        "displacement": [0, "free", "free"],
        "rotation": ["free", 0.01, "free"],
    }
    case = one(tmp_path, lidded("KINEMATIC", "9, ENCASTRE\n", "top, 3, 1.\n"))
    assert case["support"][1] == {"on": "lid", "kind": "fixed"}
    case = one(tmp_path, lidded("DISTRIBUTING", "", "9, 1, 2.\n9, 5, 4.\n"))
    (load,) = case["load"]
    assert load == {
        "kind": "remote-force",
        "on": "lid",
        "point": [5, 5, 25],
        "force": ["2 N", 0, 0],
        "moment": [0, "4 N*mm", 0],
    }


def test_the_order_of_couplings_and_supports(tmp_path: Path) -> None:
    """*BOUNDARY above the *COUPLING of its reference node was one of no node of the body, and the
    lid was free."""
    below = lidded("KINEMATIC", "9, 1, 6\n9, 3, 3, 0.02\n", "bottom, 1, 0.\n")
    head, tail = "*COUPLING", "*BOUNDARY"
    coupling = below[below.index(head) : below.index(tail)]
    support = below[below.index(tail) : below.index("*MATERIAL")]
    above = below.replace(coupling + support, support + coupling)
    assert above != below
    assert one(tmp_path, above)["support"] == one(tmp_path, below)["support"]
    assert one(tmp_path, above)["support"][1]["displacement"] == [0, 0, "0.02 mm"]
    twice = below.replace(coupling, coupling * 2)
    (fault,) = faults(tmp_path, twice)
    assert "another *COUPLING, *RIGID BODY or *EQUATION has its reference node" in fault


TURNED = "*NSET, NSET=ref\n9\n*TRANSFORM, NSET=ref\n0., 1., 0., -1., 0., 0.\n"
LOCAL = {
    ("9, 1, 6\n", "top, 3, 1.\n"): "",
    ("9, 1, 3\n", "top, 3, 1.\n"): "",
    ("9, 1\n", "9, 5, 0.\n"): "local directions (*TRANSFORM) at a reference node",
    ("9, 1, 3, 0.1\n", "top, 3, 1.\n"): "local directions (*TRANSFORM) at a reference node",
    ("", "9, 1, 1.\n"): "local directions (*TRANSFORM) at a reference node",
}


@pytest.mark.parametrize("words", LOCAL)
def test_local_directions_of_reference_nodes(tmp_path: Path, words: tuple[str, str]) -> None:
    """They were those of the body, in silence; what is 0 in all directions is so in any."""
    text = lidded("KINEMATIC", *words)
    found = faults(tmp_path, text.replace("*BOUNDARY", f"{TURNED}*BOUNDARY", 1))
    assert all(LOCAL[words] in fault for fault in found)
    assert bool(found) is bool(LOCAL[words])


def test_local_directions_below_their_supports(tmp_path: Path) -> None:
    """A *TRANSFORM below them was without effect, in silence."""
    turned = "*TRANSFORM, NSET=top\n3., 4., 0., -4., 3., 0.\n"
    (fault,) = faults(tmp_path, cube(f"*BOUNDARY\ntop, 1\n{turned}" + STEEL + STATIC.format("")))
    assert "its nodes have a *BOUNDARY or *CLOAD above it" in fault


def test_local_directions(tmp_path: Path) -> None:
    """Supports along turned axes, all three along any, and forces by their components."""
    more = (
        "*TRANSFORM, NSET=top\n0., 2., 0., -1., 0., 0.\n*TRANSFORM, NSET=bottom, TYPE=C\n"
        "0., 0., 0., 0., 0., 1.\n*BOUNDARY\ntop, 1, 1, 0.5\ntop, 2\nbottom, 1\nbottom, 2, 3\n"
    )
    case = one(tmp_path, cube(more + STEEL + STATIC.format("")))
    assert case["support"] == [
        {"on": "top", "displacement": [0, "0.5 mm", "free"]},
        {"on": "bottom", "kind": "fixed"},
    ]
    more = "*TRANSFORM, NSET=top\n3., 4., 0., -4., 3., 0.\n"
    case = one(tmp_path, cube(more + STEEL + STATIC.format("*CLOAD\ntop, 1, 10.\ntop, 2, 5.\n")))
    # 10 (0.6, 0.8) + 5 (-0.8, 0.6)
    assert case["load"][0]["value"] == ["2 N", "11 N", 0]


def test_rigid_bodies(tmp_path: Path) -> None:
    """Directions 1 to 3 of the node of rotations are rotations and moments."""
    body = "*RIGID BODY, NSET=top, REF NODE=9, ROT NODE=10\n*BOUNDARY\nbottom, 1, 3\n10, 3\n"
    step = STATIC.format("*CLOAD\n9, 3, 2.\n10, 1, 4.\n")
    text = cube(body + STEEL + step).replace(
        "*ELEMENT", "9, 5., 5., 25.\n10, 0., 0., 0.\n*ELEMENT", 1
    )
    assert one(tmp_path, text)["support"][1] == {
        "kind": "rigid",
        "on": "top",
        "point": [5, 5, 25],
        "force": [0, 0, "2 N"],
        "moment": ["4 N*mm", 0, 0],
        "displacement": ["free", "free", "free"],
        "rotation": ["free", "free", 0],
    }


KEPT = {
    ("9, 1, 3\n9, 4, 6\n", "9, 4, 6\n"): "",
    ("9, 1, 3\n", "9, 1, 3\n"): "",
    ("9, 1, 3\n9, 4, 4, 0.1\n", "9, 4, 6\n"): "FIXED: it stops nodes that moved freely",
    ("9, 1\n", "top, 1\n"): "FIXED: it stops nodes that moved freely",
    ("9, 1\n", "9, 1\n*BOUNDARY, FIXED, OP=NEW\n9, 1\n"): "OP=NEW beside FIXED",
}


@pytest.mark.parametrize("words", KEPT)
def test_reference_nodes_that_are_fixed(tmp_path: Path, words: tuple[str, str]) -> None:
    """Rotations were no directions to FIXED, which said nothing; a later step may keep what is
    prescribed, and has no value of its own in the first one."""
    before, later = words
    text = lidded("KINEMATIC", before, "9, 1, 1.\n")
    found = faults(tmp_path, text + STATIC.format(f"*BOUNDARY, FIXED\n{later}"))
    assert [KEPT[words] in fault for fault in found] == [True] * bool(KEPT[words])
    first = lidded("KINEMATIC", "*BOUNDARY, FIXED\n9, 1, 3, 7.\n", "9, 4, 1.\n")
    assert one(tmp_path, first)["support"][1]["displacement"] == [0, 0, 0]


OTHER_COUPLINGS = {
    ("KINEMATIC\n1, 2", "", "9, 1, 1.\n"): "only all directions",
    ("DISTRIBUTING\n1, 3", "", "9, 1, 1.\n9, 4, 1.\n"): "a moment, but the average has",
    ("DISTRIBUTING", "9, 1\n", "9, 2, 1.\n"): "a prescribed motion of an average",
    ("KINEMATIC", "", "9, 1, 1.\n8, 1, 1.\n"): "beside other nodes",
}


@pytest.mark.parametrize("words", OTHER_COUPLINGS)
def test_couplings_that_are_not_there(tmp_path: Path, words: tuple[str, str, str]) -> None:
    """Each is an error with its line."""
    (fault,) = faults(tmp_path, lidded(*words))
    assert OTHER_COUPLINGS[words] in fault


def test_tension_by_a_coupling(tmp_path: Path) -> None:
    """A force above the middle of a lid that has no Poisson's ratio: F L / (E A)."""
    from dolfin_elastic import run

    text = lidded("KINEMATIC", "", "9, 3, 2100.\n").replace("210000., 0.3", "210000., 0.")
    case = Case.from_dict({**one(tmp_path, text), "output": {"formats": ["csv"]}}, tmp_path)
    *_, state = run(case, output=tmp_path / "results")
    # 21 MPa over 210 GPa along 10 mm: exact in linear elements.
    assert state.max_displacement == pytest.approx(1e-6, rel=1e-9)
