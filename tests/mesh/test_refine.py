"""Refined bodies: shapes, names, fields and curved boundaries, on any number of ranks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from helpers.annulus import annulus
from helpers.cad import angle, write
from mpi4py import MPI

from dolfin_elastic import Selector, box_body, name_parts, read_body, rectangle_body
from dolfin_elastic.core.parallel import on_root, total
from dolfin_elastic.mesh import Body, EdgeSelector, PointSelector
from dolfin_elastic.mesh.body import boundary_shape
from dolfin_elastic.mesh.fields import MeshField
from dolfin_elastic.mesh.geometry.curved import (
    cell_volumes,
    facet_areas,
    facet_points,
    smallest_jacobians,
)
from dolfin_elastic.mesh.geometry.simplices import (
    boundary_facets,
    cell_corners,
    edge_nodes,
    facet_corners,
)
from dolfin_elastic.mesh.refine.cad_surfaces import _restore_folded
from dolfin_elastic.mesh.refine.marking import bulk
from dolfin_elastic.mesh.refine.refinement import refine_body

WORLD = MPI.COMM_WORLD
PIPE = """\
SetFactory("OpenCASCADE");
Cylinder(1) = {0, 0, 0, 0, 0, 1, 0.6, Pi/2};
Cylinder(2) = {0, 0, 0, 0, 0, 1, 0.4, Pi/2};
BooleanDifference(3) = { Volume{1}; Delete; }{ Volume{2}; Delete; };
Mesh.MeshSizeMax = 0.5;
"""
SECTOR = """\
Point(1) = {0, 0, 0}; Point(2) = {1, 0, 0, 0.5}; Point(3) = {2, 0, 0, 0.5};
Point(4) = {0, 2, 0, 0.5}; Point(5) = {0, 1, 0, 0.5};
Line(1) = {2, 3}; Circle(2) = {3, 1, 4}; Line(3) = {4, 5}; Circle(4) = {5, 1, 2};
Curve Loop(1) = {1, 2, 3, 4}; Plane Surface(1) = {1};
Physical Curve("inside") = {4}; Physical Curve("outside") = {2}; Physical Surface("ring") = {1};
"""


def near(body: Body, place: Any, radius: float) -> np.ndarray:
    """Owned cells whose middle is near a place."""
    middles = cell_corners(body.mesh).mean(axis=1)[: len(body.owned_cells())]
    return np.flatnonzero(np.linalg.norm(middles - place, axis=1) < radius).astype(np.int32)


def volume(body: Body, cells: Any = slice(None)) -> float:
    return float(total(WORLD, cell_volumes(body.mesh)[cells].sum()))


def area(body: Body, name: str) -> float:
    return float(total(WORLD, facet_areas(body.mesh, body.owned_facets(name)).sum()))


@pytest.mark.parametrize("dim", [2, 3])
def test_shapes_and_names(dim: int) -> None:
    """Volumes and areas of all parts, one of them inside the body, are those before, to round-off.

    A mesh with hanging nodes would have boundary facets inside: the whole boundary's area is
    compared, too.
    """
    body = box_body(size=[1, 2, 3][:dim], cells=[4, 2, 3][:dim])
    known = body.mesh.topology.index_map(dim - 1)
    facets = np.arange(known.size_local + known.num_ghosts, dtype=np.int32)
    inside = np.abs(facet_corners(body.mesh, facets)[:, :, 0] - 0.5).max(axis=1) < 1e-9
    body = name_parts(
        body.named(surfaces={"cut": facets[inside]}),
        surfaces={"all": Selector(all=True)},
        regions={"half": Selector(box=[[0, 0, 0][:dim], [0.5, 2, 3][:dim]])},
    )
    before = {name: area(body, name) for name in body.surfaces}
    whole, half = volume(body), volume(body, body.regions["half"])
    assert before["cut"] == pytest.approx([2, 6][dim - 2])
    for radius in (1.2, 0.6):
        count = body.num_cells
        body = refine_body(body, near(body, np.zeros(dim), radius)).body
        assert body.num_cells > count
    again = name_parts(body, surfaces={"skin": Selector(all=True)})
    assert {name: area(body, name) for name in before} == pytest.approx(before, rel=1e-12)
    assert area(again, "skin") == pytest.approx(before["all"], rel=1e-12)
    assert (volume(body), volume(body, body.regions["half"])) == pytest.approx((whole, half))
    assert smallest_jacobians(body.mesh).min(initial=1.0) > 0


def test_nothing_marked_changes_nothing() -> None:
    """The same cells and names, whatever the ranks."""
    body = box_body(size=[1, 1], cells=[3, 3])
    same = refine_body(body, np.empty(0, dtype=np.int32)).body
    assert same.num_cells == body.num_cells
    assert {n: same.count(n) for n in same.surfaces} == {n: body.count(n) for n in body.surfaces}


def test_fields_follow() -> None:
    """Values of cells are those of the parents; at points a linear field stays linear."""
    body = box_body(size=[1, 1, 1], cells=[2, 2, 2])
    middles = cell_corners(body.mesh).mean(axis=1)
    linear = body.mesh.geometry.x @ np.array([[1.0, 0], [2, 1], [3, 0]])
    fields = {
        "side": MeshField("cell", (middles[:, :1] > 0.5).astype(float)),
        "T": MeshField("point", linear),
    }
    fine = refine_body(
        Body(body.mesh, body.regions, body.surfaces, fields=fields), near(body, np.zeros(3), 0.8)
    ).body
    x = fine.mesh.geometry.x
    assert np.allclose(fine.fields["T"].values, x @ np.array([[1.0, 0], [2, 1], [3, 0]]))
    side = cell_corners(fine.mesh).mean(axis=1)[:, :1] > 0.5
    assert np.array_equal(fine.fields["side"].values, side)


def test_curved_cells_keep_their_shape() -> None:
    """A part of a quadratic cell is a quadratic cell: its area to round-off.

    The arc's length is no polynomial: the rule of degree 8 leaves 1e-9, chords would leave 1e-3.
    """
    body = annulus(WORLD, 2)
    whole, arc = volume(body), area(body, "inside")
    for _ in range(2):
        body = refine_body(body, near(body, np.array([1.0, 0.0]), 0.8)).body
    assert body.mesh.geometry.cmap.degree == 2
    assert volume(body) == pytest.approx(whole, rel=1e-12)
    assert area(body, "inside") == pytest.approx(arc, rel=1e-8)


@pytest.mark.long
@pytest.mark.parametrize("curved", [False, True])
def test_arcs_of_cad(tmp_path: Path, curved: bool) -> None:
    """Nodes that are made on an arc lie on it; the area approaches the exact one by the rate.

    Sides of chords leave h^2 of the area, quadratic ones h^4: halving h divides by 4 and 16.
    """
    path = on_root(WORLD, lambda: tmp_path) / "sector.geo"
    on_root(WORLD, lambda: path.write_text(SECTOR))
    body, off = read_body(path, curved=curved), []
    for _ in range(3):
        off.append(abs(volume(body) - 0.75 * np.pi))
        for name, radius in (("inside", 1.0), ("outside", 2.0)):
            ends = np.array([[0.0], [0.5], [1.0]] if curved else [[0.0], [1.0]])
            x, _ = facet_points(body.mesh, body.owned_facets(name), ends)
            assert np.allclose(np.linalg.norm(x, axis=-1), radius, rtol=0, atol=1e-9)
        body = refine_body(body, body.owned_cells()).body
    least = 12 if curved else 3.7
    assert off[0] / off[1] > least
    assert off[1] / off[2] > least


@pytest.mark.parametrize("curved", [False, True])
def test_surfaces_of_cad(tmp_path: Path, curved: bool) -> None:
    """A quarter of a pipe in mm: cylinders, their circular rims, and plane ends that stay plane.

    The area of the skin approaches the exact one by the rate, h^2 and h^4.
    """
    path = on_root(WORLD, lambda: tmp_path) / "pipe.geo"
    on_root(WORLD, lambda: path.write_text(PIPE))
    body = read_body(path, curved=curved, scale=1e-3)
    surfaces = {
        "bore": Selector(cylinder={"axis": "z", "point": [0, 0, 0], "radius": 4e-4}),
        "skin": Selector(cylinder={"axis": "z", "point": [0, 0, 0], "radius": 6e-4}),
        "low": Selector(plane="z", at="min"),
    }
    body = name_parts(body, surfaces=surfaces)
    exact = 0.6 * np.pi / 2 * 1e-6
    off = abs(area(body, "skin") - exact)
    body = refine_body(body, body.owned_cells()).body
    assert not body.notes
    ends = np.array(
        [[0, 0], [1, 0], [0, 1]] + curved * [[0.5, 0], [0, 0.5], [0.5, 0.5]], dtype=float
    )
    for name, radius in (("bore", 4e-4), ("skin", 6e-4)):
        x, _ = facet_points(body.mesh, body.owned_facets(name), ends)
        assert np.allclose(np.linalg.norm(x[..., :2], axis=-1), radius, rtol=0, atol=1e-9)
    x, _ = facet_points(body.mesh, body.owned_facets("low"), ends)
    assert np.allclose(x[..., 2], 0, rtol=0, atol=1e-12)
    assert smallest_jacobians(body.mesh).min(initial=1.0) > 0.05
    assert off / abs(area(body, "skin") - exact) > (10 if curved else 3)


def off_cylinder(body: Body, name: str, middle: Any, columns: list[int], r: float) -> Any:
    """Nodes of a face of quadratic cells and their distances from a cylinder, in mm. Collective."""
    six = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0], [0, 0.5], [0.5, 0.5]])
    facets = np.intersect1d(body.surface(name), boundary_facets(body.mesh))
    nodes = facet_points(body.mesh, facets, six)[0].reshape(-1, 3) / 1e-3
    nodes = np.unique(np.concatenate(WORLD.allgather(nodes)).round(7), axis=0)
    return np.abs(np.linalg.norm(nodes[:, columns] - middle, axis=1) - r)


def test_nodes_within_follow_those_that_move_to_cad(tmp_path: Path) -> None:
    """One element on a fillet of 4 mm: seven nodes stayed off it, for cells behind would fold."""
    path = on_root(WORLD, lambda: tmp_path) / "angle.step"
    write(path, angle)
    body = read_body(path, size=8)
    body = refine_body(body, body.owned_cells()).body
    assert not body.notes
    assert off_cylinder(body, "face 3", [7, 7], [0, 2], 4).max() < 1e-6
    assert smallest_jacobians(body.mesh).min(initial=1.0) > 0.05


def test_nodes_that_stay_off_cad_are_told_again(tmp_path: Path) -> None:
    """Where cells fold on the face itself nodes stay off, and count on each later mesh.

    Their number and largest distance are those of the nodes of that face from the exact cylinder.
    """
    path = on_root(WORLD, lambda: tmp_path) / "angle.step"
    write(path, angle)
    body = read_body(path, size=10)
    for turn in (45.0, 90.0):
        body = refine_body(body, body.owned_cells()).body
        off = off_cylinder(body, "face 10", [14, 3], [0, 1], 1.5)
        (note,) = body.notes
        assert note.startswith(
            f"{np.count_nonzero(off > 2.7e-5)} nodes are off face 10 (cylinder r 1.5 mm, hole) of "
            f"angle.step, by up to {off.max():.3g} mm at ("
        )
        turns = np.concatenate(WORLD.allgather(boundary_shape(body).turn))
        assert turns.max() > np.deg2rad(turn), "halved by each refinement if it were on the face"


def test_marking_carries_its_share() -> None:
    """As few cells as have half of the sum: those that sorting on one rank would take."""
    every = np.random.default_rng(1).random(1000) ** 4
    mine = every[WORLD.rank :: WORLD.size]
    marked = bulk(WORLD, mine, 0.5)
    descending = np.sort(every)[::-1]
    wanted = int(np.searchsorted(np.cumsum(descending), 0.5 * every.sum())) + 1
    assert total(WORLD, len(marked)) == wanted
    assert not len(bulk(WORLD, np.zeros(3), 0.5))


def test_edges_and_points() -> None:
    """Mesh edges are halved and keep their name and length; a node keeps its name, and it alone."""
    body = box_body(size=[1, 1, 1], cells=[2, 2, 2])
    body = name_parts(
        body,
        edges={"rim": EdgeSelector(between=["left", "top"])},
        points={"corner": PointSelector(nearest=(0, 0, 1))},
    )
    for _ in range(2):
        body = refine_body(body, near(body, np.array([0, 0, 1]), 0.8)).body
    x = body.mesh.geometry.x[edge_nodes(body.mesh, body.owned_edges("rim"))]
    lengths = np.linalg.norm(x[:, 1] - x[:, 0], axis=1)
    assert total(WORLD, len(lengths)) > 2
    assert total(WORLD, lengths.sum()) == pytest.approx(1, rel=1e-12)
    assert np.allclose(x[..., [0, 2]], [0, 1])
    corner = body.mesh.geometry.x[body.owned_points("corner")]
    assert total(WORLD, len(corner)) == 1
    assert np.allclose(corner, [0, 0, 1])


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize(("left", "back"), [(0.05, 1), (0.2, 0)])
def test_nodes_that_would_fold_cells_go_back(size: float, left: float, back: int) -> None:
    """A node of a square's corner that leaves a twentieth of its cell is put back, in any unit."""
    body = rectangle_body(size=(size, size), cells=(2, 2))
    space = fem.functionspace(body.mesh, ("Lagrange", 1))
    x = space.tabulate_dof_coordinates()[:, :2].copy()
    # The two cells of the corner square share its diagonal, or one cell has the corner alone.
    corners = cell_corners(body.mesh)
    corner = np.array([[0.0, 0.0], [size, 0.0], [0.0, size], [size, size]])
    alone = next(
        c
        for c in corner
        if total(WORLD, int((np.linalg.norm(corners - c, axis=2) < 1e-9 * size).sum())) == 1
    )
    inwards = np.sign(size / 2 - alone) * size / 4  # to the middle of the diagonal: a flat cell
    moved = x.copy()
    moved[np.linalg.norm(x - alone, axis=1) < 1e-9 * size] += (1 - left) * inwards
    assert _restore_folded(body, space, x, moved) == back
    change = np.linalg.norm(moved - x, axis=1).max(initial=0.0)
    assert (WORLD.allreduce(float(change), op=MPI.MAX) > 0) is (back == 0)
