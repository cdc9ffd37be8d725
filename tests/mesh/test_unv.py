"""I-DEAS universal files: kinds of elements, groups, units, and damaged ones."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from helpers.bodies import drawing
from helpers.decks import COMM, box, made, quadratic

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.mesh import mesh_statistics, read_body
from dolfin_elastic.mesh.formats.unv import read_unv

POINTS, CELLS = box((1, 1, 1), (1, 1, 1))
ROUND = {4: [0, 1, 2, 3], 3: [0, 1, 2], 2: [0, 1]}
ROUND[10] = [0, 4, 1, 5, 2, 6, 7, 8, 9, 3]  # corners and midside nodes in turns
ROUND[6] = [0, 3, 1, 4, 2, 5]


def dataset(number: int, lines: Sequence[str]) -> str:
    return "\n".join(["    -1", f"{number:6d}", *lines, "    -1"]) + "\n"


def nodes(points: AnyArray, number: int = 2411) -> str:
    """Nodes from label 11 on, in steps of ten, with exponents of Fortran."""
    lines = []
    for i, x in enumerate(points, start=1):
        head = f"{10 * i + 1:10d}{1:10d}{1:10d}{11:10d}"
        row = "".join(f"{v:25.16E}" for v in x).replace("E", "D")
        lines += [head, row] if number != 15 else [head + "".join(f"{v:13.5E}" for v in x)]
    return dataset(number, lines)


def rows(words: Sequence[int]) -> list[str]:
    return ["".join(f"{w:10d}" for w in words[i : i + 8]) for i in range(0, len(words), 8)]


def element(label: int, kind: int, row: AnyArray, number: int = 2412) -> list[str]:
    """An element by rows of points in the order of VTK."""
    labels = [10 * int(row[i]) + 11 for i in ROUND.get(len(row), range(len(row)))]
    head = [label, kind, 1, 1, 7, len(row)] if number == 2412 else [label, kind, 1, 1, 1, 1, 7]
    beam = ([0, 1, 1] if number == 2412 else [0, 1, 1, 1, 1]) if 11 <= kind < 33 else []
    return [
        *rows(head if number == 2412 else [*head, len(row)]),
        *(rows(beam) if beam else []),
        *rows(labels),
    ]


def group(number: int, label: int, name: str, members: Sequence[tuple[int, int]]) -> list[str]:
    """A group of kinds (7: nodes, 8: elements) and labels."""
    width = 4 if number in (2435, 2452, 2467, 2477) else 2
    heads = {752: [label, 0, 0, 0, 0], 2417: [label, 0, 0, 0, 0, 0]}
    words = [w for kind, tag in members for w in (kind, tag, 0, 0)[:width]]
    head = [*heads.get(number, [label, 0, 0, 0, 0, 0, 0]), len(members)]
    return [*rows(head), name, *rows(words)]


def cube(*groups: str, kind: int = 111) -> str:
    """The cube with its bottom as triangles 101 and 102, an edge 201, and groups."""
    points, cells = (POINTS, CELLS) if kind == 111 else quadratic(POINTS, CELLS)
    lines = [line for i, cell in enumerate(cells, start=1) for line in element(i, kind, cell)]
    lines += element(101, 91, np.array([0, 1, 3])) + element(102, 91, np.array([0, 2, 3]))
    lines += element(201, 21, np.array([0, 1]))
    return nodes(points) + dataset(2412, lines) + "".join(groups)


@pytest.mark.parametrize("number", [752, 2417, 2429, 2430, 2432, 2435, 2452, 2467, 2477])
def test_groups(folder: Path, number: int) -> None:
    lines = group(number, 1, "soft part", [(8, i) for i in (1, 2, 3)])
    lines += group(number, 2, "hard", [(8, i) for i in (4, 5, 6)])
    lines += group(number, 3, "foot", [(8, 101), (8, 102)])
    lines += group(number, 4, "top", [(7, 10 * i + 11) for i in (4, 5, 6, 7)])
    lines += group(number, 5, "rim", [(8, 201)])
    made(lambda: (folder / "cube.unv").write_text(cube(dataset(number, lines))))
    size = mesh_statistics(read_body(folder / "cube.unv", scale=2))
    assert size.volume == pytest.approx(8)
    assert size.regions == pytest.approx({"soft part": 4, "hard": 4})
    assert size.surfaces == pytest.approx({"foot": 4, "top": 4})


def test_edges_as_axisymmetric_shells(folder: Path) -> None:
    """Cubit writes the edges of a body as elements 171: the file was refused for them."""
    text = cube(dataset(2467, group(2467, 1, "rim", [(8, 301)])))
    lines = [element(label, kind, np.array([0, 1])) for label, kind in ((201, 21), (301, 171))]
    text = text.replace(lines[0][0], "\n".join((*lines[1], lines[0][0])))
    made(lambda: (folder / "cube.unv").write_text(text))
    assert read_body(folder / "cube.unv").kinds("rim") == ("edge",)


@pytest.mark.parametrize("blank", [[], [""]])
def test_empty_groups(folder: Path, blank: list[str]) -> None:
    """SALOME writes an empty line for their members, as no other program does."""
    empty = [line for i in (7, 8, 9) for line in group(2467, i, f"nothing {i}", [])[:2] + blank]
    lines = [*empty[: len(empty) // 3], *group(2467, 3, "foot", [(8, 101), (8, 102)])]
    lines += empty[len(empty) // 3 :]
    made(lambda: (folder / "cube.unv").write_text(cube(dataset(2467, lines))))
    body = read_body(folder / "cube.unv")
    assert mesh_statistics(body).surfaces == pytest.approx({"foot": 1})
    assert body.notes == ("groups without members: nothing 7, nothing 8, nothing 9",)


@pytest.mark.parametrize(("number", "kinds"), [(15, 2412), (781, 780), (2411, 2412)])
def test_versions_of_nodes_and_elements(folder: Path, number: int, kinds: int) -> None:
    lines = [line for i, c in enumerate(CELLS, start=1) for line in element(i, 111, c, kinds)]
    lines += element(9, 21, np.array([0, 1]), kinds)
    text = nodes(POINTS, number) + dataset(151, ["anything -1 else", "x"]) + dataset(kinds, lines)
    made(lambda: (folder / "cube.unv").write_text(text))
    assert mesh_statistics(read_body(folder / "cube.unv")).volume == pytest.approx(1)


def test_quadratic_cells_keep_their_order(folder: Path) -> None:
    """Midside nodes stand between their corners; in any other order the cells would fold."""
    lines = group(2467, 1, "foot", [(8, 101), (8, 102)])
    made(lambda: (folder / "cube.unv").write_text(cube(dataset(2467, lines), kind=118)))
    body = read_body(folder / "cube.unv")
    size = mesh_statistics(body)
    assert body.mesh.geometry.cmap.degree == 2
    assert size.volume == pytest.approx(1) and size.surfaces == pytest.approx({"foot": 1})


@pytest.mark.parametrize("order", [1, 2])
def test_what_gmsh_writes(folder: Path, order: int) -> None:
    """Order of nodes and groups by another program: a ball whose cells follow its surface."""

    def draw() -> None:
        with drawing() as gmsh:
            gmsh.model.occ.addSphere(0, 0, 0, 1)
            gmsh.model.occ.synchronize()
            gmsh.model.addPhysicalGroup(3, [1], name="ball")
            gmsh.model.addPhysicalGroup(2, [1], name="skin")
            gmsh.option.setNumber("Mesh.MeshSizeMax", 0.6)
            gmsh.model.mesh.generate(3)
            gmsh.model.mesh.setOrder(order)
            gmsh.write(str(folder / "ball.unv"))

    made(draw)
    size = mesh_statistics(read_body(folder / "ball.unv"))
    near = {1: 0.15, 2: 3e-3}[order]  # what straight and what quadratic cells of this size leave
    assert size.regions == {"ball": pytest.approx(4 / 3 * np.pi, rel=near)}
    assert size.surfaces == {"skin": pytest.approx(4 * np.pi, rel=near)}


def test_plane_meshes(folder: Path) -> None:
    square = np.array([[0, 0, 0], [2, 0, 0], [0, 1, 0], [2, 1, 0]], dtype=float)
    lines = element(1, 91, np.array([0, 1, 3])) + element(2, 91, np.array([0, 3, 2]))
    lines += element(3, 11, np.array([0, 2]))
    text = nodes(square) + dataset(2412, lines)
    text += dataset(2467, group(2467, 1, "left", [(8, 3)]))
    made(lambda: (folder / "square.unv").write_text(text))
    size = mesh_statistics(read_body(folder / "square.unv"))
    assert size.volume == pytest.approx(2) and size.surfaces == pytest.approx({"left": 1})


@pytest.mark.parametrize(
    ("factor", "name", "edge"),
    [(1e3, "mm", 1e-3), (39.370079, "in", 0.0254), (1.0, "m", 1.0), (0.4, "x 2.5 m", 2.5)],
)
def test_the_unit_of_the_file(folder: Path, factor: float, name: str, edge: float) -> None:
    """Lengths of the file over the factor of dataset 164 are metres."""
    numbers = f"{factor:25.16E}{1:25.16E}{1:25.16E}".replace("E", "D")
    text = dataset(164, ["         5mm (newton)                  2", numbers, "0.D+0"]) + cube()
    made(lambda: (folder / "cube.unv").write_text(text))
    body = read_body(folder / "cube.unv")
    assert body.unit.name == name and body.unit.stated
    assert mesh_statistics(body).volume == pytest.approx(edge**3)
    other = read_body(folder / "cube.unv", scale=1e-2)
    assert mesh_statistics(other).volume == pytest.approx(1e-6)
    assert any(
        f"its lengths are in {name}, mesh.unit that they are in cm" in n for n in other.notes
    )
    assert read_body(folder / "cube.unv", scale=edge).notes == ()


FAULTS = {
    "none": ("hello\n", "no universal file"),
    "no end": (cube()[:-8], r"cube\.unv:20: the last dataset has no end"),
    "no nodes": (dataset(2412, element(1, 111, CELLS[0])), "there are no nodes"),
    "no number": ("    -1\nnodes\n    -1\n", r"cube\.unv:2: a dataset has no number"),
    "words": (cube().replace("        91", "  triangle", 1), "'TRIANGLE' is no number"),
    "range": (cube().replace("        71        81", "        71      9991", 1), "9991"),
    "cut node": (dataset(2411, ["         1         1         1         1"]), "cut short"),
    "cut cell": (cube() + dataset(2412, ["  1 111 1 1 7 4", "11 21"]), "element 1 is cut short"),
    "cut group": (
        cube() + dataset(2467, ["1 0 0 0 0 0 0 9", "foot", "8 101 0 0"]),
        "'foot'",
    ),
    "cylinder": (nodes(POINTS, 781).replace("         1", "         3"), "coordinate system 3"),
    "factor": (cube() + dataset(164, ["1 SI", "0.D+0 1. 1."]), "factor of length is 0"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_name_the_line(folder: Path, fault: str) -> None:
    text, said = FAULTS[fault]
    made(lambda: (folder / "cube.unv").write_text(text))
    with pytest.raises(MeshError, match=said) as caught:
        read_body(folder / "cube.unv")
    assert str(caught.value).startswith("cube.unv:")


def test_damaged_files(folder: Path) -> None:
    """Cut at many places, and with bytes changed: read, or a MeshError, never anything else."""
    bad = folder / "bad.unv"
    whole = cube(dataset(2467, group(2467, 1, "foot", [(8, 101), (8, 102), (7, 11)]))).encode()

    def attempt() -> int:
        random, refused = np.random.default_rng(1), 0
        for i in range(160):
            data = bytearray(whole)
            if i % 2:
                data = data[: len(whole) * i // 160]
            else:
                at = int(random.integers(len(data) - 4))
                data[at : at + 4] = random.bytes(4)
            bad.write_bytes(bytes(data))
            try:
                read_unv(bad)
            except MeshError:
                refused += 1
        return refused

    assert on_root(COMM, attempt) >= 80
