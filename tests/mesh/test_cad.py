"""CAD files: their unit, bodies that touch, faces sewn into solids, sizes that Gmsh cannot mesh."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.bodies import drawing
from helpers.cad import block, stack, write
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.mesh import Selector, mesh_statistics, name_parts, read_body
from dolfin_elastic.mesh.body import extent
from dolfin_elastic.mesh.formats.cad import folded, sizes
from dolfin_elastic.mesh.formats.cad.shapes import Lengths
from dolfin_elastic.mesh.formats.cad.units import stated_unit
from dolfin_elastic.mesh.refine.refinement import refine_body

COMM = MPI.COMM_WORLD
MILLI = "( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.) )"


def named(text: str) -> str:
    """Names the parts of `stack`."""
    for number, name in ((1, "steel"), (2, "rubber")):
        text = re.sub(rf"'Open CASCADE STEP translator \d+\.\d+ \d+\.{number}'", f"'{name}'", text)
    return text


def in_unit(si: str) -> Callable[[str], str]:
    """Lets the file state another unit."""
    return lambda text: text.replace(MILLI, si)


INCH = (
    "( CONVERSION_BASED_UNIT('INCH',#9001) LENGTH_UNIT() NAMED_UNIT(#9002) );\n"
    "#9001 = LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),#9003);\n"
    "#9002 = DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.);\n"
    f"#9003 = {MILLI}"
)
METRES = "( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT($,.METRE.) )"
FURLONG = INCH.replace("INCH", "FURLONG").replace("25.4", "201168.")


@pytest.mark.parametrize(
    ("si", "name", "metres"),
    [(MILLI, "mm", 1e-3), (INCH, "in", 0.0254), (METRES, "m", 1.0)],
    ids=["mm", "in", "m"],
)
def test_a_step_file_has_the_size_that_it_states(folder: Path, si, name, metres) -> None:
    """A part of 12 mm was 12 m long, and nothing was wrong; in inches it was 304.8 m."""
    write(folder / "part.step", block, in_unit(si))
    body = read_body(folder / "part.step", size=3)
    assert extent(body) == pytest.approx((12 * metres, 4 * metres, 3 * metres), rel=1e-6)
    assert (body.unit.name, body.notes) == (name, ())
    assert f"lengths in {name}, as the file says" in body.information
    assert f"meshed by Gmsh, size 3 {name}" in body.information
    other = read_body(folder / "part.step", size=f"{3 * metres} m")
    assert other.num_cells == pytest.approx(body.num_cells, rel=0.05)


def test_a_unit_without_a_common_name(folder: Path) -> None:
    write(folder / "part.step", block, in_unit(FURLONG))
    body = read_body(folder / "part.step", size=3)
    assert extent(body) == pytest.approx((12 * 201.168, 4 * 201.168, 3 * 201.168), rel=1e-6)
    assert body.unit.name == "x 201.168 m"


def test_another_unit_counts_and_is_doubted(folder: Path) -> None:
    write(folder / "part.step", block, in_unit(INCH))
    body = read_body(folder / "part.step", scale=1e-3)
    assert extent(body) == pytest.approx((0.012, 0.004, 0.003), rel=1e-6)
    (note,) = body.notes
    assert "its lengths are in in, mesh.unit that they are in mm, which counts" in note


def test_a_script_that_merges_a_step_file_is_in_its_millimetres(folder: Path) -> None:
    """Also after a file in inches: OpenCASCADE keeps the unit of the file before."""
    write(folder / "part.step", block, in_unit(INCH))
    read_body(folder / "part.step")
    text = 'SetFactory("OpenCASCADE");\nMerge "part.step";\n'
    on_root(COMM, lambda: (folder / "a.geo").write_text(text) and None)
    body = read_body(folder / "a.geo")
    assert extent(body)[0] == pytest.approx(12 * 0.0254, rel=1e-6)
    assert body.unit.name == "mm" and not body.notes


def test_refined_bodies_return_to_the_surfaces_of_a_file_in_inches(folder: Path) -> None:
    """The nodes that refining makes on a cylinder of 1 inch lie on it."""
    write(folder / "part.step", lambda occ: occ.addCylinder(0, 0, 0, 0, 0, 1, 1), in_unit(INCH))
    body = read_body(folder / "part.step", size=1, curved=False)
    fine = refine_body(body, body.owned_cells()).body
    assert not fine.notes and fine.unit.name == "in"
    bound = np.pi * 0.0254**3
    coarse_error, error = (1 - mesh_statistics(b).volume / bound for b in (body, fine))
    assert 0 < error < 0.3 * coarse_error


@pytest.mark.parametrize(("suffix", "unit"), [(".iges", "mm"), (".brep", None)])
def test_units_of_other_files(folder: Path, suffix: str, unit: str | None) -> None:
    path = folder / f"part{suffix}"
    write(path, block)
    stated = stated_unit(path)
    assert (None if stated is None else stated.name) == unit


@pytest.mark.parametrize(
    ("prefix", "metres"),
    [
        *((f".{name}.", 10.0**power) for power, name in [(3, "KILO"), (2, "HECTO"), (1, "DECA")]),
        *((f".{name}.", 10.0**-power) for power, name in [(1, "DECI"), (2, "CENTI"), (3, "MILLI")]),
        *((f".{name}.", 10.0**-power) for power, name in [(6, "MICRO"), (9, "NANO")]),
        ("$", 1.0),
        (".LIGHT.", None),
    ],
)
def test_prefixes_of_step(prefix: str, metres: float | None, tmp_path: Path) -> None:
    """Those of SI, in the words of ISO 10303-41."""
    (tmp_path / "part.step").write_text(
        "#1 = ( GLOBAL_UNIT_ASSIGNED_CONTEXT ( ( #2 ) ) );\n"
        f"#2 = ( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT({prefix},.METRE.) );\n"
    )
    stated = stated_unit(tmp_path / "part.step")
    found = None if stated is None else stated.metres
    assert found == (None if metres is None else pytest.approx(metres, rel=1e-12))


IGES_UNITS = {
    1: 25.4e-3,  # inch
    2: 1e-3,
    4: 12 * 25.4e-3,  # foot
    5: 5280 * 12 * 25.4e-3,  # mile
    6: 1.0,
    7: 1e3,
    8: 25.4e-6,  # a thousandth of an inch
    9: 1e-6,
    10: 1e-2,
    11: 25.4e-9,  # a millionth of an inch
}


@pytest.mark.parametrize("flag", [*IGES_UNITS, 3, 12])
def test_unit_flags_of_iges(flag: int, tmp_path: Path) -> None:
    """The fourteenth parameter of the global section, IGES 5.3; others state none."""
    before = "1H,,1H;,4Hpart,6Hp.iges,1Hx,1Hx,32,38,6,308,15,4Hpart,1.0"
    text = f"{before},{flag},4Hunit,1,0.01;"
    rows = [text[i : i + 72].ljust(72) + "G" for i in range(0, len(text), 72)]
    (tmp_path / "part.iges").write_text("\n".join(rows))
    stated = stated_unit(tmp_path / "part.iges")
    if flag not in IGES_UNITS:
        assert stated is None
    else:
        assert stated is not None
        assert stated.metres == pytest.approx(IGES_UNITS[flag], rel=1e-12)


def test_bodies_that_touch_are_joined(folder: Path) -> None:
    """Two bodies of a STEP file shared no node: the upper one flew off, or had no support."""
    write(folder / "stack.step", stack, named)
    body = read_body(folder / "stack.step", size=2)
    statistics = mesh_statistics(body)
    assert statistics.regions == pytest.approx({"steel": 144e-9, "rubber": 32e-9}, rel=1e-6)
    # Boundaries of both, without the face that they share.
    assert statistics.boundary == pytest.approx((192 + 64 - 2 * 16) * 1e-6, rel=1e-6)
    assert not body.notes
    assert "bodies that touch are joined: 'rubber' and 'steel' (16 mm^2)" in body.information


FACES = ["left", "right", "front", "back", "bottom", "top"]


def with_faces(text: str) -> str:
    """Names the faces of both blocks of `stack`."""
    names = iter([*FACES, *(f"upper {name}" for name in FACES)])
    return re.sub(r"ADVANCED_FACE\(''", lambda _: f"ADVANCED_FACE('{next(names)}'", named(text))


@pytest.mark.parametrize("join", [True, False])
def test_faces_of_a_step_file_keep_their_names(folder: Path, join: bool) -> None:
    """Also those that are split or shared: the lower block's top has that under the upper one."""
    write(folder / "stack.step", stack, with_faces)
    body = read_body(folder / "stack.step", size=2, join=join)
    sizes = {name: 1e6 * area for name, area in mesh_statistics(body).surfaces.items()}
    lower = dict(zip(FACES, (12, 12, 36, 36, 48, 48), strict=True))
    upper = dict(zip(FACES, (8, 8, 8, 8, 16, 16), strict=True))
    assert sizes == pytest.approx({**lower, **{f"upper {n}": a for n, a in upper.items()}})
    found = name_parts(
        body, surfaces={"x": Selector(of="upper right", plane="x", at=6)}, scale=body.unit.metres
    )
    assert found.count("x") == body.count("upper right") > 0


