"""Shapes: one distance for arrays and UFL, triangles on the surface; a new one is one class."""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from conftest import ROOT
from helpers.processes import of_copy

from dolfin_elastic import (
    Bearing,
    Bolt,
    Centrifugal,
    Contact,
    CylindricalAxes,
    Guccione,
    RectangularAxes,
    Rotation,
    Selector,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.shapes.box import Box
from dolfin_elastic.core.shapes.directions import check_components, unit_vector, vector_of
from dolfin_elastic.core.shapes.shapes import (
    Cylinder,
    CylinderObstacle,
    Operations,
    Plane,
    Shape,
    Sphere,
    SphereObstacle,
)
from dolfin_elastic.core.shapes.sharp import BoxObstacle, ConeObstacle

SOLID = [
    Plane(axis="-y", at=0.3),
    Plane(point=[0.1, 0.2, 0.3], normal=[1, 2, -2]),
    Sphere(center=[0.1, -0.2, 0.3], radius=0.7),
    SphereObstacle(center=[0.1, -0.2, 0.3], radius=2.5, inside=True),
    Cylinder(point=[0.1, -0.2, 0.3], radius=0.7),
    Cylinder(axis=[0, 3, 4], point=[0.1, -0.2, 0.3], radius=0.7),
    CylinderObstacle(axis="x", point=[0.1, -0.2, 0.3], radius=2.5, inside=True),
    BoxObstacle(center=[0.1, -0.2, 0.3], size=[0.8, 1.2, 1.6]),
    BoxObstacle(
        center=[0.1, -0.2, 0.3], size=[1, 1.2, 0.9], x=[1, 2, -2], y=[2, 1, 2], inside=True
    ),
    ConeObstacle(tip=[0.1, -0.2, 0.3], axis="-z", half_angle=30),
    ConeObstacle(tip=[0.1, -0.2, -0.3], axis=[1, 2, 2], half_angle="1.2 rad", inside=True),
    BoxObstacle(center=[0.1, -0.2, 0.3], size=[0.8, 1.2, 1.6], rounding=0.3),
    ConeObstacle(tip=[0.1, -0.2, 0.3], axis="-z", half_angle=30, rounding=0.2),
]
FLAT = [
    Plane(axis="y", at=0.3),
    Plane(point=[0.1, 0.2], normal=[3, -4]),
    SphereObstacle(center=[0.1, -0.2], radius=0.7),
    CylinderObstacle(point=[0.1, -0.2], radius=2.5, inside=True),
    CylinderObstacle(axis="y", point=[0, 0], radius=0.5),
    BoxObstacle(center=[0.1, -0.2], size=[0.8, 1.2], x=[3, 4]),
    BoxObstacle(center=[0.1, -0.2], size=[0.8, 1.2], x=[3, 4], y=[4, -3], inside=True),
    ConeObstacle(tip=[0.1, -0.2], axis=[1, 2], half_angle=20, inside=True),
    ConeObstacle(tip=[0.1, -0.2], axis="-y", half_angle=70),
    BoxObstacle(center=[0.1, -0.2], size=[1.8, 2.2], x=[3, 4], inside=True, rounding=0.4),
    ConeObstacle(tip=[0.1, -0.2], axis=[1, 2], half_angle=20, rounding=0.1),
]

DEGREE = 180 / np.pi
UFL = Operations(ufl.as_ufl, ufl.sqrt, lambda s, a, b: ufl.conditional(ufl.ge(s, 0.0), a, b))


def points(shape: Shape, count: int) -> Any:
    """Around all of the shapes."""
    return np.random.default_rng(7).uniform(-1.5, 1.5, (count, 2 if shape in FLAT else 3))


@pytest.mark.parametrize("shape", [*SOLID, *FLAT])
def test_the_normal_is_the_gradient_of_the_distance(shape: Shape) -> None:
    """Of length 1, and by central differences; UFL gives the same numbers."""
    x, step = points(shape, 40), 1e-6
    gap, normal = shape.gaps(x)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=1e-12)
    for axis, unit in enumerate(np.eye(x.shape[1])):
        there, here = (shape.gaps(x + sign * step * unit)[0] for sign in (1, -1))
        np.testing.assert_allclose((there - here) / (2 * step), normal[:, axis], atol=1e-8)
    place = [ufl.as_ufl(float(value)) for value in x[0]]
    found, along = shape.gap(place, UFL)
    np.testing.assert_allclose([float(one) for one in (found, *along)], [gap[0], *normal[0]])


