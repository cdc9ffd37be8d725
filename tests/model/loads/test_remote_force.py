"""Remote forces: resultants, cantilevers in closed form, and both couplings."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.nodal_forces import forces, total
from mpi4py import MPI

from dolfin_elastic import (
    Fixed,
    Force,
    LinearElastic,
    Problem,
    RemoteForce,
    Rigid,
    Statics,
    StVenantKirchhoff,
    box_body,
    rectangle_body,
)
from dolfin_elastic.core.errors import InputError

E, L, H, DISTANCE = 1e9, 10.0, 1.0, 4.0


def bar(dim: int = 3, cells: int = 10) -> Any:
    """A bar along x whose middle line is the x axis."""
    size, number, origin = (L, H, H)[:dim], (cells, 1, 1)[:dim], (0, -H / 2, -H / 2)[:dim]
    return (box_body if dim == 3 else rectangle_body)(size=size, cells=number, origin=origin)


def problem(loads: Any, dim: int = 3, law: Any = LinearElastic, **keys: Any) -> Problem:
    supports = [Fixed(on="left")]
    return Problem(bar(dim), law(E=E, nu=0.0), supports=supports, loads=loads, degree=2, **keys)


def solved(loads: Any, **keys: Any) -> tuple[Problem, np.ndarray]:
    made = problem(loads, **keys)
    *_, state = Statics(made).steps()
    return made, state.u.x.array.reshape(-1, made.body.dim).copy()


def tip(made: Problem, u: np.ndarray) -> float:
    """Mean deflection of the nodes of the end."""
    last = np.isclose(made.places[: len(u), 0], L)
    comm = made.body.comm
    sums = [float(u[last, 1].sum()), float(last.sum())]
    return float(np.divide(*(comm.allreduce(one, op=MPI.SUM) for one in sums)))


@pytest.mark.parametrize(("dim", "thickness"), [(3, 1.0), (2, 0.2)])
def test_resultants(dim, thickness):
    """Force and moment at the point, on two faces at once and at another time."""
    F, M = [3.0, -20.0, 7.0][:dim], [11.0, 5.0, -9.0] if dim == 3 else -9.0
    point = [14.0, 2.0, -1.0][:dim]
    load = RemoteForce(
        on=["right", "top"], point=point, force=[*F[:1], "-10*t", *F[2:]], moment=M, curve="2"
    )
    keys = {"thickness": thickness} if dim == 2 else {}
    made = Problem(bar(dim), LinearElastic(E=E, nu=0.0), loads=[load], degree=2, **keys)
    made.set_time(2.0)
    x, f = forces(made)
    np.testing.assert_allclose(total(made, f), 2 * np.array(F), rtol=1e-12, atol=1e-12)
    arms, f = (np.pad(a, ((0, 0), (0, 3 - dim))) for a in (x - np.array(point), f))
    wanted = 2 * np.resize(np.array([0.0, 0, M]) if dim == 2 else np.array(M), 3)
    np.testing.assert_allclose(total(made, np.cross(arms, f)), wanted, rtol=1e-12, atol=1e-11)


def test_force_beyond_the_end_is_a_force_and_a_moment_at_the_end():
    """F L^3/(3 E I) + F d L^2/(2 E I), of a slender beam; and the same as the equivalent pair."""
    F = 100.0
    made, u = solved([RemoteForce(on="right", point=[L + DISTANCE, 0, 0], force=[0, F, 0])])
    pair = [
        Force(on="right", value=[0, F, 0]),
        RemoteForce(on="right", moment=[0, 0, f"{F * DISTANCE} N*m"]),
    ]
    _, other = solved(pair)
    np.testing.assert_allclose(u, other, rtol=0, atol=1e-10 * np.abs(u).max())
    stiff = E * H**4 / 12
    beam = F * L**3 / (3 * stiff) + F * DISTANCE * L**2 / (2 * stiff)
    assert tip(made, u) == pytest.approx(beam, rel=0.02)


def test_pure_moment_bends_a_bar_in_a_circle_exactly():
    """The traction is linear over the end, as in the closed form: u_y = M x^2/(2 E I)."""
    made, u = solved([RemoteForce(on="right", moment=["0 N*m", 0, 600])])
    x = made.places[: len(u)]
    exact = 600 / (E * H**4 / 12) * np.where(np.isclose(x[:, 0], L), L**2 / 2, np.nan)
    middle = np.isclose(x[:, 1], 0) & np.isfinite(exact)
    np.testing.assert_allclose(u[middle, 1], exact[middle], rtol=1e-9)


def test_rigid_coupling_is_a_rigid_plate():
    """With all six motions free; and as the bar's end, by beam theory."""
    keys = {"point": [L + DISTANCE, 0, 0], "force": [0, 100.0, 0]}
    made, u = solved([RemoteForce(on="right", coupling="rigid", **keys)])
    plate = Rigid(on="right", moment=[0, 0, 0], **keys)
    other = Problem(bar(), LinearElastic(E=E, nu=0.0), supports=[Fixed(on="left"), plate], degree=2)
    *_, state = Statics(other).steps()
    np.testing.assert_allclose(u, state.u.x.array.reshape(-1, 3), atol=1e-9 * np.abs(u).max())
    _, averaged = solved([RemoteForce(on="right", **keys)])
    assert tip(made, u) == pytest.approx(tip(made, averaged), rel=5e-3)


def test_work_and_reactions_with_large_strains():
    """The audit closes; what is fixed bears the force, and its moment by the undeformed arm."""
    load = RemoteForce(on="right", point=[L, 3, 0], force=[500, 0, 0])
    made = problem([load], law=StVenantKirchhoff)
    *_, state = Statics(made).steps()
    np.testing.assert_allclose(state.reactions["left"], [-500, 0, 0], rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({}, "force: nothing is given"),
        ({"value": [1, 0, 0]}, "value: a remote force has no value"),
        ({"force": ["x", 0, 0]}, "force: a force at one point is the same everywhere"),
        ({"force": [1, 0, 0], "point": ["t", 0, 0]}, "point[0]: 't' is not a number"),
        ({"moment": "5 N"}, "moment"),
        ({"force": [1, 0, 0], "coupling": "loose"}, "coupling"),
        ({"force": [1, 0]}, "load[0].force: 2 components given"),
        ({"moment": 3}, "load[0].moment: 1 components given"),
        ({"force": [1, 0, 0], "point": [0, 0]}, "load[0].point: 2 components given"),
    ],
)
def test_what_is_no_remote_force(keys, says):
    with pytest.raises(InputError) as caught:
        problem([RemoteForce(on="right", **keys)])
    assert says in str(caught.value)


def test_body_of_revolution_takes_none():
    with pytest.raises(InputError, match="a body of revolution takes no force at a point"):
        Problem(
            rectangle_body(size=(1, 1), cells=(1, 1)),
            LinearElastic(E=E, nu=0.0),
            loads=[RemoteForce(on="top", force=[0, 1])],
            geometry="axisymmetric",
        )


def test_sentence():
    load = RemoteForce(on="right", point=[0, 1, 0], force=["1 kN", 0, 0], moment=[0, 0, "5 N*m"])
    said = "remote force (1 kN, 0, 0) and moment (0, 0, 5 N*m); point (0, 1, 0) m"
    assert load.describe() == said