def test_names_of_faces_of_bodies_that_are_alike(folder: Path) -> None:
    """Two equal blocks with different names: which is which cannot be seen."""

    def draw(occ: Any) -> None:
        occ.addBox(0, 0, 0, 1, 1, 1)
        occ.addBox(3, 0, 0, 1, 1, 1)

    write(folder / "two.step", draw, with_faces)
    body = read_body(folder / "two.step", size=1)
    assert not body.surfaces
    assert "names of faces that cannot be assigned (left out): back, bottom, front" in body.notes[0]


def test_bodies_that_are_not_joined_are_noted_with_the_place(folder: Path) -> None:
    write(folder / "stack.step", stack)
    body = read_body(folder / "stack.step", size=2, join=False)
    first, second, *_ = body.notes
    assert "'body1' and 'body2' touch on 16 mm^2 near (4, 2, 3) mm" in first
    assert "mesh.join = true joins them" in first and "2 unconnected pieces" in second
    text = 'SetFactory("OpenCASCADE");\nBox(1) = {0,0,0,1,1,1};\nBox(2) = {1,0,0,1,1,1};\n'
    on_root(COMM, lambda: (folder / "a.geo").write_text(text) and None)
    first, *_ = read_body(folder / "a.geo", size=1).notes
    assert "touch on 1 m^2 near (1, 0.5, 0.5) m" in first and "Coherence;" in first
    on_root(COMM, lambda: (folder / "a.geo").write_text(f"{text}Coherence;\n") and None)
    assert not read_body(folder / "a.geo", size=1).notes
    with pytest.raises(MeshError, match=r"a \.geo file joins its bodies itself"):
        read_body(folder / "a.geo", join=True)


