"""Meshes as plain text: TetGen and MFEM."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.decks import box, made, quadratic

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.mesh import mesh_statistics, read_body
from dolfin_elastic.mesh.formats.text.mfem import read_mfem
from dolfin_elastic.mesh.formats.text.tetgen import read_tetgen

POINTS, CELLS = box((2, 1, 1), (2, 1, 1))
EDGES = [(2, 3), (0, 3), (0, 1), (1, 2), (1, 3), (0, 2)]
"""Ends of the edges in an order of midside nodes that is not that of VTK."""


def low(cells: AnyArray, points: AnyArray) -> list[AnyArray]:
    """Triangles at z = 0."""
    faces = [np.delete(cell[:4], j) for cell in cells for j in range(4)]
    return [face for face in faces if not points[face, 2].any()]


def rows(*tables: AnyArray) -> str:
    columns = [table.reshape(len(tables[0]), -1).tolist() for table in tables]
    lines = zip(*columns, strict=True)
    return "\n".join(" ".join(f"{x:.17g}" for part in line for x in part) for line in lines)


def tetgen(folder: Path, order: int, first: int) -> None:
    points, cells = (POINTS, CELLS) if order == 1 else quadratic(POINTS, CELLS)
    number = first + np.arange(len(points))
    parts = np.where(points[cells[:, :4], 0].mean(axis=1) < 1, 3, 7)
    faces = np.array(low(cells, points))
    if order == 2:
        middle = {tuple(x): i for i, x in enumerate(points.tolist())}
        own = [
            [middle[tuple(points[list(c[[a, b]])].mean(axis=0).tolist())] for a, b in EDGES]
            for c in cells
        ]
        cells = np.concatenate([cells[:, :4], own], axis=1)
        faces = np.concatenate([faces, faces], axis=1)  # nodes that nobody looks at
    (folder / "a.1.node").write_text(
        f"# made by hand\n{len(points)} 3 1 0\n\n{rows(number, points, points[:, 0])}\n"
    )
    count = np.arange(len(cells))
    (folder / "a.1.ele").write_text(
        f"{len(cells)} {cells.shape[1]} 1\n{rows(count, cells + first, parts)}\n# end\n"
    )
    marks = np.full(len(faces), 5)
    (folder / "a.1.face").write_text(f"{len(faces)} 1\n{rows(marks, faces + first, marks)}\n")


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("first", [0, 1])
def test_tetgen(folder: Path, order: int, first: int) -> None:
    """Markers of faces were left out, and ten nodes refused; in another order elements fold."""
    made(lambda: tetgen(folder, order, first))
    body = read_body(folder / "a.1.ele")
    size = mesh_statistics(body)
    assert size.volume == pytest.approx(2, rel=1e-14) and body.notes == ()
    assert size.regions == pytest.approx({"3": 1, "7": 1})
    assert size.surfaces == pytest.approx({"5": 2})
    assert body.mesh.geometry.cmap.degree == order
    found = read_tetgen(folder / "a.1.node")
    assert np.array_equal(found.point_data["tetgen:attr1"][:, 0], found.points[:, 0])


@pytest.mark.parametrize(
    ("suffix", "old", "new", "said"),
    [
        (".ele", "12 4 1", "13 4 1", r"a\.1\.ele:14: the file is cut short"),
        (".ele", "12 4 1", "12 6 1", r"a\.1\.ele:1: elements of 6 nodes are not read"),
        (".node", " 3 1 0", " 1 1 0", r"a\.1\.node:2: nodes in 1 dimensions are not read"),
        (".node", "12 3", "-2 3", r"a\.1\.node:2: -2 is no number of lines"),
        (".node", "\n1 1 0 0 1", "\n1 1 x 0 1", r"a\.1\.node:5: '1 1 x 0 1' are no numbers"),
        (".node", "\n1 1 0 0 1", "\n1 1 0 1", r"a\.1\.node:5: the line has 4 numbers"),
        (".node", "\n1 1 0 0 1", "\n0 1 0 0 1", "a node stands twice"),
        (".ele", "12 4 1", "12 10 1", "the lines have 6 numbers, 12 are needed"),
        (".face", "4 1\n", "4 1 1\n4 1\n", "the line has 5 numbers, those before 2"),
    ],
)
def test_faults_of_tetgen(tmp_path: Path, suffix: str, old: str, new: str, said: str) -> None:
    tetgen(tmp_path, 1, 0)
    path = tmp_path / f"a.1{suffix}"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(MeshError, match=said):
        read_tetgen(path)


FLAT = "4 2 0 1\n1 0 0 1\n2 3 0 1\n3 3 2 1\n4 0 2 1\n"
MIDDLES = "10 1.5 1 0\n11 1.5 0 1\n12 3 1 1\n13 1.5 2 1\n14 0 1 1\n"
TRIANGLES = {3: "1 1 2 3 8\n2 1 3 4 9\n", 6: "1 1 2 3 12 10 11 8\n2 1 3 4 13 14 10 9\n"}
SIDES = {".edge": "2 1\n1 4 1 5\n2 2 3 0\n", ".poly": "1 2 0 0\n7 0 0\n1 1\n1 4 1 5\n0\n"}


@pytest.mark.parametrize("corners", [3, 6])
@pytest.mark.parametrize("suffix", SIDES)
def test_triangle(tmp_path: Path, corners: int, suffix: str) -> None:
    """Meshes of Triangle were refused: nodes in 2 dimensions. Midside nodes face corners."""
    nodes = FLAT if corners == 3 else FLAT.replace("4 2", "9 2", 1) + MIDDLES
    (tmp_path / "a.node").write_text(nodes)
    (tmp_path / "a.ele").write_text(f"2 {corners} 1\n{TRIANGLES[corners]}")
    (tmp_path / f"a{suffix}").write_text(SIDES[suffix])
    body = read_body(tmp_path / "a.node")
    size = mesh_statistics(body)
    assert size.volume == pytest.approx(6, rel=1e-14) and body.notes == ()
    assert size.regions == pytest.approx({"8": 3, "9": 3})
    assert size.surfaces == pytest.approx({"5": 2})
    assert body.mesh.geometry.cmap.degree == corners // 3
    assert "those of facets (.edge) name surfaces" in body.information[0]


def test_facets_without_markers(tmp_path: Path) -> None:
    """A file of no facets was refused; a marker of which the head knows nothing, too."""
    tetgen(tmp_path, 1, 0)
    faces = tmp_path / "a.1.face"
    faces.write_text(faces.read_text().replace(" 1\n", " 0\n", 1))
    assert mesh_statistics(read_body(tmp_path / "a.1.node")).surfaces == pytest.approx({"5": 2})
    faces.write_text("0 1\n")
    assert mesh_statistics(read_body(tmp_path / "a.1.node")).surfaces == {}


def test_elements_of_tetgen_are_missing(tmp_path: Path) -> None:
    """It was advised to save the mesh anew, for nodes without elements."""
    (tmp_path / "a.node").write_text(FLAT)
    with pytest.raises(MeshError, match=r"a\.ele' beside it; nodes \(\.node\) and elements"):
        read_tetgen(tmp_path / "a.node")


def mfem(version: str = "v1.0") -> str:
    parts = np.where(POINTS[CELLS, 0].mean(axis=1) < 1, 3, 7)
    faces = np.array(low(CELLS, POINTS))
    four, two, five = np.full(len(CELLS), 4), np.full(len(faces), 2), np.full(len(faces), 5)
    return (
        f"MFEM mesh {version}\n\n# made by hand\ndimension\n3\n\n"
        f"elements\n{len(CELLS)}\n{rows(parts, four, CELLS)}\n\n"
        f"boundary\n{len(faces)}\n{rows(five, two, faces)}\n\n"
        f"vertices\n{len(POINTS)}\n3\n{rows(POINTS)}\n"
    )


def test_mfem(folder: Path) -> None:
    """They were taken for files of Medit, with which they share the suffix."""
    made(lambda: (folder / "a.mesh").write_text(mfem()))
    size = mesh_statistics(read_body(folder / "a.mesh"))
    assert size.volume == pytest.approx(2, rel=1e-14)
    assert size.regions == pytest.approx({"3": 1, "7": 1})
    assert size.surfaces == pytest.approx({"5": 2})


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("mesh v1.0", "NC mesh v1.0", "a.mesh:1: 'MFEM NC mesh v1.0' is not read"),
        ("\n3\n0 0 0", "\nnodes\nFiniteElementSpace", "curved elements are not read"),
        ("boundary", "vertex_parents", "a.mesh:22: the section 'vertex_parents' is not read"),
        ("\n3 4 0", "\n3 5 0", "is no element"),
        ("\n3\n0 0 0", "\n2\n0 0 0", "vertices of 3 coordinates, not 2"),
        ("\n12\n", "\n99\n", "are no whole numbers"),
    ],
)
def test_faults_of_mfem(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in mfem()
    (tmp_path / "a.mesh").write_text(mfem().replace(old, new, 1))
    with pytest.raises(MeshError, match=said):
        read_mfem(tmp_path / "a.mesh")
