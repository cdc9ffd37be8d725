"""What readers do not understand of nodes, elements or coordinates is an error, with its line.

Each of these files was read without a part of its body, or in other coordinates, in silence.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest
from helpers.decks import box, inp_text

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.mesh import read_body

pytestmark = pytest.mark.usefixtures("serial_only")

POINTS, CELLS = box((1, 1, 1), (1, 1, 1))
MESH = meshio.Mesh(POINTS, [("tetra", CELLS)])


def text(path: Path, change: Callable[[str], str]) -> None:
    """Changes a text file."""
    before = path.read_text()
    assert change(before) != before
    path.write_text(change(before))


def written(path: Path, **how: object) -> Path:
    MESH.write(path, **how)
    return path


# --- Abaqus ---


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("*NODES\n90, 0., 0., 0.", r"a.inp:2: \*NODES: this keyword is not understood; did you "),
        ("*ELEMNT, TYPE=C3D4\n90, 1, 2, 3, 4", r"a.inp:2: \*ELEMNT: .* did you mean \*ELEMENT"),
        ("*NODE COPY\n1", r"a.inp:2: \*NODE COPY: this keyword is not understood"),
        ("*IMPERFECTION, FILE=a", r"a.inp:2: \*IMPERFECTION: this is not understood"),
        ("*PARAMETER\nx = 1", r"a.inp:2: \*PARAMETER: this is not understood"),
        ("*NODE, SYSTEM=S\n90, 1., 2., 3.", r"a.inp:2: \*NODE: SYSTEM=S is not understood"),
        ("*NODE, MOVED=1\n90, 1., 2., 3.", r"a.inp:2: \*NODE: MOVED is not understood; known: N"),
        ("*ELEMENT, TYPE=C3D4, OFFSET=5\n9, 1, 2, 3, 4", r"a.inp:2: \*ELEMENT: OFFSET is not und"),
        ("1, 2, 3, 4", "a.inp:2: numbers stand before the first keyword; for example"),
    ],
)
def test_abaqus(tmp_path: Path, lines: str, said: str) -> None:
    (tmp_path / "a.inp").write_text(f"** a comment\n{lines}\n" + inp_text(POINTS, CELLS, ""))
    with pytest.raises(MeshError, match=said):
        read_body(tmp_path / "a.inp")


def test_keywords_about_results(tmp_path: Path) -> None:
    lines = "*NODE FILE\nU\n*EL FILE\nS\n*ELEMENT OUTPUT\nS\n*NODE PRINT\nU\n*STATIC\n"
    (tmp_path / "a.inp").write_text(inp_text(POINTS, CELLS, lines))
    assert read_body(tmp_path / "a.inp").num_cells == 6


# --- universal files ---


def unv(elements: str, more: str = "") -> str:
    nodes = "\n".join(f"{i} 1 1 11\n {x[0]} {x[1]} {x[2]}" for i, x in enumerate(POINTS, start=1))
    return f"    -1\n  2411\n{nodes}\n    -1\n    -1\n  2412\n{elements}\n    -1\n{more}"


SOLIDS = "\n".join(
    f"{i} 111 1 1 7 4\n{' '.join(map(str, nodes + 1))}" for i, nodes in enumerate(CELLS, start=1)
)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (
            unv(SOLIDS + "\n50 117 1 1 7 5\n1 2 3 4 5"),
            "a.unv:22: 1 elements of the type 117 with",
        ),
        (unv(SOLIDS + "\n50 111 1 1 7 3\n1 2 3"), "1 elements of the type 111 with 3 nodes, such "),
        (unv(SOLIDS, "    -1\n    71\n1 1\n    -1\n"), "a.unv:.*: dataset 71: elements of this"),
        (unv(SOLIDS, "50 111 1 1 7 4\n1 2 3 5\n"), "a.unv:.*: '50 111 1 1 7 4' stands outside"),
    ],
)
def test_unv(tmp_path: Path, content: str, said: str) -> None:
    (tmp_path / "a.unv").write_text(content)
    with pytest.raises(MeshError, match=said):
        read_body(tmp_path / "a.unv")


def test_springs_of_unv(tmp_path: Path) -> None:
    """They are no part of the body: left out, with a note."""
    (tmp_path / "a.unv").write_text(unv(SOLIDS + "\n50 136 1 1 7 2\n1 2"))
    assert any(
        "elements left out: 1 of type 136" in note for note in read_body(tmp_path / "a.unv").notes
    )


# --- Gmsh ---


def short(name: str, by: int) -> Callable[[str], str]:
    """States fewer rows than a section has."""

    def change(content: str) -> str:
        return re.sub(
            rf"(\${name}\n)(\d+)\n", lambda found: f"{found[1]}{int(found[2]) - by}\n", content
        )

    return change


def doubled(name: str) -> Callable[[str], str]:
    def change(content: str) -> str:
        start, end = content.index(f"${name}"), content.index(f"$End{name}") + len(f"$End{name}\n")
        return content + content[start:end]

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (short("Elements", 2), r"a.msh: section \$Elements holds more than the numbers"),
        (short("Nodes", 1), r"a.msh: section \$Nodes holds more than the numbers"),
        (doubled("Elements"), r"a.msh: there are 2 sections \$Elements"),
        (doubled("Nodes"), r"a.msh: there are 2 sections \$Nodes"),
    ],
)
def test_gmsh(tmp_path: Path, change: Callable[[str], str], said: str) -> None:
    path = written(tmp_path / "a.msh", file_format="gmsh22", binary=False)
    text(path, change)
    with pytest.raises(MeshError, match=said):
        read_body(path)


# --- what meshio reads ---


@pytest.mark.parametrize("system", [1, 2])
def test_med(tmp_path: Path, system: int) -> None:
    """Cylindrical and spherical coordinates."""
    path = written(tmp_path / "a.med")
    assert read_body(path).num_cells == 6
    with h5py.File(path, "r+") as file:
        file["ENS_MAA/mesh"].attrs["REP"] = system
    with pytest.raises(MeshError, match=rf"a.med: its coordinates are .* \(REP = {system}\)"):
        read_body(path)


def test_binary_medit(tmp_path: Path) -> None:
    """A section of elements that meshio does not know, which it says where nobody reads it."""
    path = written(tmp_path / "a.meshb")
    assert read_body(path).num_cells == 6
    content = path.read_bytes()
    end = np.array([54], "i4").tobytes() + bytes(8)
    assert content.endswith(end)
    # GmfTetrahedraP2: where the next section begins, how many, ten nodes and a reference of one.
    at = len(content) - len(end) + 4 + 8 + 8 + 88
    more = np.array([30], "i4").tobytes() + np.array([at, 1, *range(1, 12)], "i8").tobytes()
    path.write_bytes(content[: -len(end)] + more + end)
    with pytest.raises(MeshError, match=r"a.meshb: meshio leaves a part of it out: .*Tetrahedra"):
        read_body(path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: re.sub(r"CELL_TYPES 6\n", "CELL_TYPES 5\n", t), "a.vtk"),
        (lambda t: re.sub(r"CELLS 6 30\n", "CELLS 6 25\n", t), "a.vtk"),
        (lambda t: t.replace("\n10\n", "\nten\n", 1), "a.vtk"),
        (lambda t: re.sub(r"(CELLS 6 30\n(?:.*\n){3})", r"\1word\n", t), "a.vtk"),
        (lambda t: t + "\nDATASET UNSTRUCTURED_GRID\n", "a.vtk: it has several grids"),
    ],
)
def test_legacy_vtk(tmp_path: Path, change: Callable[[str], str], said: str) -> None:
    points = "\n".join(" ".join(map(str, x)) for x in POINTS)
    cells = "\n".join(" ".join(map(str, (4, *nodes))) for nodes in CELLS)
    types = "10\n" * len(CELLS)
    head = "# vtk DataFile Version 4.2\na\nASCII\nDATASET UNSTRUCTURED_GRID\n"
    content = f"{head}POINTS {len(POINTS)} double\n{points}\nCELLS 6 30\n{cells}\n"
    (tmp_path / "a.vtk").write_text(f"{content}CELL_TYPES 6\n{types}")
    assert read_body(tmp_path / "a.vtk").num_cells == 6
    text(tmp_path / "a.vtk", change)
    with pytest.raises(MeshError, match=said):
        read_body(tmp_path / "a.vtk")


def test_zones(tmp_path: Path) -> None:
    """Tecplot, SU2 and CGNS: of several zones the first was read."""
    path = written(tmp_path / "a.dat", file_format="tecplot")
    assert read_body(path).num_cells == 6
    text(path, lambda t: t + t[t.index("ZONE") :])
    with pytest.raises(MeshError, match=r"a.dat:\d+: a second ZONE is not read; one zone"):
        read_body(path)
    path = written(tmp_path / "a.su2")
    text(path, lambda t: "NZONE= 2\n" + t)
    with pytest.raises(MeshError, match=r"a.su2:1: several zones are not read"):
        read_body(path)
    path = written(tmp_path / "a.cgns")
    assert read_body(path).num_cells == 6
    with h5py.File(path, "r+") as file:
        file.copy("Base/Zone1", "Base/Zone2")
    with pytest.raises(MeshError, match="a.cgns: it has 2 zones with 1 sections of elements"):
        read_body(path)
    with h5py.File(path, "r+") as file:
        file.move("Base", "block")
    with pytest.raises(MeshError, match="this layout of CGNS is not read: .*; save the mesh in"):
        read_body(path)
    path.write_bytes(b"@(#)ADF Database Version B02012>")
    with pytest.raises(MeshError, match="a.cgns: it is no HDF5 file; .* adf2hdf converts ADF"):
        read_body(path)


def test_quadratic_elements_of_medit(tmp_path: Path) -> None:
    """As Gmsh writes them."""
    path = tmp_path / "a.mesh"
    path.write_text("MeshVersionFormatted 2\n Tetrahedra\n 1\n 1 2 3 4 5 6 7 8 9 10 1\n End\n")
    with pytest.raises(MeshError, match="a.mesh: its Tetrahedra have 10 nodes each; linear"):
        read_body(path)


@pytest.mark.parametrize("key", ["BaseOffset", "Order"])
def test_topologies_of_xdmf(tmp_path: Path, key: str) -> None:
    path = written(tmp_path / "a.xdmf")
    text(path, lambda t: t.replace("<Topology ", f'<Topology {key}="1" '))
    with pytest.raises(MeshError, match=f"a.xdmf: a Topology with {key} = '1' is not understood"):
        read_body(path)