def has_sharp_edges(shape: Any) -> bool:
    """Those of round boxes are drawn sharp."""
    return not (isinstance(shape, BoxObstacle) and shape.rounding)


@pytest.mark.parametrize("shape", filter(has_sharp_edges, [*SOLID, *FLAT]))
def test_triangles_lie_on_the_surface(shape: Shape) -> None:
    """Of discs and strips in a plane their rims, and what they fill lies behind."""
    dim = 2 if shape in FLAT else 3
    near = Box(np.array([-1.0, -1.0, 0.0]), np.array([1.0, 1.0, 1.0]))
    x, triangles = shape.drawn(near, dim)
    outward = (x[triangles] if dim == 3 else x)[..., :dim]
    gap, _ = shape.gaps(outward.reshape(-1, dim))
    if dim == 3:
        assert np.abs(gap).max() < 1e-12
        a, b, c = np.moveaxis(x[triangles], 1, 0)
        across = np.cross(b - a, c - a)
        large = np.linalg.norm(across, axis=1) > 1e-9
        _, normal = shape.gaps((a + b + c)[large] / 3)
        assert (np.sum(across[large] * normal, axis=1) > 0).all()
    else:
        hollow = -1.0 if shape.hollow else 1.0
        assert (hollow * gap).max() < 1e-12
        assert np.abs(gap).min() < 1e-12


# --- edges and tips ---


def nearest_of_box(shape: Any, x: Any) -> Any:
    """Nearest points of the surface: of each face that of a rectangle."""
    dim = x.shape[1]
    sides, half = shape.sides(dim), np.array(shape.size) / 2
    local = (x - shape.center) @ sides.T
    found = []
    for axis, side in itertools.product(range(dim), (-1, 1)):
        foot = np.clip(local, -half, half)
        foot[:, axis] = side * half[axis]
        found.append(foot @ sides + shape.center)
    return found, (np.abs(local) < half).all(axis=1)


def nearest_of_cone(shape: Any, x: Any) -> Any:
    """Of each straight line through the tip the nearest point; lines round the axis ever closer."""
    dim, angle = x.shape[1], 1.2 if isinstance(shape.half_angle, str) else shape.half_angle / DEGREE
    axis = np.array(unit_vector(shape.axis))[:dim]
    arm = x - shape.tip
    within = arm @ axis > np.cos(angle) * np.linalg.norm(arm, axis=1)
    if dim == 2:
        turns = [np.full(len(x), side) for side in (0.0, np.pi)]
        a, b = np.array([-axis[1], axis[0]]), np.zeros(2)
    else:
        a = np.cross(axis, [0.3, 0.5, -0.7])
        a /= np.linalg.norm(a)
        b = np.cross(axis, a)
        turns = list(np.broadcast_to(np.linspace(0, 6.3, 64)[:, None], (64, len(x))))

    def feet(turns: Any) -> list[Any]:
        result = []
        for turn in turns:
            across = np.cos(turn)[:, None] * a + np.sin(turn)[:, None] * b
            line = np.cos(angle) * axis + np.sin(angle) * across
            result.append(shape.tip + np.maximum(np.sum(arm * line, axis=1), 0)[:, None] * line)
        return result

    width = 0.1
    for _ in range(0 if dim == 2 else 8):
        far = [np.linalg.norm(x - foot, axis=1) for foot in feet(turns)]
        best = np.array(turns)[np.argmin(far, axis=0), np.arange(len(x))]
        turns = [best + width * k for k in np.linspace(-1, 1, 21)]
        width /= 10
    return feet(turns), within


