"""Kinds of support: rollers, symmetry, rotation, springs, dashpots."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import locate_entities_boundary
from helpers.bodies import turned
from helpers.states import last
from mpi4py import MPI

from dolfin_elastic import (
    BodyForce,
    Dashpot,
    Dynamics,
    LinearElastic,
    NeoHookean,
    Normal,
    Pressure,
    Problem,
    Rigid,
    Rotation,
    Spring,
    Statics,
    Support,
    Symmetry,
    Traction,
    box_body,
    rectangle_body,
    run,
)
from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.consistency import check
from dolfin_elastic.case.check.report import report
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.mesh import Body
from dolfin_elastic.mesh.distribute import make_mesh
from dolfin_elastic.model.amplitude import CONSTANT
from dolfin_elastic.problem.constraints.rigid_motion import tangent
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.diagnostics.rigid_body import free_motions
from dolfin_elastic.solvers.dynamics.explicit.explicit import Explicit
from dolfin_elastic.solvers.dynamics.explicit.scheme import SymplecticEuler
from dolfin_elastic.solvers.linear.choice import LinearSettings

E, NU = 1e6, 0.3
FREE = "free"


def rows(problem: Problem) -> np.ndarray:
    """Displacements of this rank's nodes."""
    return problem.u.x.array.reshape(-1, problem.body.dim)


def off(problem: Problem, wanted: np.ndarray) -> float:
    """Largest deviation of the displacement on all ranks."""
    local = float(np.max(np.abs(rows(problem) - wanted), initial=0.0))
    return largest(problem.body.comm, local)


