"""Edges and arcs of a boundary: exact ones of CAD files, and what facets alone tell."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.bodies import drawing
from helpers.cad import angle, write
from helpers.ranks import SIZES, on_ranks
from mpi4py import MPI

from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.mesh import Body, read_body
from dolfin_elastic.mesh.body import boundary_shape
from dolfin_elastic.mesh.geometry.curved import facet_areas
from dolfin_elastic.mesh.geometry.simplices import facet_corners
from dolfin_elastic.mesh.refine.refinement import refine_body

COMM = MPI.COMM_WORLD


def lengths_of_edges(body: Body) -> dict[int, float]:
    """Interior angle [degree] to the length of all edges that have it, in the file's unit.

    Collective.
    """
    shape = boundary_shape(body)
    x = facet_corners(body.mesh, shape.facets)
    sides = np.stack([x[:, (k + 2) % 3] - x[:, (k + 1) % 3] for k in range(3)], axis=1)
    lengths = np.linalg.norm(sides, axis=2) / 2 / body.unit.metres
    angles = np.round(np.degrees(shape.angles)).astype(int)
    found = [
        (int(a), float(w))
        for a, w in zip(angles[~shape.smooth], lengths[~shape.smooth], strict=True)
    ]
    sums: dict[int, float] = {}
    for degrees, length in [one for part in body.comm.allgather(found) for one in part]:
        sums[degrees] = sums.get(degrees, 0.0) + length
    return sums


def boss(occ: Any) -> None:
    """A plate with a round boss that stands on it without a fillet, and a step."""
    plate = [(3, occ.addBox(0, 0, 0, 20, 10, 3)), (3, occ.addBox(0, 0, 0, 4, 10, 6))]
    occ.fuse(plate[:1], [plate[1], (3, occ.addCylinder(13, 5, 3, 0, 0, 4, 2))])


@pytest.mark.parametrize("curved", [True, False])
def test_re_entrant_edges_are_those_of_the_file(folder: Path, curved: bool) -> None:
    """The foot of the boss, of about 2 pi 2, and that of the step, of 10; both of 270 degrees.

    Also on the body that is refined, and on any ranks.
    """
    write(folder / "boss.step", boss)
    body = read_body(folder / "boss.step", size=1.5, curved=curved)
    for one in (body, refine_body(body, body.owned_cells()[:40]).body):
        found = lengths_of_edges(one)
        assert set(found) == {90, 270}
        assert found[270] == pytest.approx(10 + 4 * np.pi, rel=0.03)
        assert boundary_shape(one).exact.all()
    at = [on_ranks(n, lambda comm: _of(comm, folder / "boss.step", curved)) for n in SIZES]
    for other in at[1:]:
        assert other == pytest.approx(at[0])


def _of(comm: Any, path: Path, curved: bool) -> dict[int, float]:
    return lengths_of_edges(read_body(path, comm=comm, size=1.5, curved=curved))


@pytest.mark.long
@pytest.mark.sample(2)
@pytest.mark.parametrize("size", [1.0, 4.0, 9.0])
def test_a_fillet_is_no_edge_however_coarse_it_is(folder: Path, size: float) -> None:
    """One cell on its quarter circle: the angle of its facets, 45 or 90 degrees, was an edge's."""
    write(folder / "angle.step", angle)
    for curved in (True, False):
        body = read_body(folder / "angle.step", size=size, curved=curved)
        assert set(lengths_of_edges(body)) == {90}
        (finer, turn) = (refine_body(body, body.owned_cells()).body, boundary_shape(body).turn)
        assert set(lengths_of_edges(finer)) == {90}
        most = max(COMM.allgather(np.degrees(turn.max(initial=0.0))))
        assert most < 45 if size == 1 else most > 45
        sharpest = min(COMM.allgather(boundary_shape(body).bend.min(initial=0.0)))
        assert sharpest == pytest.approx(-1 / 1.5e-3, rel=0.02)  # of the hole


