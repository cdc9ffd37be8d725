"""Paths through limit points: shallow arches against the closed form of their beams."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from conftest import displacement_at
from helpers.arch import FULL, RISE, SPAN, THICK, E, arch
from helpers.states import last
from mpi4py import MPI

from dolfin_elastic import (
    Contact,
    NeoHookean,
    Problem,
    Spring,
    Statics,
    StVenantKirchhoff,
    Support,
    Traction,
    rectangle_body,
)
from dolfin_elastic.core.errors import ConvergenceError


def arch_path(rise: float) -> tuple[np.ndarray, np.ndarray]:
    """Load and midspan deflection of a clamped shallow arch under a central point load.

    The arch is a parabola of the given rise.  With the axial compression C = EI m^2, constant along
    the arch, the vertical displacement v of the half from the clamp (x = 0) to midspan (x = l) has

        EI v'''' + C v'' = C k,  k = 8 rise/span^2,  v = v' = 0 at the clamp, v' = 0 at midspan,

    and C l/EA = -integral of (y' v' + v'^2/2): a quadratic equation for one constant, two branches.
    Source: H. L. Schreyer and E. F. Masur, Buckling of shallow arches, J. Eng. Mech. Div. ASCE 92
    (1966) 1; also M. A. Bradford, B. Uy and Y.-L. Pi, J. Eng. Mech. 128 (2002) 710.
    """
    EA, EI, l = E * THICK, E * THICK**3 / 12, SPAN / 2
    k = 8 * rise / SPAN**2
    x = np.linspace(0, l, 2001)
    slope = 4 * rise / SPAN - k * x
    points = []
    for m in np.linspace(1e-3, 3 * np.pi, 6000) / l:
        s, c = np.sin(m * l), np.cos(m * l)
        if abs(1 - c) < 1e-9:
            continue
        # v' = k x - a m sin(m x) - b m (1 - cos(m x)), zero at midspan: b = (k l/m - a s)/(1 - c).
        b0, b1 = k * l / (m * (1 - c)), -s / (1 - c)
        d0 = k * x - b0 * m * (1 - np.cos(m * x))
        d1 = -m * np.sin(m * x) - b1 * m * (1 - np.cos(m * x))
        q = [
            np.trapezoid(d1 * d1 / 2, x),
            np.trapezoid(slope * d1 + d0 * d1, x),
            np.trapezoid(slope * d0 + d0 * d0 / 2, x) + EI * m**2 * l / EA,
        ]
        disc = q[1] ** 2 - 4 * q[0] * q[2]
        if disc < 0:
            continue
        for sign in (-1, 1):
            a = (-q[1] + sign * np.sqrt(disc)) / (2 * q[0])
            b = b0 + b1 * a
            v = k * l**2 / 2 + a * (c - 1) - b * (m * l - s)
            third = a * m**3 * s - b * m**3 * c
            points.append((2 * EI * third, -v))
    loads, deflections = np.array(points).T
    return loads, deflections


def limits(rise: float) -> tuple[float, float]:
    """Upper and lower limit load of the closed form."""
    loads, deflections = arch_path(rise)
    upper = loads[deflections < 0.8 * rise].max()
    low = (deflections > 0.8 * rise) & (deflections < 1.4 * rise)
    return float(upper), float(loads[low].min())


@pytest.mark.long
def test_snap_through_of_a_shallow_arch():
    """The path of a solid arch, L/h = 200, is that of the shallow arch.

    What the closed form leaves out is the square of the slope, 0.06^2 = 0.4 %, and shear.
    """
    problem = arch(RISE, FULL, (24, 1))
    states = [*Statics(problem, method="arc-length", first_step=0.05).steps()]
    loads, deflections = arch_path(RISE)
    upper, lower = limits(RISE)
    found = np.array(states[-1].limit_points) * FULL
    assert found == pytest.approx([upper, lower], rel=1e-2)
    assert states[-1].load_factor == 1.0
    w = -displacement_at(problem, (SPAN / 2, RISE))[1]
    near = (deflections > 1.2 * RISE) & (loads < 1.2 * FULL)
    order = np.argsort(loads[near])
    there = np.interp(FULL, loads[near][order], deflections[near][order])
    assert w == pytest.approx(there, rel=1e-2)


def test_a_load_far_beyond_the_limit_points():
    """Ten times as large a load: its first step is made so small that nothing is passed over."""
    problem = arch(RISE, 10 * FULL, (24, 1))
    states = [*Statics(problem, method="arc-length", max_displacement=2.5 * RISE).steps()]
    found = np.array(states[-1].limit_points) * 10 * FULL
    assert found == pytest.approx(limits(RISE), rel=2e-2)  # of longer steps


def test_the_falling_path_is_unstable_and_the_rising_ones_are_not():
    """Between the limit points the tangent of a half arch has one negative eigenvalue."""
    problem = arch(RISE, FULL, (24, 1))
    states = [*Statics(problem, method="arc-length", first_step=0.05).steps()]
    factors = np.array([s.load_factor for s in states])
    top = int(np.argmax(factors[:-1] * (np.arange(len(factors) - 1) < len(factors) // 2)))
    bottom = top + int(np.argmin(factors[top:]))
    # Near a limit point the last tangent may belong to its other side.
    assert {s.negative for s in states[1 : top - 1]} == {0}
    assert {s.negative for s in states[top + 2 : bottom - 1]} == {1}
    assert {s.negative for s in states[bottom + 2 :]} == {0}


@pytest.mark.long
def test_growing_load_snaps_and_says_so(caplog):
    """Beyond the upper limit point the load finds the other branch, with a warning."""
    problem = arch(RISE, FULL, (24, 1))
    with caplog.at_level(logging.WARNING, logger="dolfin_elastic"):
        *_, state = Statics(problem).steps()
    assert state.load_factor == 1.0
    assert any(MPI.COMM_WORLD.allgather("the part has snapped" in caplog.text))
    along = arch(RISE, FULL, (24, 1))
    *_, other = Statics(along, method="arc-length", first_step=0.05).steps()
    # Both are the same equilibrium to Newton's tolerance.
    assert state.energies["strain"] == pytest.approx(other.energies["strain"], rel=1e-6)


def test_without_snapping_the_limit_point_is_the_end():
    problem = arch(RISE, FULL, (24, 1))
    upper, _ = limits(RISE)
    with pytest.raises(ConvergenceError) as caught:
        _ = [*Statics(problem, snap=False, min_step=0.02).steps()]
    reached = float(str(caught.value).split("load factor ")[1].split(":")[0])
    # The last step below the limit is at most twice 0.02 of a quarter of the load.
    assert upper / FULL * 0.99 - 0.01 <= reached <= upper / FULL * 1.01


def test_a_path_without_limit_points_ends_at_the_load():
    """A bar that is pulled: the arc length only chooses the steps."""
    pulled = [Traction(on="right", value=[0.2 * E, 0])]
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    held = [Support(on="left", displacement=[0, 0])]
    states = []
    for settings in ({"method": "arc-length"}, {"steps": 4}):
        bar = Problem(body, StVenantKirchhoff(E=E, nu=0.3), supports=held, loads=pulled, degree=1)
        states.append([*Statics(bar, **settings).steps()][-1])
    assert states[0].limit_points == ()
    assert states[0].load_factor == 1.0
    # Newton's tolerance, 1e-8 of the force.
    assert states[0].max_displacement == pytest.approx(states[1].max_displacement, rel=1e-8)


@pytest.mark.long
def test_snap_back_of_an_arch_behind_a_soft_spring():
    """Pushed through a spring softer than the arch is unstable, the spring's base goes back.

    The base is at d = w + P/(2 k) of each half, with the closed form's load P and deflection w:
    d falls wherever -dP/dw > 2 k, so neither load nor base can be prescribed there.
    """
    loads, deflections = arch_path(RISE)
    inside = deflections < 1.4 * RISE
    upper, lower = (loads[inside & (s * (deflections - 0.8 * RISE) < 0)] for s in (1, -1))
    k = 0.25 * (upper.max() - lower.min()) / RISE
    base = deflections + loads / (2 * k)
    far = 1.2 * base[inside & (deflections < 0.8 * RISE)].max()
    problem = arch(RISE, 0.0, (24, 1))
    pushed = Spring(on="right", stiffness=[0, k], total=True, displacement=[0, -far])
    problem = Problem(
        problem.body,
        StVenantKirchhoff(E=E, nu=0.0),
        degree=2,
        supports=[*problem.supports, pushed],
    )
    states = [*Statics(problem, method="arc-length", first_step=0.05).steps()]
    first, second = np.array(states[-1].limit_points)[:2] * far
    assert second < first  # it comes back
    assert first == pytest.approx(base[inside & (deflections < 0.8 * RISE)].max(), rel=1e-2)
    back = inside & (deflections > 0.8 * RISE)
    assert second == pytest.approx(base[back].min(), rel=1e-2)


@pytest.mark.long
@pytest.mark.parametrize("first", [0.2, 0.6])
def test_no_step_passes_a_thin_obstacle(first):
    """Neither the first step nor one in its direction nor the last one; a plate stops the block."""
    problem = Problem(
        rectangle_body(size=(1, 1), cells=(4, 2)),
        NeoHookean(E=1e3, nu=0.3),
        supports=[
            Support(on="left", displacement=[0, "free"]),
            Support(on="bottom", displacement=["free", 0]),
        ],
        loads=[Traction(on="right", value=[700, 0])],
        contacts=[Contact(on="right", box={"center": [1.31, 0.5], "size": [0.02, 4]})],
        degree=1,
    )
    state = last(problem, method="arc-length", first_step=first)
    assert state.t == 1.0
    right = problem.body.comm.allreduce(problem.u.x.array[::2].max(), op=MPI.MAX)
    # Pressed by hundreds of pascals, the gap is closed to the tolerance, 1e-3 of an element.
    assert right == pytest.approx(0.3, abs=2.5e-4)