@pytest.mark.parametrize(
    "shape",
    [s for s in (*SOLID, *FLAT) if isinstance(s, BoxObstacle | ConeObstacle) and not s.rounding],
)
def test_the_nearest_point_of_edges_and_tips(shape: Any) -> None:
    """Gap and normal as found by trial of all faces, and of all lines of a cone."""
    x = points(shape, 400)
    find = nearest_of_box if isinstance(shape, BoxObstacle) else nearest_of_cone
    feet, within = find(shape, x)
    far = np.array([np.linalg.norm(x - foot, axis=1) for foot in feet])
    best = np.argmin(far, axis=0)
    sign = np.where(within, -1.0, 1.0) * (-1.0 if shape.hollow else 1.0)
    expected = sign * far[best, np.arange(len(x))]
    gaps, normals = shape.gaps(x)
    np.testing.assert_allclose(gaps, expected, atol=1e-12)
    arm = x - np.array(feet)[best, np.arange(len(x))]
    # Of a minimum to 1e-16 the place is found to its root.
    np.testing.assert_allclose(expected[:, None] * normals, arm, atol=1e-7)
    assert within.any() and not within.all()


@pytest.mark.parametrize("shape", [*SOLID, *FLAT])
def test_curvature(shape: Shape) -> None:
    """As differences of the normal, away from edges of the distance."""
    x, step = points(shape, 60), 1e-6
    found = shape.curvature(x)
    for axis, unit in enumerate(np.eye(x.shape[1])):
        there, here = (shape.gaps(x + sign * step * unit)[1] for sign in (1, -1))
        np.testing.assert_allclose((there - here) / (2 * step), found[:, axis], atol=1e-6)
    if not isinstance(shape, Plane):
        assert shape in FLAT or np.abs(found).max() > 0.1


def test_round_edges_and_tips() -> None:
    """The end of a wedge of 30 degrees that stands on its tip, and an edge of a box."""
    wedge = ConeObstacle(tip=[0, 0], axis="y", half_angle=30, rounding=1)
    off = wedge.off(np.array([[0, 1], [0, -1], [np.sqrt(3), 3]]))
    np.testing.assert_allclose(off, [0, 2, 0], atol=1e-12)
    box = BoxObstacle(center=[0, 0], size=[4, 6], rounding=1)
    off = box.off(np.array([[2, 0], [0, 4], [1 + np.sqrt(0.5), 2 + np.sqrt(0.5)], [2, 3]]))
    np.testing.assert_allclose(off, [0, 1, 0, np.sqrt(2) - 1], atol=1e-12)
    with pytest.raises(InputError, match="half of the smallest side"):
        BoxObstacle(center=[0, 0], size=[4, 6], rounding=2.1).check(2, axisymmetric=False)


def test_a_place_on_an_edge_or_axis() -> None:
    """On faces, edges, corners and a cone's axis all is finite."""
    box = BoxObstacle(center=[0, 0, 0], size=[2, 2, 2])
    x = np.array([[1.0, 0, 0], [1, 1, 0], [1, 1, 1], [0, 0, 0]])
    gaps, normals = box.gaps(x)
    np.testing.assert_array_equal(gaps, [0, 0, 0, -1])
    np.testing.assert_array_equal(normals, [[1, 0, 0]] * 4)
    assert box.thickness == 1.0
    cone = ConeObstacle(tip=[0, 0, 0], axis="z", half_angle=30)
    gaps, normals = cone.gaps(np.array([[0.0, 0, 0], [0, 0, 2], [0, 0, -2]]))
    np.testing.assert_allclose(gaps, [0, -1, 2], atol=1e-9)
    np.testing.assert_allclose(normals[1:], [[0, 0, -0.5], [0, 0, -1]], atol=1e-9)
    for shape in (box, cone):
        assert np.isfinite(shape.curvature(np.vstack([x, np.zeros(3)]))).all()


