"""RBE2, RBE3, MOMENT and CELAS of Nastran as cases: closed forms after import."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.deck_cases import last, one
from helpers.decks import box, quadratic

from dolfin_elastic.case.decks.deck import Deck
from dolfin_elastic.case.decks.reading import read_deck
from dolfin_elastic.core.errors import MeshError

LENGTH, E = 8.0, 1000.0
POINTS, CELLS = quadratic(*box((LENGTH, 1, 1), (4, 1, 1)))
TIP = 900
POINT = [LENGTH + 2, 0.5, 0.5]


def listed(x: float) -> list[int]:
    return [int(i) + 1 for i in np.flatnonzero(POINTS[:, 0] == x)]


def continued(words: list[object]) -> str:
    """An entry in free fields, eight to a line."""
    texts = [str(word) for word in words]
    lines = [texts[i : i + 8] for i in range(0, len(texts), 8)]
    return "\n,".join(",".join(line) for line in lines)


RBE2 = f"RBE2,{continued([50, TIP, 123456, *listed(LENGTH)])}"
RBE3 = f"RBE3,{continued([50, '', TIP, 123456, '1.', 123, *listed(LENGTH)])}"


def read(folder: Path, bulk: str, solution: int = 101, more: str = "") -> Deck:
    """A bar along x that is fixed at x = 0, with a node beyond its end.

    Args:
        more: What the subcase selects beside supports and loads.
    """
    grids = [f"GRID,{i},,{x!r},{y!r},{z!r}" for i, (x, y, z) in enumerate(POINTS.tolist(), 1)]
    grids.append(f"GRID,{TIP},,{','.join(map(str, POINT))}")
    cells = [f"CTETRA,{continued([i, 7, *cell])}" for i, cell in enumerate(CELLS + 1, 1)]
    held = [f"SPC1,1,123,{node}" for node in listed(0.0)]
    law = ["PSOLID,7,5", f"MAT1,5,{E},,0.,2."]
    lines = [f"SOL {solution}", "CEND", "SPC = 1", "LOAD = 2", "METHOD = 9", more, "BEGIN BULK"]
    lines += [*grids, *cells, *held, *law, "EIGRL,9,,,2", bulk, "ENDDATA", ""]
    (folder / "bar.bdf").write_text("\n".join(lines))
    return read_deck(folder / "bar.bdf")


def test_a_rigid_spider(tmp_path: Path) -> None:
    """What is prescribed and acts at the reference node, in an equivalent case; equal entries act
    twice."""
    force = f"FORCE,2,{TIP},,1.,1.,0.,0."
    bulk = f"SPC,1,{TIP},24,0.5\n{force}\n{force}\nMOMENT,2,{TIP},,3.,0.,0.,2."
    table = one(read(tmp_path, f"{RBE2}\n{bulk}"))
    assert table["support"][1:] == [
        {
            "kind": "rigid",
            "on": "rbe2_50",
            "point": POINT,
            "force": ["2 N", 0, 0],
            "moment": [0, 0, "6 N*m"],
            "displacement": ["free", "0.5 m", "free"],
            "rotation": [0.5, "free", "free"],
        }
    ]
    assert "load" not in table


def test_a_spider_that_is_fixed(tmp_path: Path) -> None:
    """In modes, too, where one that moves is an error."""
    fixed = f"{RBE2}\nSPC1,1,123456,{TIP}"
    assert one(read(tmp_path, fixed, 103))["support"][1] == {"on": "rbe2_50", "kind": "fixed"}
    (fault,) = read(tmp_path, RBE2, 103).faults
    assert "RBE2: a rigid surface that moves exists in statics only" in str(fault)


@pytest.mark.parametrize("element", [RBE2, RBE3])
def test_bending_by_a_moment(tmp_path: Path, element: str) -> None:
    """M L^2 / (2 E I) with nu = 0, exact for quadratic displacements: without the element there
    is no moment on a solid.  The tip's edge goes back by half of M L / (E I), too.  A rigid
    surface turns by a finite angle: 1e-5 of it, of whose square the difference is."""
    M = 1e-4
    table = one(read(tmp_path, f"{element}\nMOMENT,2,{TIP},,{M},0.,0.,1."))
    turn = 12 * M * LENGTH / E
    expected = float(np.hypot(turn * LENGTH / 2, turn / 2))
    assert last(table, tmp_path).max_displacement == pytest.approx(expected, rel=1e-6)


def test_an_average(tmp_path: Path) -> None:
    """Forces of both cards at its node, its weight in two texts; that it is one of areas is a
    note."""
    bulk = f"FORCE,2,{TIP},,2.,0.,1.,0.\nMOMENT,2,{TIP},,3.,1.,0.,0."
    deck = read(tmp_path, f"{RBE3}\n,1.0,123,{listed(LENGTH)[0]}\n{bulk}")
    assert "RBE3: its forces are spread over the area" in str(deck.left_out[-1])
    keys = {"kind": "remote-force", "on": "rbe3_50", "point": POINT}
    acting = {"force": [0, "2 N", 0], "moment": ["3 N*m", 0, 0]}
    assert one(deck)["load"] == [{**keys, **acting}]


@pytest.mark.long
def test_springs_to_the_ground(tmp_path: Path) -> None:
    """E A / L and the springs at four corners share the force; nu = 0, and equal parts of the
    force and the springs at corners alone would bend the end face, so that all nodes of it have
    them, with the weights of a uniform stress: this is exact."""
    shares = dict.fromkeys(listed(LENGTH), 0.0)
    for cell in CELLS:
        face = [n + 1 for n in cell if POINTS[n, 0] == LENGTH]
        if len(face) == 6:
            middles = [n for n in face if n > len(POINTS) - 1 or n - 1 in cell[4:]]
            for node in middles:
                shares[node] += 0.5 / 3
    k = 2 * E / LENGTH
    lines = [
        f"CELAS2,{60 + i},{k * share},{node},1\nFORCE,2,{node},,{share},3.,0.,0."
        for i, (node, share) in enumerate(shares.items())
        if share
    ]
    table = one(read(tmp_path, "\n".join(lines)))
    assert [s["kind"] for s in table["support"][1:]] == ["spring"] * len(lines)
    expected = 3 / (k + E / LENGTH)
    assert last(table, tmp_path).max_displacement == pytest.approx(expected, rel=1e-9)


def test_a_spring_with_a_property_and_a_mass(tmp_path: Path) -> None:
    """PELAS has its stiffness, two of them in a line, by default that of the spring's own number;
    a mass has no effect in statics without weight, which is a note."""
    node = listed(LENGTH)[0]
    spring = f"CELAS1,60,61,,,{node},2\nCELAS1,62,,{node},1\nPELAS,61,7.,,,62,8.\n"
    deck = read(tmp_path, f"{spring}CONM2,62,{node},,3.\nFORCE,2,1,,1.,1.")
    stiffness = {"on": "celas_60", "kind": "spring", "stiffness": [0, "7 N/m", 0]}
    own = {"on": "celas_62", "kind": "spring", "stiffness": ["8 N/m", 0, 0]}
    assert one(deck)["support"][1:] == [stiffness, own]
    assert any("CONM2: a mass without weight" in str(note) for note in deck.left_out)


OUTER = listed(LENGTH)[1]  # a corner of one triangle of the end
REST = [node for node in listed(LENGTH) if node != OUTER]
OTHERS = {
    f"RBE2,{continued([50, OUTER, 123, *REST])}": "a reference node of the solid",
    f"{RBE2},1.-5,20.\nTEMPD,4,30.": "thermal expansion of a rigid element",
    f"{RBE3}\n,ALPHA,1.-5\nTEMPD,4,30.": "thermal expansion of a rigid element",
    "CELAS2,60,1.,,,,": "no spring from one node to the ground",
    "CELAS2,60,1.,5,0": "no spring from one node to the ground",
}


@pytest.mark.parametrize("bulk", OTHERS)
def test_what_a_case_does_not_have(tmp_path: Path, bulk: str) -> None:
    """Each is an error; an expansion without a change of temperature is a note."""
    warm = "TEMPD" in bulk
    faults = read(tmp_path, bulk, more="TEMP(LOAD) = 4" if warm else "").faults
    assert any(OTHERS[bulk] in str(fault) for fault in faults), faults
    if warm:
        deck = read(tmp_path, bulk)
        notes = [str(note) for note in deck.left_out]
        assert not any("expansion" in str(f) for f in deck.faults)
        assert any(OTHERS[bulk] in note for note in notes)


@pytest.mark.parametrize("bulk", [f"{RBE2},,20.", f"{RBE3}\n,ALPHA,,20."])
def test_a_temperature_without_an_expansion(tmp_path: Path, bulk: str) -> None:
    """The temperature of reference (TREF) alone was said to be the coefficient before it."""
    deck = read(tmp_path, f"{bulk}\nTEMPD,4,30.", more="TEMP(LOAD) = 4")
    assert not any("expansion" in str(one) for one in deck.left_out)


BROKEN = {
    RBE3.replace("1.,123", "1.,12"): "other directions than 123",
    RBE3.replace("1.,123", "1.,456"): "other directions than 123; components 123",
    RBE3.replace("1.,123", "1,123"): "its nodes have no weights, or several; one weight",
    f"{RBE3}\n,2.,123,1": "its nodes have no weights, or several",
    f"RBE2,50,{TIP},123,9999": "there is no GRID 9999",
    "CELAS1,60,61,1,1": "there is no PELAS 61",
}


@pytest.mark.parametrize("line", BROKEN)
def test_lines_that_cannot_be_read(tmp_path: Path, line: str) -> None:
    """One message with the line."""
    with pytest.raises(MeshError, match=rf"bar.bdf:\d+: .*{BROKEN[line]}"):
        read(tmp_path, line)
