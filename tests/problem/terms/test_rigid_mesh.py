"""Obstacles of triangles: distances, and the same contact as with shapes that have a formula."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from helpers.runs import begun
from helpers.tangents import against_differences
from mpi4py.MPI import MAX

from dolfin_elastic import (
    Case,
    Contact,
    Dynamics,
    NeoHookean,
    Problem,
    Statics,
    Support,
    Traction,
    box_body,
    restart,
    run,
)
from dolfin_elastic.case.check.report import report
from dolfin_elastic.core.errors import InputError, RestartError
from dolfin_elastic.core.jit import compile_c, options
from dolfin_elastic.core.shapes.box import Box
from dolfin_elastic.core.shapes.surface import CODE, LEAF, Surface
from dolfin_elastic.results.finished.draw import obstacles_of
from dolfin_elastic.results.finished.run import FinishedRun

E, NU = 1e6, 0.3
BLOCK = {"size": (1, 1, 1), "cells": (2, 2, 2)}


def written(path: Path, points: Any, triangles: Any, comm: Any) -> str:
    """A file of triangles, which rank 0 writes."""
    if comm.rank == 0:
        meshio.write_points_cells(
            path, np.array(points, float), [("triangle", np.array(triangles))]
        )
    comm.barrier()
    return str(path)


def sheet(n: int, height: Any = lambda x, y: 0 * x, half: float = 2.0) -> tuple[Any, Any]:
    """The surface z = height(x, y) over a square, its normals up."""
    line = np.linspace(-half, half, n + 1)
    x, y = (one.ravel() for one in np.meshgrid(line, line, indexing="ij"))
    i, j = (one.ravel() for one in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    a = i * (n + 1) + j
    b, c, d = a + n + 1, a + n + 2, a + 1
    return np.c_[x, y, height(x, y)], np.vstack([np.c_[a, b, c], np.c_[a, c, d]])


def brick(low: Any, high: Any) -> tuple[Any, Any]:
    """The surface of a box, its normals outwards."""
    points = [
        [x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])
    ]
    sides = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return points, [t for a, b, c, d in sides for t in ([a, b, c], [a, c, d])]


def pressed(degree: int, contact: dict[str, Any], **support: Any) -> Problem:
    """A block, the top of which moves down and sideways."""
    motion = support.pop("displacement", ["0.1*t", 0, "-0.1*t"])
    return Problem(
        box_body(**BLOCK),
        NeoHookean(E=E, nu=NU),
        degree=degree,
        supports=[Support(on="top", displacement=motion)],
        contacts=[Contact.model_validate({"on": "bottom", "name": "floor", **contact})],
    )


def last(problem: Problem, **settings: Any) -> Any:
    *_, state = Statics(problem, **settings).steps()
    return state


# --- distances ---


def nearest_of_all(corners: Any, x: Any) -> tuple[float, Any]:
    """Distance from the nearest of triangles, and its place: of faces, then edges, then corners."""
    found = []
    for a, b, c in corners:
        n = np.cross(b - a, c - a)
        weights = np.linalg.solve(np.c_[b - a, c - a, n], x - a)
        if weights[0] >= 0 and weights[1] >= 0 and weights[0] + weights[1] <= 1:
            found.append(x - weights[2] * n)
        for p, q in ((a, b), (b, c), (c, a)):
            share = np.clip((x - p) @ (q - p) / ((q - p) @ (q - p)), 0, 1)
            found.append(p + share * (q - p))
    distances = [np.linalg.norm(x - place) for place in found]
    return min(distances), found[int(np.argmin(distances))]


def inside(corners: Any, x: Any) -> bool:
    """By the solid angle: independent of any normal at the nearest point."""
    a, b, c = np.moveaxis(corners - x, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    dot = lambda p, q: np.einsum("ni,ni->n", p, q)  # noqa: E731
    below = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb
    return abs(np.sum(2 * np.arctan2(dot(a, np.cross(b, c)), below))) > 2 * np.pi


def test_distances_and_normals(comm):
    """Against all triangles, of a body with concave edges and corners, inside and out."""
    points, triangles = brick((0, 0, 0), (1, 1, 1))
    points, triangles = np.array(points, float), np.array(triangles)
    rng = np.random.default_rng(2)
    points += rng.uniform(-0.1, 0.1, points.shape)
    points = np.vstack([points, points[[1, 3, 7, 5]].mean(axis=0) - [0, 0, 0.7]])  # a dent
    top = [[1, 5, 8], [5, 7, 8], [7, 3, 8], [3, 1, 8]]
    triangles = np.vstack([triangles[:10], top])
    surface = Surface(points, triangles, compile_c(comm, CODE, {"LEAF": LEAF}, options(comm)))
    x = np.vstack(
        [rng.uniform(-0.5, 1.5, (200, 3)), points[[0, 5, 8]] + [[0, 0, 0], [1, -1, 1], [0, 0, 0.2]]]
    )
    near, corners = surface.near(x), points[triangles]
    kinds = near.feature % 7
    assert {0, 1, 4} <= set(np.where(kinds == 0, 0, np.where(kinds < 4, 1, 4)).tolist())
    for place, distance, normal in zip(x, near.distance, near.normal, strict=True):
        exact, foot = nearest_of_all(corners, place)
        side = -1 if inside(corners, place) else 1
        # Round-off of numbers of size 1; on the surface there is no side.
        assert abs(abs(distance) - exact) < 1e-12
        if exact > 1e-12:
            assert distance * side > 0
            assert normal == pytest.approx(side * (place - foot) / exact, abs=1e-11)
    h, forward = 1e-6, np.array([0.3, -0.5, 0.8])
    ahead, behind = surface.near(x + h * forward), surface.near(x - h * forward)
    same = (ahead.feature == behind.feature) & (np.abs(near.distance) > 0.05)
    slope = (ahead.distance - behind.distance)[same] / (2 * h)
    assert slope == pytest.approx(near.normal[same] @ forward, abs=1e-8)


# --- the same as shapes with a formula ---


@pytest.mark.long
@pytest.mark.parametrize(("degree", "friction"), [(1, 0.3), (2, 0.3)])
def test_a_plane_of_triangles(degree, friction, folder, comm):
    """Linear elements with a plane have their forces in UFL, those with triangles never."""
    found = []
    file = written(folder / "plane.stl", *sheet(3), comm)
    for shape in ({"plane": {"axis": "z", "at": 0}}, {"mesh": file}):
        problem = pressed(degree, {"friction": friction, "gap_tolerance": 1e-12, **shape})
        found.append((last(problem, steps=2), problem.u.x.array.copy()))
    (one, u), (two, v) = found
    # Both solves end at a force out of balance of 1e-8 of the others.
    assert two.reactions["floor"] == pytest.approx(one.reactions["floor"], rel=1e-8, abs=1e-8)
    assert np.max(np.abs(u - v), initial=0) < 1e-9
    for key in ("stick_share_floor", "friction_dissipation_floor", "contact_area_floor"):
        # Multipliers of slip are unknowns where triangles are: to 1e-6 of mu p.
        assert two.numbers[key] == pytest.approx(one.numbers[key], rel=3e-6, abs=1e-12)


# Facets of 1/10 lie up to 0.1^2/(4*3) below the ball: 0.6 % of the depth, those of 3/8 all but 9 %.
# Curved ones are off by 0.53^4/(128*3^3): 0.01 % of the depth.
@pytest.mark.parametrize(
    ("degree", "cells", "smooth", "within"),
    [(1, 30, False, 0.02), (2, 30, False, 0.02), (1, 8, True, 2e-4), (2, 8, True, 2e-4)],
)
def test_a_round_cap(degree, cells, smooth, within, folder, comm):
    """A block on a ball of facets, with the force and the pressures of a ball."""
    z = lambda x, y: np.sqrt(9 - x**2 - y**2) - 3  # noqa: E731
    file = written(folder / "cap.ply", *sheet(cells, z, 1.5), comm)
    ball = {"sphere": {"center": [0.5, 0.5, -3], "radius": 3}, "gap_tolerance": 1e-6}
    mesh = {"mesh": {"file": file, "smooth": smooth}, "gap_tolerance": 1e-6}
    found = []
    for shape in (ball, mesh | {"motion": [0.5, 0.5, 0], "curve": "constant"}):
        problem = pressed(degree, shape, displacement=[0, 0, "-0.15*t"])
        force = last(problem, steps=2).reactions["floor"][2]
        found.append(
            (force, comm.allreduce(problem.contact_pairs[0].pressures().max(initial=0), MAX))
        )
    assert found[1] == pytest.approx(found[0], rel=within)


def test_a_smooth_surface(comm):
    """A cylinder with caps: round along its sides, sharp at its ends."""
    m = 24
    angle = 2 * np.pi * np.arange(m) / m
    circle = np.c_[np.cos(angle), np.sin(angle)]
    points = np.vstack(
        [np.c_[circle, 0 * angle], np.c_[circle, 0 * angle + 2], [[0, 0, 0], [0, 0, 2]]]
    )
    i = np.arange(m)
    j, low, high = (i + 1) % m, 0 * i + 2 * m, 0 * i + 2 * m + 1
    triangles = np.vstack(
        [np.c_[i, j, j + m], np.c_[i, j + m, i + m], np.c_[low, j, i], np.c_[high, i + m, j + m]]
    )
    loops = compile_c(comm, CODE, {"LEAF": LEAF}, options(comm))
    surface = Surface(points, triangles, loops, smooth=True)
    x = np.random.default_rng(1).uniform([-1.3, -1.3, -0.3], [1.3, 1.3, 2.3], (500, 3))
    near = surface.near(x)
    out, beyond = np.hypot(x[:, 0], x[:, 1]) - 1, np.maximum(-x[:, 2], x[:, 2] - 2)
    exact = np.where((out > 0) & (beyond > 0), np.hypot(out, beyond), np.maximum(out, beyond))
    # Parabolas through arcs of 15 degrees: (pi/12)^4/128; facets are off by 0.0086.
    assert near.distance == pytest.approx(exact, abs=4e-5)
    h = 1e-5
    for axis in np.eye(3):
        ahead, behind = surface.near(x + h * axis), surface.near(x - h * axis)
        same = (ahead.feature == near.feature) & (behind.feature == near.feature)
        assert set(near.feature[same] % 7) == {0, 1, 2}
        slope = (ahead.distance - behind.distance)[same] / (2 * h)
        turn = (ahead.normal - behind.normal)[same] / (2 * h)
        # Of differences h^2 over the distance, of which the smallest is 0.002, squared.
        assert slope == pytest.approx(near.normal[same] @ axis, abs=1e-6)
        assert turn == pytest.approx(near.curvature[same] @ axis, rel=1e-4, abs=1e-5)


@pytest.mark.long
def test_a_cavity_under_a_force(folder, comm):
    """A body inside a box of triangles, one wall of which is pressed on as a plane would be."""
    file = written(folder / "box.stl", *brick((-1, -1, 0), (2, 2, 5)), comm)
    force = {"force": "5e4*t", "direction": "z"}
    found = []
    for shape in ({"plane": {"axis": "z", "at": 0}}, {"mesh": {"file": file, "inside": True}}):
        problem = pressed(2, force | shape, displacement=[0, 0, 0])
        found.append(last(problem, steps=1).numbers["obstacle_displacement_floor"])
    assert found[0] > 0.01
    # The force on the obstacle is met to 1e-10.
    assert found[1] == pytest.approx(found[0], rel=1e-8)


# --- edges ---

OBSTACLES: dict[str, Any] = {
    "step": brick((-1, -1, -1), (0.45, 2, 0)),
    "bumps": sheet(16, lambda x, y: 0.01 * np.sin(9 * x) * np.sin(7 * y) - 0.01),
}


@pytest.mark.long
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("shape", OBSTACLES)
def test_edges_of_facets(shape, degree, folder, comm):
    """At which normals jump: Newton's method settles, in one load step."""
    file = written(folder / "edges.stl", *OBSTACLES[shape], comm)
    problem = pressed(degree, {"mesh": file})
    *states, end = Statics(problem, steps=1).steps()
    assert len(states) <= 1  # the start
    assert end.t == 1.0
    assert end.newton < 30
    assert end.reactions["floor"][2] == pytest.approx(-end.reactions["top"][2], rel=1e-6)
    (pair,) = problem.contact_pairs
    # A point may have another facet once the step is accepted: within the largest tolerance.
    assert pair.gap_error()[0] <= pair.tolerance