@pytest.mark.parametrize(
    ("shape", "turned", "said"),
    [
        (BoxObstacle(center=[0, 0], size=[1, 1, 1]), False, "size: 3 components"),
        (BoxObstacle(center=[0, 0], size=[1, 1], x="z"), False, "x: a plane body has no axis"),
        (
            BoxObstacle(center=[0, 0], size=[1, 1], x=[1, 1], y=[0, 1]),
            False,
            "y: x and y are at 45",
        ),
        (BoxObstacle(center=[0.4, 0], size=[1, 1]), True, "center: an axisymmetric body"),
        (BoxObstacle(center=[0, 0], size=[1, 1], x=[1, 2]), True, "center: an axisymmetric body"),
        (ConeObstacle(tip=[0, 0], axis=[0, 0, 1], half_angle=9), False, "axis: 3 components"),
        (ConeObstacle(tip=[0, 0], axis=[1, 1], half_angle=9), True, "axis: an axisymmetric body"),
        (ConeObstacle(tip=[1, 0], axis="y", half_angle=9), True, "tip: an axisymmetric body"),
    ],
)
def test_boxes_and_cones_that_do_not_fit(shape: Shape, turned: bool, said: str) -> None:
    """Vectors in the plane, about the axis."""
    with pytest.raises(InputError, match=said):
        shape.check(2, axisymmetric=turned)


def test_what_boxes_and_cones_may_be() -> None:
    """A rectangle about the axis or beside it; half angles are acute."""
    for beside in (
        BoxObstacle(center=[0, 0], size=[1, 1], x="y"),
        BoxObstacle(center=[0.8, 0], size=[1, 1], x=[1, 1]),
        ConeObstacle(tip=[0, 1], axis="-y", half_angle="9 deg"),
    ):
        beside.check(2, axisymmetric=True)
    for angle in (0, 90, "-1 deg", "2 rad", "5 mm", True, "wide"):
        with pytest.raises(InputError, match="half_angle"):
            ConeObstacle(tip=[0, 1], axis="-y", half_angle=angle)


def test_a_sphere_has_no_edges() -> None:
    """Each side belongs to two triangles with an area: nothing is drawn there, at poles neither."""
    near = Box(np.full(3, -1.0), np.ones(3))
    x, triangles = SphereObstacle(center=[0, 0, 0], radius=1).drawn(near, 3)
    a, b, c = np.moveaxis(x[triangles], 1, 0)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 1e-6
    pairs = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert (np.unique(pairs, axis=0, return_counts=True)[1] == 2).all()


def test_lengths_beside_a_mesh() -> None:
    """Bare numbers in its unit, texts as they are; what is left out stays so."""
    shape = SphereObstacle(center=[1, "2 cm", 3.0], radius="4 mm")
    assert shape.in_metres(1e-3) == SphereObstacle(center=[1e-3, 0.02, 3e-3], radius=4e-3)
    assert shape.bare_lengths() == [1.0, 3.0]
    assert shape.selecting(1e-3, 2, "").center == (1e-3, 0.02)
    assert Sphere(radius=2).in_metres(0.5) == Sphere(radius=1)
    found = [one.thickness for one in (shape.in_metres(1.0), SOLID[3], SOLID[0])]
    assert found == [4e-3, np.inf, np.inf]


DIRECTIONS: dict[str, Callable[[Any], Any]] = {
    "bearing": lambda d: Bearing(on="a", value=[1, 0, 0], axis=d).axis,
    "bolt": lambda d: Bolt(on="a", value=1, axis=d).axis,
    "centrifugal": lambda d: Centrifugal(value=1, axis=d).axis,
    "rotation": lambda d: Rotation(on="a", point=[0, 0, 0], angle=1, axis=d).axis,
    "force on an obstacle": lambda d: (
        Contact(on="a", plane={"axis": "z", "at": 0}, force=1, direction=d).direction
    ),
    "normal of a plane": lambda d: Plane(point=[0, 0, 0], normal=d).normal,
    "axis of an obstacle": lambda d: CylinderObstacle(point=[0, 0, 0], axis=d, radius=1).axis,
    "normal of facets": lambda d: Selector(normal=d).normal,
    "cylindrical axes": lambda d: CylindricalAxes(axis=d).axis,
    "rectangular axes": lambda d: RectangularAxes(x=d, y=[1, 0, 0]).x,
    "law": lambda d: Guccione(C=1, bf=1, bt=1, bfs=1, K=10, fibre=d).fibre,
}