def everywhere(problem: Problem, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places and displacements of all nodes, turned back by R and put in order.

    Two bodies may be parted and numbered in two ways.
    """
    size = problem.V.dofmap.index_map.size_local
    mine = np.hstack([problem.V.tabulate_dof_coordinates()[:size] @ R, rows(problem)[:size] @ R])
    table = np.concatenate(problem.body.comm.allgather(mine))
    table = table[np.lexsort(table[:, :3].round(9).T + 0.0)]
    return table[:, :3], table[:, 3:]


def alike(found: list[tuple[np.ndarray, np.ndarray]], tolerance: float) -> None:
    """The same displacements at the same places."""
    np.testing.assert_allclose(found[0][0], found[1][0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(found[0][1], found[1][1], rtol=0, atol=tolerance)


# --- rollers on flat surfaces ---


@pytest.mark.parametrize("method", ["direct", "iterative"])
@pytest.mark.parametrize(
    ("law", "degree", "formulation"),
    [
        (LinearElastic(E=E, nu=NU), 1, "displacement"),
        (NeoHookean(E=E, nu=NU), 2, "displacement"),
        (NeoHookean(E=E, nu=0.49), 2, "mixed"),
    ],
)
def test_turned_block_on_slanted_rollers(law, degree, formulation, method):
    """A block on three rollers, pulled: turned by 30 degrees about an oblique axis it is the same.

    The tolerance is that of the equilibrium, 1e-12 of the forces, times the conditioning.
    """
    found = []
    for angle in (0.0, np.pi / 6):
        body = box_body(size=(1.0, 0.6, 0.5), cells=(3, 2, 2))
        R = turned(body, (1, 2, 3), angle)
        problem = Problem(
            body,
            law,
            degree=degree,
            formulation=formulation,
            supports=[
                Normal(on="left"),
                Symmetry(on=["front", "bottom"]),
                Normal(on="right", displacement=0.1),
            ],
            loads=[BodyForce(value=list(R @ [0, 5e4, 0]))],
        )
        state = last(problem, linear=LinearSettings(method=method), rtol=1e-12)
        assert state.newton <= 6  # quadratic: the tangent is the residual's
        found.append((everywhere(problem, R), {k: R.T @ f for k, f in state.reactions.items()}))
    alike([places for places, _ in found], 1e-10)
    for label, force in found[0][1].items():
        np.testing.assert_allclose(found[1][1][label], force, rtol=0, atol=1e-5)
    np.testing.assert_allclose(sum(found[1][1].values()), [0, -1.5e4, 0], rtol=0, atol=1e-5)


# --- rollers on curved surfaces ---


def ring(cells: int = 16, inner: float = 1.0, outer: float = 2.0) -> Body:
    """A whole ring in the plane, two cells thick, with surfaces "inner" and "outer"."""
    comm = MPI.COMM_WORLD
    angle = 2 * np.pi * np.arange(cells) / cells
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.concatenate([r * circle for r in (inner, (inner + outer) / 2, outer)])
    quads = [
        (k * cells + i, k * cells + (i + 1) % cells, k * cells + cells + i)
        for k in range(2)
        for i in range(cells)
    ]
    sides = [
        (k * cells + (i + 1) % cells, k * cells + cells + (i + 1) % cells, k * cells + cells + i)
        for k in range(2)
        for i in range(cells)
    ]
    root = comm.rank == 0
    triangles = np.array(quads + sides if root else np.empty((0, 3)), dtype=np.int64)
    mesh = make_mesh(comm, triangles, points if root else np.empty((0, 2)), 1)

    def facets(inside: bool) -> np.ndarray:
        middle = (inner + outer) / 2
        return locate_entities_boundary(
            mesh, 1, lambda x: (np.hypot(x[0], x[1]) < middle * 0.9) == inside
        )

    return Body(mesh).named(surfaces={"inner": facets(True), "outer": facets(False)})


def test_ring_on_its_inner_circle():
    """No node of the inner circle moves radially, and only turning about the centre is free."""
    body, held = ring(), Normal(on="inner")
    problem = Problem(body, LinearElastic(E=E, nu=NU), supports=[held], degree=1)
    assert free_motions(problem) == ["turn about z through (0, 0) m"]
    problem = Problem(
        body,
        LinearElastic(E=E, nu=NU),
        supports=[held, Spring(on="outer", tangential="10 kPa/m")],
        loads=[BodyForce(value=[1e4, "3e3*x"])],
        degree=1,
    )
    assert not free_motions(problem)
    state = last(problem)
    x = problem.V.tabulate_dof_coordinates()[:, :2]
    r = np.linalg.norm(x, axis=1)
    on = r < 1 + 1e-9
    radial = np.einsum("ni,ni->n", rows(problem), x / r[:, None])
    across = rows(problem)[:, 1] * x[:, 0] - rows(problem)[:, 0] * x[:, 1]
    # The displacements are about 1e-2: 1e-14 is their round-off times the conditioning of normals.
    assert largest(body.comm, float(np.abs(radial[on]).max(initial=0.0))) < 1e-14
    assert largest(body.comm, float(np.abs(across[on]).max(initial=0.0))) > 1e-3
    area = 16 / 2 * np.sin(2 * np.pi / 16) * (4 - 1)
    np.testing.assert_allclose(
        sum(state.reactions.values()), [-1e4 * area, 0], rtol=1e-9, atol=1e-4
    )


def test_thick_cylinder_pushed_outward():
    """A slanted sector between planes of symmetry, its inner side moved outwards by g.

    u = A r + B/r, g = A + B and no stress at r = 2: B/A = 4/(1 - 2 nu).  Plane strain; Timoshenko
    & Goodier, Theory of Elasticity, section 28.  Straight sides of 9 degrees cost 1 - cos 4.5
    degrees = 0.3 %.
    """
    body = rectangle_body(size=(1.0, np.pi / 2), cells=(4, 10))
    x = body.mesh.geometry.x
    r, angle = 1 + x[:, 0].copy(), x[:, 1] + 0.3
    x[:, 0], x[:, 1] = r * np.cos(angle), r * np.sin(angle)
    g, ratio = 1e-3, 4 / (1 - 2 * NU)
    problem = Problem(
        body,
        LinearElastic(E=E, nu=NU),
        degree=2,
        supports=[Normal(on="left", displacement=-g), Symmetry(on=["bottom", "top"])],
    )
    assert not free_motions(problem)
    last(problem)
    X = problem.V.tabulate_dof_coordinates()[:, :2]
    R = np.linalg.norm(X, axis=1)
    exact = g / (1 + ratio) * (R + ratio / R)
    u = np.einsum("ni,ni->n", rows(problem), X / R[:, None])
    assert largest(body.comm, float(np.abs(u / exact - 1).max(initial=0.0))) < 6e-3
    corners = np.abs(R - 1) < 1e-9  # their normals are exactly radial, also at the planes
    assert largest(body.comm, float(np.abs(u[corners] - g).max(initial=0.0))) < 1e-15


@pytest.mark.parametrize("degree", [1, 2])
def test_roller_on_a_cone(degree):
    """Axisymmetric: a cone's side is held along its normal, its foot along the axis."""
    body = rectangle_body(size=(1.0, 1.0), cells=(3, 3))
    x = body.mesh.geometry.x
    x[:, 0] *= 1 - 0.4 * x[:, 1]
    problem = Problem(
        body,
        NeoHookean(E=E, nu=NU),
        degree=degree,
        geometry="axisymmetric",
        supports=[Normal(on="right"), Normal(on="bottom", displacement=-0.05, name="foot")],
    )
    state = last(problem, steps=2)
    n = np.array([1.0, 0.4]) / np.hypot(1.0, 0.4)
    X = problem.V.tabulate_dof_coordinates()
    side = np.abs(X[:, 0] + 0.4 * X[:, 1] - 1) < 1e-9
    gap = np.abs(rows(problem)[side] @ n).max(initial=0.0)
    assert largest(body.comm, float(gap)) < 1e-15
    rim = np.abs(rows(problem)[X[:, 1] < 1e-9, 1] - 0.05).max(initial=0.0)
    assert largest(body.comm, float(rim)) < 1e-15
    # Of a ring only the forces along the axis balance.
    force = sum(state.reactions.values())
    assert abs(force[1]) < 1e-7 * abs(state.reactions["foot"][1])


def test_oblique_directions_at_one_node():
    """A slanted roller meets a prescribed component: both hold exactly, whichever comes first."""
    for order in (1, -1):
        body = rectangle_body(size=(1.0, 1.0), cells=(3, 3))
        x = body.mesh.geometry.x
        x[:, 1] += 0.5 * x[:, 0]
        slanted = Normal(on="bottom", displacement=0.02)
        wall = Support(on="left", displacement=[0.03, FREE])
        problem = Problem(body, NeoHookean(E=E, nu=NU), supports=[slanted, wall][::order], degree=1)
        state = last(problem)
        X = problem.V.tabulate_dof_coordinates()
        n = np.array([0.5, -1.0]) / np.hypot(0.5, 1.0)
        low, left = np.abs(X[:, 1] - 0.5 * X[:, 0]) < 1e-9, X[:, 0] < 1e-9
        for held, direction, value in ((low, n, 0.02), (left, [1.0, 0.0], 0.03)):
            gap = np.abs(rows(problem)[held] @ direction - value).max(initial=0.0)
            assert largest(body.comm, float(gap)) < 1e-15
        force = state.reactions
        # Each pushes along its own normal only, and together they balance.
        assert abs(np.cross(np.append(force["bottom"], 0), np.append(n, 0))[2]) < 1e-6
        assert abs(force["left"][1]) < 1e-6
        np.testing.assert_allclose(force["left"] + force["bottom"], 0, atol=1e-6)


# --- the tangent ---


@pytest.mark.parametrize(("degree", "formulation"), [(1, "displacement"), (2, "mixed")])
def test_projected_tangent_is_the_residuals_derivative(degree, formulation):
    """Where the held directions are met, also with springs; the tangent stays symmetric."""
    body = box_body(size=(1.0, 0.6, 0.5), cells=(2, 2, 1))
    turned(body, (1, 2, 3), 0.5)
    problem = Problem(
        body,
        NeoHookean(E=E, nu=0.48),
        degree=degree,
        formulation=formulation,
        supports=[
            Normal(on=["left", "front"]),
            Support(on="right", displacement=[FREE, 0, FREE]),
            Spring(on="top", normal=1e7, tangential=2e6, displacement=[0.01, 0, 0]),
            Spring(on="bottom", stiffness=[1e6, 0, 3e6]),
        ],
    )
    problem.set_time(1.0)
    a = Assembler(problem)
    x, f, d, Kd, lower = (a.create_vector() for _ in range(5))
    rng = np.random.default_rng(body.comm.rank)
    x.array_w[:] = 0.01 * rng.standard_normal(a.size)
    x.array_w[:] = a.free_part(x.array_r)
    d.array_w[:] = a.free_part(rng.standard_normal(a.size))
    a.residual.evaluate(x, f)
    assert a.residual.gap < 1e-16
    a.tangent.assemble(x)
    a.tangent.matrix.mult(d, Kd)
    eps = 1e-6
    a.residual.evaluate(x + eps * d, f)
    a.residual.evaluate(x - eps * d, lower)
    difference = (f - lower) / (2 * eps)
    # Central differences: eps^2 and round-off over eps, each about 1e-10 of the stiffest mode.
    assert (difference - Kd).norm() < 1e-8 * Kd.norm()
    other = a.create_vector()
    other.array_w[:] = rng.standard_normal(a.size)
    product = a.create_vector()
    a.tangent.matrix.mult(other, product)
    assert product.dot(d) == pytest.approx(other.dot(Kd), rel=1e-11)
    for thing in (x, f, d, Kd, lower, difference, other, product):
        thing.destroy()
    a.destroy()


# --- rotation ---


@pytest.mark.parametrize("dim", [2, 3])
def test_half_a_turn(dim):
    """Both ends turn by 180 degrees about one axis and move on: so does the body, unstrained."""
    body = box_body(size=(1.0, 0.4, 0.4)[:dim], cells=(2, 1, 1)[:dim])
    axis = np.array([1.0, 2.0, 2.0]) / 3 if dim == 3 else np.array([0.0, 0.0, 1.0])
    c, shift = np.array([0.2, -0.1, 0.3])[:dim], np.array([0.5, 0.1, -0.2])[:dim]
    held = Rotation(
        on=["left", "right"],
        point=list(c),
        axis=list(axis) if dim == 3 else None,
        angle="180 deg",
        displacement=list(shift),
    )
    problem = Problem(body, NeoHookean(E=E, nu=NU), supports=[held], degree=1)
    X = problem.V.tabulate_dof_coordinates()[:, :dim]
    K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    for state in Statics(problem, steps=6, rtol=1e-10).steps():
        angle = np.pi * state.load_factor
        R = (np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K)[:dim, :dim]
        exact = (X - c) @ (R - np.eye(dim)).T + state.load_factor * shift
        ends = (X[:, 0] < 1e-9) | (X[:, 0] > 1 - 1e-9)
        worst = np.abs(rows(problem) - exact)[ends].max(initial=0.0)
        assert largest(body.comm, float(worst)) < 1e-14
        assert off(problem, exact) < 1e-9
        assert abs(state.energies["strain"]) < 1e-9 * E


@pytest.mark.parametrize("velocity", ["90 deg/s", "15 rpm", np.pi / 2], ids=str)
def test_a_rotation_at_a_constant_rate(velocity):
    """The angle is rate times time, in statics too: the body turns unstrained."""
    body = box_body(size=(1.0, 0.4, 0.4), cells=(2, 1, 1))
    held = Rotation(on=["left", "right"], point=[0.2, 0, 0], axis="z", velocity=velocity)
    problem = Problem(body, NeoHookean(E=E, nu=NU), supports=[held], degree=1)
    r = problem.V.tabulate_dof_coordinates() - np.array([0.2, 0, 0])
    for state in Statics(problem, end="2 s", steps=6, rtol=1e-10).steps():
        c, s = np.cos(np.pi / 2 * state.t), np.sin(np.pi / 2 * state.t)
        exact = r @ (np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) - np.eye(3)).T
        assert off(problem, exact) < 1e-9
    assert state.t == 2.0
    assert "turned at" in held.describe()


