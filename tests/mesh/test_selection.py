"""Parts picked by geometry: exact counts, and messages that say how near one was."""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic.core.errors import InputError, MeshError
from dolfin_elastic.mesh import (
    Body,
    EdgeSelector,
    PointSelector,
    Selector,
    box_body,
    mesh_statistics,
    name_parts,
    rectangle_body,
)
from dolfin_elastic.mesh.geometry.simplices import facet_corners

COMM = MPI.COMM_WORLD


@pytest.fixture(scope="module")
def box() -> Body:
    """2 x 1 x 1 in millimetres, with cells of 0.25."""
    return box_body(size=(2, 1, 1), cells=(8, 4, 4), scale=1e-3)


def picked(body: Body, scale: float = 1e-3, **keys: Any) -> Body:
    """The body with the surface 'part'."""
    return name_parts(body, surfaces={"part": Selector(**keys)}, scale=scale)


@pytest.mark.parametrize(
    ("kind", "keys", "says"),
    [
        (Selector, {"line": {}}, r"\[edges\]"),
        (Selector, {"nearest": [0, 0, 0]}, r"\[points\]"),
        (EdgeSelector, {"nearest": [0, 0, 0]}, r"\[points\]"),
        (EdgeSelector, {"normal": [0, 0, 1]}, r"\[surfaces\]"),
        (PointSelector, {"line": {}}, r"\[edges\]"),
    ],
)
def test_a_key_of_another_kind_of_part(kind: Any, keys: dict[str, Any], says: str) -> None:
    """The list of the known keys did not say which table takes it."""
    with pytest.raises(InputError, match=says):
        kind(**keys)


@pytest.mark.parametrize(
    ("keys", "area"),
    [
        ({"plane": "z", "at": "min"}, 2.0),
        ({"plane": "x", "at": "max"}, 1.0),
        ({"plane": "x", "at": 2}, 1.0),
        ({"all": True}, 10.0),
        ({"plane": "z", "at": 0, "box": [[0, 0, 0], [0.5, 1, 1]]}, 0.5),
        ({"box": [[2, 1, 1], [1, 0, 0]]}, 1.0 + 4 * 1.0),
        ({"normal": [0, 0, 2]}, 2.0),
        ({"normal": [1, 1, 0], "angle": 46}, 1.0 + 2.0),
        ({"normal": [1, 0, 0], "angle": 180}, 10.0),
        ({"of": "left"}, 1.0),
        ({"of": "left", "box": [[0, 0, 0], [0, 1, 0.5]]}, 0.5),
        ({"plane": "z", "at": 0.2, "tolerance": 0.25}, 2.0),
    ],
)
def test_surfaces_have_the_area_asked_for(box: Body, keys: dict[str, Any], area: float) -> None:
    body = picked(box, **keys)
    expected = area if "tolerance" not in keys else None
    found = mesh_statistics(body).surfaces["part"] * 1e6
    if expected is None:  # the bottom and the lowest layer of the four sides
        expected = 2.0 + 6 * 0.25
    assert found == pytest.approx(expected)


def test_lists_are_joined_and_later_parts_refer_to_earlier_ones(box: Body) -> None:
    ends = [
        Selector(plane="x", at="min"),
        Selector(plane="x", at="max"),
        Selector(plane="x", at="max"),
    ]
    body = name_parts(
        box,
        surfaces={"ends": ends, "low": Selector(of="ends", box=[[0, 0, 0], [2, 1, 0.5]])},
        scale=1e-3,
    )
    assert body.count("ends") == 64 and body.count("low") == 32


def test_regions(box: Body) -> None:
    body = name_parts(
        box,
        regions={
            "half": Selector(box=[[0, 0, 0], [1, 1, 1]]),
            "rest": Selector(box=[[1, 0, 0], [2, 1, 1]]),
            "all": Selector(all=True),
            "low": Selector(of="half", box=[[0, 0, 0], [1, 1, 0.5]]),
            "ball": Selector(sphere={"center": [1, 0.5, 0.5], "radius": 9}),
            "bar": Selector(cylinder={"axis": "x", "point": [0, 0, 0], "radius": 0.6}),
        },
        scale=1e-3,
    )
    size = mesh_statistics(body).regions
    for name, volume in {"half": 1e-9, "rest": 1e-9, "all": 2e-9, "ball": 2e-9}.items():
        assert size[name] == pytest.approx(volume)
    assert size["low"] == pytest.approx(0.5e-9)
    assert size["bar"] == pytest.approx(2e-9 * np.pi * 0.36 / 4, rel=0.1)