@pytest.mark.parametrize("read", DIRECTIONS.values(), ids=DIRECTIONS)
def test_a_direction_is_a_word_or_components(read: Callable[[Any], Any]) -> None:
    """Wherever one is asked for; of two components it lies in the plane."""
    for written, unit in (("y", (0, 1, 0)), ("-z", (0, 0, -1)), ([0, -2], (0, -1, 0))):
        assert unit_vector(read(written)) == unit
    np.testing.assert_allclose(unit_vector(read([3, 0, -4])), [0.6, 0, -0.8], rtol=1e-15)
    for wrong in ("w", "y-", [0, 0, 0], [1], [1, 0, 0, 0]):
        with pytest.raises(InputError):
            read(wrong)


def test_directions_of_a_body() -> None:
    """An axis must be one of the body, and components as many."""
    assert vector_of("-y") == (0, -1, 0)
    assert vector_of([0, 3]) == (0, 3)
    for right in ("-y", [0, 1], None):
        check_components(right, 2, "axis")
    for wrong, said in (("-z", "axis: a plane body has no axis '-z'"), ([0, 0, 1], "axis: 3 comp")):
        with pytest.raises(InputError, match=said):
            check_components(wrong, 2, "axis")
    flat = CylinderObstacle(axis=[0, 0, 2], point=[0, 0], radius=1)
    flat.check(2, axisymmetric=False)
    with pytest.raises(InputError, match="meets no cylinder"):
        flat.check(2, axisymmetric=True)


def test_box() -> None:
    """Distances beyond faces, edges and corners; its volume, and that of the ball in it."""
    box = Box.between([[1, 0, 2], [0, 1, "0 m"]], 1.0, 3, "box")
    x = np.array([[0.5, 0.5, 1], [4, 0.5, 1], [4, 5, 1], [-3, 5, 14]])
    np.testing.assert_allclose(box.outside(x), [0, 3, 5, 13])
    np.testing.assert_allclose(box.beyond(x).max(axis=1), [0, 3, 4, 12])
    assert box.volume(3) == 2 and box.volume(2) == 1
    assert 4 / 3 * np.pi < Sphere(radius=1).volume(3) < 4.21
    assert np.pi < Sphere(radius=1).volume(2) < 3.21


# --- a new obstacle ---

RING = '''

class Ring(Shape):
    """A ring of round wire around an axis along z.

    Attributes:
        center: Its middle.
        wide: Radius of the wire's axis.
        radius: Of the wire.
    """

    lengths: ClassVar[tuple[str, ...]] = ("center", "wide", "radius")
    center: Point
    wide: PositiveLength
    radius: PositiveLength

    def distance(self, x: Sequence[Scalar], use: Operations) -> Distance:
        """See `Shape.distance`."""
        p, q, up = (a - use.number(c) for a, c in zip(x, self.center, strict=True))
        away = use.root(p * p + q * q + 1e-20)  # not 0 on the axis
        across = away - use.number(self.wide)
        length = use.root(across * across + up * up)
        n = across / length / away
        return length - use.number(self.radius), [n * p, n * q, up / length]

    def triangles(self, near: Box, dim: int) -> Triangles:
        """See `Shape.triangles`."""
        turn = np.linspace(0, 2 * np.pi, ROUND)
        along, radii = self.radius * np.sin(turn), self.wide + self.radius * np.cos(turn)
        return revolved(whole(self.center), np.eye(3)[2], along, radii)
'''
"""A class, and its row: a field of `Contact`."""
FIELD = "    cylinder: CylinderObstacle | None = None\n"
ROWS = {
    "    CylinderObstacle,\n": "    Ring,\n    CylinderObstacle,\n",
    FIELD: f"{FIELD}    ring: Ring | None = None\n",
}
CASE = """
[mesh]
box = {size = [1, 1, 0.5], cells = [4, 4, 2]}
degree = 1
[materials.rubber]
law = "neo-hookean"
E = "1 MPa"
nu = 0.3
[[support]]
on = "bottom"
[[contact]]
name = "stamp"
on = "top"
ring = {center = [0.5, 0.5, "701 mm"], wide = 0.25, radius = "20 cm"}
motion = [0, 0, "-11 mm"]
[statics]
steps = 2
[output]
pictures = [{file = "with.png"}, {file = "without.png", obstacles = false}]
probes = {below = [0.25, 0.5, 0.5]}
"""