def test_a_rotation_by_a_record_of_its_velocity():
    """1 s up to 2 rad/s, then 1 s of it, then rest: 1 + 2 rad; the curve moves only the point."""
    table = {"table": [[0, 0], [1, 2], [2, 2]], "unit": "rad/s"}
    keys = {"point": [0, 0, 0], "axis": "z", "displacement": [0, 0, 1.0]}
    held = Rotation(on="a", velocity=table, curve=[[0, 0], [4, 1]], **keys)
    x = np.array([[1.0, 0.0, 0.0]])
    for t, angle in [(0.5, 0.25), (1.0, 1.0), (2.0, 3.0), (4.0, 3.0)]:
        u = [np.asarray(held.at(i, x, t, CONSTANT)).item() for i in range(3)]
        assert u == pytest.approx([np.cos(angle) - 1, np.sin(angle), t / 4], rel=1e-14)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, 'angle: this key is missing; for example "90 deg"; or velocity = "90 deg/s"'),
        ({"angle": 1, "velocity": 1}, "velocity: angle and velocity are given together"),
        ({"velocity": "90 deg"}, "velocity: '90 deg' has the wrong unit"),
        ({"velocity": "2*t"}, "velocity: .* is not a number"),
        ({"velocity": 1, "curve": "ramp"}, "curve: the velocity says how the angle changes"),
    ],
)
def test_keys_of_a_rotation(keys, message):
    with pytest.raises(InputError, match=f"^{message}"):
        Rotation(on="a", point=[0, 0, 0], axis="z", **keys)


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ({}, "in statics"),
        ({"modal": {"count": 1}}, "to undamped modes"),
        ({"modal": {"count": 1, "preload": True}}, "to undamped modes"),
        ({"buckling": {"count": 1}}, "to load factors"),
        ({"buckling": {"count": 1, "preload": 0.1}}, "to load factors"),
    ],
)
def test_a_dashpot_that_does_nothing_is_told_of_once(tables, said, folder, caplog):
    """By `check`, by a run, and by a solver in Python; also where a preload comes first."""
    read = Case.from_dict(
        {
            "mesh": {"rectangle": {"size": [4, 1], "cells": [8, 2]}, "degree": 1},
            "materials": {"gel": {"law": "neo-hookean", "E": 1e6, "nu": 0.3, "density": 1000}},
            "support": [
                {"on": "left"},
                {"kind": "dashpot", "on": "top", "viscosity": [0, 1], "name": "damper"},
            ],
            "load": [{"kind": "traction", "on": "right", "value": [-1e3, 0]}],
            **tables,
        }
    )
    (note,) = (n for n in report(read).notes if "dashpot" in n)
    assert note.startswith("support[1]: a dashpot does nothing in ")
    for steps in (
        read.make_solver(read.make_problem(read.read_body())).steps(),
        run(read, output=folder / "a"),
    ):
        caplog.clear()
        for _ in steps:
            pass
        told = [r.getMessage() for r in caplog.records if "dashpot" in r.getMessage()]
        assert MPI.COMM_WORLD.bcast(told) == [f"the dashpot 'damper' does nothing {said}"]