def bent(radius: float = 1.0) -> Body:
    """A quarter of a ring between `radius` and twice that, along z."""
    body = box_body(size=(1, np.pi / 2, 1), cells=(2, 12, 2))
    x = body.mesh.geometry.x
    r, angle = radius * (1 + x[:, 0]), x[:, 1].copy()
    x[:, 0], x[:, 1] = r * np.cos(angle), r * np.sin(angle)
    return body


def test_cylinders_and_spheres_as_surfaces() -> None:
    ring = bent()
    axes: list[Any] = ["z", (0, 0, -3)]
    for axis in axes:
        body = picked(ring, 1.0, cylinder={"axis": axis, "point": [0, 0, 7], "radius": 1})
        assert body.count("part") == body.count("left") == 48
    with pytest.raises(MeshError, match=r"on the sphere: 0 .*the nearest is off by 0\.1"):
        picked(ring, 1.0, sphere={"center": [0, 0, 0.5], "radius": 1.0})
    body = picked(ring, 1.0, sphere={"center": [0, 0, 0.5], "radius": 1.0}, tolerance=0.12)
    assert body.count("part") == 48


def test_plane_bodies() -> None:
    plate = rectangle_body(size=(2, 1), cells=(4, 2))
    assert picked(plate, 1.0, normal=[0, 1]).count("part") == 4
    assert picked(plate, 1.0, box=[[0, 0], [1, 1]]).count("part") == 2 + 2 * 2
    inside = name_parts(plate, regions={"r": Selector(box=[[0, 0, 0], [1, 1, 0]])})
    assert mesh_statistics(inside).regions == {"r": pytest.approx(1.0)}
    with pytest.raises(MeshError, match="the body is plane, it has no z"):
        picked(plate, 1.0, plane="z", at="min")


units = pytest.mark.skipif(importlib.util.find_spec("pint") is None, reason="pint is absent")


@units
def test_lengths_with_units_are_absolute(box: Body) -> None:
    assert picked(box, plane="x", at="0.2 cm").count("part") == 32
    assert picked(box, plane="x", at="2e-3 m", tolerance="1 um").count("part") == 32
    with pytest.raises(InputError, match="at.*wrong unit"):
        Selector(plane="x", at="2 kg")


def test_not_quite_flat_feet_say_which_tolerance_helps(box: Body) -> None:
    rough = box_body(size=(2, 1, 1), cells=(8, 4, 4))
    x = rough.mesh.geometry.x
    x[:, 2] -= np.where(x[:, 2] < 1e-9, 0.01 * np.abs(np.sin(7 * x[:, 0] + 5 * x[:, 1])), 0)
    with pytest.raises(MeshError) as caught:
        picked(rough, 1.0, plane="z", at="min")
    text = str(caught.value)
    assert text.startswith("surfaces.part: found 0 of 320 facets of the boundary; on the plane z")
    advised = float(text.partition("tolerance = ")[2].partition(" ")[0])
    assert picked(rough, 1.0, plane="z", at="min", tolerance=advised).count("part") >= 1
    assert picked(rough, 1.0, plane="z", at="min", tolerance=0.01).count("part") == 64


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        (
            {"plane": "x", "at": 9},
            r"on the plane x = 9: 0 \(the nearest is off by 7 mm, allowed is "
            r"2\.45e-06 mm\); the body lies in x from 0 to 2 mm, y from 0 to 1 mm, "
            r"z from 0 to 1 mm$",
        ),
        ({"plane": "x", "at": "min", "normal": [1, 0, 0]}, "on the plane x = 0: 32; facing .*: 32"),
        (
            {"normal": [1, 1, 1]},
            r"facing \(1, 1, 1\): 0 .*off by 54\.7 degrees.* degrees; angle = 56 would find it",
        ),
        ({"of": "lft"}, "no surface 'lft' in box 2 x 1 x 1; did you mean 'left'"),
        ({"box": [[0, 0], [1, 1]]}, "part.box: the body is three-dimensional"),
    ],
)
def test_nothing_found(box: Body, keys: dict[str, Any], said: str) -> None:
    with pytest.raises(MeshError, match=said):
        picked(box, **keys)


