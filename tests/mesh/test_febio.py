"""FEBio files: parts, sets and surfaces by name, of all specifications that are read."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from helpers.decks import COMM, box, made, quadratic
from helpers.febio_text import febio_text

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.mesh import mesh_statistics, read_body
from dolfin_elastic.mesh.formats.febio import read_febio

POINTS, CELLS = box((2, 1, 1), (2, 1, 1))


def side(points: AnyArray, cells: AnyArray, x: float) -> AnyArray:
    """Facets at x, with midside nodes of quadratic cells in the order of FEBio."""
    middle = {(0, 1): 4, (1, 2): 5, (0, 2): 6, (0, 3): 7, (1, 3): 8, (2, 3): 9}
    found = []
    for cell in cells:
        for three in ((0, 1, 2), (0, 1, 3), (1, 2, 3), (0, 2, 3)):
            if (points[cell[list(three)], 0] == x).all():
                a, b, c = three
                more = [middle[a, b], middle[b, c], middle[a, c]] if len(cell) == 10 else []
                found.append(cell[[*three, *more]])
    return np.array(found)


def two_parts(points: AnyArray, cells: AnyArray, version: str, more: str = "") -> str:
    left = points[cells[:, :4], 0].mean(axis=1) < 1
    return febio_text(
        points,
        {"soft": cells[left], "hard": cells[~left]},
        sets={"wall": np.flatnonzero(points[:, 0] == 0), "corner": np.array([0])},
        surfaces={"end": side(points, cells, 2.0), "wall": side(points, cells, 0.0)},
        version=version,
        more=more,
    )


@pytest.mark.parametrize("version", ["2.0", "2.5", "3.0", "4.0"])
@pytest.mark.parametrize("nodes", [4, 10])
def test_names_of_parts_sets_and_surfaces(folder: Path, version: str, nodes: int) -> None:
    """Nodes where they are; quadratic cells in any other order would fold."""
    points, cells = quadratic(POINTS, CELLS) if nodes == 10 else (POINTS, CELLS)
    made(lambda: (folder / "a.feb").write_text(two_parts(points, cells, version)))
    assert np.array_equal(read_febio(folder / "a.feb").points, points)
    body = read_body(folder / "a.feb")
    size = mesh_statistics(body)
    assert size.volume == pytest.approx(2, rel=1e-14)
    assert size.regions == pytest.approx({"soft": 1, "hard": 1}, rel=1e-14)
    assert size.surfaces == pytest.approx({"end": 1, "wall": 1}, rel=1e-14)
    assert COMM.allreduce(len(body.owned_points("corner"))) == 1
    assert body.mesh.geometry.cmap.degree == (2 if nodes == 10 else 1)
    assert body.notes == ()


def test_element_sets_ranges_and_numbers_of_nodes(tmp_path: Path) -> None:
    text = febio_text(POINTS, {"all": CELLS}, sets={}).replace(
        "</Elements>",
        '</Elements>\n<ElementSet name="few">1:5:2, 12</ElementSet>\n'
        '<NodeSet name="gone">1, 99</NodeSet>',
    )
    text = text.replace('<node id="12">', '<node id="700">').replace("12,", "700,")
    text = text.replace(",12<", ",700<").replace(",12,", ",700,").replace("2, 700", "2, 12")
    (tmp_path / "a.feb").write_text(text)
    found = read_febio(tmp_path / "a.feb")
    assert found.blocks[0].parts["few"].tolist() == [0, 2, 4, 11]
    assert found.incomplete == {"gone": "1 of its 2 nodes do not exist in the file, for example 99"}


def test_sections_of_other_files(tmp_path: Path) -> None:
    (tmp_path / "mesh.feb").write_text(two_parts(POINTS, CELLS, "4.0"))
    for section in ('<Mesh from="mesh.feb"/>', "<Include>mesh.feb</Include>"):
        (tmp_path / "a.feb").write_text(f'<febio_spec version="4.0">{section}</febio_spec>')
        assert len(read_febio(tmp_path / "a.feb").points) == len(POINTS)


WHOLE = two_parts(POINTS, CELLS, "4.0")
FAULTS = {
    "hexahedra": (
        WHOLE.replace(
            "<Elements",
            '<Elements type="hex8" name="h">\n<elem id="9">1,2,3,4,5,6,7,8</elem>\n</Elements>\n'
            '<Elements type="tet15" name="t">\n<elem id="10">1</elem>\n</Elements>\n<Elements',
            1,
        ),
        r"a.feb:19: elements other than tetrahedra are not supported: 1 hex8 \(line 19\), 1 tet15 "
        r"\(line 22\); the part meshed with tet4 or tet10",
    ),
    "no node": (WHOLE.replace('<elem id="1">1,', '<elem id="1">77,'), "a.feb:20: there is no n"),
    "short row": (WHOLE.replace('<elem id="1">1,', '<elem id="1">'), "a.feb:20: 3 numbers, not 4"),
    "no number": (WHOLE.replace('<node id="1">0', '<node id="1">x'), "'x.0,0.0,0.0' are no numb"),
    "no id": (WHOLE.replace('<node id="1">', '<node id="one">'), 'a.feb:6: id="one" is no whole'),
    "twice": (WHOLE.replace('<node id="2">', '<node id="1">'), "the node 1 stands twice"),
    "infinite": (WHOLE.replace('<node id="1">0.0', '<node id="1">nan'), "the node 1 are not fini"),
    "instance": (WHOLE.replace("</Mesh>", '<Part name="p"/></Mesh>'), "<Part> is not read"),
    "cut": (WHOLE[: len(WHOLE) // 2], "the XML file is damaged: "),
    "other": ("<html/>", "this is no FEBio file of the specifications 2.0, .*: <html>"),
    "old": ('<febio_spec version="1.2"/>', "2.5, 3.0, 4.0: version 1.2; the model saved anew"),
    "range": (WHOLE.replace(">1</NodeSet>", ">1:9999999999</NodeSet>"), "more nodes or elements t"),
    "nothing": ('<febio_spec version="4.0"/>', "the FEBio file has no nodes"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_not_understood(tmp_path: Path, fault: str) -> None:
    text, said = FAULTS[fault]
    (tmp_path / "a.feb").write_text(text)
    with pytest.raises(MeshError, match=said):
        read_febio(tmp_path / "a.feb")


BOMB = (
    '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;">]>\n'
    '<febio_spec version="4.0">&b;</febio_spec>'
)
HOSTILE = {
    "entities": (BOMB, "definitions of entities"),
    "outer file": (BOMB.replace('"ha"', 'SYSTEM "file:///etc/passwd"'), "definitions of entities"),
    "deep": ('<febio_spec version="4.0">' + "<a>" * 10**5, "<a> stands too deep"),
    "above": (
        '<febio_spec version="4.0"><Mesh from="../b.feb"/></febio_spec>',
        "not in the folder",
    ),
    "root": ('<febio_spec version="4.0"><Include>/etc/passwd</Include></febio_spec>', "not in the"),
    "link": ('<febio_spec version="4.0"><Mesh from="link.feb"/></febio_spec>', "not in the folder"),
    "none": ('<febio_spec version="4.0"><Mesh from="none.feb"/></febio_spec>', "no included file"),
    "itself": ('<febio_spec version="4.0"><Mesh from="a.feb"/></febio_spec>', "includes another"),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_files_of_strangers(tmp_path: Path, kind: str) -> None:
    text, said = HOSTILE[kind]
    (tmp_path / "link.feb").symlink_to("/etc/passwd")
    (tmp_path / "a.feb").write_text(text)
    with pytest.raises(MeshError, match=said):
        read_febio(tmp_path / "a.feb")


def test_memory(tmp_path: Path) -> None:
    """Less than the 1 kB a cell that readers may take; a tree of the standard library takes it."""
    points, cells = box((10, 10, 10), (10, 10, 10))
    (tmp_path / "a.feb").write_text(febio_text(points, {"all": cells}))
    tracemalloc.start()
    try:
        read_febio(tmp_path / "a.feb")
        assert tracemalloc.get_traced_memory()[1] < 500 * len(cells)
    finally:
        tracemalloc.stop()
