"""Abaqus decks: blank fields, surfaces of mixed parts, sets that are not whole, names."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from helpers.decks import COMM, box, inp_text, made, numbers, shared_folder

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.mesh import Body, mesh_statistics, read_body
from dolfin_elastic.mesh.formats.abaqus import read_abaqus

POINTS, CELLS = box((1, 1, 1), (1, 1, 1))


@pytest.fixture
def folder() -> Iterator[Path]:
    with shared_folder() as path:
        yield path


def deck(folder: Path, text: str) -> Body:
    made(lambda: (folder / "deck.inp").write_text(text))
    return read_body(folder / "deck.inp")


def cube(more: str) -> str:
    """The cube of six tetrahedra, which meet at the edge from node 1 to node 8."""
    return inp_text(POINTS, CELLS, more)


# --- lines ---


def test_blank_fields_are_zero(folder: Path) -> None:
    """As Abaqus reads them: blank, left out at the end, with exponents of Fortran, in columns."""
    lines = ["1", "2, 1.", "3,, 1.0D0", "4,1.,1.,", "5, , ,1.", "6,1.E0,,1.", "7,0.,1.,1.,0.,0.,1."]
    rows = "\n".join(f"{i}, {', '.join(map(str, c + 1))}" for i, c in enumerate(CELLS, 1))
    text = "*NODE,\n NSET=some\n" + "\n".join([*lines, "8,1.,1.,1."])
    body = deck(folder, f"{text}\n*ELEMENT, TYPE=C3D4\n{rows}\n")
    assert mesh_statistics(body).volume == pytest.approx(1)
    assert list(body.surfaces) == ["some"]


def test_cylindrical_coordinates(folder: Path) -> None:
    """A wedge of 30 degrees from radius 1 to 2, straight: area 3/4 and height 1."""
    text = inp_text(POINTS * [1, 30, 1] + [1, 0, 0], CELLS).replace("*NODE", "*NODE, SYSTEM=C", 1)
    assert mesh_statistics(deck(folder, text)).volume == pytest.approx(0.75)


FAULTS = {
    "word": (cube("").replace("3, 0,", "3, zero,", 1), r"deck\.inp:4: \*NODE: '3, zero, 1, 0'"),
    "label": (cube("").replace("\n3, ", "\n3.5, ", 1), r"inp:4: \*NODE: 3\.5 is no number"),
    "no label": (cube("").replace("\n3, ", "\n, ", 1), r"inp:4: .* is not a row of numbers"),
    "twice": (cube("*NODE\n3, 0.5, 0.5, 0.5\n"), "1 nodes stand twice, at different places"),
    "spherical": (cube("").replace("*NODE", "*NODE, SYSTEM=S"), "inp:1: .*SYSTEM=S is not underst"),
    "other file": (cube("*NODE, INPUT=a.txt\n"), r"inp:17: \*NODE: INPUT= is not read"),
    "type": (cube("*ELEMENT, TYPE=GAPUNI\n9, 1, 2\n"), "inp:17: .*element type GAPUNI is unknown"),
    "cut": (cube("*ELEMENT, TYPE=C3D4\n9, 1, 2\n"), "inp:18: .*3 numbers do not make rows of 5"),
    "letter": (cube("*ELEMENT, TYPE=C3D4\n9, 1, 2, x, 4\n"), "inp:18: .*'x' is no whole number"),
    "no name": (cube("*NSET\n1\n"), r"inp:17: \*NSET: NSET= is missing"),
    "no set": (cube("*NSET, NSET=a\nfoto\n*NSET, NSET=foot\n1\n"), "inp:18: .*'foto' does not"),
    "no elset": (cube("*SURFACE, NAME=a\nal, S1\n"), "'al' does not exist; did you mean 'ALL'"),
    "generate": (cube("*NSET, NSET=a, GENERATE\n1, x\n"), "inp:18: .*'1, x' generates nothing"),
    "step": (cube("*NSET, NSET=a, GENERATE\n1, 9, 0\n"), "inp:18: .*'1, 9, 0' generates nothing"),
    "face": (cube("*SURFACE, NAME=a\nALL, S5\n"), "inp:18: .*the face 'S5', which no element has"),
    "ngen": (cube("*NGEN\n1, 2\n"), r"inp:17: \*NGEN: this is not understood"),
    "turned": (cube("*INSTANCE, NAME=a\n0., 0., 1.\n"), "inp:17: .*moved or turned"),
    "offset": (cube("*INSTANCE, NAME=a\n0., up, 1.\n"), "inp:18: .*not a row of numbers"),
    "include": (cube("*INCLUDE, INPUT=none.inp\n"), "inp:17: .*there is no file"),
    "circle": (cube("*INCLUDE, INPUT=deck.inp\n"), "goes round in a circle"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_name_file_and_line(folder: Path, fault: str) -> None:
    text, said = FAULTS[fault]
    with pytest.raises(MeshError, match=said) as caught:
        deck(folder, text)
    assert str(caught.value).startswith("deck.inp:")


def test_damaged_decks(folder: Path) -> None:
    """Cut at many places, and with bytes changed: read, or a MeshError, never anything else."""
    more = "*NSET, NSET=a, GENERATE\n1, 4, 1\n*SURFACE, NAME=b\nALL, S1\n*SURFACE, NAME=c\nALL\n"
    bad, whole = folder / "bad.inp", cube(more + "*NSET, NSET=d, ELSET=ALL\n").encode()

    def attempt() -> int:
        random, refused = np.random.default_rng(1), 0
        for i in range(200):
            data = bytearray(whole)
            if i % 2:
                data = data[: len(whole) * i // 200]
            else:
                at = int(random.integers(len(data) - 3))
                data[at : at + 3] = random.bytes(3)
            bad.write_bytes(bytes(data))
            try:
                read_abaqus(bad)
            except MeshError:
                refused += 1
        return refused

    assert on_root(COMM, attempt) >= 80


# --- sets ---


def test_nodes_of_elements(folder: Path) -> None:
    body = deck(folder, cube("*ELSET, ELSET=two\n1, 2\n*NSET, NSET=n, ELSET=two\n"))
    assert "n" in body.surfaces


def test_surfaces_of_mixed_parts(folder: Path) -> None:
    """Faces of tetrahedra and of the shells on them, single elements, and a union."""
    bottom = [[i + 1 for i in c[:3]] for c in CELLS if not POINTS[c[:3], 2].any()]
    rows = "\n".join(f"{i}, {a}, {b}, {c}" for i, (a, b, c) in enumerate(bottom, 21))
    top = [i for i, c in enumerate(CELLS, 1) if POINTS[c[1:], 2].all()]  # face S3 is 2, 4, 3
    more = f"*ELEMENT, TYPE=S3, ELSET=shells\n{rows}\n"
    more += f"*ELSET, ELSET=upper\n{numbers(np.array(top) - 1)}\n"
    more += "*SURFACE, NAME=below, TYPE=ELEMENT\nshells, SPOS\n"
    more += "*SURFACE, NAME=above\n" + "".join(f"{i}, S3\n" for i in top)
    more += "*SURFACE, NAME=mixed\nshells, SNEG\nupper, S3\n"
    more += "*SURFACE, NAME=both, COMBINE=UNION\nbelow\nABOVE\n"
    size = mesh_statistics(deck(folder, cube(more)))
    assert len(bottom) == len(top) == 2
    areas = {"below": 1, "above": 1, "mixed": 2, "both": 2, "shells": 1}
    assert size.surfaces == pytest.approx(areas)


def test_surfaces_of_nodes_have_all_their_lines(folder: Path) -> None:
    low = np.flatnonzero(POINTS[:, 2] == 0)
    more = f"*NSET, NSET=three\n{numbers(low[:3])}\n"
    more += f"*SURFACE, NAME=foot, TYPE=NODE\nthree, 0.25\n{low[3] + 1}, 0.25\n"
    assert mesh_statistics(deck(folder, cube(more))).surfaces["foot"] == pytest.approx(1)


def test_sets_with_members_that_do_not_exist_are_left_out(folder: Path) -> None:
    more = "*ELSET, ELSET=part\n1, 2, 97, 98\n*SURFACE, NAME=side\n1, S1\n88, S1\n"
    body = deck(folder, cube(more))
    assert not body.surfaces and list(body.regions) == ["ALL"]
    assert any("'part' (2 of its 4 elements do not exist" in note for note in body.notes)
    assert any("'side' (1 of its 2 elements do not exist" in note for note in body.notes)