@pytest.mark.long
@pytest.mark.skipif(not shutil.which("Xvfb"), reason="pictures need Xvfb")
def test_a_new_obstacle_is_one_class_and_one_row(tmp_path: Path) -> None:
    """A ring in a copy of the package: checked, computed, drawn, reported, and in the schema."""
    from matplotlib.image import imread

    package = tmp_path / "dolfin_elastic"
    shutil.copytree(ROOT / "dolfin_elastic", package, ignore=shutil.ignore_patterns("__pycache__"))
    shapes, contact = package / "core/shapes/shapes.py", package / "model/contact.py"
    shapes.write_text(shapes.read_text() + RING)
    text = contact.read_text()
    for before, after in ROWS.items():
        assert text.count(before) == 1
        text = text.replace(before, after)
    contact.write_text(text)
    cases = {
        "stamp": CASE,
        "short": CASE.replace('0.5, "701 mm"', "0.5"),
        "misspelt": CASE.replace("ring = {", "rings = {"),
    }
    for name, words in cases.items():
        (tmp_path / f"{name}.toml").write_text(words)
    checked, short, refused, ran, looked, reported, schema = of_copy(
        tmp_path,
        *(f"check {name}.toml" for name in cases),
        *("run stamp.toml", "look stamp.toml -o look.png", "report stamp_results", "schema"),
    )
    assert checked.startswith("0\n"), checked
    row = next(line.split() for line in checked.splitlines() if "'stamp'" in line)
    assert row[2] == "0.001", checked
    said = " ".join(checked.split())
    assert "contact[0] top may touch a rigid ring (center (500, 500, 701) mm" in said, checked
    assert "contact[0].ring.center: 2 components given" in short
    assert refused.startswith("2\n") and "did you mean 'ring'?" in refused

    assert ran.startswith("0\n"), ran
    results = tmp_path / "stamp_results"
    history = np.genfromtxt(results / "history.csv", delimiter=",", names=True)
    assert history["reaction_stamp_z"][-1] < -100
    # It has moved 11 mm, of which 1 mm was free; the node below it gives way to its side a little.
    assert history["below_z"][-1] == pytest.approx(-0.010, abs=3e-4)
    # Nodes are less than 1e-3 m deep; between them faces of 0.25 m meet a wire of 0.2 m.
    assert 1e-3 < history["penetration_stamp"][-1] < 6e-3
    shown = [imread(results / name)[..., :3] for name in ("with.png", "without.png")]
    assert shown[0].shape == shown[1].shape
    assert (np.abs(shown[0] - shown[1]).max(axis=2) > 0.02).sum() > 2000

    assert looked.startswith("0\n"), looked
    red, green, blue = np.moveaxis(imread(tmp_path / "look.png")[..., :3], 2, 0)
    assert ((blue > green + 0.03) & (red > green + 0.015) & (blue > 0.8)).sum() > 2000

    assert reported.startswith("0\n"), reported
    page = (results / "report.html").read_text()
    assert "may touch a rigid ring (center " in page and "wide 250 mm" in page
    assert '"Ring"' in schema
