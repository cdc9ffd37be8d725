"""Triangles of files: what is corrected, and what is refused."""

from __future__ import annotations

import meshio
import numpy as np
import pytest

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.units import METRE
from dolfin_elastic.mesh.facets_of_files import clean, read_facets

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
OUTWARD = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
MANY = np.c_[np.arange(600), np.arange(600) % 7, np.arange(600) % 11] / 100


def volume(facets) -> float:
    a, b, c = np.moveaxis(facets.points[facets.triangles], 1, 0)
    return float(np.sum(np.einsum("ni,ni->n", a, np.cross(b, c))) / 6)


def one_by_one(points, triangles):
    """Each triangle has corners of its own, as in an STL file."""
    return points[triangles].reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)


def test_corners_are_joined_and_normals_point_outwards():
    turned = OUTWARD.copy()
    turned[[0, 2]] = turned[[0, 2], ::-1]
    points, triangles = one_by_one(CORNERS, np.vstack([turned, turned[:1], [[0, 0, 1]]]))
    points[4] += 1e-9
    found = clean(points, triangles, "a.stl")
    assert found.facets.points.shape == (4, 3)
    assert volume(found.facets) == pytest.approx(1 / 6, rel=1e-7)
    assert found.remarks == (
        "4 triangles, closed, 1 without area left out, 1 that were there twice left out, "
        "2 turned round"
    )


def test_a_shell_within_another_is_a_cavity():
    small = 0.1 + 0.2 * CORNERS
    points = np.vstack([CORNERS, small, small * 0.3 + 0.09])
    triangles = np.vstack([OUTWARD, OUTWARD + 4, OUTWARD[:, ::-1] + 8])
    found = clean(points, triangles, "a.stl")
    assert volume(found.facets) == pytest.approx((1 - 0.2**3 + 0.06**3) / 6, rel=1e-9)


def test_most_of_an_open_surface_decide():
    triangles = OUTWARD[:3].copy()
    triangles[1] = triangles[1, ::-1]
    found = clean(CORNERS, triangles, "a.stl")
    assert found.remarks == "3 triangles, open, 1 turned round"
    assert volume(found.facets) == pytest.approx(volume(clean(CORNERS, OUTWARD[:3], "b").facets))


def moebius():
    turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    edges = []
    for side in (-1, 1):
        r = 3 + side * np.cos(turn / 2)
        edges.append(np.c_[r * np.cos(turn), r * np.sin(turn), side * np.sin(turn / 2)])
    low, high = np.arange(12), np.arange(12, 24)
    after, above = np.r_[low[1:], high[0]], np.r_[high[1:], low[0]]
    triangles = np.vstack([np.c_[low, after, above], np.c_[low, above, high]])
    return np.vstack(edges), triangles


@pytest.mark.parametrize(
    ("points", "triangles", "said"),
    [
        (*moebius(), "its surface has one side only"),
        (np.vstack([CORNERS, [1, 1, 1]]), np.vstack([OUTWARD, [[0, 1, 4]]]), "3 triangles meet"),
        (CORNERS, np.array([[0, 0, 1]]), "none of its triangles has an area"),
        (CORNERS, OUTWARD - 1, "1 points that do not exist, for example -1"),
        (np.vstack([CORNERS[:3], [np.nan] * 3]), OUTWARD, "no finite numbers"),
        (1e9 + MANY, np.arange(600).reshape(-1, 3), "to the seven digits"),
    ],
    ids=["moebius", "fin", "flat", "lost", "nan", "far"],
)
def test_what_is_no_surface(points, triangles, said):
    with pytest.raises(MeshError, match=said):
        clean(points, triangles, "a.stl")


@pytest.mark.parametrize(
    ("suffix", "kind", "rows", "count"),
    [
        (".stl", "triangle", OUTWARD, 4),
        (".ply", "triangle", OUTWARD, 4),
        (".obj", "triangle", OUTWARD, 4),
        (".vtu", "tetra", [[0, 1, 2, 3]], 4),
        (".obj", "quad", [[0, 1, 3, 2]], 2),
    ],
)
def test_kinds_of_files(suffix, kind, rows, count, tmp_path):
    """A volume mesh has the surface of its elements."""
    path = tmp_path / f"a{suffix}"
    meshio.write_points_cells(path, CORNERS, [(kind, np.array(rows))])
    found = read_facets(path, None, METRE, None)
    assert len(found.facets.triangles) == count
    if count == 4:
        assert volume(found.facets) == pytest.approx(1 / 6)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.stl", b"x" * 80 + b"\xff" * 54, "it states 4294967295 triangles"),
        ("a.stl", b"solid\nouter loop\nvertex 0 0 z\n", r"a.stl:3: 'vertex 0 0 z' is no vertex"),
        (
            "a.obj",
            b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n",
            "a.obj:4: a face refers",
        ),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 z\n", "a.obj:4: .f 1 2 z. is no face"),
    ],
    ids=["size", "vertex", "number", "face"],
)
def test_files_of_strangers(name, content, said, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(MeshError, match=said):
        read_facets(tmp_path / name, None, METRE, None)


def test_colours_and_points_of_no_triangle(tmp_path):
    """Beside coordinates some programs write colours; what is in no triangle is left out."""
    rows = ["v 0 0 0 1 0 0", "v 1 0 0 1 0 0", "v 0 1 0 1 0 0", "v nan 0 0 1 0 0", "f 1 2 3"]
    (tmp_path / "a.obj").write_text("\n".join(rows))
    found = read_facets(tmp_path / "a.obj", None, METRE, None)
    np.testing.assert_array_equal(found.facets.points[:, :2], [[0, 0], [0, 1], [1, 0]])


def test_faces_of_a_cad_file(tmp_path):
    import gmsh

    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.occ.addBox(0, 0, 0, 10, 20, 30)
    gmsh.model.occ.synchronize()
    gmsh.write(str(tmp_path / "a.step"))
    gmsh.finalize()
    found = read_facets(tmp_path / "a.step", None, METRE, "10 mm")
    assert volume(found.facets) == pytest.approx(6e-6)  # the file states mm
    assert found.remarks.startswith(f"{len(found.facets.triangles)} triangles, closed")


def test_no_triangles(tmp_path):
    meshio.write_points_cells(tmp_path / "a.vtu", CORNERS, [("line", np.array([[0, 1]]))])
    with pytest.raises(MeshError, match="it has no triangles"):
        read_facets(tmp_path / "a.vtu", None, METRE, None)