@pytest.mark.parametrize(("gap", "said"), [(0.05, True), (1.0, False)])
def test_bodies_that_almost_touch_are_noted_with_the_gap(
    folder: Path, gap: float, said: bool
) -> None:
    """Only that a body is free was said; a gap as wide as this is meant to be one."""

    def apart(occ: Any) -> None:
        stack(occ)  # its two blocks are joined: one piece
        occ.addBox(2, 0, 5 + gap, 4, 4, 2)

    write(folder / "apart.step", apart)
    body = read_body(folder / "apart.step", size=2)
    note = (
        "'body2' and 'body3' are 0.05 mm apart and not joined, so that each moves on its own: "
        "close the gap in the CAD program, or tie their surfaces by [[tie]]"
    )
    assert (note in body.notes) == said
    assert any("apart" in line for line in body.notes) == said


def test_bodies_that_overlap_are_noted(folder: Path) -> None:
    def draw(occ: Any) -> None:
        occ.addBox(0, 0, 0, 2, 1, 1)
        occ.addBox(1.5, 0, 0, 2, 1, 1)

    write(folder / "two.brep", draw)
    body = read_body(folder / "two.brep", size=1)
    assert mesh_statistics(body).regions == pytest.approx({"body1": 2.0, "body2": 2.0})
    assert mesh_statistics(body).volume == pytest.approx(3.5)
    assert body.notes == ("'body1' and 'body2' overlap by 0.5 m^3: that part belongs to both",)
    assert not any("'body1' and 'body1'" in told for told in body.information)