def test_axes_with_names():
    """x, y and z stand for their directions, as in obstacles and selectors."""
    for name, row in zip("xyz", np.eye(3), strict=True):
        by_name, by_row = (
            Rotation(on="left", point=[0, 0, 0], axis=axis, angle=1) for axis in (name, list(row))
        )
        assert by_name.direction == by_row.direction == tuple(row)
    plane = Rotation(on="left", point=[0, 0], axis="z", angle=1)
    assert plane.prescribed_components(2) == (0, 1)
    with pytest.raises(InputError, match="a plane body turns about z only"):
        Rotation(on="left", point=[0, 0], axis="x", angle=1).prescribed_components(2)


# --- springs ---


def bar(law: Any, *more: Any, load: float = 0.0, **fields: Any) -> Problem:
    """A bar of length 2 and cross section 0.5 x 0.5 between smooth walls, load at its right end."""
    return Problem(
        box_body(size=(2.0, 0.5, 0.5), cells=(3, 1, 1)),
        law,
        supports=[Symmetry(on=["front", "bottom"]), *more],
        loads=[Traction(on="right", value=[load, 0, 0])] if load else [],
        **{"degree": 1, **fields},
    )


@pytest.mark.parametrize("total_value", [False, True])
def test_bar_on_a_spring(total_value):
    """u = p/k + p x/E, exactly; the spring carries the load and stores (p A)^2/(2 k A)."""
    k, p, area = 2e6, 1e3, 0.25
    value: dict[str, Any] = {"normal": k * area, "total": True} if total_value else {"normal": k}
    problem = bar(LinearElastic(E=E, nu=0.0), Spring(on="left", name="base", **value), load=p)
    state = last(problem)
    x = problem.V.tabulate_dof_coordinates()[:, 0]
    exact = np.zeros((len(x), 3))
    exact[:, 0] = p / k + p * x / E
    assert off(problem, exact) < 1e-12 * 2e-3 * 1e3
    np.testing.assert_allclose(state.reactions["base"], [-p * area, 0, 0], rtol=1e-10, atol=1e-9)
    assert state.energies["springs"] == pytest.approx((p * area) ** 2 / (2 * k * area), rel=1e-10)
    assert state.energies["strain"] == pytest.approx(p**2 / E / 2 * 2 * area, rel=1e-10)


