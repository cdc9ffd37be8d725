"""Limit points are found inside the steps: closed forms, and nothing else changes.

Von Mises' truss as one bar of St. Venant-Kirchhoff material between two rigid ends that turn
freely, which moves on straight lines through all of its heights: the vertical force is
E A h (L^2 - l^2)/(2 L^3) at the height h and the length l, L at first, for the strain is Green's.
Its largest value is at h = (L^2 - a^2)^(1/2)/3^(1/2), a the span.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.arch import FULL, RISE, arch
from mpi4py import MPI
from scipy.optimize import brentq

from dolfin_elastic import (
    Case,
    Problem,
    Statics,
    StVenantKirchhoff,
    Support,
    Traction,
    rectangle_body,
)
from dolfin_elastic.problem.state import State
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.solvers.statics import arc_length
from dolfin_elastic.solvers.statics.limit_points import LimitPoint, Sample, limit_points

SPAN, HEIGHT, THICK, E = 0.1, 0.01, 0.012, 1e6
LENGTH = float(np.hypot(SPAN, HEIGHT))
LOAD = E * THICK * 2 * HEIGHT**3 / (3 * np.sqrt(3)) / (2 * LENGTH**3)
"""The largest force of a bar of unit depth [N]."""


def truss(folder: Path, load: float = 1.5, **statics: Any) -> list[State]:
    """All states of the path to a force downwards, by default beyond both limit points."""
    across = np.array([-HEIGHT, SPAN]) / LENGTH * THICK / 2
    ends = np.array([[0.0, 0.0], [SPAN, HEIGHT]])
    corners = [ends[0] - across, ends[1] - across, ends[1] + across, ends[0] + across]
    lines = [
        f"Point({i + 1}) = {{{x!r}, {y!r}, 0, 6e-3}};"
        for i, (x, y) in enumerate([[float(value) for value in corner] for corner in corners])
    ]
    lines += [f"Line({i}) = {{{i}, {i % 4 + 1}}};" for i in range(1, 5)]
    lines += [
        "Curve Loop(1) = {1, 2, 3, 4}; Plane Surface(1) = {1};",
        'Physical Curve("b") = {2}; Physical Curve("a") = {4}; Physical Surface("bar") = {1};',
    ]
    file = folder / "truss.geo"
    if MPI.COMM_WORLD.rank == 0:
        file.write_text("\n".join(lines) + "\n")
    MPI.COMM_WORLD.barrier()
    held = {"kind": "rigid", "rotation": "free"}
    case = Case.from_dict(
        {
            "mesh": {"file": str(file), "unit": "m"},
            "materials": {"m": {"law": "st-venant-kirchhoff", "E": E, "nu": 0}},
            "support": [
                held | {"on": "a", "point": [0, 0], "displacement": [0, 0]},
                held
                | {
                    "on": "b",
                    "point": [SPAN, HEIGHT],
                    "displacement": [0, "free"],
                    "force": [0, -LOAD * load],
                },
            ],
            "statics": {"method": "arc-length", **statics},
            "output": {"folder": str(folder / "results")},
        }
    )
    return [*case.make_solver(case.make_problem(case.read_body())).steps()]


@pytest.mark.long
@pytest.mark.parametrize("rtol", [1e-4, 1e-6, 1e-11])
@pytest.mark.parametrize("first", [0.05, 0.4])
def test_errors_are_at_least_the_true_ones(folder, first, rtol):
    """Also where forces balance to few digits, or to many: beside the closed form."""
    *_, last = truss(folder, first_step=first, rtol=rtol)
    found, errors = 1.5 * np.array(last.limit_points), 1.5 * np.array(last.limit_errors)
    assert len(found) == 2
    assert np.all(np.abs(found - [1.0, -1.0]) <= errors)
    assert errors.max() < 20 * rtol


@pytest.mark.parametrize("first", [None, 0.05, 0.2, 0.4])
def test_truss(folder, first):
    """Both limit points to 1e-7, whatever the steps: parabolas were off by 2e-4, 8 % or saw one."""
    states = truss(folder, **({} if first is None else {"first_step": first}))
    found = np.array(states[-1].limit_points) * 1.5
    assert found == pytest.approx([1.0, -1.0], abs=1e-7)
    errors = np.array(states[-1].limit_errors)
    assert np.all(np.abs(np.abs(found) - 1) <= 1.5 * errors + 1e-15)
    assert errors.max() < 1e-6
    assert {s.audit.verdict for s in states[1:] if s.audit is not None} == {"pass"}
    assert len(states[0].limit_points) == 0


@pytest.mark.parametrize("load", [0.5, 0.95, 0.9999])
@pytest.mark.parametrize("first", [0.1, 0.6])
def test_an_end_that_is_passed_within_a_step(folder, load, first):
    """Below the limit point, at the larger height of two with this load, though steps pass both."""
    *_, state = truss(folder, load, first_step=first)
    a = 3**-0.5 * HEIGHT  # the height of the limit point, but for the slope of the bar

    def off(h: float) -> float:
        return E * THICK * h * (HEIGHT**2 - h**2) / (2 * LENGTH**3) - LOAD * load

    h = float(brentq(off, a, HEIGHT, xtol=1e-18))
    strain = (h**2 - HEIGHT**2) / (2 * LENGTH**2)
    assert state.load_factor == pytest.approx(1.0, rel=1e-12)
    # dF = 0 there: an error 1e-8 of the force is one of 1e-6 of the energy.
    assert state.energies["strain"] == pytest.approx(E * THICK * LENGTH * strain**2 / 2, rel=1e-5)
    assert state.limit_points == ()


def test_states_are_those_of_a_path_that_is_not_looked_into(monkeypatch):
    """Reactions, audit and work after the extra points are those of the ends of the steps."""
    looked = [*Statics(arch(RISE, FULL, (24, 1)), method="arc-length", first_step=0.05).steps()]
    monkeypatch.setattr(arc_length, "limit_points", lambda *_, **__: [])
    plain = [*Statics(arch(RISE, FULL, (24, 1)), method="arc-length", first_step=0.05).steps()]
    assert len(looked[-1].limit_points) == 2
    assert len(plain[-1].limit_points) == 0
    assert len(looked) == len(plain)
    for one, other in zip(looked, plain, strict=True):
        assert one.load_factor == pytest.approx(other.load_factor, rel=1e-9, abs=1e-12)
        for name, force in one.reactions.items():
            scale = max(float(np.abs(other.reactions[name]).max()), 1e-9)
            assert force == pytest.approx(other.reactions[name], rel=0, abs=1e-6 * scale)
        for name, moment in one.moments.items():
            wanted = other.moments[name].value
            assert moment.value == pytest.approx(wanted, rel=1e-6, abs=1e-12 * FULL)
        assert (one.audit is None) == (other.audit is None)
        if one.audit is not None and other.audit is not None:
            assert one.audit.verdict == other.audit.verdict
            assert one.audit.work == pytest.approx(other.audit.work, rel=1e-6, abs=1e-14)


@pytest.mark.long
def test_solvers_and_steps_agree():
    """Factors, and multigrid whose solves for the slope are tight; long steps and short ones."""
    found = []
    for method, first in (("direct", 0.05), ("iterative", 0.05), ("direct", 0.2)):
        problem = arch(RISE, FULL, (24, 1))
        linear = LinearSettings(method=method)
        *_, state = Statics(problem, method="arc-length", first_step=first, linear=linear).steps()
        found.append(state.limit_points)
    assert found[1] == pytest.approx(found[0], rel=1e-6)
    assert found[2] == pytest.approx(found[0], rel=1e-6)


def test_bifurcation_of_a_column(caplog):
    """A straight path has no limit point where the column buckles; its pivots tell the place.

    Euler's load of a cantilever, L/h = 10: pi^2 E I/(4 L^2) in plane stress; shear and the
    shortening take 1.4 %.
    """
    euler = np.pi**2 * (1.0 / 12) / (4 * 10.0**2)
    problem = Problem(
        rectangle_body(size=(1.0, 10.0), cells=(2, 20)),
        StVenantKirchhoff(E=1.0, nu=0.0),
        degree=2,
        supports=[Support(on="bottom")],
        loads=[Traction(on="top", value=[0, -2 * euler])],
    )
    with caplog.at_level("WARNING", logger="dolfin_elastic"):
        *_, state = Statics(problem, method="arc-length", first_step=0.11).steps()
        said = [r.getMessage() for r in caplog.records if "bifurcation" in r.getMessage()]
    (said,) = MPI.COMM_WORLD.bcast(said)  # only rank 0 speaks
    low, high = (float(x.strip(":,")) for x in said.split("load factors ")[1].split()[:3:2])
    assert low < 0.5 * 0.986 < high
    assert "0 negative eigenvalues before and 1 behind, with 0 limit points between" in said
    assert state.limit_points == ()


# --- the cubics alone ---


def spring(s: float, span: float = 8.0, height: float = 10.0) -> Sample:
    """Force of a deep truss of linear springs at a deflection, and its derivative."""
    h, long = height - s, float(np.hypot(span, height))
    now = float(np.hypot(span, h))
    slope = -(long / now - 1) + h**2 * long / now**3
    return Sample(s, h * (long / now - 1), slope)


EXACT = [spring(float(brentq(lambda s: spring(s).slope, *ends))).t for ends in ((1, 9), (11, 19))]


@pytest.mark.parametrize("steps", [2, 3, 6, 12, 25])
def test_cubics(steps):
    """All limits of a path that is no cubic, in steps of any length: with few further points."""
    ends, found, points = np.linspace(0.0, 25.0, steps + 1), list[LimitPoint](), []

    def find(s: float) -> Sample:
        points.append(s)
        return spring(s)

    for a, b in zip(ends[:-1], ends[1:], strict=True):
        found += limit_points(spring(float(a)), spring(float(b)), find)
    assert [limit.t for limit in found] == pytest.approx(EXACT, rel=1e-7)
    assert all(
        abs(limit.t - exact) <= limit.error + 1e-12
        for limit, exact in zip(found, EXACT, strict=True)
    )
    assert len(points) <= (3 if steps >= 6 else 5) * len(found)


@pytest.mark.parametrize("height", [1e-1, 1e-3, 1e-5])
def test_flat_limits_are_found_once(height):
    """Where the load hardly varies, its error says little of the place: none is told twice.

    Steps with one limit point in them, of a load that is no cubic.
    """
    draw = np.random.default_rng(1)
    for _ in range(300):
        c, top = np.append(draw.uniform(-0.3, 0.3, 2), -0.1), draw.uniform(0.05, 0.95)
        load = np.polynomial.Polynomial([1.0, 0.0, -height, *(height * c)])
        slope = load.deriv()
        at = [x.real for x in slope.roots() if abs(x.imag) < 1e-9 and -top < x.real < 1 - top]
        if len(at) != 1:
            continue

        def find(s: float, top: float = top, load: Any = load, slope: Any = slope) -> Sample:
            return Sample(s, float(load(s - top)), float(slope(s - top)))

        (limit,) = limit_points(find(0.0), find(1.0), find)
        assert abs(limit.t - float(load(at[0]))) <= limit.error + 1e-12


def test_a_point_that_is_not_found():
    """Then the cubic of the whole step tells the limit, with an error as large as the step's."""
    begin, end = spring(0.0), spring(8.0)
    (limit,) = limit_points(begin, end, lambda s: None)
    assert limit.t == pytest.approx(EXACT[0], rel=0.1)
    assert limit.error > abs(limit.t - EXACT[0])
