"""Motions that do not begin as their supports do: told, with where and how much."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dolfinx import fem

from dolfin_elastic import (
    Case,
    Dynamics,
    Normal,
    Problem,
    Rotation,
    StVenantKirchhoff,
    Support,
    Symmetry,
    rectangle_body,
)
from dolfin_elastic.case.check.report import report
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.problem.state import StateCopy
from dolfin_elastic.solvers.dynamics import consistent_start
from dolfin_elastic.solvers.dynamics.initial_conditions import SupportJump, set_initial
from dolfin_elastic.solvers.dynamics.settings import DynamicsSettings

FREE = "free"
LAW = StVenantKirchhoff(E=1e6, nu=0.3, density=1000)


def start(
    supports: list[Any], *, slope: float = 0.0, **motion: Any
) -> tuple[list[SupportJump], Any]:
    """What a rectangle of 2 by 1 begins with, sheared by `slope`."""
    body = rectangle_body(size=(2, 1), cells=(4, 2))
    x = body.mesh.geometry.x
    x[:, 1] += slope * x[:, 0]
    problem = Problem(body, LAW, supports=supports, degree=1)
    s = DynamicsSettings(end=1.0, dt=0.1, **motion)
    v = fem.Function(problem.V)
    return set_initial(problem, v, s.displacement, s.velocity, s.end), v


CLAMP = Support(on="left")


@pytest.mark.parametrize(
    ("supports", "motion", "expected"),
    [
        ([CLAMP], {"initial_velocity": [3, 4]}, ("left", "velocity", 5.0, (0, 0))),
        ([CLAMP], {"initial_velocity": ["1 - y", 0]}, ("left", "velocity", 1.0, (0, 0))),
        ([CLAMP], {"initial_velocity": ["y", 0]}, ("left", "velocity", 1.0, (0, 1))),
        (
            [Support(on="right", displacement=["0.1*sin(20*t)", FREE])],
            {},
            ("right", "velocity", 2.0, (2, 0)),
        ),
        (
            [Support(on="right", displacement=[0.5, FREE], curve="ramp")],
            {"initial_velocity": [0.2, 7]},
            ("right", "velocity", 0.3, (2, 0)),
        ),
        (
            [Support(on="right", displacement=[0, "0.1*x"])],
            {},
            ("right", "displacement", 0.2, (2, 0)),
        ),
        ([CLAMP], {"initial_displacement": [0, "-0.3*y"]}, ("left", "displacement", 0.3, (0, 1))),
        ([Symmetry(on="bottom")], {"initial_velocity": [9, 2]}, ("bottom", "velocity", 2, (0, 0))),
        (
            [Rotation(on="left", point=[0, 0], angle="4*t")],
            {},
            ("left", "velocity", 4.0, (0, 1)),
        ),
    ],
)
def test_what_does_not_fit_is_told(supports, motion, expected):
    """With the support, how much, and where; the differences are exact but for round-off.

    Speeds of supports are differences over 1e-7 s, so 1e-16 of 2 m gives 1e-8 m/s.
    """
    (found,), _ = start(supports, **motion)
    assert (found.support, found.what) == expected[:2]
    assert found.most == pytest.approx(expected[2], rel=1e-7)
    assert found.place == pytest.approx(expected[3], abs=1e-12)


def test_two_supports_with_a_node_in_common():
    """Each is told of with what it holds: in the corner the later one."""
    supports = [CLAMP, Support(on="top", displacement=[0, "2*t"])]
    found, _ = start(supports, initial_velocity=[1, 0])
    assert [(f.support, f.most) for f in found] == [
        ("left", pytest.approx(1.0)),
        ("top", pytest.approx(np.sqrt(5))),
    ]


@pytest.mark.parametrize(
    ("supports", "motion"),
    [
        ([CLAMP], {}),
        ([CLAMP], {"initial_velocity": ["3*x", "x*(1 + y)"]}),
        ([Support(on="right")], {"initial_velocity": ["sin(pi*x)", "x - 2"]}),
        ([Support(on="right")], {"initial_displacement": ["1e-3*sin(pi*x)", "(x - 2)/3"]}),
        ([Support(on="right", displacement=["0.1*sin(20*t)", 0])], {"initial_velocity": [2, 0]}),
        ([Support(on="right", displacement=["0.1*(1 - cos(1000*t))", 0])], {}),
        ([Support(on="right", displacement=[0.3, 0], curve="smooth")], {}),
        ([Support(on="right", displacement=[0.3, 0])], {"initial_displacement": [0.3, 0]}),
        ([Symmetry(on="bottom")], {"initial_velocity": [9, "y"]}),
        (
            [Rotation(on="left", point=[0.5, 0.25], angle="4*t")],
            {"initial_velocity": ["-4*(y - 0.25)", "4*(x - 0.5)"]},
        ),
        ([], {"initial_velocity": [1, 2], "initial_displacement": [0, 1]}),
    ],
)
def test_what_fits_is_not_told(supports, motion):
    """Nor is round-off, nor the difference by which the speed of a support is found."""
    assert start(supports, **motion)[0] == []


def test_along_and_across_an_inclined_surface():
    """The bottom leans by 1 in 2: (2, 1) is along it, and of (0, 1) 2/sqrt(5) goes across."""
    held = [Normal(on="bottom")]
    assert start(held, slope=0.5, initial_velocity=[2, 1])[0] == []
    (found,), v = start(held, slope=0.5, initial_velocity=[0, 1])
    assert (found.support, found.what) == ("bottom", "velocity")
    assert found.most == pytest.approx(2 / np.sqrt(5), rel=1e-12)
    assert np.isfinite(v.x.array).all()


def test_speeds_of_supports_are_of_second_order():
    """At t = 0 of 1 - cos(1000 t) it is 0, where a difference of first order has 0.05 m/s."""
    shaken = Support(on="right", displacement=["1 - cos(1000*t)", "exp(30*t) - 1"])
    _, v = start([shaken], initial_velocity=[0, 30])
    own = v.x.array.reshape(-1, 2)
    np.testing.assert_allclose(own, np.tile([0, 30], (len(own), 1)), atol=1e-6)


@pytest.mark.parametrize("scheme", ["generalized-alpha", "central-differences"])
def test_the_log_says_it_once_and_a_restart_does_not(caplog, scheme):
    """In words: who, how much, where, what follows and what to do."""
    dt = {"dt": 1e-3} if scheme == "generalized-alpha" else {}
    body = rectangle_body(size=(2, 1), cells=(2, 1))
    settings = DynamicsSettings(scheme=scheme, end=2e-3, initial_velocity=[0, -3], **dt)
    first = Dynamics(Problem(body, LAW, supports=[CLAMP], degree=1), settings)
    steps = first.steps()
    next(steps)
    saved = StateCopy(first.restart_state())
    steps.close()
    next(Dynamics(Problem(body, LAW, supports=[CLAMP], degree=1), settings).steps(saved))
    said = [r.getMessage() for r in caplog.records if r.levelname == "WARNING"]
    if body.comm.rank == 0:
        (text,) = said
        assert text == (
            "at the start the support 'left' and the body differ in velocity, by 3 m/s at "
            "(0, 0) m: its nodes move with the support at once, and a shock runs into the body. "
            "Was that meant? Else dynamics.initial_velocity fits it, or a curve that begins gently"
        )


def test_a_check_notes_it():
    """And leaves the body where it is for what else there is to say."""
    found = report(
        Case(
            mesh={"rectangle": {"size": [1, 1], "cells": [1, 1]}, "degree": 1},
            materials={"gel": {"law": "neo-hookean", "E": 1e6, "nu": 0.3, "density": 1000}},
            support=[{"on": "left"}],
            dynamics={"end": 1, "dt": 0.1, "initial_displacement": [0.25, 0]},
        )
    )
    (note,) = (n for n in found.notes if "shock" in n)
    assert note.startswith(
        "at the start the support 'left' and the body differ in displacement, by 0.25 m at (0, 0) m"
    )


@pytest.mark.parametrize("which", ["displacement", "velocity"])
def test_values_that_are_none_are_refused_where_a_support_overrules_them(which):
    """Somebody has written 1/x without the clamp at x = 0 in mind."""
    with pytest.raises(InputError, match=f"dynamics.initial_{which}: .* not finite"):
        start([CLAMP], **{f"initial_{which}": ["1/x", 0]})


@pytest.mark.parametrize(
    ("material", "motion", "where"),
    [({"viscosity": 3}, {}, "materials"), ({}, {"rayleigh": [1, 1e-5]}, "dynamics.rayleigh")],
)
def test_damping_in_plane_stress_is_refused_before_a_run(material, motion, where):
    case = Case.from_dict(
        {
            "mesh": {
                "rectangle": {"size": [2, 1], "cells": [2, 1]},
                "geometry": "plane-stress",
                "degree": 1,
            },
            "materials": {
                "body": {"law": "neo-hookean", "E": 1, "nu": 0.3, "density": 1, **material}
            },
            "support": [{"on": "left"}],
            "dynamics": {"end": 1, "dt": 0.1, **motion},
        }
    )
    with pytest.raises(InputError, match=f"{where}: .* cannot be damped"):
        report(case)


def test_differences_in_time_are_exact_for_a_cubic() -> None:
    """First and second derivative at the first of four points, of 1, t, t^2 and t^3."""
    powers = np.vander(np.arange(4.0), increasing=True).T
    np.testing.assert_allclose(powers @ consistent_start.FIRST, [0, 1, 0, 0], rtol=0, atol=1e-14)
    np.testing.assert_allclose(powers @ consistent_start.SECOND, [0, 0, 2, 0], rtol=0, atol=1e-14)