@pytest.mark.long
def test_friction_in_valleys(folder, comm):
    """Points that come to lie where facets meet, and stick there, end no iteration late."""
    cup = sheet(12, lambda x, y: 0.3 * ((x - 0.5) ** 2 + (y - 0.5) ** 2))
    file = written(folder / "cup.stl", *cup, comm)
    problem = pressed(1, {"mesh": file, "friction": 0.3}, displacement=["0.05*t", 0, "-0.1*t"])
    states = list(Statics(problem, steps=3).steps())
    assert [state.t for state in states[1:]] == pytest.approx([1 / 3, 2 / 3, 1])
    # Points that pass between facets for as long as they may take 115.
    assert max(state.newton for state in states) <= 20


@pytest.mark.parametrize("degree", [1, 2])
def test_tangent_on_edges(degree, folder, comm):
    """With points beyond an edge and a corner, of which the surface is round."""
    file = written(folder / "corner.stl", *brick((-1, -1, -1), (0.4, 0.6, -0.03)), comm)
    contact = {"on": "bottom", "mesh": {"file": file, "offset": 0.1}}
    problem = Problem(
        box_body(**BLOCK),
        NeoHookean(E=E, nu=NU),
        degree=degree,
        contacts=[Contact.model_validate(contact)],
    )
    (pair,) = problem.contact_pairs
    pair.lam.x.array[:] = 3e3
    with against_differences(problem) as (assembler, off, size):
        assert comm.allreduce(int(np.sum(pair.pressures() > 0))) > 0
        # Cancellation: 1e-16 of the forces over 1e-7 of the place.
        assert off < 1e-7 * size
        assert assembler.tangent.matrix.isSymmetric(1e-9 * size)