def test_names_are_taken_once_and_planes_pick_no_regions(box: Body) -> None:
    with pytest.raises(MeshError, match=r"surfaces\.left: the mesh has a surface 'left' already"):
        name_parts(box, surfaces={"left": Selector(all=True)})
    with pytest.raises(MeshError, match=r"regions\.core: a plane picks surfaces, not regions"):
        name_parts(box, regions={"core": Selector(plane="x", at=0)})
    with pytest.raises(MeshError, match=r"surfaces\.a\[1\]: found 0"):
        name_parts(box, surfaces={"a": [Selector(all=True), Selector(plane="x", at=5)]})
    with pytest.raises(MeshError, match=r"surfaces\.a: an empty list"):
        name_parts(box, surfaces={"a": []})


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({}, "say where"),
        ({"plane": "z"}, "belong together"),
        ({"at": "min"}, "belong together"),
        ({"plane": "z", "at": "mn"}, 'should be "min", "max", a number'),
        ({"angle": 3, "all": True}, "goes with normal"),
        ({"normal": [0, 0, 0]}, "cannot be zero"),
        ({"plan": "z"}, "did you mean 'plane'"),
        ({"sphere": {"centre": [0, 0], "radius": 1}}, "did you mean 'center'"),
        ({"plane": "z", "at": True}, "at"),
        ({"plane": "z", "at": float("nan")}, "at"),
        ({"box": [[0, 0, 0]]}, "box"),
        ({"sphere": {"center": [0, 0, 0], "radius": -1}}, "radius"),
    ],
)
def test_selectors_that_make_no_sense(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        Selector(**keys)


def halves(box: Body, **surfaces: Any) -> Body:
    """The box with the regions 'half' and 'rest', which meet at x = 1, and surfaces."""
    regions = {
        "half": Selector(box=[[0, 0, 0], [1, 1, 1]]),
        "rest": Selector(box=[[1, 0, 0], [2, 1, 1]]),
    }
    return name_parts(box, regions=regions, surfaces=surfaces, scale=1e-3)


@pytest.mark.parametrize(
    ("keys", "area"),
    [
        ({"between": ["half", "rest"]}, 1.0),
        ({"between": ["rest", "half"], "box": [[0, 0, 0], [2, 1, 0.5]]}, 0.5),
        ({"cut": True, "plane": "z", "at": 0.5}, 2.0),
        ({"cut": True, "plane": "z", "at": 0.5, "of": "half"}, 1.0),
        ({"cut": True, "plane": "z", "at": 0.5, "box": [[0, 0, 0], [0.5, 1, 1]]}, 0.5),
    ],
)
def test_inner_surfaces_have_the_area_of_the_interface_or_cut(
    box: Body, keys: dict[str, Any], area: float
) -> None:
    body = halves(box, part=Selector(**keys))
    assert mesh_statistics(body).surfaces["part"] * 1e6 == pytest.approx(area)


def test_a_body_prints_in_a_line(box: Body) -> None:
    text = repr(halves(box))
    assert text.startswith("<Body box 2 x 1 x 1: 768 elements; regions half, rest; surfaces ")
    assert "\n" not in text


def test_a_cut_between_the_nodes_lies_within_a_cell_of_its_plane(box: Body) -> None:
    """It parts the body: what lies beyond has the volume beyond the plane, give or take a cell."""
    body = halves(box, part=Selector(cut=True, plane="x", at=1.1))
    corners = facet_corners(body.mesh, body.owned_facets("part"))
    assert np.all(np.abs(corners[..., 0] - 1.1e-3) < 0.25e-3)
    assert mesh_statistics(body).surfaces["part"] * 1e6 >= 1.0


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"between": ["half", "rset"]}, "no region 'rset'.*'rest'"),
        ({"between": ["half", "half"]}, "'half' and 'half' have .* elements in common"),
        ({"between": ["half", "rest"], "plane": "x", "at": 0.5}, "facets between 'half' and"),
        ({"cut": True, "plane": "x", "at": 3}, "no elements lie on both sides of x = 3"),
        ({"cut": True, "plane": "x", "at": 0.5, "of": "rest"}, "between 1.062 and 1.938"),
    ],
)
def test_inner_surfaces_that_are_not_there(box: Body, keys: dict[str, Any], said: str) -> None:
    with pytest.raises(MeshError, match=said) as caught:
        halves(box, part=Selector(**keys))
    assert caught.value.where.startswith("surfaces.part")


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"cut": True}, "cut goes with plane and at"),
        ({"cut": True, "plane": "z", "at": 1, "normal": [0, 0, 1]}, "normal is of the boundary"),
        ({"between": ["a", "b"], "of": "c"}, "between stands alone"),
        ({"between": ["a"]}, "expected a list of 2"),
    ],
)
def test_keys_that_inner_surfaces_do_not_have(keys: dict[str, Any], said: str) -> None:
    with pytest.raises((InputError, ValueError), match=said):
        Selector(**keys)