def notched(path: Path, turns: list[float]) -> None:
    """A block whose lower side has a notch with these re-entrant angles [degree], of one cell each.

    A finished mesh of straight cells.
    """
    heading = np.cumsum([sum(turns) / 2, *(-t for t in turns)])
    steps = np.column_stack([np.cos(np.radians(heading)), np.sin(np.radians(heading))])
    x = np.concatenate([[[0.0, 0.0]], np.cumsum(steps, axis=0)])
    width = x[-1, 0]
    corners = [*x, [width + 6, 0], [width + 6, 9], [-6, 9], [-6, 0]]
    with drawing() as gmsh:
        geo = gmsh.model.geo
        points = [geo.addPoint(*p, 0, 3.0) for p in corners]
        lines = [geo.addLine(a, b) for a, b in zip(points, [*points[1:], points[0]], strict=True)]
        geo.addPlaneSurface([geo.addCurveLoop(lines)])
        for line in lines[: len(steps)]:
            geo.mesh.setTransfiniteCurve(line, 2)
        geo.extrude([(2, 1)], 0, 0, 4, [2])
        geo.synchronize()
        gmsh.model.mesh.generate(3)
        gmsh.write(str(path))


@pytest.mark.parametrize(
    ("turns", "arc"),
    [
        ([30.0, 30.0, 30.0], True),
        ([45.0, 45.0], True),
        ([22.5, 45.0, 22.5], True),
        ([40.0], False),
        ([70.0, 70.0], False),
    ],
)
def test_arcs_of_facets(folder: Path, turns: list[float], arc: bool) -> None:
    """A chain of parallel edges of like angles is a round; a lone one, or a sharp one, is an edge.

    The ends of the notch are convex edges of half of its angle.
    """
    path = folder / "notch.msh"
    on_root(COMM, lambda: notched(path, turns))
    body = read_body(path)
    for one in (body, refine_body(body, body.owned_cells()).body):
        shape = boundary_shape(one)
        re_entrant = (shape.angles > np.pi + 1e-3) & ~shape.smooth
        count = COMM.allreduce(int(np.count_nonzero(re_entrant)))
        assert (count == 0) == arc


def drawn(path: Path, count: int) -> None:
    """A disk of radius 2 whose circle has so many straight cells; without the CAD file."""
    with drawing() as gmsh:
        gmsh.model.occ.addDisk(0, 0, 0, 2, 2)
        gmsh.model.occ.synchronize()
        gmsh.model.mesh.setTransfiniteCurve(1, count + 1)
        gmsh.model.mesh.generate(2)
        gmsh.write(str(path.with_suffix(".msh")))
        gmsh.write(str(path.with_suffix(".brep")))


@pytest.mark.parametrize("count", [12, 24])
def test_the_area_that_straight_cells_cut_off(folder: Path, count: int) -> None:
    """A regular polygon is smaller than its circle by (pi - n/2 sin(2 pi/n)) r^2.

    Both rules are of the third order in the angle: 2 and 0.4 % of the area itself, 0.5 times
    the square of the angle.
    """
    on_root(COMM, lambda: drawn(folder / "disk", count))
    size = 2 * 2 * np.sin(np.pi / count)
    exact = 4 * (np.pi - count / 2 * np.sin(2 * np.pi / count))
    given = read_body(folder / "disk.msh")
    made = read_body(folder / "disk.brep", size=size, curved=False)
    for body in (given, made, refine_body(given, given.owned_cells()).body):
        shape = boundary_shape(body)
        areas = facet_areas(body.mesh, shape.facets)
        found = COMM.allreduce(float(areas @ shape.gap))
        assert found == pytest.approx(
            exact, rel=0.5 * (2 * np.pi / count) ** 2 if body is not made else 0.2
        )
    assert (boundary_shape(read_body(folder / "disk.brep", size=size)).gap == 0).all()


def test_the_volume_that_straight_cells_cut_off(folder: Path) -> None:
    """A ball: what is missing of its volume, from normals and from the angles between facets."""
    write(folder / "ball.brep", lambda occ: occ.addSphere(0, 0, 0, 1))
    body = read_body(folder / "ball.brep", size=0.35, curved=False)
    bare = Body(body.mesh)
    volume = COMM.allreduce(float(_volume(body)))
    for one in (body, bare):
        shape = boundary_shape(one)
        found = COMM.allreduce(float(facet_areas(one.mesh, shape.facets) @ shape.gap))
        assert found == pytest.approx(4 / 3 * np.pi - volume, rel=0.05)


def _volume(body: Body) -> float:
    from dolfin_elastic.mesh.geometry.curved import cell_volumes

    return float(cell_volumes(body.mesh)[body.owned_cells()].sum())
