"""Bearing loads: their total, their pressure in closed form, and what they refuse."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from helpers.annulus import annulus
from helpers.nodal_forces import forces, total
from mpi4py import MPI

from dolfin_elastic import Bearing, LinearElastic, Problem, box_body, rectangle_body
from dolfin_elastic.case.check.integrals import Integrals
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import total as reduced
from dolfin_elastic.model.loads import LoadPoints
from dolfin_elastic.problem.context import Measures

E, NU, R, LENGTH = 1e6, 0.3, 0.5, 0.8


def tube(dim: int, cells: int = 24, *, arc: float = 2 * np.pi, centre: Any = (3, -2, 0)) -> Any:
    """A tube about z, or a ring, from radius R on: its bore is called left, its shaft right."""
    size, number = (1, 1, LENGTH)[:dim], (1, cells, 2)[:dim]
    body = (box_body if dim == 3 else rectangle_body)(size=size, cells=number)
    x = body.mesh.geometry.x
    r, angle = R + x[:, 0], 0.3 + arc * x[:, 1]
    x[:, 0], x[:, 1] = centre[0] + r * np.cos(angle), centre[1] + r * np.sin(angle)
    return body


def nodal(body: Any, load: Bearing, at: float = 1.0, **keys: Any) -> tuple[Any, Any, Any]:
    problem = Problem(body, LinearElastic(E=E, nu=NU), loads=[load], degree=1, **keys)
    problem.set_time(at)
    return problem, *forces(problem)


@pytest.mark.parametrize(("dim", "on"), [(3, "left"), (3, "right"), (2, "left")])
def test_total_is_the_force_and_there_is_no_moment_about_the_axis(dim, on):
    """Also where the mesh has no symmetry about the force."""
    load = Bearing(on=on, value=["1 kN", 300, 0][:dim])
    problem, x, f = nodal(tube(dim), load, **({"thickness": 0.1} if dim == 2 else {}))
    np.testing.assert_allclose(total(problem, f), [1000, 300, 0][:dim], rtol=1e-12, atol=1e-9)
    r = x[:, :2] - [3, -2]
    about = total(problem, r[:, 0] * f[:, 1] - r[:, 1] * f[:, 0])
    assert abs(about) < 1e-2 * R * 1000 / 24**2  # of facets; the pressure itself is radial


def test_half_that_is_pressed():
    """A bolt presses the wall ahead of it, a hub the shaft from behind."""
    for on, side in (("left", 1), ("right", -1)):
        problem, x, f = nodal(tube(2), Bearing(on=on, value=[7, 0]))
        far = side * (x[:, 0] - 3) < -0.1
        assert np.abs(f[far]).max(initial=0.0) < 1e-12
        assert total(problem, np.abs(f[~far]).sum(axis=0, keepdims=True))[0] > 6.9


def test_pressure_in_closed_form():
    """p0 = 2 F/(pi r L), from a fine mesh."""
    F, load = 1000.0, Bearing(on="left", value=[1000, 0, 0])
    problem = Problem(tube(3, 96), LinearElastic(E=E, nu=NU), degree=1)
    measures = Measures(problem.body, [problem.regions[0].cells], [("left",)], None)
    points = measures.load_points(["left"], 2)
    p = np.linalg.norm(load.intensity(points), axis=-1)
    r = points.X[..., :2] - [3, -2]
    cosine = np.maximum(r[..., 0] / np.linalg.norm(r, axis=-1), 0)
    np.testing.assert_allclose(p, 2 * F / (np.pi * R * LENGTH) * cosine, atol=3e-3 * F)


def test_a_reversed_force_presses_the_other_side():
    load = Bearing(on="left", value=[10, 0], curve=[[0, 1], [1, -1]])
    problem, x, f = nodal(tube(2), load)
    np.testing.assert_allclose(total(problem, f), [-10, 0], atol=1e-11)
    assert np.abs(f[x[:, 0] > 3.1]).max(initial=0.0) < 1e-12


def test_half_a_bore_and_a_given_axis():
    half = tube(3, 12, arc=np.pi)
    middle = 0.3 + np.pi / 2
    value = [float(5 * np.cos(middle)), float(5 * np.sin(middle)), 0]
    problem, _, f = nodal(half, Bearing(on="left", value=value, axis="z"))
    np.testing.assert_allclose(total(problem, f), value, atol=1e-11)


def test_curved_elements_bear_the_same_total():
    """A quarter of a ring that follows its arc, pressed along its bisector; the check agrees."""
    body, F = annulus(MPI.COMM_WORLD, 4), [300.0, 300.0]
    problem, _, f = nodal(body, Bearing(on="inside", value=F), thickness=0.3)
    np.testing.assert_allclose(total(problem, f), F, rtol=1e-12)
    integrals = Integrals(problem, 0.3)
    points = integrals.facets(["inside"])
    weights = integrals.full_weights(points)
    share = partial(reduced, body.comm)
    p = problem.loads[0].intensity(LoadPoints(points.X, 1, points.N, weights=weights, total=share))
    np.testing.assert_allclose(share((weights[..., None] * p).sum(axis=(0, 1))), F, rtol=1e-12)


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"value": [3, 0, 4]}, "load[0].value: 4 N of it are along the bore's axis (0, 0, 1)"),
        ({"value": [3, 0, 0], "on": "top"}, "load[0].on: the surface is no cylinder: it is flat"),
        ({"value": [3, 0, 0], "on": ["top", "left"]}, "its normals are not across one axis"),
        ({"value": [3, 0, 0], "axis": "x"}, "its normals are not across one axis"),
        ({"value": [3, 0, 0], "on": ["left", "right"]}, "its normals do not meet in one axis"),
        ({"value": [-1, -3, 0]}, "load[0].value: no pressure on this surface sums up"),
    ],
)
def test_what_is_no_bearing_load(keys, says):
    arc = np.pi if keys["value"][1] else 2 * np.pi
    with pytest.raises(InputError) as caught:
        nodal(tube(3, 12, arc=arc), Bearing(**{"on": "left", **keys}))
    assert says in str(caught.value)


def test_body_of_revolution_takes_no_force_across_its_axis():
    with pytest.raises(InputError, match="across the axis of a body of revolution"):
        nodal(tube(2, centre=(9, 0)), Bearing(on="left", value=[1, 0]), geometry="axisymmetric")


def test_formulas_are_refused():
    with pytest.raises(InputError, match="a formula cannot stand here"):
        Bearing(on="left", value=["3*t", 0, 0])


def test_arrows_need_no_sum():
    along = Bearing(on="left", value=[2, 0]).intensity(
        LoadPoints(np.zeros((2, 2)), 1.0, N=np.array([[-1.0, 0], [1, 0]]))
    )
    np.testing.assert_allclose(along, [[2, 0], [0, 0]])
