"""Lines of decks and tables that were passed over, or made into other elements, without a word."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.mesh.formats.abaqus import read_abaqus
from dolfin_elastic.mesh.formats.nastran import read_nastran
from dolfin_elastic.mesh.formats.raw import MeshFile
from dolfin_elastic.mesh.formats.text.mfem import read_mfem
from dolfin_elastic.mesh.formats.text.tetgen import read_tetgen
from dolfin_elastic.mesh.read import check_file

POINTS = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1), (2, 0, 0)]
NODES = "*NODE\n" + "".join(f"{i},{x},{y},{z}\n" for i, (x, y, z) in enumerate(POINTS, 1))
TWO = "*ELEMENT, TYPE=C3D4\n1,1,2,3,4\n{}2,2,3,4,5\n"
GRIDS = "".join(f"GRID,{i},,{x}.,{y}.,{z}.\n" for i, (x, y, z) in enumerate(POINTS, 1))
MARK = b"\xef\xbb\xbf"
"""Of UTF-8, which editors of Windows put before the first line."""


def read(reader: Callable[[Path], MeshFile], path: Path, text: str, mark: bytes = b"") -> MeshFile:
    path.write_bytes(mark + text.encode())
    return reader(path)


def count(mesh: MeshFile) -> int:
    return sum(len(block.nodes) for block in mesh.blocks)


@pytest.mark.parametrize("comment", ["** more\n", "  ** more\n", "\t**\n", ""])
def test_comments_of_abaqus(tmp_path: Path, comment: str) -> None:
    """An indented one was a keyword, and the elements below it were gone."""
    text = NODES + TWO.format(comment)
    assert count(read(read_abaqus, tmp_path / "a.inp", text)) == 2
    assert count(read(read_abaqus, tmp_path / "b.inp", text, MARK)) == 2


@pytest.mark.parametrize(
    ("rows", "line"),
    [
        ("".join(f"{k},1,2,3,4,5,6,1,2,3,4\n" for k in range(1, 6)), 9),  # five of ten nodes
        ("1,1,2,3\n2,2,3,4,5,1\n", 10),
        ("1,1,2,3,4\n2,2,3,4\n", 10),
        ("1,1,2,3,4,\n2,2,3,4,5,3,3,3,4,6\n", 10),
    ],
)
def test_rows_of_another_length(tmp_path: Path, rows: str, line: int) -> None:
    """Numbers of several lines that happen to make rows made elements that the deck has not."""
    with pytest.raises(MeshError, match=f"a.inp:{line}.* do not make rows of 5"):
        read(read_abaqus, tmp_path / "a.inp", f"{NODES}*ELEMENT, TYPE=C3D4\n{rows}")


def test_rows_that_go_on(tmp_path: Path) -> None:
    """In further lines, with commas at their ends or without."""
    for rows in (
        "1,1,2,\n3,4\n2,2,3,4,5\n",
        "1,1,2\n3,4\n2,2,3,4,5,\n",
        "1,1,2,3,4,\n2,2,3,4,5,\n",
    ):
        mesh = read(read_abaqus, tmp_path / "a.inp", f"{NODES}*ELEMENT, TYPE=C3D4\n{rows}")
        assert count(mesh) == 2


def test_surfaces_without_elements(tmp_path: Path) -> None:
    """A rigid tool by lines and arcs made its file unreadable; now its name is incomplete."""
    more = "*SURFACE, TYPE=SEGMENTS, NAME=tool\nSTART, 0., 1.\nLINE, 2., 3.\n"
    mesh = read(read_abaqus, tmp_path / "a.inp", NODES + TWO.format("") + more)
    assert mesh.incomplete == {"tool": "TYPE=SEGMENTS is not read"}


def test_paths_of_windows(tmp_path: Path) -> None:
    """As Abaqus writes them there."""
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub/nodes.inp").write_text(NODES)
    text = "*INCLUDE, INPUT=sub\\nodes.inp\n" + TWO.format("")
    assert count(read(read_abaqus, tmp_path / "a.inp", text)) == 2


@pytest.mark.parametrize("word", ["INCLUDE", "  INCLUDE", "\tinclude"])
@pytest.mark.parametrize("mark", [b"", MARK])
def test_includes_of_nastran(tmp_path: Path, word: str, mark: bytes) -> None:
    """An indented one was an entry without a meaning, and half of the body was gone."""
    (tmp_path / "part.bdf").write_text("CTETRA,2,1,2,3,4,5\n")
    text = f"{word} 'part.bdf'\n{GRIDS}CTETRA,1,1,1,2,3,4\nENDDATA\n"
    assert count(read(read_nastran, tmp_path / "a.bdf", text, mark)) == 2


def test_entries_of_nastran_that_are_not_known(tmp_path: Path) -> None:
    """They are counted: one may be a misspelt element."""
    text = f"{GRIDS}CTETRA,1,1,1,2,3,4\nTETRA,2,1,2,3,4,5\nMAT1,1,2.+11,,.3\nPSOLID,1,1\nENDDATA\n"
    mesh = read(read_nastran, tmp_path / "a.bdf", text)
    assert mesh.information == ["unknown to the reader of meshes: 1 TETRA"]


def test_blank_fields_at_the_end_of_a_line(tmp_path: Path) -> None:
    """More commas than fields, with nothing behind them."""
    text = f"{GRIDS}CTETRA,1,1,1,2,3,4,,,,,\nENDDATA\n"
    assert count(read(read_nastran, tmp_path / "a.bdf", text)) == 1


def test_pointers_of_git(tmp_path: Path) -> None:
    """A file of a repository that was cloned without its large files."""
    (tmp_path / "a.inp").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:1\n")
    with pytest.raises(MeshError, match="a pointer of Git LFS, not the mesh; git lfs pull"):
        check_file(tmp_path / "a.inp")


def tetgen(folder: Path, elements: str, nodes: str = "") -> MeshFile:
    (folder / "a.ele").write_text(elements)
    rows = "".join(f"{i} {x} {y} {z} {i % 2}\n" for i, (x, y, z) in enumerate(POINTS, 1))
    return read(read_tetgen, folder / "a.node", nodes or f"6 3 0 1\n{rows}")


def test_tetgen(tmp_path: Path) -> None:
    """Regions by numbers between whole ones, which were all 0; markers of nodes are said."""
    mesh = tetgen(tmp_path, "2 4 1\n1 1 2 3 4 0.5\n2 2 3 4 5 0.75\n")
    assert {name: list(rows) for name, rows in mesh.blocks[0].parts.items()} == {
        "0.5": [0],
        "0.75": [1],
    }
    assert "markers of nodes are not read" in mesh.information[0]


@pytest.mark.parametrize(
    ("elements", "words"),
    [
        ("1 4 0\n1 1 2 3 4 5 6 5 6 5 6\n", "11 numbers, 5 after the first line"),
        ("1 4 0\n1 1 2 3 4.5\n", "4.5 is no number of a node"),
    ],
)
def test_tables_of_tetgen(tmp_path: Path, elements: str, words: str) -> None:
    """Ten nodes where the head says four were read as four."""
    with pytest.raises(MeshError, match=words):
        tetgen(tmp_path, elements)


def test_flat_vertices_of_mfem(tmp_path: Path) -> None:
    """They ended in an error of numpy."""
    text = "MFEM mesh v1.0\nelements\n1\n1 4 0 1 2 3\nvertices\n4\n2\n0 0\n1 0\n0 1\n1 1\n"
    with pytest.raises(MeshError, match="elements in space, but vertices of 2 coordinates"):
        read(read_mfem, tmp_path / "a.mesh", text)
