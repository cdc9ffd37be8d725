"""*EQUATION as ties and periodic cells: closed forms after import, and what stays an error."""

from __future__ import annotations

from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import deck_cases
from helpers.deck_cases import last
from helpers.decks import box, inp_text, numbers

from dolfin_elastic.case.decks.deck import Deck
from dolfin_elastic.case.decks.reading import read_deck
from dolfin_elastic.core.errors import MeshError

E, SOFT = 200.0, 50.0
MATERIAL = "*MATERIAL, NAME={0}\n*ELASTIC\n{1}, 0.\n*SOLID SECTION, ELSET={2}, MATERIAL={0}\n"
STATIC = "*STEP\n*STATIC\n{}*END STEP\n"
one = partial(deck_cases.one, units="mm-t-s")


def read(folder: Path, text: str) -> Deck:
    (folder / "deck.inp").write_text(text)
    return read_deck(folder / "deck.inp")


# --- ties ---

BOTTOM, CELLS = box((2, 1, 1), (2, 1, 1))
COUNT = len(BOTTOM)
STACK = np.concatenate([BOTTOM, BOTTOM + np.array([0, 0, 1])])
FEET, LIDS = (np.flatnonzero(BOTTOM[:, 2] == z) for z in (0, 1))


def stack(equations: str, forces: str = "") -> str:
    """Two blocks, one on the other, that share no node; `top` is pulled, `low` is held."""
    more = "".join(
        f"*NSET, NSET={name}\n{numbers(rows)}\n"
        for name, rows in (("low", FEET), ("up", LIDS), ("feet", FEET + COUNT))
    )
    text = inp_text(STACK, np.concatenate([CELLS, CELLS + COUNT]), more + equations)
    held = "*BOUNDARY\nlow, 1, 3\n"
    return text + held + MATERIAL.format("steel", E, "ALL") + STATIC.format(forces)


def pairs(*directions: int) -> str:
    """Nodes by number, an equation each."""
    lines = [
        f"2\n{foot + COUNT + 1}, {i}, 1., {lid + 1}, {i}, -1.\n"
        for foot, lid in zip(FEET, LIDS, strict=True)
        for i in directions
    ]
    return "*EQUATION\n" + "".join(lines)


def shares() -> str:
    """Forces at the nodes of the upper face that are a stress of 2: a third of each triangle."""
    top = set(LIDS.tolist())
    faces = [[n for n in cell if n in top] for cell in CELLS.tolist()]
    sizes = {n: sum(n in f for f in faces if len(f) == 3) / 6 for n in top}
    lines = (f"{n + COUNT + 1}, 3, {2 * size!r}\n" for n, size in sizes.items())
    return "*CLOAD\n" + "".join(lines)


def test_a_tie_by_numbers(tmp_path: Path) -> None:
    """sigma L / E over both blocks, exact in linear elements; without the tie the upper one would
    fly away."""
    table = one(read(tmp_path, stack(pairs(1, 2, 3), shares())))
    name = next(iter(table["tie"]))["on"]
    assert name.startswith("EQUATION line ")
    assert table["tie"] == [{"on": name, "to": f"{name} to"}]
    assert last(table, tmp_path).max_displacement == pytest.approx(2 * 2e-3 / E, rel=1e-9)


def test_a_tie_by_sets(tmp_path: Path) -> None:
    """A node of the first set for each of the second one."""
    lines = "".join(f"2\nfeet, {i}, 2., up, {i}, -2.\n" for i in (1, 2, 3))
    assert len(one(read(tmp_path, stack("*EQUATION\n" + lines)))["tie"]) == 1


