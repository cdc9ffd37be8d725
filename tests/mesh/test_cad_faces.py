"""Faces of CAD files: what they are, named by number and kind, on refined meshes, in messages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.bodies import drawing
from helpers.cad import angle, round_things, stack, write
from helpers.cad import angle as angle_of
from mpi4py import MPI

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.consistency import check
from dolfin_elastic.case.check.report import report
from dolfin_elastic.core.errors import InputError, MeshError
from dolfin_elastic.core.parallel import on_root, total
from dolfin_elastic.mesh import Body, Cylinder, Selector, name_parts, read_body
from dolfin_elastic.mesh.faces import CadFaces, chosen_faces
from dolfin_elastic.mesh.formats.cad import faces
from dolfin_elastic.mesh.formats.cad.faces import CadFace
from dolfin_elastic.mesh.generate import box_body
from dolfin_elastic.mesh.geometry.curved import facet_areas
from dolfin_elastic.mesh.geometry.simplices import boundary_facets, facet_corners
from dolfin_elastic.mesh.refine.refinement import refine_body

COMM = MPI.COMM_WORLD
MM = 1e-3


def area(body: Body, name: str) -> float:
    """Area of a surface [mm^2]."""
    return float(total(COMM, facet_areas(body.mesh, body.owned_facets(name)).sum())) / MM**2


def forms(body: Body) -> dict[str, int]:
    """Description of a face to how many there are."""
    assert body.faces is not None
    texts = [f.description("mm", MM, body.dim) for f in body.faces.faces.values()]
    return {text: texts.count(text) for text in texts}


@pytest.fixture(name="angle", scope="module")
def _angle(folder_of_module: Path) -> Body:
    write(folder_of_module / "angle.step", angle)
    return read_body(folder_of_module / "angle.step", size=3)


def test_kinds_radii_and_forms(folder: Path, angle: Body) -> None:
    """By construction: 8 planes, a fillet and a hole; a ball, a cone, a torus and a shaft."""
    assert forms(angle) == {"plane": 8, "cylinder r 4 mm, fillet": 1, "cylinder r 1.5 mm, hole": 1}
    write(folder / "round.step", round_things)
    body = read_body(folder / "round.step", size=2)
    slope = np.degrees(np.arctan(1 / 3))
    assert forms(body) == {
        "sphere r 2 mm": 1,
        f"cone {slope:.4g} deg": 1,
        "torus r 3 and 1 mm": 1,
        "cylinder r 1 mm, shaft": 1,
        "plane": 4,
    }
    assert body.faces is not None
    exact = {"sphere": 16 * np.pi, "torus": 12 * np.pi**2, "cylinder": 4 * np.pi}
    found = {f.kind: f.area / MM**2 for f in body.faces.faces.values() if f.area}
    assert {kind: found[kind] for kind in exact} == pytest.approx(exact, rel=1e-9)


def test_tolerance_holds_for_all_lengths_of_a_face() -> None:
    """Of a torus of radii 1 and 3 mm, and of a shaft of 2 mm along y; angles have none."""

    def face(number: int, kind: str, **numbers: Any) -> CadFace:
        known = {"radius": None, "major": None, "angle": None, "axis": (0.0, 1.0, 0.0), **numbers}
        return CadFace(
            number, kind, "", area=None, centroid=(), samples=(), normals=(), names=(), **known
        )

    there = CadFaces(
        {
            1: face(1, "torus", radius=1 * MM, major=3 * MM),
            2: face(2, "cylinder", radius=2 * MM),
            3: face(3, "cone", angle=30.0),
        },
        3,
    )

    def chosen(**keys: Any) -> set[int]:
        try:
            return chosen_faces(there, Selector(tolerance=0.2, **keys), MM)
        except MeshError:
            return set()

    assert chosen(torus={"radius": 1.1, "major": 3.1}) == {1}
    assert chosen(torus={"major": 3.1}) == {1}
    assert chosen(torus={"radius": 1.1, "major": 3.3}) == set()
    assert chosen(cylinder={"radius": 2.1, "axis": "y"}) == {2}
    assert chosen(cylinder={"radius": 2.1, "axis": "z"}) == set()
    assert chosen(cylinder={"radius": 2.3, "axis": "y"}) == set()
    assert chosen(cone={"angle": 30}) == {3}
    assert chosen(cone={"angle": 30.1}) == set()


def test_kinds_by_curvature(folder: Path) -> None:
    """Splines are of no kind: the curvature of such a shaft tells what it is."""

    def splines(occ: Any) -> None:
        occ.convertToNURBS([(3, occ.addCylinder(0, 0, 0, 0, 0, 3, 2))])

    write(folder / "shaft.brep", splines)
    body = read_body(folder / "shaft.brep", size=1)
    assert body.faces is not None
    texts = sorted(f.description("m", 1.0) for f in body.faces.faces.values())
    assert texts == ["cylinder r 2 m, shaft", "plane", "plane"]


def test_each_facet_has_its_face(angle: Body) -> None:
    """The faces divide the boundary; curved cells have their areas to 1e-3."""
    assert angle.faces is not None
    assert not any(face.samples or face.normals for face in angle.faces.faces.values())
    for number, face in angle.faces.faces.items():
        body = name_parts(angle, surfaces={"s": Selector(faces=(number,))})
        assert face.area is not None
        assert area(body, "s") == pytest.approx(face.area / MM**2, rel=1e-3)


@pytest.mark.parametrize(
    ("keys", "exact"),
    [
        ({"kind": "hole"}, 2 * np.pi * 1.5 * 3),
        ({"kind": "fillet"}, np.pi / 2 * 4 * 6),
        ({"cylinder": {"radius": "4 mm"}}, np.pi / 2 * 4 * 6),
        ({"cylinder": {"radius": 1.5, "axis": "z"}}, 2 * np.pi * 1.5 * 3),
        ({"cylinder": {"radius": 4.1}, "tolerance": 0.2}, np.pi / 2 * 4 * 6),
        ({"kind": "plane", "normal": [-1, 0, 0]}, 6 * 16),
        ({"kind": "cylinder"}, 2 * np.pi * 1.5 * 3 + np.pi / 2 * 4 * 6),
    ],
    ids=["hole", "fillet", "radius", "axis", "tolerance", "normal", "cylinders"],
)
@pytest.mark.sample(3)
def test_surfaces_by_kind(angle: Body, keys, exact) -> None:
    body = name_parts(angle, surfaces={"s": Selector(**keys)}, scale=MM)
    assert area(body, "s") == pytest.approx(exact, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "exact"),
    [
        ("hole r 1.5", 2 * np.pi * 1.5 * 3),
        ("Hole  r 1.500 mm", 2 * np.pi * 1.5 * 3),
        ("hole r 0.15 cm", 2 * np.pi * 1.5 * 3),
        ("cylinder r 1.5 mm, hole", 2 * np.pi * 1.5 * 3),
        ("fillet r 4", 2 * np.pi * 6),
        ("cylinder r 4", 2 * np.pi * 6),
    ],
)
def test_names_by_kind_and_size(angle: Body, name: str, exact: float) -> None:
    """As `look` prints them; they are found wherever a surface is, and listed nowhere."""
    assert name in angle.surfaces and name not in list(angle.surfaces)
    assert angle.kinds(name) == ("surface",)
    assert area(angle, name) == pytest.approx(exact, rel=0.02)
    again = name_parts(angle, surfaces={"bore": Selector(of=name)})
    assert area(again, "bore") == pytest.approx(area(angle, name), rel=1e-12)
    (number,) = angle.faces.named(name)
    np.testing.assert_array_equal(angle.surface(f"face {number}"), angle.surface(name))


@pytest.mark.parametrize(
    "name", ["hole r 1.6", "hole r 4", "face 99", "hole", "plane", "hole r 2 kg", "hole r", "3"]
)
def test_what_names_no_face(angle: Body, name: str) -> None:
    assert name not in angle.surfaces
    with pytest.raises(MeshError, match="named by number or size, as .*hole r 1.5|face "):
        angle.surface(name)


def test_names_of_the_body_go_first(angle: Body) -> None:
    bare = angle.named(surfaces={"hole r 1.5": angle.surface("face 1")})
    np.testing.assert_array_equal(bare.surface("hole r 1.5"), angle.surface("face 1"))
    assert "face 1" not in box_body(size=(1, 1, 1), cells=(1, 1, 1)).surfaces


def test_a_case_with_names_of_faces(folder: Path) -> None:
    """In `on`, in [surfaces], and for smaller elements; unknown ones with what there is."""
    write(folder / "angle.step", angle_of)
    tables: dict[str, Any] = {
        "mesh": {
            "file": "angle.step",
            "size": 3,
            "degree": 1,
            "refine": [{"on": "fillet r 4", "size": 1}],
        },
        "surfaces": {"both": ["hole r 1.5", "fillet r 4"]},
        "materials": {"steel": {"law": "linear-elastic", "E": 2e11, "nu": 0.3}},
        "support": [{"kind": "fixed", "on": "face 1"}],
        "load": [{"kind": "bearing", "on": "hole r 1.5", "value": [5, 0, 0]}],
    }
    case = Case.from_dict(tables, folder)
    body = case.read_body()
    check(case, body)
    assert area(body, "both") == pytest.approx(
        area(body, "hole r 1.5") + area(body, "fillet r 4"), rel=1e-12
    )
    sizes = {part.name: part for part in report(case).surfaces}
    assert [name for name in sizes if name != "both"] == ["face 1", "hole r 1.5"]
    assert (sizes["face 1"].use, sizes["hole r 1.5"].use) == ("support", "bearing")
    assert sizes["face 1"].faces == (1,)
    assert sizes["hole r 1.5"].measure / MM**2 == pytest.approx(area(body, "hole r 1.5"))
    tables["support"][0]["on"] = "hole r 5"
    wrong = Case.from_dict(tables, folder)
    with pytest.raises(InputError, match=r"support\[0\].on: .*'hole r 5'.*r 1.5 mm, hole"):
        check(wrong, body)


def test_faces_between_joined_bodies_have_numbers_only(folder: Path) -> None:
    """A block of 4 x 4 on one of 12 x 4: what faces down is the foot alone, on any ranks."""
    write(folder / "stack.step", stack)
    body = read_body(folder / "stack.step", size=2)
    assert body.faces is not None
    between = body.faces.numbers_of(body.faces.facets)[
        np.isclose(facet_corners(body.mesh, body.faces.facets)[:, :, 2], 3 * MM).all(axis=1)
        & np.isin(body.faces.facets, boundary_facets(body.mesh), invert=True)
    ]
    (number,) = set(COMM.allreduce([int(n) for n in between]))
    wanted = {
        "down": Selector(kind="plane", normal=(0, 0, -1)),
        "up": Selector(kind="plane", normal=(0, 0, 1)),
        "planes": Selector(kind="plane"),
        "between": Selector(faces=(number,)),
    }
    body = name_parts(body, surfaces=wanted, scale=MM)
    areas = {name: area(body, name) for name in wanted}
    exact = {"down": 48.0, "up": 48.0, "planes": 96.0 + 2 * 16 * 3 + 16 * 2, "between": 16.0}
    assert areas == pytest.approx(exact, rel=1e-9)


def test_refined_bodies_keep_names_and_faces(angle: Body) -> None:
    """A refined cylinder is nearer to the true one, and every facet is still of its face."""
    body = name_parts(angle, surfaces={"s": Selector(kind="fillet")}, scale=MM)
    fine = refine_body(body, body.owned_cells()).body
    assert fine.count("s") == 4 * body.count("s")
    errors = [abs(area(b, "s") - 24 * np.pi / 2) for b in (body, fine)]
    assert errors[1] < errors[0]
    assert fine.faces is not None
    again = name_parts(fine, surfaces={"t": Selector(kind="fillet")}, scale=MM)
    assert np.array_equal(again.surface("t"), again.surface("s"))


def test_faces_of_a_plane_body_are_its_curves(folder: Path) -> None:
    text = 'SetFactory("OpenCASCADE");\nDisk(1) = {0, 0, 0, 3};\nDisk(2) = {0, 0, 0, 1};\n'
    text += "BooleanDifference{ Surface{1}; Delete; }{ Surface{2}; Delete; }\n"
    on_root(COMM, lambda: (folder / "ring.geo").write_text(text) and None)
    body = read_body(folder / "ring.geo", size=1)
    assert body.faces is not None
    unit = body.faces.unit
    texts = {f.description(unit.name, unit.metres, 2) for f in body.faces.faces.values()}
    assert texts == {"circle r 3 m, shaft", "circle r 1 m, hole"}
    body = name_parts(body, surfaces={"inner": Selector(cylinder=Cylinder(radius=1))})
    length = float(total(COMM, facet_areas(body.mesh, body.owned_facets("inner")).sum()))
    assert length == pytest.approx(2 * np.pi, rel=1e-3)


def test_messages(angle: Body) -> None:
    """Who names a face that is not there is told which are."""
    with pytest.raises(MeshError, match=r"surfaces\.s\.faces: there is no face 12; .* 1 to 10"):
        name_parts(angle, surfaces={"s": Selector(faces=(2, 12))})
    with pytest.raises(MeshError, match=r"radius: no face .* like that; the nearest are \d+ \(cyl"):
        name_parts(angle, surfaces={"s": Selector(cylinder=Cylinder(radius=3.9))}, scale=MM)
    with pytest.raises(
        MeshError, match=r"no surface 'hole2' .*or .hole r 1\.5.: .* 1\.5 mm, hole\)"
    ):
        angle.surface("hole2")
    with pytest.raises(MeshError, match=r"the nearest CAD face is \d+ \(plane\)"):
        name_parts(angle, surfaces={"s": Selector(plane="z", at=16.5)}, scale=MM)
    box = box_body(size=[1, 1, 1], cells=[1, 1, 1], comm=COMM)
    with pytest.raises(MeshError, match=r"surfaces\.s\.kind: this picks faces of a CAD file, but"):
        name_parts(box, surfaces={"s": Selector(kind="hole")})
    with pytest.raises(MeshError, match=r"regions\.r: a faces picks surfaces, not regions"):
        name_parts(angle, regions={"r": Selector(faces=(1,))})
    with pytest.raises(MeshError, match=r"cylinder\.point: this key is missing"):
        name_parts(angle, regions={"r": Selector(cylinder=Cylinder(radius=1))})
    with pytest.raises(InputError, match=r"kind: .*did you mean 'fillet'"):
        Selector(kind="filet")  # type: ignore[arg-type]


def test_faces_that_cannot_be_described_are_there_all_the_same(monkeypatch) -> None:
    """A shaft of two halves, of which Gmsh gives no samples, or of which something fails."""

    def described() -> list[dict[str, Any]] | None:
        if COMM.rank:
            return None
        with drawing() as gmsh:
            occ = gmsh.model.occ
            gmsh.option.setNumber("Geometry.OCCUnionUnify", 0)
            halves = [(3, occ.addCylinder(0, 0, 0, 0, 0, 3, 2, angle=np.pi)) for _ in range(2)]
            occ.rotate(halves[1:], 0, 0, 0, 0, 0, 1, np.pi)
            occ.fuse(halves[:1], halves[1:])
            occ.synchronize()
            return faces.describe_faces(gmsh, 3)

    def fails(*_: object) -> None:
        raise ZeroDivisionError

    def nothing(*_: object) -> tuple[Any, ...]:
        return np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 2)), np.empty((0, 2, 3)), 0.0

    for change, kind in ((("_sampled", nothing), "cylinder"), (("_measured", fails), "surface")):
        with monkeypatch.context() as changed:
            changed.setattr(faces, *change)
            found = [f for f in described() or [] if abs(f["area"] - 6 * np.pi) < 1e-9]
        if COMM.rank == 0:
            assert [(f["kind"], f["form"], f["radius"]) for f in found] == [(kind, "", None)] * 2