def test_faces_of_an_iges_file_become_solids(folder: Path) -> None:
    """IGES holds faces only: a block was "a surface in space", and shells were advised."""
    write(folder / "part.iges", stack)
    body = read_body(folder / "part.iges", size=2)
    assert mesh_statistics(body).volume == pytest.approx(176e-9)
    assert "12 faces sewn into 2 solids" in body.information and not body.notes


@pytest.mark.parametrize("suffix", [".iges", ".step"])
def test_faces_that_enclose_nothing_are_refused_by_what_is_missing(folder, suffix) -> None:
    def draw(occ: Any) -> None:
        occ.addBox(0, 0, 0, 2, 1, 1)
        occ.remove([(3, 1)])
        occ.remove([(2, 1)])

    path = folder / f"open{suffix}"
    write(path, draw)
    with pytest.raises(MeshError, match="5 faces enclose no solid: 4 edges belong to one face"):
        read_body(path)


def test_a_plane_step_file_remains_plane(folder: Path) -> None:
    write(folder / "flat.step", lambda occ: occ.addRectangle(0, 0, 0, 2, 1))
    body = read_body(folder / "flat.step")
    assert body.dim == 2 and mesh_statistics(body).volume == pytest.approx(2e-6)


def thin_tube(occ: Any) -> None:
    """A tube whose wall is thinner than the arcs of its default cells are high."""
    outer = occ.addCylinder(0, 0, 0, 0, 0, 0.5, 1)
    inner = occ.addCylinder(0, 0, 0, 0, 0, 0.5, 0.995)
    occ.rotate([(3, inner)], 0, 0, 0, 0, 0, 1, 0.12)  # or inner chords are beside outer ones
    occ.cut([(3, outer)], [(3, inner)])


def test_a_default_size_that_gmsh_cannot_mesh_is_changed(folder: Path) -> None:
    write(folder / "tube.brep", thin_tube)
    (how,) = read_body(folder / "tube.brep", curved=False).information
    assert how.startswith(
        "meshed by Gmsh, 0.5 times the default size, 0.0144 m to 0.287 m: 12 elements round a"
    )
    assert how.endswith("with which Gmsh finds no valid mesh")
    with pytest.raises(MeshError, match="Gmsh cannot mesh it: .* another mesh.size"):
        read_body(folder / "tube.brep", size=0.25)