def test_the_axis_of_a_body_of_revolution_has_no_area():
    """So that no total can be spread over it."""
    with pytest.raises(InputError, match="support 'left'.on: the surface has no area"):
        Problem(
            rectangle_body(size=(1.0, 1.0), cells=(1, 1)),
            LinearElastic(E=E, nu=NU),
            supports=[Spring(on="left", normal=1.0, total=True)],
            degree=1,
            geometry="axisymmetric",
        )


def test_base_that_moves():
    """A body on springs alone goes where their base goes, in a straight line and without strain."""
    spring = Spring(
        on="left", stiffness=["1 MPa/m", "2 MPa/m", "3 MPa/m"], displacement=[0.1, 0.2, -0.1]
    )
    problem = Problem(
        box_body(size=(1.0, 1.0, 1.0), cells=(2, 1, 1)),
        NeoHookean(E=E, nu=NU),
        supports=[spring],
        degree=1,
    )
    for state in Statics(problem, steps=2).steps():
        assert off(problem, np.array([0.1, 0.2, -0.1]) * state.load_factor) < 1e-9
    assert abs(state.energies["springs"]) < 1e-9


def test_what_holds_a_body():
    body = box_body(size=(1.0, 1.0, 1.0), cells=(1, 1, 1))

    def free(*supports: Any) -> list[str]:
        return free_motions(Problem(body, LinearElastic(E=E, nu=NU), supports=supports, degree=1))

    across = ["move along y", "move along z", "turn about x through (0.5, 0.5, 0.5) m"]
    assert free(Normal(on="left")) == across
    assert free(Normal(on="left"), Normal(on="front"), Normal(on="bottom")) == []
    assert free(Spring(on="left", normal=1.0)) == across
    turns = [f"turn about {axis} through (0, 0.5, 0.5) m" for axis in "yz"]
    assert free(Spring(on="left", tangential=1.0)) == ["move along x", *turns]
    assert free(Spring(on="left", normal=1.0, tangential=1.0)) == []
    assert free(Spring(on="left", stiffness=[1.0, 1.0, 0.0])) != []
    assert free(Rotation(on="left", point=[0, 0, 0], axis=[1, 0, 0], angle=1.0)) == []
    assert free(Dashpot(on="left", normal=1.0, tangential=1.0)) == ["move and turn freely"]