def test_a_blade_does_not_pass(folder, comm):
    """A blade a tenth as thick as the body is moved: steps end before it is through."""
    file = written(folder / "blade.stl", *brick((-1, -1, -0.1), (2, 2, 0)), comm)
    problem = pressed(1, {"mesh": file}, displacement=[0, 0, "-0.4*t"])
    states = list(Statics(problem, steps=1).steps())
    assert np.diff([state.t for state in states]).max() <= 0.5 * 0.1 / 2 / 0.4 + 1e-12
    assert states[-1].numbers["penetration_floor"] <= problem.contact_pairs[0].tolerance


@pytest.mark.long
@pytest.mark.parametrize("degree", [1, 2])
def test_a_load_does_not_pass(degree, folder, comm):
    """A load presses a beam on a thin plate below its end: as on a half space, in more steps."""
    file = written(folder / "plate.stl", *brick((2, -1, -0.12), (5, 2, -0.1)), comm)
    found = []
    for shape in ({"plane": {"axis": "z", "at": -0.1}}, {"mesh": file}):
        problem = Problem(
            box_body(size=(4, 1, 1), cells=(4, 1, 1)),
            NeoHookean(E=E, nu=NU),
            degree=degree,
            supports=[Support(on="left")],
            loads=[Traction(on="right", value=[0, 0, "-0.02 MPa"])],
            contacts=[Contact.model_validate({"on": "bottom", "name": "floor", **shape})],
        )
        found.append(last(problem, steps=2).reactions["floor"][2])
    assert found[0] > 0.0
    # Both end within the tolerance of gaps, 1e-2 of what the pressure shortens an element by.
    assert found[1] == pytest.approx(found[0], rel=0.01)