@pytest.mark.long
def test_cells_that_are_large_for_a_small_fillet_are_told_with_their_place(folder: Path) -> None:
    """Cells of 9.4 mm at a fillet of 5 mm, in walls of 6 mm: only the number of straight ones was.

    The largest stress is 14 % too small there, with an estimated error of 5 %.
    """

    def bracket(occ: Any) -> None:
        walls, _ = occ.fuse(
            [(3, occ.addBox(0, 0, 0, 60, 40, 6))], [(3, occ.addBox(0, 0, 0, 6, 40, 60))]
        )
        occ.synchronize()
        near = (5.9, -1, 5.9, 6.1, 41, 6.1)
        (edge,) = [tag for _, tag in occ.getEntitiesInBoundingBox(*near, 1)]
        body = occ.fillet([walls[0][1]], [edge], [5])
        occ.cut(body, [(3, occ.addCylinder(45, y, -1, 0, 0, 10, 3.5)) for y in (10, 30)])

    write(folder / "bracket.step", bracket)
    body = read_body(folder / "bracket.step", size=9.4)
    (note,) = body.notes
    told = re.search(
        r"spans (\d+) degrees of a round face near \((.*)\) mm: its peak stress is not known; "
        r'mesh.size = "(\S+) mm" or a \[\[mesh.refine\]\] of that face follows it, with about '
        r"(\S+) elements; without sizes, in case and file, ",
        note,
    )
    assert told is not None, note
    place = np.array([*map(float, told[2].split(","))])
    assert np.hypot(place[0] - 11, place[2] - 11) == pytest.approx(5, rel=1e-3), "on the fillet"
    # The angle of a chord is 2 asin(chord/2r); what is asked for is half of it, 45 degrees.
    chord = float(told[3]) * float(told[1]) / 45
    assert 2 * np.degrees(np.arcsin(chord / 10)) == pytest.approx(float(told[1]), rel=0.02)
    assert read_body(folder / "bracket.step", size=3.8).notes == ()
    assert read_body(folder / "bracket.step", size=float(told[3])).num_cells == pytest.approx(
        float(told[4]), rel=0.4
    ), "what it costs"
    assert not [n for n in read_body(folder / "bracket.step").notes if "spans" in n]
    (how,) = [line for line in body.information if "Gmsh" in line]
    found = re.search(r"but (\d+) are too large to follow the round face (.*) mm: stress", how)
    assert found is not None, how
    places = np.array([[*map(float, p.split(","))] for p in re.findall(r"\(([^)]*)\)", found[2])])
    assert len(places) == min(int(found[1]), 3)
    assert (np.hypot(places[:, 0] - 11, places[:, 2] - 11) < 12).all(), "at the fillet"


@pytest.mark.parametrize("hopeless", [True, False])
def test_cells_are_mended_only_where_they_can_be(hopeless: bool) -> None:
    """Of cells that fold on a surface itself none, as where pipes cross; in a thin wall all."""

    def work() -> tuple[bool, bool]:
        with drawing() as gmsh:
            occ, wide = gmsh.model.occ, 2.0 if hopeless else 5.0
            solid = (3, occ.addCylinder(-5, 0, 0, 10, 0, 0, wide))
            if hopeless:
                occ.fuse([solid], [(3, occ.addCylinder(0, -5, 0, 0, 10, 0, 1.5))])
            else:
                occ.cut([solid], [(3, occ.addCylinder(-5, 0, 0, 10, 0, 0, 4.7))])
            occ.synchronize()
            for key in ("Min", "Max"):
                gmsh.option.setNumber(f"Mesh.MeshSize{key}", 1.0 if hopeless else 2.0)
            gmsh.model.mesh.generate(3)
            gmsh.model.mesh.setOrder(2)
            before = folded._folded(gmsh, 3)
            lost = folded._lost(gmsh, 3, before)
            tags, places, _ = gmsh.model.mesh.getNodes()
            folded.relax_folded(gmsh, 3)
            relaxed = folded._folded(gmsh, 3)
            # Gmsh's own way, which moves the whole body, mends none that is lost, and no more.
            for tag, place in zip(tags, places.reshape(-1, 3), strict=True):
                gmsh.model.mesh.setNode(int(tag), place.tolist(), [])
            gmsh.model.mesh.optimize("HighOrderElastic")
            elastic = folded._folded(gmsh, 3)
            assert len(before)
            assert all(np.isin(before[lost], after).all() for after in (relaxed, elastic))
            assert len(relaxed) <= len(elastic)
            return bool(lost.all()), len(relaxed) == len(before)

    assert on_root(COMM, work) == (hopeless, hopeless)


# --- sizes where nobody gives one ---


def tray(occ: Any, radius: float = 1.0) -> None:
    """A block of 60 x 40 x 8 with a hole of some radius."""
    occ.cut(
        [(3, occ.addBox(0, 0, 0, 60, 40, 8))], [(3, occ.addCylinder(30, 20, -1, 0, 0, 10, radius))]
    )