# --- motion ---

RHO = 1000.0


@pytest.mark.parametrize("scheme", ["generalized-alpha", "symplectic-euler"])
def test_mass_on_a_dashpot(scheme):
    """A stiff block of mass 1000 kg and a dashpot of c = 1000 N s/m: v = exp(-t c/m).

    The explicit scheme has (1 - dt c/m)^n.  The block's own wave, c/(rho c_p) = 1 % of a length,
    and for the implicit scheme (dt c/m)^2/12, leave a few 1e-4.
    """
    body = box_body(size=(1.0, 1.0, 1.0), cells=(1, 1, 1))
    problem = Problem(
        body,
        LinearElastic(E=1e8, nu=0.0, density=RHO),
        supports=[Dashpot(on="left", viscosity=[1000.0, 0, 0], total=True)],
        degree=1,
    )
    dt = 0.02 if scheme == "generalized-alpha" else 1e-3
    states = Dynamics(
        problem, scheme=scheme, end=0.5, dt=dt, initial_velocity=[1, 0, 0], every=25
    ).steps()
    first = next(states)
    for state in states:
        exact = np.exp(-state.t) if scheme == "generalized-alpha" else (1 - dt) ** (state.t / dt)
        assert state.momenta["linear"][0] / RHO == pytest.approx(exact, rel=1e-3)
        lost = first.energies["total"] - state.energies["total"]
        # What the dashpot takes is counted as work of supports.
        assert state.energies["external"] == pytest.approx(-lost, rel=2e-3)
    assert state.reactions["left"][0] == pytest.approx(-1000 * exact, rel=2e-2)


def test_dashpots_lower_the_stable_step():
    """Without stiffness it is 2 m/c; one row of the dashpot matrix has c A/3 of the mass m/8."""
    body = box_body(size=(1.0, 1.0, 1.0), cells=(1, 1, 1))
    found = []
    for c in (1.0, 1e9):
        problem = Problem(
            body,
            LinearElastic(E=E, nu=NU, density=RHO),
            supports=[Dashpot(on="left", normal=c)],
            degree=1,
        )
        march = Explicit(
            problem, fem.Function(problem.V), SymplecticEuler, end=1.0, dt=None, safety=1.0, every=1
        )
        found.append(march.size.dt)
        march.assembler.destroy()
    plain = Problem(body, LinearElastic(E=E, nu=NU, density=RHO), degree=1)
    march = Explicit(
        plain, fem.Function(plain.V), SymplecticEuler, end=1.0, dt=None, safety=1.0, every=1
    )
    assert found[0] == pytest.approx(march.size.dt, rel=1e-3)
    worst = max(total(body.comm, 0.0), 1e9 / 3 / (RHO / 24))  # the least mass with the most area
    assert 0.9 * 2 / worst <= found[1] <= 24 * 2 / worst
    march.assembler.destroy()