# --- motion, runs that go on, cases ---


@pytest.mark.long
@pytest.mark.parametrize("scheme", ["symplectic-euler", "generalized-alpha"])
def test_motion(scheme, folder, comm):
    """A block falls on triangles as on a plane."""
    file, found = written(folder / "plane.stl", *sheet(2), comm), []
    for shape in ({"plane": {"axis": "z", "at": 0}}, {"mesh": file}):
        problem = Problem(
            box_body(**BLOCK),
            NeoHookean(E=E, nu=NU, density=1000),
            degree=1,
            contacts=[Contact.model_validate({"on": "bottom", "name": "floor", **shape})],
        )
        steps = {"dt": 2e-3} if scheme == "generalized-alpha" else {"every": 100}
        motion = Dynamics(problem, scheme=scheme, end=0.02, initial_velocity=[0, 0, -1], **steps)
        *_, state = motion.steps()
        found.append((state.reactions["floor"][2], state.energies["contact"]))
    assert found[0][0] != 0.0
    assert found[1] == pytest.approx(found[0], rel=1e-7)


def tables(file: str) -> dict[str, Any]:
    return {
        "mesh": {"box": {"size": [10, 10, 10], "cells": [2, 2, 2]}, "unit": "mm", "degree": 1},
        "materials": {"rubber": {"law": "neo-hookean", "E": E, "nu": NU}},
        "support": [{"on": "top"}],
        "contact": [
            {
                "on": "bottom",
                "name": "mould",
                "mesh": {"file": file, "unit": "cm"},
                "motion": [0, 0, "1 mm"],
            }
        ],
        "statics": {"steps": 1},
    }


