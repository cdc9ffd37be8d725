"""Abaqus decks: blank fields, surfaces of mixed parts, sets that are not whole, names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.decks import COMM, box, inp_text, made, numbers, quadratic
from mpi4py import MPI

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.consistency import check
from dolfin_elastic.case.check.report import report
from dolfin_elastic.core.errors import InputError, MeshError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.mesh import Body, Selector, mesh_statistics, name_parts, read_body
from dolfin_elastic.mesh.formats.abaqus import read_abaqus

POINTS, CELLS = box((1, 1, 1), (1, 1, 1))


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
    "twice": (cube("*NODE\n3, 0.5, 0.5, 0.5\n"), "1 nodes stand twice, at different positions"),
    "spherical": (cube("").replace("*NODE", "*NODE, SYSTEM=S"), "inp:1: .*SYSTEM=S is not underst"),
    "other file": (cube("*NODE, INPUT=a.txt\n"), r"inp:17: \*NODE: there is no file"),
    "type": (cube("*ELEMENT, TYPE=U1\n9, 1, 2\n"), "inp:17: .*element type U1 is unknown"),
    "spring": (cube("*ELEMENT, TYPE=SPRINGA\nx, 1, 2\n"), "inp:18: .*'x' is no whole number"),
    "unknown": (cube("*TAPERED ELEMENT\n9, 1, 2\n"), "inp:17: .*this keyword is not understood"),
    "cut": (cube("*ELEMENT, TYPE=C3D4\n9, 1, 2\n"), "inp:18: .*3 numbers do not make rows of 5"),
    "letter": (cube("*ELEMENT, TYPE=C3D4\n9, 1, 2, x, 4\n"), "inp:18: .*'x' is no whole number"),
    "no name": (cube("*NSET\n1\n"), r"inp:17: \*NSET: NSET= is missing"),
    "no set": (cube("*NSET, NSET=a\nfoto\n*NSET, NSET=foot\n1\n"), "inp:18: .*'foto' does not"),
    "no elset": (cube("*SURFACE, NAME=a\nal, S1\n"), "'al' does not exist; did you mean 'ALL'"),
    "generate": (cube("*NSET, NSET=a, GENERATE\n1, x\n"), "inp:18: .*'1, x' generates nothing"),
    "step": (cube("*NSET, NSET=a, GENERATE\n1, 9, 0\n"), "inp:18: .*'1, 9, 0' generates nothing"),
    "face": (cube("*SURFACE, NAME=a\nALL, S5\n"), "inp:18: .*the face 'S5', which no element has"),
    "nmap": (cube("*NMAP\n1, 2\n"), r"inp:17: \*NMAP: this is not understood"),
    "ngen": (cube("*NGEN\n1, 8, 2\n"), "inp:18: .*'1, 8, 2' generates nothing"),
    "ngen node": (cube("*NGEN\n1, 21, 10\n"), "inp:18: .*the node 21 does not exist before it"),
    "arc": (cube("*NGEN, LINE=C\n1, 2, 1, 1\n"), "inp:18: .*'1, 2, 1, 1' generates nothing"),
    "nfill": (cube("*NSET, NSET=a\n1\n*NFILL\na, ALL, 2\n"), "inp:20: .*NSET 'ALL' does not"),
    "bias": (cube("*NFILL, BIAS=2.\n"), "inp:17: .*BIAS is not understood"),
    "reflect": (cube("*NCOPY, REFLECT=POINT\n"), "inp:17: .*REFLECT is not understood"),
    "no shift": (cube("*NCOPY, OLD SET=a\n"), "inp:17: .*SHIFT is missing"),
    "elgen": (cube("*ELGEN\n9, 2\n"), "inp:18: .*the element 9 does not exist before it"),
    "copies": (cube("*ELGEN\n1, 99999, 1, 1, 99999\n"), "inp:18: .*no number of copies"),
    "large": (cube("*ELGEN\n1, 2, 1, 9999999999\n"), "inp:18: .*the number 9999999999 is too l"),
    "below": (cube("*ELGEN\n1, 2, 1, -1\n"), "inp:17: .*0 is no number of a node or an element"),
    "elgen rows": (cube("*ELGEN\n1, 0\n"), "inp:18: .*'1, 0' generates nothing"),
    "elcopy": (cube("*ELCOPY, OLD SET=ALL, ELEMENT SHIFT=a\n"), "inp:17: .*SHIFT NODES= is miss"),
    "motion": (cube("*INSTANCE, NAME=a\n0., 0., 1., 2.\n"), "inp:18: .*motion is not understood"),
    "axis": (cube("*INSTANCE, NAME=a\n0.\n1., 0., 0., 1., 0., 0., 9.\n"), "inp:19: .*no length"),
    "no part": (cube("*INSTANCE, NAME=a, PART=p\n"), "inp:17: .*there is no part 'P' before"),
    "two parts": (cube("*PART, NAME=p\n*PART, NAME=p\n"), "inp:18: .*there is a part 'p' before"),
    "no instance": (cube("*PART, NAME=p\n*PART, NAME=q\n*NODE\n"), "has 2 parts without an inst"),
    "two instances": (cube("*INSTANCE, NAME=a\n*INSTANCE, NAME=A\n"), "inp:18: .*an instance 'A'"),
    "system": (cube("*SYSTEM\n0., 0., 0., 0., 0., 1.\n"), "inp:18: .*the points span no plane"),
    "systems": (cube("*SYSTEM\n0.\n0.\n0.\n"), "inp:20: .*there are more than two lines"),
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


@pytest.mark.parametrize(
    ("kind", "nodes", "side", "name"),
    [
        ("C3D8", 8, "S2", "hexahedra"),
        ("C3D20R", 20, "S6", "20-node hexahedra"),
        ("C3D6", 6, "S1", "wedges"),
        ("CPS4", 4, "S4", "quadrilaterals"),
    ],
)
def test_faces_of_elements_that_are_not_supported(
    folder: Path, kind: str, nodes: int, side: str, name: str
) -> None:
    rows = "".join(f"{i}, {i}., {i * i}., {i % 3}.\n" for i in range(1, nodes + 1))
    cell = ", ".join(map(str, range(1, nodes + 1)))
    text = f"*NODE\n{rows}*ELEMENT, TYPE={kind}\n1, {cell}\n*SURFACE, NAME=a\n1, {side}\n"
    with pytest.raises(MeshError, match=f"faces of {name}.*, which are not supported"):
        deck(folder, text)


def test_elements_without_shape_and_unknown_keywords_are_counted(folder: Path) -> None:
    more = "*NODE\n900, 5., 5., 5.\n*ELEMENT, TYPE=SPRINGA, ELSET=spring\n9, 900, 3\n10, 900, 4\n"
    more += "*ELEMENT, TYPE=CONN3D2\n11, , 2\n*ELEMENT, TYPE=B31\n12, 900, 2\n"
    more += "*ELSET, ELSET=both\n1, 9\n*SPELL\n1.\n*SPELL\n*STATIC\n"
    body = deck(folder, cube(more))
    assert body.num_cells == 6 and body.kinds("both") == ("region",)
    said = "elements that are left out; the case file states such: 2 SPRINGA, 1 CONN3D2"
    assert said in body.notes
    assert "unknown to the reader of meshes: 2 *SPELL" in body.information
    with pytest.raises(MeshError, match="'spring' .*its elements are left out"):
        body.region("spring")


def test_beams_with_a_node_for_their_section(folder: Path) -> None:
    """A third node of B31 turns its section: four numbers were no row. Pipes of CalculiX are D."""
    more = "*ELEMENT, TYPE=B31H, ELSET=rim\n12, 1, 2, 5\n13, 2, 1, 5\n"
    body = deck(folder, cube(more + "*ELEMENT, TYPE=D\n14, 0, 2, 3\n"))
    assert body.num_cells == 6 and body.kinds("rim") == ("edge",)
    assert "elements that are left out; the case file states such: 1 D" in body.notes
    with pytest.raises(MeshError, match=r"there are no \*NODE or no \*ELEMENT lines of a body"):
        deck(folder, "*NODE\n1, 0., 0., 0.\n2, 1., 0., 0.\n*ELEMENT, TYPE=D\n1, 1, 0, 2\n")


def test_texts_of_ucd(folder: Path) -> None:
    """AVS names its meshes .inp, too: that there are no *NODE lines was all that was said."""
    rows = [f"{i + 1} {' '.join(map(str, x))}" for i, x in enumerate(POINTS.tolist())]
    rows += [
        f"{i + 1} 7 tet {' '.join(map(str, row))}" for i, row in enumerate((CELLS + 1).tolist())
    ]
    text = "\n".join(["# made by hand", f"{len(POINTS)} {len(CELLS)} 0 0 0", *rows, ""])
    size = mesh_statistics(deck(folder, text))
    assert size.volume == pytest.approx(1) and size.regions == pytest.approx(
        {"avsucd:material_7": 1}
    )


def test_lines_in_other_files(folder: Path) -> None:
    """INPUT= and *INCLUDE, also amid the lines of a keyword; faults name the other file."""
    whole = cube("*NSET, NSET=foot\n1, 2\n")
    _, nodes, elements = whole.split("*", 2)
    lines = nodes.splitlines(keepends=True)[1:]
    made(lambda: (folder / "first.txt").write_text("** nodes\n" + "".join(lines[:3])))
    made(lambda: (folder / "rest.txt").write_text("".join(lines[4:])))
    text = f"*NODE, INPUT=first.txt, NSET=every\n{lines[3]}*INCLUDE, INPUT=rest.txt\n*{elements}"
    body, direct = deck(folder, text), deck(folder, whole)
    assert mesh_statistics(body).volume == pytest.approx(1)
    assert np.array_equal(body.mesh.geometry.x, direct.mesh.geometry.x)
    assert COMM.allreduce(len(body.owned_points("every"))) == 8
    made(lambda: (folder / "first.txt").write_text("\n1, 0., zero\n"))
    with pytest.raises(MeshError, match=r"^first\.txt:2: \*NODE: '1, 0\., zero' is not a row"):
        deck(folder, text)
    made(lambda: (folder / "first.txt").write_text("*ELEMENT\n"))
    with pytest.raises(MeshError, match=r"^first\.txt:1: .*a keyword in a file of INPUT="):
        deck(folder, text)


def test_coordinate_systems(folder: Path) -> None:
    """One with three points, one turned about the global Z, a moved one, and the global again."""
    text = "*SYSTEM\n1., 2., 3., 1., 2., 5.\n4., 2., 3.\n*NODE\n1, 1., 0., 0.\n2, 0., 1., 7.\n"
    text += "*SYSTEM\n1., 0., 0., 1., 2., 0.\n*NODE\n3, 1., 2., 3.\n*SYSTEM\n1., 1., 1.\n"
    text += "*NODE, SYSTEM=C\n4, 2., 90., 5.\n*SYSTEM\n*NODE\n5, 1., 2., 3.\n"
    made(lambda: (folder / "deck.inp").write_text(f"{text}*ELEMENT, TYPE=C3D4\n1, 1, 2, 3, 4\n"))
    points = [[1, 2, 4], [2, 9, 3], [-1, 1, 3], [1, 3, 6], [1, 2, 3]]
    assert read_abaqus(folder / "deck.inp").points == pytest.approx(np.array(points), abs=1e-14)


@pytest.mark.parametrize("order", [[0, 1, 2, 3, 5, 4], [2, 0, 1, 5, 3, 4]])
def test_midside_nodes_in_another_order(folder: Path, order: list[int]) -> None:
    """Also where the cells are curved; cells of different orders are refused as before."""
    points, cells = quadratic(*box((1, 1, 1), (2, 2, 2)))
    points[:, 0] += 0.05 * np.sin(3 * points[:, 1])
    right = deck(folder, inp_text(points, cells))
    mixed = cells[:, [0, 1, 2, 3, *(4 + k for k in order)]]
    body = deck(folder, inp_text(points, mixed))
    back = ", ".join(map(str, [1, 2, 3, 4, *(5 + k for k in np.argsort(order))]))
    assert any(f"of {len(cells)} elements" in n and n.endswith(f"order {back}") for n in body.notes)
    assert mesh_statistics(body).volume == pytest.approx(mesh_statistics(right).volume, rel=1e-12)
    assert not any("midside" in note for note in right.notes)
    mixed[::2] = cells[::2]
    with pytest.raises(MeshError, match="fold over themselves"):
        deck(folder, inp_text(points, mixed))


def test_generated_nodes_and_elements(folder: Path) -> None:
    """A bar of 4 x 1 x 1 from two corner nodes, and lines on a circle and a parabola."""
    text = "*NODE\n1, 0., 0., 0.\n5, 4., 0., 0.\n*NGEN, NSET=low\n1, 5, 1\n"
    text += "*NCOPY, CHANGE NUMBER=10, OLD SET=low, SHIFT, NEW SET=back\n0., 1., 0.\n\n"
    text += "*NCOPY, CHANGE NUMBER=200, OLD SET=low, SHIFT, NEW SET=high\n0., 0., 2.\n"
    text += "*NCOPY, CHANGE NUMBER=200, OLD SET=back, SHIFT, NEW SET=top\n0., 0., 2.\n"
    text += "*NFILL\nlow, high, 2, 100\nback, top, 2, 100\n"
    text += "*NCOPY, CHANGE NUMBER=1000, OLD SET=back, SHIFT, MULTIPLE=2\n0.\n"
    text += "0., 0., 0., 0., 0., 1., 90.\n"
    x, y, z = 1, 10, 100
    paths = [[0, a, a + b, x + y + z] for a in (x, y, z) for b in (x, y, z) if a != b]
    rows = "".join(f"{i}, {', '.join(str(1 + n) for n in p)}\n" for i, p in enumerate(paths, 1))
    text += f"*ELEMENT, TYPE=C3D4, ELSET=first\n{rows}*ELGEN, ELSET=all\n"
    text += "".join(f"{i}, 3, 1, 10, 2, 100, 100\n" for i in range(1, 7))
    text += "*ELCOPY, OLD SET=first, ELEMENT SHIFT=30, SHIFT NODES=3, NEW SET=last\n"
    text += "*NODE\n4001, 2., 0., 0.\n4004, 0., 2., 0.\n4010, 0., 0., 1.\n4014, 4., 0., 1.\n"
    text += "4020, 2., 3., 1.\n*NGEN, LINE=C\n4001, 4004, 1, 1\n*NGEN, LINE=P, NSET=bow\n"
    text += "4010, 4014, 1, 4020\n"
    made(lambda: (folder / "deck.inp").write_text(text))
    file = read_abaqus(folder / "deck.inp")
    assert list(file.points[file.point_sets["bow"], 1]) == pytest.approx([0, 2.25, 3, 2.25, 0])
    for radius, angle in zip((2, 2), np.radians([30, 60]), strict=True):
        point = np.array([np.cos(angle), np.sin(angle), 0]) * radius
        assert np.linalg.norm(file.points - point, axis=1).min() < 1e-14
    # Node 15 at (4, 1) is turned twice by 90 degrees.
    assert np.linalg.norm(file.points - [-4, -1, 0], axis=1).min() < 1e-14
    regions = mesh_statistics(read_body(folder / "deck.inp")).regions
    assert regions == pytest.approx({"first": 1, "all": 6, "last": 1})


# --- assemblies ---

PART = "*PART, NAME=p\n" + cube("*NSET, NSET=corner\n1\n*SURFACE, NAME=foot\nlow, S1\n*END PART\n")
PART = PART.replace("*SURFACE", "*ELSET, ELSET=low\n1\n*SURFACE")
TURN = "1., 0., 0., 1., 0., 1., 90."


def assembly(more: str, second: str = f"2., 0., 0.\n{TURN}\n") -> str:
    """The cube as instance a, and as b: moved by 2 along x and turned about an axis at x = 1."""
    text = f"{PART}*ASSEMBLY, NAME=all\n*INSTANCE, NAME=a, PART=p\n*END INSTANCE\n"
    text += f"*INSTANCE, NAME=b, PART=P\n{second}*END INSTANCE\n"
    return f"{text}{more}*END ASSEMBLY\n"


def test_instances_are_moved_and_turned(folder: Path) -> None:
    more = "*NSET, NSET=both\na.1, all.b.2\n*NSET, NSET=low, INSTANCE=b\n1, 2\n*NSET, NSET=sets\n"
    more += "b.corner\n*ELSET, ELSET=_s, INSTANCE=b, GENERATE\n1, 2\n*SURFACE, NAME=top\n_s, S1\n"
    more += (
        "*NODE, NSET=own\n1, 9., 9., 9.\n*NSET, NSET=rp\n1\n*SURFACE, NAME=feet, COMBINE=UNION\n"
    )
    more += (
        "a.foot\nb.foot\n*ELEMENT, TYPE=CONN3D2\n1, 1, b.3\n*ELEMENT, TYPE=MASS, ELSET=m\n2, b.1\n"
    )
    text = assembly(more).replace("*END PART", "*SPELL\n*END PART", 1)
    made(lambda: (folder / "deck.inp").write_text(text))
    file = read_abaqus(folder / "deck.inp")
    turned = np.stack([1 - POINTS[:, 1], POINTS[:, 0] + 1, POINTS[:, 2]], axis=1)
    assert file.points == pytest.approx(np.vstack([POINTS, turned, [[9, 9, 9]]]), abs=1e-14)
    rows = {"a.corner": [0], "b.corner": [8], "both": [0, 9], "low": [8, 9], "sets": [8]}
    rows |= {"own": [16], "rp": [16]}
    assert {name: list(found) for name, found in file.point_sets.items()} == rows
    body = read_body(folder / "deck.inp")
    volumes = {"a": 1, "b": 1, "a.ALL": 1, "b.ALL": 1, "_s": 1 / 3, "a.low": 1 / 6, "b.low": 1 / 6}
    assert mesh_statistics(body).regions == pytest.approx(volumes)
    size, kinds = mesh_statistics(body).surfaces, body.kinds
    assert size["feet"] == pytest.approx(size["a.foot"] + size["b.foot"])
    assert size["a.foot"] == pytest.approx(size["b.foot"]) and size["top"] > 0
    assert kinds("m") == ("point",)
    assert "unknown to the reader of meshes: 1 *SPELL" in body.information


def test_numbers_of_an_assembly_name_their_instance(folder: Path) -> None:
    faults = {
        "*NSET, NSET=n\n1\n": "1 is a number in one of 2 instances",
        "*NSET, NSET=n, INSTANCE=c\n1\n": "there is no instance 'C' before it",
        "*NSET, NSET=n\nc.corner\n": "the NSET 'c.corner' does not exist",
        "*ELEMENT, TYPE=MASS\nx, a.1\n": "'x' is no whole number",
        "*ELEMENT, TYPE=MASS\n1, a.1, 2\n": "3 entries do not make rows of 2",
        "*ELEMENT, TYPE=T3D2\n1, a.1, a.corner.x\n": "'a.corner.x' does not exist",
    }
    for more, said in faults.items():
        with pytest.raises(MeshError, match=said):
            deck(folder, assembly(more))
    with pytest.raises(MeshError, match="refer to 1 points that do not exist, for example 77"):
        deck(folder, assembly("").replace("ALL\n1, 1,", "ALL\n1, 77,"))


def test_one_part_without_instance_and_one_too_many(folder: Path) -> None:
    """A single part is taken as it is; of several, those without an instance are left out."""
    assert mesh_statistics(deck(folder, PART)).volume == pytest.approx(1)
    body = deck(folder, PART.replace("=p", "=q") + assembly("", "0., 0., 5.\n"))
    assert mesh_statistics(body).volume == pytest.approx(2)
    assert "parts without an instance, which are left out: Q" in body.information


# --- sets ---


def test_nodes_of_elements(folder: Path) -> None:
    body = deck(folder, cube("*ELSET, ELSET=two\n1, 2\n*NSET, NSET=n, ELSET=two\n"))
    assert COMM.allreduce(len(body.owned_points("n"))) == len({*CELLS[0], *CELLS[1]})


def test_reference_points_of_an_assembly(folder: Path) -> None:
    """Their numbers begin at 1 again; sets of the assembly name them, or nodes of an instance."""
    more = "*NSET, NSET=own\n1\n*END PART\n*ASSEMBLY, NAME=a\n*INSTANCE, NAME=i, PART=p\n"
    more += "*END INSTANCE\n*NODE\n1, 9., 9., 9.\n*NSET, NSET=reference\n1\n"
    more += "*NSET, NSET=corner, INSTANCE=i\n1\n*END ASSEMBLY\n*NSET, NSET=after\n1\n"
    body = deck(folder, "*PART, NAME=p\n" + cube(more))
    for name in ("own", "corner", "after"):
        nodes = body.mesh.geometry.x[body.owned_points(name)]
        assert COMM.allreduce(len(nodes)) == 1 and not nodes.any()
    with pytest.raises(MeshError, match="'reference' .* 1 of its 1 nodes belong to no element"):
        body.point("reference")


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


INCOMPLETE = {
    "*NSET, NSET=part\n1, 2, 99\n": "1 of its 3 nodes do not exist in the file, for example 99",
    "*ELSET, ELSET=part\n1, 2, 97, 98\n": "2 of its 4 elements do not exist in the file",
    "*SURFACE, NAME=part\n1, S1\n88, S1\n": "1 of its 2 elements do not exist",
    "*ELEMENT, TYPE=T3D2\n9, 1, 2\n*ELSET, ELSET=two\n1, 9\n*SURFACE, NAME=part\ntwo, S1\n": (
        "1 of its 2 elements do not exist, or have no such face"
    ),
    "*SURFACE, NAME=one\n1, S1\n*SURFACE, NAME=part, COMBINE=DIFFERENCE\none, one\n": "DIFFERENCE",
    "*ELEMENT, TYPE=C3D4\n6, 1, 2, 4, 8\n*ELSET, ELSET=part\n5, 6\n": "1 of its 2 elements stand",
    "*NSET, NSET=part\n": "it has no nodes",
    "*NODE\n50, 5., 5., 5.\n*NSET, NSET=part\n1, 50\n": "1 of its 2 nodes belong to no element",
    "*ELEMENT, TYPE=S3, ELSET=part\n9, 1, 2, 4\n10, 2, 3, 5\n": "1 of its 2 facets are no facets",
}


@pytest.mark.parametrize("more", INCOMPLETE, ids=range(len(INCOMPLETE)))
def test_sets_that_are_not_whole_are_refused_where_they_are_used(folder: Path, more: str) -> None:
    body = deck(folder, cube(more))
    assert not body.kinds("part")
    assert any(INCOMPLETE[more] in note for note in body.notes)
    for use in (body.surface, body.region, body.point):
        with pytest.raises(MeshError, match=r"'part' of deck\.inp is incomplete") as caught:
            use("part")
        assert INCOMPLETE[more] in str(caught.value)


def test_sets_of_lines_and_of_masses_are_edges_and_points(folder: Path) -> None:
    """They vanished."""
    more = "*ELEMENT, TYPE=T3D2, ELSET=Ridge\n21, 1, 2\n*ELEMENT, TYPE=MASS, ELSET=weight\n22, 8\n"
    body = deck(folder, cube(more))
    assert body.kinds("RIDGE") == ("edge",) and body.kinds("weight") == ("point",)
    assert COMM.allreduce(len(body.owned_edges("ridge"))) == 1
    assert COMM.allreduce(len(body.owned_points("weight"))) == 1
    assert any(told.endswith("no stiffness: 1 T3D2, 1 MASS") for told in body.information)


def test_a_part_may_be_named_anew_by_where_it_lies(folder: Path) -> None:
    body = deck(folder, cube("*NSET, NSET=foot\n1, 2, 99\n"))
    body = name_parts(body, surfaces={"foot": Selector(plane="z", at="min")})
    assert body.count("foot") == 2 and not body.incomplete
    body.check_whole("FOOT")


# --- cases ---


def case(folder: Path, **tables: Any) -> Case:
    tables = {
        "mesh": {"file": "deck.inp", "degree": 1},
        "materials": {"steel": {"law": "linear-elastic", "E": "210 GPa", "nu": 0.3}},
        "support": [{"on": "foot"}],
        "load": [{"kind": "traction", "on": "end", "value": ["1 MPa", 0, "1 MPa"]}],
        **tables,
    }
    return Case.from_dict(tables, folder, file="case.toml")


def bar(order: int = 1, *, more: str = "") -> str:
    """A bar of 8 x 2 x 2 little cubes: 9 nodes of the left end and one of the tip are `foot`."""
    points, cells = box((4, 1, 1), (8, 2, 2))
    if order == 2:
        points, cells = quadratic(points, cells)
    left = np.flatnonzero(points[:, 0] == 0)
    tip = np.flatnonzero((points == [4, 0.5, 0.5]).all(axis=1))
    right = np.flatnonzero(points[:, 0] == 4)
    sets = {"foot": np.append(left, tip), "left": left, "tip": tip, "end": right}
    text = "".join(f"*NSET, NSET={name}\n{numbers(rows)}\n" for name, rows in sets.items())
    return inp_text(points, cells, text + more)


def largest(case: Case) -> float:
    """Largest displacement of a node [m]."""
    problem = case.make_problem(case.read_body())
    for _ in case.make_solver(problem).steps():
        pass
    return float(COMM.allreduce(np.abs(problem.u.x.array).max(initial=0), op=MPI.MAX))


def test_a_mesh_without_a_unit_is_said_to_be_in_metres(folder: Path) -> None:
    """A deck in mm is a part of 4 m, where nothing else looks wrong."""
    made(lambda: (folder / "deck.inp").write_text(bar()))
    said = "lengths in m: neither the file nor mesh.unit says what they are in"
    assert said in report(case(folder)).information
    mesh = {"file": "deck.inp", "degree": 1, "unit": "mm"}
    assert said not in report(case(folder, mesh=mesh)).information


@pytest.mark.parametrize("order", [1, 2])
def test_a_set_of_nodes_holds_its_single_nodes(folder: Path, order: int) -> None:
    """Eight facets and one node at the tip; without that node the tip moved 56 times as far."""
    made(lambda: (folder / "deck.inp").write_text(bar(order)))
    mesh = {"file": "deck.inp", "degree": order}
    whole = largest(case(folder, mesh=mesh))
    apart = largest(case(folder, mesh=mesh, support=[{"on": "left"}, {"on": "tip"}]))
    without = largest(case(folder, mesh=mesh, support=[{"on": "left"}]))
    assert whole == pytest.approx(apart, rel=1e-12)
    assert without > 20 * whole


def test_sets_of_a_deck_with_loads(folder: Path) -> None:
    """FreeCAD writes *CLOAD at nodes and *BOUNDARY at sets: both sets can be named in a case.

    The sum of the reactions is that of the forces, and what the deck itself asks for is not read.
    """
    more = "*BOUNDARY\nleft, 1, 3\n*STEP\n*STATIC\n*CLOAD\nTIP, 3, -1000.\n*END STEP\n"
    made(lambda: (folder / "deck.inp").write_text(bar(2, more=more)))
    force = {"kind": "point-force", "on": "TIP", "value": [0, 0, "1 kN"]}
    held = case(folder, mesh={"file": "deck.inp"}, support=[{"on": "Left"}], load=[force])
    problem = held.make_problem(held.read_body())
    assert "for the case file, no part of the mesh: *BOUNDARY, *CLOAD" in problem.body.information
    *_, last = held.make_solver(problem).steps()
    assert last.reactions["Left"] == pytest.approx([0, 0, -1000], abs=1e-4)  # the linear solver's
    at = [{"kind": "point-force", "at": [4, 0.5, 0.5], "value": [0, 0, "1 kN"]}]
    apart = case(folder, mesh={"file": "deck.inp"}, support=[{"on": "left"}], load=at)
    assert largest(held) == pytest.approx(largest(apart), rel=1e-9)


def test_names_in_any_case(folder: Path) -> None:
    made(lambda: (folder / "deck.inp").write_text(bar(more="*ELSET, ELSET=Steel\nALL\n")))
    load = {"kind": "traction", "on": "END", "value": ["1 MPa", 0, "1 MPa"]}
    material = {"law": "linear-elastic", "E": "210 GPa", "nu": 0.3, "on": "STEEL"}
    other = case(
        folder,
        support=[{"on": "FOOT", "name": "foot"}],
        load=[load],
        materials={"steel": material},
    )
    assert largest(other) == pytest.approx(largest(case(folder)), rel=1e-12)
    found = report(other)
    assert {part.name: part.use for part in found.surfaces} == {"left": "", "end": "traction"}
    assert {part.name: part.use for part in found.points} == {"foot": "support", "tip": ""}
    assert {part.name: part.use for part in found.regions} == {
        "(whole body)": "",
        "ALL": "",
        "Steel": "steel",
    }


def test_an_exact_name_comes_first() -> None:
    from dolfin_elastic import box_body

    body = box_body(size=(1, 1, 1), cells=(1, 1, 1))
    body = body.named(
        surfaces={"Foot": body.surface("bottom"), "foot": body.surface("top")},
        points={"TOP": np.empty(0, dtype=np.int32)},
    )
    assert np.array_equal(body.surface("Foot"), body.surface("bottom"))
    assert np.array_equal(body.surface("foot"), body.surface("top"))
    assert np.array_equal(body.surface("LEFT"), body.surface("left"))
    with pytest.raises(MeshError, match="'FOOT' may mean 'Foot' or 'foot'"):
        body.surface("FOOT")
    with pytest.raises(MeshError, match="'TOP' is a point"):
        body.surface("TOP")
    assert body.kinds("TOP") == ("point",)
    assert body.kinds("Left") == ("surface",)


def test_an_incomplete_set_is_an_error_of_its_key(folder: Path) -> None:
    made(lambda: (folder / "deck.inp").write_text(bar(more="*NSET, NSET=part\n1, 2, 999\n")))
    good, bad = case(folder), case(folder, support=[{"on": "foot"}, {"on": "Part"}])
    body = good.read_body()
    check(good, body)
    with pytest.raises(InputError) as caught:
        check(bad, body)
    assert str(caught.value) == (
        "case.toml: support[1].on: 'Part' of deck.inp is incomplete: 1 of its 3 nodes do not exist "
        "in the file, for example 999; correct the mesh file, or name the part by where it lies"
    )
