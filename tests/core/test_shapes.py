"""Shapes: one distance for arrays and UFL, triangles on the surface; a new one is one class."""

from __future__ import annotations

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
    Plane,
    Shape,
    Sphere,
    SphereObstacle,
)

RNG = np.random.default_rng(7)
SOLID = [
    Plane(axis="-y", at=0.3),
    Plane(point=[0.1, 0.2, 0.3], normal=[1, 2, -2]),
    Sphere(center=[0.1, -0.2, 0.3], radius=0.7),
    SphereObstacle(center=[0.1, -0.2, 0.3], radius=2.5, inside=True),
    Cylinder(point=[0.1, -0.2, 0.3], radius=0.7),
    Cylinder(axis=[0, 3, 4], point=[0.1, -0.2, 0.3], radius=0.7),
    CylinderObstacle(axis="x", point=[0.1, -0.2, 0.3], radius=2.5, inside=True),
]
FLAT = [
    Plane(axis="y", at=0.3),
    Plane(point=[0.1, 0.2], normal=[3, -4]),
    SphereObstacle(center=[0.1, -0.2], radius=0.7),
    CylinderObstacle(point=[0.1, -0.2], radius=2.5, inside=True),
    CylinderObstacle(axis="y", point=[0, 0], radius=0.5),
]


def gap_of(shape: Shape, x: Any) -> tuple[Any, Any]:
    gap, normal = shape.gap(list(x.T), float, np.sqrt)
    return np.asarray(gap), np.stack([np.broadcast_to(n, len(x)) for n in normal], axis=1)


@pytest.mark.parametrize("shape", [*SOLID, *FLAT])
def test_the_normal_is_the_gradient_of_the_distance(shape: Shape) -> None:
    """Of length 1, and by central differences; UFL gives the same numbers."""
    dim = 2 if shape in FLAT else 3
    x, step = RNG.uniform(-1.5, 1.5, (40, dim)), 1e-6
    gap, normal = gap_of(shape, x)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=1e-12)
    for axis, unit in enumerate(np.eye(dim)):
        there, here = (gap_of(shape, x + sign * step * unit)[0] for sign in (1, -1))
        np.testing.assert_allclose((there - here) / (2 * step), normal[:, axis], atol=1e-8)
    place = [ufl.as_ufl(float(value)) for value in x[0]]
    found, along = shape.gap(place, ufl.as_ufl, ufl.sqrt)
    np.testing.assert_allclose([float(one) for one in (found, *along)], [gap[0], *normal[0]])


@pytest.mark.parametrize("shape", [*SOLID, *FLAT])
def test_triangles_lie_on_the_surface(shape: Shape) -> None:
    """Of discs and strips in a plane their rims, and what they fill lies behind."""
    dim = 2 if shape in FLAT else 3
    near = Box(np.array([-1.0, -1.0, 0.0]), np.array([1.0, 1.0, 1.0]))
    x, triangles = shape.drawn(near, dim)
    outward = (x[triangles] if dim == 3 else x)[..., :dim]
    gap, _ = gap_of(shape, outward.reshape(-1, dim))
    if dim == 3:
        assert np.abs(gap).max() < 1e-12
        a, b, c = np.moveaxis(x[triangles], 1, 0)
        across = np.cross(b - a, c - a)
        large = np.linalg.norm(across, axis=1) > 1e-9
        _, normal = gap_of(shape, (a + b + c)[large] / 3)
        assert (np.sum(across[large] * normal, axis=1) > 0).all()
    else:
        hollow = -1.0 if shape.hollow else 1.0
        assert (hollow * gap).max() < 1e-12
        assert np.abs(gap).min() < 1e-12


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

    def distance(self, x: Sequence[Scalar], number: Constant, root: Root) -> Distance:
        """See `Shape.distance`."""
        p, q, up = (a - number(c) for a, c in zip(x, self.center, strict=True))
        away = root(p * p + q * q + 1e-20)  # not 0 on the axis
        across = away - number(self.wide)
        length = root(across * across + up * up)
        n = across / length / away
        return length - number(self.radius), [n * p, n * q, up / length]

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
    assert 0 < history["penetration_stamp"][-1] < 1e-3
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
