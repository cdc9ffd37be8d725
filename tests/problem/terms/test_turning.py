"""Obstacles that turn: rollers, turntables, planes in another frame; their work, and restarts."""

from __future__ import annotations

import numpy as np
import pytest

from dolfin_elastic import (
    Contact,
    Dynamics,
    Gravity,
    LinearElastic,
    NeoHookean,
    Problem,
    Statics,
    Support,
    box_body,
    rectangle_body,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.shapes.box import Box
from dolfin_elastic.model.amplitude import CONSTANT
from dolfin_elastic.problem.state import State, StateCopy

E = 1e6


def own(state: State) -> np.ndarray:
    """Displacements of the owned nodes, shape (n, dim) [m]."""
    V = state.u.function_space
    return state.u.x.array.reshape(-1, V.dofmap.index_map_bs)[: V.dofmap.index_map.size_local]


def places(problem: Problem) -> np.ndarray:
    n = problem.V.dofmap.index_map.size_local
    return problem.V.tabulate_dof_coordinates()[:n, : problem.body.dim]


@pytest.mark.long
@pytest.mark.parametrize("degree", [1, 2])
def test_a_roller_drives_a_strip(degree):
    """Where it sticks, the strip moves along by R times the angle, which nothing resists.

    One vertex is on it.  It is pressed before the roller turns, which then sinks there by R a^2/2,
    1e-5 of the depth; and the coefficient is large, so that it sticks in all iterations, too.
    """
    R, angle, tight, before = 100.0, 5e-6, 1e-9, 0.0
    strip = rectangle_body(size=(1, 0.25), cells=(4, 1), origin=(-0.5, 0))
    roller = Contact(
        on="bottom",
        sphere={"center": [0, -R + 1e-4], "radius": R},
        rotation={"point": [0, -R + 1e-4], "angle": f"-{angle}*max(2*t - 1, 0)"},
        friction=100.0,
        gap_tolerance=tight,
        name="roller",
    )
    problem = Problem(
        strip,
        LinearElastic(E=E, nu=0.0),
        supports=[Support(on="top", displacement=["free", 0])],
        contacts=[roller],
        degree=degree,
    )
    for state in Statics(problem, steps=4).steps():
        assert state.audit is not None
        assert state.audit.verdict == "pass", state.audit.reasons
        if state.t == 0.5:
            before = own(state)[:, 0].copy()
    np.testing.assert_allclose(own(state)[:, 0] - before, R * angle, rtol=1e-6)


def test_no_load_step_has_a_whole_turn():
    """Of two rotations that are alike what sticks to a drum would be driven by nothing."""
    square = rectangle_body(size=(1, 1), cells=(2, 2))
    drum = Contact(
        on="bottom",
        sphere={"center": [0.5, 0.5], "radius": 1, "inside": True},
        rotation={"point": [0.5, 0.5], "angle": "6*t"},
        name="drum",
    )
    problem = Problem(square, LinearElastic(E=E, nu=0.0), contacts=[drum])
    assert problem.terms.within_stride(0.0, 1.0, problem.acting) == 0.25


@pytest.mark.parametrize(("dim", "degree"), [(2, 1), (2, 2), (3, 1)])
def test_a_plane_that_has_turned(dim, degree):
    """In the end it is as one that was drawn there: forces, displacements and pressures."""
    slope, found = 0.05, []
    body = (
        rectangle_body(size=(1, 0.5), cells=(4, 2))
        if dim == 2
        else box_body(size=(1, 1, 0.5), cells=(2, 2, 1))
    )
    up, axis = "xyz"[dim - 1], {} if dim == 2 else {"axis": "y"}
    sign = 1 if dim == 2 else -1
    point = [0.0] * dim
    normal = [-np.sin(slope), *[0] * (dim - 2), np.cos(slope)]
    flat = {"axis": up, "at": 0}
    turns = {"plane": flat, "rotation": {"point": point, "angle": sign * slope, **axis}}
    for shape in (turns, {"plane": {"point": point, "normal": normal}}):
        contact = Contact(on="bottom", gap_tolerance=1e-8, name="floor", **shape)
        problem = Problem(
            body,
            NeoHookean(E=E, nu=0.3),
            supports=[Support(on="top", displacement=[0] * dim)],
            contacts=[contact],
            degree=degree,
        )
        *_, last = Statics(problem, steps=2).steps()
        found.append(
            (own(last).copy(), last.reactions["floor"], last.numbers["contact_area_floor"])
        )
    (u, force, area), (same, push, part) = found
    np.testing.assert_allclose(u, same, atol=1e-7 * slope)
    np.testing.assert_allclose(force, push, rtol=1e-5, atol=1e-7 * np.linalg.norm(push))
    assert area == pytest.approx(part, rel=1e-5)


@pytest.mark.long
@pytest.mark.parametrize("degree", [1, 2])
def test_a_block_on_a_turntable(degree):
    """It sticks and turns with it, by 10 degrees, as it was: friction alone holds it."""
    c, turn = np.array([1.0, 0.2, 0.0]), np.pi / 13.5
    table = Contact(
        on="bottom",
        plane={"axis": "z", "at": 0},
        rotation={"point": c.tolist(), "axis": "z", "angle": f"{turn}*max(t - 1/4, 0)"},
        friction=0.3,
        gap_tolerance=1e-10,
        name="table",
    )
    problem = Problem(
        box_body(size=(1, 1, 0.5), cells=(1, 1, 1)),
        NeoHookean(E=E, nu=0.3, density=1000),
        loads=[Gravity(value=[0, 0, "-10*min(1, 4*t)"])],
        contacts=[table],
        degree=degree,
    )
    X, rows = places(problem), []
    for state in Statics(problem, steps=4).steps():
        assert state.audit is not None
        assert state.audit.verdict == "pass", state.audit.reasons
        a = turn * max(state.t - 1 / 4, 0)
        R = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
        rows.append((X + own(state) - c) @ R + c - X)
    for row in rows[2:]:
        np.testing.assert_allclose(row, rows[1], atol=1e-9)


def dragged(scheme: str, degree: int = 1) -> Dynamics:
    """A block that lies on a floor which tilts and slides below it."""
    floor = Contact(
        on="bottom",
        plane={"axis": "y", "at": 0},
        motion=["0.5*t", 0],
        rotation={"point": [-3, 1], "angle": "0.3*t + 8*t^2"},
        friction=0.3,
        name="floor",
    )
    problem = Problem(
        rectangle_body(size=(1, 0.5), cells=(4, 2)),
        NeoHookean(E=E, nu=0.3, density=1000),
        loads=[Gravity(value=[0, -10])],
        contacts=[floor],
        degree=degree,
    )
    steps = {"dt": 2e-3} if scheme == "generalized-alpha" else {"every": 5}
    return Dynamics(problem, scheme=scheme, end=0.04, **steps)


@pytest.mark.long
@pytest.mark.parametrize(
    ("scheme", "degree", "close"),
    [
        ("generalized-alpha", 1, 1e-12),
        ("generalized-alpha", 2, 1e-12),
        ("central-differences", 1, 3e-3),
    ],
)
def test_work_of_an_obstacle_that_turns(scheme, degree, close):
    """What it has put into the body is in it: to round-off, or as explicit hits of nodes allow."""
    scale = off = 0.0
    for state in dragged(scheme, degree).steps():
        e = state.energies
        scale = max(scale, abs(e["external"]))
        off = max(off, abs(e["total"] + e["friction"] - e["external"]))
    assert e["kinetic"] > 1e3
    assert e["friction"] > 1.0
    assert off < close * scale


@pytest.mark.parametrize("scheme", ["generalized-alpha", "central-differences"])
def test_a_run_goes_on(scheme):
    """From a state on the way as if it had not ended."""
    whole = [(own(s).copy(), s.energies) for s in dragged(scheme).steps()]
    first = dragged(scheme)
    for count, _ in enumerate(first.steps()):
        if count == len(whole) // 2:
            saved = StateCopy(first.restart_state())
            break
    rest = [(own(s).copy(), s.energies) for s in dragged(scheme).steps(saved)]
    assert len(rest) == len(whole) - count - 1
    for (again, energies), (before, stored) in zip(rest, whole[-len(rest) :], strict=True):
        np.testing.assert_allclose(again, before, rtol=0, atol=1e-13)
        assert energies == pytest.approx(stored, rel=1e-9, abs=1e-8)


@pytest.mark.parametrize(
    ("keys", "where"),
    [
        ({"rotation": {"point": [0, 0], "angle": 1}, "force": 1, "direction": "-y"}, "force"),
        ({"rotation": {"point": [0, 0], "angle": "x"}}, "angle"),
        ({"rotation": {"point": [0, 0], "angle": "1 mm"}}, "angle"),
    ],
)
def test_input_that_is_refused(keys, where):
    with pytest.raises(InputError, match=where):
        Contact(on="bottom", plane={"axis": "y", "at": 0}, **keys)


@pytest.mark.parametrize(
    ("rotation", "dim", "axisymmetric", "where"),
    [
        ({"point": [0, 0, 0]}, 3, False, "rotation.axis"),
        ({"point": [0, 0], "axis": "z"}, 3, False, "rotation.point"),
        ({"point": [0, 0], "axis": "x"}, 2, False, "rotation.axis"),
        ({"point": [0, 0]}, 2, True, "rotation"),
    ],
)
def test_axes_that_do_not_fit(rotation, dim, axisymmetric, where):
    contact = Contact(on="a", plane={"axis": "y", "at": 0}, rotation={**rotation, "angle": 1})
    with pytest.raises(InputError) as error:
        contact.check(dim, axisymmetric=axisymmetric)
    assert error.value.where == where


def test_what_is_drawn_has_turned():
    """Corners of the drawn box are on its surface; and a quarter of a turn swaps its sides."""
    row = {"point": [1, 0, 0], "axis": "z", "angle": "90 deg"}
    box = {"center": [1, 0, 0], "size": [4, 2, 1]}
    contact = Contact(on="a", box=box, rotation=row).in_metres(1.0)
    shape = contact.turned(contact.obstacle, contact.pose_at(1.0, CONSTANT, 3))
    points, _ = shape.drawn(Box(np.zeros(3), np.ones(3)), 3)
    np.testing.assert_allclose(shape.gaps(points)[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.ptp(points, axis=0), [2, 4, 1], atol=1e-12)
    gaps, normals = shape.gaps(np.array([[2.5, 0, 0]]))
    np.testing.assert_allclose([*gaps, *normals[0]], [0.5, 1, 0, 0], atol=1e-12)