def test_in_a_case(folder, comm):
    """Paths are relative to the case file; a path alone is enough; units are those of the file."""
    written(folder / "plane.obj", *sheet(2), comm)
    case = Case.from_dict(tables("plane.obj"), folder)
    assert Case.from_dict(case.to_dict(), folder) == case
    body = case.read_body(comm)
    assert any("plane.obj': 8 triangles, open" in one for one in body.information)
    problem = case.make_problem(body)
    state = last(problem, steps=1)
    assert state.reactions["mould"][2] > 0
    extent = np.ptp(body.obstacles[problem.contact_pairs[0].contact.mesh.key].points, axis=0)
    assert extent == pytest.approx([0.04, 0.04, 0])
    assert not any("facets" in one for one in report(case, comm=comm).notes)
    # A quarter turn of y into z about a line 1 mm above the plane, then 20 cm down: y = 1 mm.
    moved = tables("plane.obj")
    turn = {"axis": "x", "angle": 90, "point": [0, 0, 1]}
    moved["contact"][0]["mesh"] |= {"turn": turn, "move": [0, 0, "-20 cm"]}
    placed = Case.from_dict(moved, folder)
    assert Case.from_dict(placed.to_dict(), folder) == placed
    gaps, _ = (
        placed.make_problem(body)
        .contact_pairs[0]
        .contact.obstacle.gaps(np.array([[0.0, -0.009, -0.18], [0, 0.002, -0.24]]))
    )
    assert gaps == pytest.approx([0.01, -np.hypot(0.001, 0.021)], abs=1e-15)
    hills = sheet(4, lambda x, y: 0.1 * np.sin(x) * np.sin(y) - 0.1)
    written(folder / "plane.obj", *hills, comm)
    (note,) = [one for one in report(case, comm=comm).notes if "facets" in one]
    assert "facets of plane.obj are up to 14.2 mm long where it is curved, elements 5 mm" in note
    alone = tables("plane.obj")
    alone["contact"][0]["mesh"] = "plane.obj"
    assert Case.from_dict(alone, folder).contact[0].mesh.file == "plane.obj"


@pytest.mark.long
def test_a_run_goes_on(folder, comm):
    """As if it had not ended; not with another surface.  Its folder is enough for pictures."""
    row = tables("bumps.stl")
    row["mesh"]["unit"] = row["contact"][0]["mesh"]["unit"] = "cm"
    row["contact"][0] |= {"motion": [0, 0, "10 mm"], "friction": 0.2}
    case = Case.from_dict(row | {"statics": {"steps": 3}}, folder)

    def bumps(size: float) -> None:
        surface = sheet(12, lambda x, y: size * np.sin(x) * np.sin(y) - 0.1, 12.0)
        written(folder / "bumps.stl", *surface, comm)

    bumps(0.1)
    *_, whole = run(case, output=folder / "whole")
    begun(case, folder / "a", 1)
    bumps(0.11)
    with pytest.raises(RestartError, match="its surfaces of obstacles differ"):
        next(restart(folder / "a"))
    bumps(0.1)
    *_, state = restart(folder / "a")
    assert state.reactions["mould"] == pytest.approx(whole.reactions["mould"], rel=1e-11)
    assert state.numbers == pytest.approx(whole.numbers, rel=1e-11, abs=1e-15)
    if comm.rank == 0:
        finished = FinishedRun(folder / "whole")
        assert finished.case["contact"][0]["mesh"]["file"] == "bumps.stl"
        ((_, shape, shift),) = obstacles_of(finished, 1.0)
        points, triangles = shape.drawn(Box(-np.ones(3), np.ones(3)), 3)
        assert len(triangles) == 288
        assert np.ptp(points, axis=0)[:2] == pytest.approx([0.24, 0.24])
        assert shift == pytest.approx([0, 0, 0.01])
    comm.barrier()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"file": "plain.stl"}, r"contact\[0\].mesh.file: there is no mesh file .*plane.stl"),
        ({"unit": "kg"}, r"contact\[0\].mesh.unit: 'kg' is no unit of length"),
        ({"turn": {"axis": [1, 0], "angle": 9}}, r"mesh.turn.axis: 2 components given"),
        ({"turn": {"axis": "x", "angle": "1 mm"}}, r"mesh.turn.angle: .*expected a number in deg"),
        ({"move": [1, 2]}, r"contact\[0\].mesh.move: .*3"),
        ({"size": 1}, r"contact\[0\].mesh.file: .*size is given, but the facets of this file are"),
    ],
)
def test_what_is_refused(change, said, folder, comm):
    written(folder / "plane.stl", *sheet(2), comm)
    row = tables("plane.stl")
    row["contact"][0]["mesh"] |= change
    with pytest.raises(InputError, match=said):
        case = Case.from_dict(row, folder)
        case.make_problem(case.read_body(comm))
