"""Nastran bulk data in every format, with coordinate systems and included files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from helpers.decks import box, quadratic
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.mesh import mesh_statistics, read_body
from dolfin_elastic.mesh.formats.cad.process import Permission
from dolfin_elastic.mesh.formats.nastran import read_nastran
from dolfin_elastic.mesh.read import reader

COMM = MPI.COMM_WORLD
POINTS, CELLS = box((3, 2, 1), (3, 2, 1))


def made(action: Callable[[], object]) -> None:
    """Makes files on rank 0 while the others wait."""
    on_root(COMM, lambda: action() and None)


def small(name: str, *fields: object) -> str:
    """An entry in small field format, its continuations marked by blanks."""
    words, lines = [str(field) for field in fields], []
    for at in range(0, max(len(words), 1), 8):
        head = name if at == 0 else ""
        lines.append(f"{head:<8}" + "".join(f"{word:>8.8}" for word in words[at : at + 8]))
    return "\n".join(lines)


def large(name: str, *fields: object) -> str:
    words, lines = [str(field) for field in fields], []
    for at in range(0, max(len(words), 1), 4):
        head = f"{name}*" if at == 0 else "*"
        lines.append(f"{head:<8}" + "".join(f"{word:>16.16}" for word in words[at : at + 4]))
    return "\n".join(lines)


def free(name: str, *fields: object) -> str:
    words, lines = [str(field) for field in fields], []
    for at in range(0, max(len(words), 1), 8):
        lines.append(",".join([name if at == 0 else "+", *words[at : at + 8]]))
    return "\n".join(lines)


def marked(name: str, *fields: object) -> str:
    """Small fields with marks of continuations, as old preprocessors write them."""
    lines = small(name, *fields).splitlines()
    for i in range(1, len(lines)):
        lines[i - 1] = f"{lines[i - 1]:<72}+E{i}"
        lines[i] = f"+E{i}".ljust(8) + lines[i][8:]
    return "\n".join(lines)


def exponents(x: float) -> str:
    """A number as Nastran abbreviates it: 1.5-3."""
    digits, power = f"{x:.3e}".split("e")
    return f"{digits}{int(power):+d}"


def deck(
    points: AnyArray = POINTS,
    cells: AnyArray = CELLS,
    *,
    form: Callable[..., str] = small,
    system: object = "",
    number: Callable[[float], object] = lambda x: f"{x:.6g}.".replace("..", "."),
    before: Sequence[str] = (),
) -> str:
    parts = np.where(points[cells[:, :4], 0].mean(axis=1) < 1.0, 1, 7)
    grids = [form("GRID", i, system, *map(number, x)) for i, x in enumerate(points, start=1)]
    solids = [
        form("CTETRA", i, part, *(nodes + 1))
        for i, (part, nodes) in enumerate(zip(parts, cells, strict=True), start=1)
    ]
    return "\n".join(["SOL 101", "CEND", "BEGIN BULK", *before, *grids, *solids, "ENDDATA", ""])


@pytest.mark.parametrize("cells", ["linear", "quadratic"])
@pytest.mark.parametrize("form", [small, large, free, marked])
def test_field_formats(folder: Path, form: Callable[..., str], cells: str) -> None:
    """Continuations that begin with blanks were lost: the body was "a surface in space"."""
    points, nodes = (POINTS, CELLS) if cells == "linear" else quadratic(POINTS, CELLS)
    text = deck(points, nodes, form=form, number=lambda x: f"{x:.4f}")
    made(lambda: (folder / "a.bdf").write_text(text))
    body = read_body(folder / "a.bdf")
    size = mesh_statistics(body)
    assert size.cells == len(CELLS) and size.volume == pytest.approx(6, rel=1e-14)
    assert size.regions == pytest.approx({"1": 2, "7": 4}) and not body.notes
    assert body.mesh.geometry.cmap.degree == (1 if cells == "linear" else 2)


@pytest.mark.parametrize("suffix", [".bdf", ".nas", ".fem", ".dat"])
def test_other_ways_to_write(tmp_path: Path, suffix: str) -> None:
    """No control sections as Gmsh does, comments, small letters, tabs, exponents without E."""
    bulk = deck(number=exponents, form=small).partition("BEGIN BULK\n")[2]
    bulk = "$ a comment\n" + bulk.replace("GRID    ", "grid\t").replace(
        "\nCT", "$ more\n\n$\nCT", 1
    )
    (tmp_path / f"a{suffix}").write_text(bulk)
    found = reader(tmp_path / f"a{suffix}", pytest.fail, Permission(False, 1.0))[0]()
    assert np.array_equal(found.points, POINTS) and len(found.blocks[0].nodes) == len(CELLS)


# --- coordinate systems ---


def frame(origin: Sequence[float], z: Sequence[float], x: Sequence[float]) -> tuple[AnyArray, ...]:
    """A, B, C of a system and its axes, by other formulas: C is not on the x axis itself."""
    e3 = np.array(z) / np.linalg.norm(z)
    e1 = np.array(x) - np.dot(x, e3) * e3
    e1 /= np.linalg.norm(e1)
    a = np.array(origin, dtype=float)
    return a, a + 3 * e3, a + 2 * e1 + 0.7 * e3, np.stack([e1, np.cross(e3, e1), e3], axis=1)


def inverse(kind: str, local: AnyArray) -> AnyArray:
    """Rectangular coordinates as those of a kind of system, angles in degrees."""
    x, y, z = local.T
    if kind == "R":
        return local
    angle, r = np.degrees(np.arctan2(y, x)), np.hypot(x, y)
    if kind == "C":
        return np.stack([r, angle, z], axis=1)
    return np.stack([np.hypot(r, z), np.degrees(np.arctan2(r, z)), angle], axis=1)


def full(x: float) -> str:
    return f"{x:.17g}"


@pytest.mark.parametrize("kind", ["R", "C", "S"])
def test_systems(tmp_path: Path, kind: str) -> None:
    """GRID in a system of its own: coordinates were taken as rectangular ones, whatever it is.

    To round-off: 17 digits are written, and the angles go through one sine and cosine.
    """
    a, b, c, axes = frame((1, -2, 3), (1, 2, -2), (0, 1, 1))
    local = inverse(kind, (POINTS - a) @ axes)
    system = free(f"CORD2{kind}", 12, 0, *map(full, (*a, *b, *c)))
    (tmp_path / "a.bdf").write_text(deck(local, form=free, number=full, system=12, before=[system]))
    assert np.abs(read_nastran(tmp_path / "a.bdf").points - POINTS).max() < 2e-15 * 10


@pytest.mark.parametrize("outer", ["R", "C", "S"])
@pytest.mark.parametrize("inner", ["R", "C", "S"])
def test_chains_of_systems(tmp_path: Path, outer: str, inner: str) -> None:
    """A system whose three points are given in another one, which stands below it in the file."""
    a, b, c, axes = frame((1, -2, 3), (1, 2, -2), (0, 1, 1))
    e, f, g, others = frame((0.5, 1, 1), (-1, 0, 2), (3, 1, 0))
    three = inverse(outer, (np.array([e, f, g]) - a) @ axes)
    local = inverse(inner, (POINTS - e) @ others)
    systems = [
        free(f"CORD2{inner}", 5, 4, *map(full, three.ravel())),
        free(f"CORD2{outer}", 4, "", *map(full, (*a, *b, *c))),
    ]
    text = deck(local, form=free, number=full, before=[free("GRDSET", "", 5), *systems])
    (tmp_path / "a.bdf").write_text(text)
    assert np.abs(read_nastran(tmp_path / "a.bdf").points - POINTS).max() < 2e-15 * 20


@pytest.mark.parametrize("kind", ["R", "C", "S"])
def test_systems_of_nodes(tmp_path: Path, kind: str) -> None:
    """CORD1: through three nodes, here of a cylindrical system; two systems in one entry."""
    a, b, c, axes = frame((1, -2, 3), (1, 2, -2), (0, 1, 1))
    e, f, g, others = frame((0.5, 1, 1), (-1, 0, 2), (3, 1, 0))
    nodes = inverse("C", (np.array([e, f, g]) - a) @ axes)
    grids = [free("GRID", 900 + i, 4, *map(full, x)) for i, x in enumerate(nodes)]
    before = [
        free(f"CORD1{kind}", 8, 900, 901, 902, 9, 902, 901, 900),
        free("CORD2C", 4, "", *map(full, (*a, *b, *c))),
        *grids,
    ]
    local = inverse(kind, (POINTS - e) @ others)
    text = deck(local, form=free, number=full, system=8, before=before)
    (tmp_path / "a.bdf").write_text(text)
    found = read_nastran(tmp_path / "a.bdf").points
    assert np.abs(found[: len(POINTS)] - POINTS).max() < 2e-15 * 20
    assert np.abs(found[len(POINTS) :] - [e, f, g]).max() < 2e-15 * 20


def test_a_ring_sector(folder: Path) -> None:
    """It was a box of 9000 with angles for lengths: a quarter of a ring of 16 straight pieces."""
    n = 16
    points, cells = box((1, 1, 1), (1, n, 1))
    x = points * [10, 90, 10] + [10, 0, 0]
    text = deck(x, cells, form=free, number=full, system=1)
    text = text.replace("BEGIN BULK", "BEGIN BULK\nCORD2C,1,0,0.,0.,0.,0.,0.,1.\n,1.,0.,0.")
    made(lambda: (folder / "ring.bdf").write_text(text))
    body = read_body(folder / "ring.bdf")
    # n trapezia with radii from 10 to 20: (20^2 - 10^2)/2 sin(pi/2n) each, 10 high.
    volume = n * (400 - 100) / 2 * np.sin(np.pi / 2 / n) * 10
    assert mesh_statistics(body).volume == pytest.approx(volume, rel=1e-13)


# --- included files ---


def test_included_files(folder: Path) -> None:
    """Half of the body was missing; names in two lines, in quotation marks, in another folder."""
    text = deck(form=free, number=full)
    head, _, rest = text.partition("BEGIN BULK\n")
    lines = rest.replace("ENDDATA\n", "").splitlines()

    def write() -> None:
        (folder / "parts").mkdir()
        top = "BEGIN BULK\nINCLUDE 'parts/\nnodes.bdf'\nInclude \"parts\\some.inc\"\n"
        (folder / "a.bdf").write_text(f"{head}INCLUDE parts/control\n{top}{lines[-1]}\nENDDATA\n")
        (folder / "parts/control").write_text("SET 1 = 4\n")
        nodes = [line for line in lines if line.startswith("GRID")]
        (folder / "parts/nodes.bdf").write_text("\n".join(nodes[:5]) + "\nINCLUDE 'more'")
        (folder / "parts/more").write_text("\n".join(nodes[5:]))
        (folder / "parts/some.inc").write_text("\n".join(lines[len(nodes) : -1]))

    made(write)
    assert mesh_statistics(read_body(folder / "a.bdf")).volume == pytest.approx(6, rel=1e-14)


def test_files_that_include_themselves(tmp_path: Path) -> None:
    (tmp_path / "a.bdf").write_text("INCLUDE 'a.bdf'\nENDDATA\n")
    with pytest.raises(MeshError, match=r"a.bdf: INCLUDE goes round in a circle"):
        read_nastran(tmp_path / "a.bdf")


# --- what is not understood ---


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("CORD3G,3,1,1", "a.bdf:4: CORD3G: this kind of coordinate system is not understood"),
        ("GRIDB,90,,,30.,,1", "a.bdf:4: GRIDB: this kind of node is not understood"),
        ("CTRIWING,9,1,1,2,3", "a.bdf:4: CTRIWING: this element is not understood"),
        ("CIHEX1,9,1,1,2,3", "a.bdf:4: CIHEX1: this element"),
        ("CSUPER,1,0,1,2", "a.bdf:4: CSUPER: a superelement is not understood"),
        ("CHEXA,9,1,1,2,3,4,5,6\n+,7,8", "a.bdf:4: CHEXA: this kind of element is not supp"),
        ("=,*1,=,=,*0.5", r"a.bdf:4: entries made by replication \(=\) are not understood"),
        ("GRID,99,77,0.,0.,0.", "a.bdf:4: GRID: there is no coordinate system 77; known: there"),
        ("GRID,99,,0.,zero,0.", "a.bdf:4: GRID: field 5 is 'zero', no number"),
        ("GRID,one,,0.,0.,0.", "a.bdf:4: GRID: field 2 is 'one', no whole number"),
        ("GRID,-1,,0.,0.,0.", "a.bdf:4: GRID: field 2 is '-1', no whole number"),
        ("GRID,1,,9.,9.,9.", "the node 1 stands twice"),
        ("GRID,99,,nan,0.,0.", "a.bdf:4: GRID: field 4 is 'nan', no number"),
        ("CTETRA,99,1,1,2,3,999", "a.bdf:4: CTETRA: there is no GRID 999"),
        ("CTETRA,99,1,1,2,3", "a.bdf:4: CTETRA: 1 of its 4 nodes are missing"),
        ("CTETRA,99,1,1,2,3,4,5,6\n+,7", "a.bdf:4: CTETRA: 3 of its 10 nodes are missing"),
        ("CTETRA,99,1,1,2,3,4,5,6,+A\n+B,7", "a.bdf:5: the continuation '\\+B' does not follow"),
        ("CTETRA,99,1,1,2,3,4,,,,,,7", "a.bdf:4: the line has 13 fields, more than 10"),
        ("INCLUDE 'nowhere.bdf'", "a.bdf:4: INCLUDE: there is no file 'nowhere.bdf'"),
        ("INCLUDE 'nowhere", "a.bdf:4: the name of the included file has no end"),
        ("BEGIN SUPER=1", "a.bdf:4: a second section of bulk data is not understood"),
        ("CORD2R,0,0,0.,0.,0.,0.,0.,1.\n+,1.,0.,0.", "the system 0 is the basic one"),
        ("CORD2R,1,0,0.,0.,0.,0.,0.,1.\n+,0.,0.,5.\nGRID,99,1", "CORD2R: .* lie on one line"),
        ("CORD2R,1,1,0.,0.,0.,0.,0.,1.\n+,1.,0.,0.\nGRID,99,1", "the coordinate system 1 is def"),
        ("CORD1R,1,99,1,2\nGRID,99,1", "the coordinate system 1 is defined by itself"),
        ("CORD1R,1,99,1,2\nGRID,98,1", "CORD1R: there is no GRID 99"),
        (
            "CORD2R,1,2,0.,0.,0.,0.,0.,1.\n+,1.,0.,0.\nCORD2R,2,1,0.,0.,0.,0.,0.,1.\n+,1.,0.,0.\n"
            "GRID,99,1",
            "is defined by itself",
        ),
        ("CORD1R,1,1,2,3\nCORD1C,1,1,2,3", "the coordinate system 1 stands twice"),
    ],
)
def test_what_is_not_understood(tmp_path: Path, line: str, said: str) -> None:
    """An error with its line, where meshio passed over it or failed by an IndexError."""
    (tmp_path / "a.bdf").write_text(deck(form=free, number=full, before=[line]))
    with pytest.raises(MeshError, match=said):
        read_nastran(tmp_path / "a.bdf")


def test_continuations_by_seven_letters(tmp_path: Path) -> None:
    """The + of a continuation stands for any letter of its line: P51 was taken for another one."""
    lines = ["CTETRA,99,1,1,2,3,4,,,P51", "+51,"]
    (tmp_path / "a.bdf").write_text(deck(form=free, number=full))
    count = len(read_nastran(tmp_path / "a.bdf").blocks[0].nodes)
    (tmp_path / "b.bdf").write_text(deck(form=free, number=full, before=lines))
    assert sum(len(b.nodes) for b in read_nastran(tmp_path / "b.bdf").blocks) == count + 1


@pytest.mark.parametrize("line", ["CAERO7,1,WING,,5,5,,1", "CAABSF,9,1,1,2,3"])
def test_what_is_no_element_of_a_body(tmp_path: Path, line: str) -> None:
    """Panels of air and absorbers of sound were elements that are not understood."""
    (tmp_path / "a.bdf").write_text(deck(form=free, number=full, before=[line]))
    assert line[:6] in " ".join(read_nastran(tmp_path / "a.bdf").information)


@pytest.mark.parametrize("cut", [0.3, 0.5, 0.8, 0.95])
def test_files_cut_short(tmp_path: Path, cut: float) -> None:
    """Also between two lines, where nothing else is missing."""
    lines = deck().splitlines()
    (tmp_path / "a.bdf").write_text("\n".join(lines[: int(cut * len(lines))]))
    with pytest.raises(
        MeshError, match=r"a.bdf:\d+: there is no ENDDATA: the file may be cut short"
    ):
        read_nastran(tmp_path / "a.bdf")


def test_what_is_beside_the_body(folder: Path) -> None:
    """Shells that name a face, beams, masses and rigid connections: told, as of other formats."""
    low = np.flatnonzero(POINTS[:, 2] == 0) + 1
    shells = [
        free("CTRIA3", 700 + i, 30, *(face[j] for j in (0, 1, 2)))
        for i, nodes in enumerate(CELLS + 1)
        if len(face := [n for n in nodes if n in low]) == 3
    ]
    others = [
        free("CBAR", 800, 31, 1, 2, "0.", "0.", "1."),
        free("CONM2", 801, 1, 0, "2.5"),
        free("RBE2", 802, 1, 123, 2, 3),
        free("PSOLID", 1, 1),
    ]
    text = deck(form=free, number=full, before=[*shells, *others])
    made(lambda: (folder / "a.bdf").write_text(text))
    body = read_body(folder / "a.bdf")
    assert mesh_statistics(body).surfaces == pytest.approx({"30": 6})
    assert f"have no stiffness: {len(shells)} CTRIA3, 1 CBAR" in body.information[0]
    assert body.information[1].endswith("for the case file, no part of the mesh: 1 CONM2, 1 RBE2")


def test_supports_and_loads(tmp_path: Path) -> None:
    """They are counted, those of GRID and GRDSET too, as are directions of their own."""
    before = [
        "CORD2R,3,0,0.,0.,0.,0.,1.,0.\n+,1.,0.,0.",
        "GRDSET,,,,,,3",
        "SPC1,1,123,1,2",
        "FORCE,2,1,0,1.,0.,0.,1.",
        "FORCE,2,2,0,1.,0.,0.,1.",
        "PLOAD4,2,1,1.",
        "SET1,9,1,2",
        "GRID,900,,0.,0.,0.,0,123",
    ]
    (tmp_path / "a.bdf").write_text(deck(form=free, number=full, before=before))
    assert read_nastran(tmp_path / "a.bdf").information == [
        "for the case file, no part of the mesh: 1 SPC1, 2 FORCE, 1 PLOAD4, 1 SET1, "
        "1 GRID with supports (PS)",
        f"{len(POINTS)} GRID with directions in a coordinate system of their own (CD): supports "
        "and loads of the case file are in basic directions",
    ]