def test_faces_are_found_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not for each side of a tie, nor for each rigid body: a body of millions of elements."""
    from dolfin_elastic.case.decks import coupling

    found, boundary = list[int](), coupling.boundary
    monkeypatch.setattr(coupling, "boundary", lambda cells: found.append(1) or boundary(cells))
    node = f"*NODE\n{2 * COUNT + 1}, 9., 9., 9.\n"
    rigid = f"*RIGID BODY, NSET=low, REF NODE={2 * COUNT + 1}\n"
    assert not read(tmp_path, stack(node + pairs(1, 2, 3) + rigid)).faults
    assert found == [1]


OTHERS = {
    pairs(1, 2): "not all directions of its nodes are equal",
    pairs(3) + "2\n1, 1, 1., 2, 2, -1.\n": "no difference of two nodes in one direction",
    pairs(1, 2, 3).replace("-1.", "-0.5"): "no difference of two nodes in one direction",
    "".join(f"*EQUATION\n2\n13, {i}, 1., 7, {i}, -1.\n" for i in (1, 2, 3)): "not those of faces",
    "*EQUATION\n2\n13, 1, 1., 8, 1, -1.\n": "not opposite on a box",
    "*EQUATION, REMOVE\n1, 1\n": "without options",
    "*MPC\nBEAM, 1, 2\n": "MPC: equations between nodes are not there",
    "*REFINE MESH, LIMIT=4\nPSTD\n": "REFINE MESH: CalculiX computes again on a finer mesh",
}


@pytest.mark.parametrize("text", OTHERS)
def test_other_equations(tmp_path: Path, text: str) -> None:
    """An error with its line."""
    found = [str(fault) for fault in read(tmp_path, stack(text)).faults]
    assert any(OTHERS[text] in fault and fault.startswith("deck.inp:") for fault in found)


@pytest.mark.parametrize(
    "lines", ["2\n1, 1, 1.\n", "1\n1, 1, 1.\n", "two\n", "2\n1,1,1.,99,1,-1\n"]
)
def test_damaged_equations(tmp_path: Path, lines: str) -> None:
    """One message with the line."""
    with pytest.raises(MeshError, match=r"deck\.inp:\d+: \*EQUATION: (one of its|a node of)"):
        read(tmp_path, stack(f"*EQUATION\n{lines}"))


# --- periodic cells ---

SIZE = np.array([2.0, 1.0, 4.0])
GRID, CUBES = box(tuple(SIZE), (2, 2, 4))
UPPER = [i for i, cell in enumerate(CUBES, 1) if GRID[cell, 2].mean() > 1]
MASTERS = [len(GRID) + k + 1 for k in range(3)]


def number(place: Any) -> int:
    return int(np.flatnonzero(np.abs(GRID - place).max(axis=1) < 1e-9)[0]) + 1


def opposite() -> list[tuple[int, int, list[int]]]:
    """Each node with an upper coordinate, that with the lower ones, and which these are."""
    result = []
    for n, x in enumerate(GRID, 1):
        axes = [k for k in range(3) if x[k] == SIZE[k]]
        if axes:
            lower = x.copy()
            lower[axes] = 0
            result.append((n, number(lower), axes))
    return result


def by_reference_nodes() -> str:
    """u+ - u- is the displacement of a node beside the body, on edges of several."""
    lines = [
        f"{2 + len(axes)}\n{n}, {i}, 1., {other}, {i}, -1."
        + "".join(f",\n{MASTERS[k]}, {i}, -1." for k in axes)
        for (n, other, axes), i in product(opposite(), (1, 2, 3))
    ]
    return "*EQUATION\n" + "\n".join(lines) + "\n"


def by_corners() -> str:
    """u+ - u- is that of two corners, of which one is at rest; a keyword each."""
    corner = [number(np.eye(3)[k] * SIZE) for k in range(3)]
    lines = []
    for (n, other, axes), i in product(opposite(), (1, 2, 3)):
        if n not in corner:
            more = "".join(f", {corner[k]}, {i}, -1." for k in axes)
            lines.append(
                f"*EQUATION\n{3 + len(axes)}\n{n}, {i}, 1., {other}, {i}, -1.{more}\n"
                f"1, {i}, {len(axes)}."
            )
    return "\n".join(lines) + "\n"


def cell(equations: str, step: str) -> str:
    """Three layers of E below one of SOFT, with three nodes beside them."""
    nodes = "".join(f"{m}, 9., 9., 9.\n" for m in MASTERS)
    sets = "".join(
        f"*ELSET, ELSET={name}\n{numbers(np.array(rows) - 1)}\n"
        for name, rows in (("a", UPPER), ("b", [i for i in range(1, 97) if i not in UPPER]))
    )
    text = inp_text(GRID, CUBES, sets + equations).replace("*ELEMENT", f"{nodes}*ELEMENT", 1)
    laws = MATERIAL.format("hard", E, "a") + MATERIAL.format("soft", SOFT, "b")
    return text + laws + STATIC.format(step)


@pytest.mark.long
@pytest.mark.parametrize("form", ["reference nodes", "corners"])
def test_a_cell_of_layers(tmp_path: Path, form: str) -> None:
    """Across layers compliances add up, along them stiffnesses: exact in linear elements.  A force
    at a reference node is a stress over the face, its displacement F - I times the edge."""
    if form == "corners":
        equations, first, third = by_corners(), number([2, 0, 0]), number([0, 0, 4])
        second = number([0, 1, 0])
    else:
        equations, (first, second, third) = by_reference_nodes(), MASTERS
    step = (
        f"*BOUNDARY\n1, 1, 3\n{third}, 1, 2\n{third}, 3, 3, 0.04\n{second}, 1, 3\n{first}, 2, 3\n"
        f"*CLOAD\n{first}, 1, 0.65\n"
    )
    table = one(read(tmp_path, cell(equations, step)))
    assert table["periodic"] == {
        "pairs": [["x min", "x max"], ["y min", "y max"], ["z min", "z max"]],
        "gradient": [["free", 0, 0], [0, 1, 0], [0, 0, 1.01]],
        "stress": [["0.1625 MPa", "free", "free"], *[["free"] * 3] * 2],
    }
    found = last(table, tmp_path).numbers
    across, along = 4 / (3 / E + 1 / SOFT), (3 * E + SOFT) / 4
    assert found["P33"] == pytest.approx(0.01 * across * 1e6, rel=1e-9)
    assert found["F11"] - 1 == pytest.approx(0.1625 / along, rel=1e-9)


HELD = "*BOUNDARY\n1, 1, 3\n" + "".join(f"{m}, 1, 3\n" for m in MASTERS)


def test_a_later_strain_beside_a_corner_at_rest(tmp_path: Path) -> None:
    """0.04 over the edge of 4.  The keyword that holds a corner has the reference nodes among its
    nodes by number; were these still at rest, the gradient would be the identity."""
    step = f"{HELD}*BOUNDARY\n{MASTERS[2]}, 3, 3, 0.04\n"
    table = one(read(tmp_path, cell(by_reference_nodes(), step)))
    assert table["periodic"]["gradient"] == [[1, 0, 0], [0, 1, 0], [0, 0, 1.01]]


FAULTS = {
    HELD + "2, 1\n": "a support in a periodic cell",
    HELD + "*CLOAD\n2, 1, 1.\n": "a load in a periodic cell",
    "*BOUNDARY\n1, 1, 3\n": "leave F12 free beside",
}


@pytest.mark.parametrize("direction", [0, 4, 6])
def test_directions_that_are_not_there(tmp_path: Path, direction: int) -> None:
    """Of any term: 0 was read as 3, and others were no more than a damaged *END STEP."""
    lines = by_reference_nodes().replace(f"{MASTERS[0]}, 1, -1.", f"{MASTERS[0]}, {direction}, -1.")
    found = [str(fault) for fault in read(tmp_path, cell(lines, HELD)).faults]
    assert "in directions 1 to 3 only" in found[0]


@pytest.mark.parametrize("step", FAULTS)
def test_cells_that_are_not_there(tmp_path: Path, step: str) -> None:
    """Each is an error with its line."""
    (fault,) = read(tmp_path, cell(by_reference_nodes(), step)).faults
    assert FAULTS[step] in str(fault)


def test_a_strain_above_its_equations(tmp_path: Path) -> None:
    """It was a note on a support, and the stress was 0 in its place."""
    above = f"{HELD}*BOUNDARY\n{MASTERS[2]}, 3, 3, 0.04\n"
    tables = [
        one(read(tmp_path, cell(text, "*BOUNDARY\n")))
        for text in (above + by_reference_nodes(), by_reference_nodes() + above)
    ]
    assert tables[0]["periodic"] == tables[1]["periodic"]
    assert tables[0]["periodic"]["gradient"][2] == [0, 0, 1.01]


def test_edges_that_are_no_sum_of_faces(tmp_path: Path) -> None:
    """An edge that follows a reference node the other way round."""
    lines = by_reference_nodes().splitlines()
    edge = lines.index("4") + 2
    lines[edge] = lines[edge].replace("-1.", "1.")
    (fault,) = read(tmp_path, cell("\n".join([*lines, ""]), "*BOUNDARY\n1, 1, 3\n")).faults
    assert "not the sum of those of the faces" in str(fault)


def test_a_face_that_is_not_joined_in_full(tmp_path: Path) -> None:
    """A middle of a face, or one of its directions, without an equation."""
    keyword, *lines = by_reference_nodes().splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith(f"{number([2, 0.5, 1])}, 2, "))
    rest = lines[: at - 1] + lines[at + 2 :]
    (fault,) = read(tmp_path, cell("\n".join([keyword, *rest, ""]), HELD)).faults
    assert "none joins 1 nodes with those opposite along x, in direction 2" in str(fault)