def chords(body: Any, radius: float) -> int:
    """Number of mesh edges round the lower end of the hole of `tray`. Collective."""
    x = body.mesh.geometry.x / body.unit.metres
    off = np.abs(np.hypot(x[:, 0] - 30, x[:, 1] - 20) - radius)
    rim = (off < 1e-6 * radius) & (np.abs(x[:, 2]) < 1e-9)
    places = body.comm.allgather(np.round(x[rim], 6))
    return len(np.unique(np.concatenate(places), axis=0)) // body.mesh.geometry.cmap.degree


def test_the_default_size_follows_curvature(folder: Path) -> None:
    """A tenth of the diagonal was 7.3 mm, of which five go round the hole of 1 mm."""
    write(folder / "tray.step", tray)
    body = read_body(folder / "tray.step")
    assert chords(body, 1.0) >= 12
    (how,) = [line for line in body.information if "Gmsh" in line]
    text = "meshed by Gmsh, default size, 0.363 mm to 7.26 mm: 12 elements round a circle"
    assert how.startswith(text)
    assert body.notes == ()
    assert body.num_cells < 4000


@pytest.mark.long
def test_only_where_nobody_gives_a_size(folder: Path) -> None:
    """Neither beside `mesh.size` nor beside sizes or options of a file."""
    write(folder / "tray.step", tray)
    assert chords(read_body(folder / "tray.step", size=7), 1.0) < 8
    script = 'SetFactory("OpenCASCADE"); Merge "tray.step";\n'
    for name, line in {
        "most": "Mesh.MeshSizeMax = 7;",
        "points": "MeshSize{ PointsOf{ Volume{1}; } } = 7;",
        "own": "Mesh.MeshSizeFromCurvature = 5;",
    }.items():
        path = folder / f"{name}.geo"
        on_root(COMM, lambda path=path, line=line: path.write_text(f"{script}{line}\n"))
        body = read_body(path)
        assert chords(body, 1.0) < 8, name
        assert any("sizes of the file" in text for text in body.information), body.information
    path = folder / "none.geo"
    on_root(COMM, lambda: path.write_text(script))
    assert chords(read_body(path), 1.0) >= 12


def test_faces_that_are_too_sharp_for_the_default_size_are_told(folder: Path) -> None:
    """A hole of 0.2 mm in 73 mm would need elements of 0.1 mm: the smallest size is 0.36 mm."""
    write(folder / "tray.step", lambda occ: tray(occ, 0.2))
    note, coarse = read_body(folder / "tray.step").notes
    assert "spans" in coarse
    assert note.startswith("curved faces of a radius below 0.693 mm have fewer than 12 elements")
    assert "the smallest radius is 0.2 mm" in note
    assert "for the smallest default size is 0.363 mm: a peak" in note
    assert 'size = "0.105 mm"' in note


def test_the_default_mesh_is_bounded(monkeypatch: Any) -> None:
    """The smallest size grows until there are few enough cells, and the radii missed are told."""

    def meshed() -> tuple[sizes.DefaultSize, int]:
        with drawing() as gmsh:
            tray(gmsh.model.occ, 0.8)
            gmsh.model.occ.synchronize()
            found = sizes.set_default_size(gmsh, 3)
            gmsh.model.mesh.generate(3)
            return found, len(gmsh.model.mesh.getElementsByType(4)[0])

    def both() -> None:
        free, many = meshed()
        assert (free.raised, free.missed) == (False, None)
        monkeypatch.setattr(sizes, "_MOST_CELLS", 2000)
        bound, few = meshed()
        assert bound.raised and bound.missed == pytest.approx(0.8)
        assert bound.smallest > 1.2 * free.smallest and few < min(many, 1.5 * 2000)
        (note,) = bound.notes(Lengths("mm", 1.0))
        assert "or there would be more than 2000 elements: a peak" in note

    on_root(COMM, both)