@pytest.mark.long
@pytest.mark.parametrize("scheme", ["generalized-alpha", "symplectic-euler"])
def test_turned_block_moves_alike(scheme):
    """A block that slides on slanted rollers, one of them moving, and the same unturned."""
    found = []
    for angle in (0.0, np.pi / 6):
        body = box_body(size=(1.0, 0.6, 0.5), cells=(3, 2, 1))
        R = turned(body, (1, 2, 3), angle)
        problem = Problem(
            body,
            NeoHookean(E=E, nu=NU, density=RHO),
            supports=[
                Normal(on="left", displacement="-0.02*sin(50*t)"),
                Symmetry(on="front"),
                Spring(on="bottom", normal="1 MPa/m"),
                Dashpot(on="right", normal=2e3, tangential=1e3),
            ],
            loads=[BodyForce(value=list(R @ [1e4, 0, 5e4]))],
            degree=1,
        )
        first, *_, state = Dynamics(
            problem,
            scheme=scheme,
            end=0.04,
            dt=1e-3,
            initial_velocity=list(R @ [0, 0.0, 1.0]),
            **({"rtol": 1e-11} if scheme == "generalized-alpha" else {}),
        ).steps()
        found.append((everywhere(problem, R), {k: R.T @ f for k, f in state.reactions.items()}))
    alike([places for places, _ in found], 1e-10)
    for label, force in found[0][1].items():
        np.testing.assert_allclose(found[1][1][label], force, rtol=0, atol=1e-6 * 1e4)
    gained = state.energies["total"] - first.energies["total"]
    # The trapezoidal rule of the work is of second order in the step.
    scale = abs(gained) + abs(state.energies["kinetic"])
    assert abs(gained - state.energies["external"]) < 0.05 * scale


# --- what is said ---


ROWS = [
    ({"kind": "rollers", "on": "left"}, r"support\[0\]\.kind: unknown kind 'rollers'.*'roller'"),
    ({"kind": "normal", "on": "left", "displacement": [0, 0, 0]}, r"support\[0\]\.displacement: "),
    ({"kind": "symmetry", "on": "left", "displacement": 1}, r"unknown key 'displacement'"),
    ({"kind": "rotation", "on": "left", "angle": "90 deg"}, r"support\[0\]\.point: .*missing"),
    (
        {"kind": "rotation", "on": "left", "point": [0, 0, 0], "angle": "3 mm"},
        r"support\[0\]\.angle: '3 mm' has the wrong unit; expected a number in rad",
    ),
    (
        {"kind": "rotation", "on": "left", "point": ["x", 0, 0], "angle": 1},
        r"support\[0\]\.point\[0\]: .x. is not a number; expected a number in the unit of",
    ),
    (
        {"kind": "rotation", "on": "left", "point": [0, 0, 0], "axis": [0, 0, 0], "angle": 1},
        r"support\[0\]\.axis: a direction cannot be zero",
    ),
    ({"kind": "spring", "on": "left"}, r"support\[0\]: no coefficient is given"),
    ({"kind": "spring", "on": "left", "normal": -1}, r"support\[0\]\.normal: -1 is negative"),
    (
        {"kind": "spring", "on": "left", "normal": "3 mm"},
        r"support\[0\]\.normal: '3 mm' has the wrong unit; expected a number in N/m\^3",
    ),
    (
        {"kind": "spring", "on": "left", "normal": 1, "stiffness": [1, 1, 1]},
        r"support\[0\]\.stiffness: 'stiffness' and 'normal' or 'tangential' given together",
    ),
    (
        {"kind": "spring", "on": "left", "normal": "x", "total": True},
        r"support\[0\]\.normal: a total is a number, no formula",
    ),
]


def case(*supports: Any, **more: Any) -> Case:
    return Case.from_dict(
        {
            "mesh": {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}, "degree": 1},
            "materials": {"a": {"law": "linear-elastic", "E": "1 MPa", "nu": 0.3}},
            "support": list(supports),
            **more,
        }
    )


@pytest.mark.parametrize(("row", "message"), ROWS)
def test_bad_rows(row, message):
    with pytest.raises(InputError, match=message):
        case(row)


@pytest.mark.parametrize(
    "held",
    [
        Support(on="right", displacement=[0.1, 0], curve="sqrt(t - 0.1)"),
        Normal(on="right", displacement=0.1, curve="sqrt(t - 0.1)"),
        Rotation(on="right", point=[0, 0], angle="sqrt(t - 0.1)"),
        Rigid(on="right", displacement=["sqrt(t - 0.1)", 0]),
    ],
)
@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_a_curve_fails_on_all_ranks(held, angle):
    """Also on those that own no node of the surface, here at the far end."""
    body = rectangle_body(size=(8, 1), cells=(16, 1))
    turned(body, [0, 0, 1], angle)
    problem = Problem(
        body, LinearElastic(E=E, nu=NU), supports=[Support(on="left"), held], degree=1
    )
    said = r"support 'right': 'sqrt\(t - 0.1\)' is not a real number at t = 0.05"
    with pytest.raises(InputError, match=said):
        problem.set_time(0.05)


def test_looking_at_a_rim_changes_nothing():
    """Whether pressure has a potential is asked at moments of its own."""
    body = rectangle_body(size=(1, 1), cells=(2, 2))
    turned(body, [0, 0, 1], 0.4)
    problem = Problem(
        body,
        NeoHookean(E=E, nu=NU),
        supports=[Normal(on="bottom", displacement="t"), Rigid(on="right", displacement=["t", 0])],
        loads=[Pressure(on="left", value=1.0)],
        degree=1,
    )
    problem.set_time(0.5)
    prescribed = problem.constraints
    before = prescribed.targets.copy(), prescribed.motion_values(prescribed.rigid_motions[0])
    _ = problem.symmetric
    np.testing.assert_array_equal(prescribed.targets, before[0])
    np.testing.assert_array_equal(prescribed.motion_values(prescribed.rigid_motions[0]), before[1])


def test_bad_on_a_body():
    for row, message in [
        ({"kind": "symmetry", "on": ["left", "curved"]}, r"'curved' is not flat: .* apart"),
        ({"kind": "rotation", "on": "left", "point": [0, 0, 0], "angle": 1}, r"axis.*missing"),
        ({"kind": "spring", "on": "left", "stiffness": [1, 1]}, r"2 components"),
        (
            {"kind": "rotation", "on": "left", "point": [0, 0], "axis": [0, 0, 1], "angle": 1},
            "2 comp",
        ),
    ]:
        read = case(row)
        body = read.read_body()
        body = body.named(
            surfaces={"curved": np.union1d(body.surface("left"), body.surface("top"))}
        )
        with pytest.raises(InputError, match=message):
            check(read, body)
            read.make_problem(body)


def test_rows_are_read_written_and_named():
    written = [
        {"on": "left"},
        {"kind": "roller", "on": "left", "displacement": "1 mm", "curve": "ramp"},
        {"kind": "normal", "on": "left", "displacement": "0.1*t*y"},
        {"kind": "symmetry", "on": ["front", "bottom"]},
        {
            "kind": "rotation",
            "on": "right",
            "point": [1, 0, 0],
            "axis": [1, 0, 0],
            "angle": "90*t*pi/180",
        },
        {"kind": "spring", "on": "top", "normal": "3 MN/m", "total": True, "name": "mount"},
        {"kind": "dashpot", "on": "top", "viscosity": [1, 2, "3 N*s/m^3"]},
    ]
    read = case(*written)
    again = Case.from_dict(read.to_dict())
    assert again.support == read.support
    assert again.to_dict() == read.to_dict()
    assert [s.kind for s in again.support] == [
        "displacement",
        "roller",
        "normal",
        "symmetry",
        "rotation",
        "spring",
        "dashpot",
    ]
    body = read.read_body()
    assert [n for n in report(read).notes if "dashpot" in n] == [
        "support[6]: a dashpot does nothing in statics"
    ]
    problem = read.make_problem(body)
    assert set(problem.weak_form.restraint_works) == {"mount", "top"}


def test_a_value_that_is_none_is_told_with_its_support_and_place(comm: MPI.Comm) -> None:
    """The lowest place of them, on any number of ranks."""
    body = rectangle_body(size=(1, 1), cells=(2, 3), comm=comm)
    supports = [Support(on="left"), Support(on="right", displacement=["0.01*log(0.6 - y)", 0])]
    problem = Problem(body, NeoHookean(E=1e6, nu=0.3), supports=supports, degree=1)
    with pytest.raises(InputError) as caught:
        _ = [*Statics(problem, steps=1).steps()]
    assert str(caught.value) == (
        "support 'right': the prescribed displacement is not finite at (1, 0.666667) m at t = 1; "
        "a formula that gives a number at every point and time"
    )


@pytest.mark.parametrize("angle", [0.9e-4, 1.1e-4, 0.3, 2.0, 6.0])
def test_spin_of_a_changing_rotation_vector(angle: float) -> None:
    """Along the axis the spin is the change; across it, it is the chord of the arc of that angle.

    dtheta sin(a)/a and, beside it, 2 sin(a/2)^2/a: up to round-off also where a series is taken.
    """
    axis, across = np.array([0.48, 0.6, 0.64]), np.array([0.8, 0.0, -0.6])
    T = tangent(angle * axis)
    chord = np.sin(angle) * across + 2 * np.sin(angle / 2) ** 2 * np.cross(axis, across)
    np.testing.assert_allclose(T @ axis, axis, rtol=0, atol=1e-14)
    np.testing.assert_allclose(T @ across, chord / angle, rtol=0, atol=1e-14)
