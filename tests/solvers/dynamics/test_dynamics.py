"""Implicit motion: order in time, exact answers, conserved quantities, moving supports.

One triangle held but for one displacement is an oscillator whose frequency is known exactly.
Momenta of the free brick are closed-form integrals.  Source of the scheme: Chung & Hulbert (1993).
"""

from __future__ import annotations

import gc

import numpy as np
import pytest
from helpers.motion import (
    NU,
    OMEGA,
    PERIOD,
    RHO,
    SPIN,
    STIFF,
    E,
    brick,
    drift,
    oscillator,
    swing,
    tip,
    value_at,
)
from mpi4py import MPI

from dolfin_elastic import (
    Dynamics,
    Gravity,
    LinearElastic,
    NeoHookean,
    Problem,
    Statics,
    Support,
    Traction,
    box_body,
    rectangle_body,
)
from dolfin_elastic.core.errors import ConvergenceError, InputError
from dolfin_elastic.model.amplitude import CONSTANT
from dolfin_elastic.solvers.assembly.matrix import TangentMatrix

# --- the oscillator ---


@pytest.mark.long
@pytest.mark.parametrize("radius", [1.0, 0.8, 0.0])
def test_second_order_in_time(radius):
    """Distance from the exact place in the plane of u and v/omega, over four time steps."""
    end, steps = 0.9 * PERIOD, np.array([40, 80, 160, 320])
    exact = 1e-3 * np.array([np.cos(OMEGA * end), -np.sin(OMEGA * end)])
    error = [
        np.linalg.norm(swing(end / n, end, spectral_radius=radius)[-1, 1:] / [1, OMEGA] - exact)
        for n in steps
    ]
    slope = np.polyfit(np.log(1 / steps), np.log(error), 1)[0]
    assert 1.95 <= slope <= 2.2


@pytest.mark.parametrize(
    ("radius", "modulus", "angle"),
    [
        (1.0, 1.0, 0.199337304982),
        (0.8, 0.999998915476, 0.199300680894),
        (0.5, 0.999971142891, 0.199010959806),
        (0.0, 0.999309414064, 0.196629820225),
    ],
)
def test_amplification_of_each_step(radius, modulus, angle):
    """Modulus and angle a step at omega dt = 0.2, from the scheme's 3x3 amplification matrix.

    u_n follows a two-term recursion with these numbers once the scheme has settled (the third
    eigenvalue belongs to the acceleration and dies out).
    """
    u = swing(0.2 / OMEGA, 12.0 / OMEGA, spectral_radius=radius)[:-1, 1]
    u = u[20:]
    left = np.stack([u[1:-1], u[:-2]], axis=1)
    (twice, minus), *_ = np.linalg.lstsq(left, u[2:], rcond=None)
    assert np.sqrt(-minus) == pytest.approx(modulus, abs=1e-9)
    assert np.arccos(twice / 2 / np.sqrt(-minus)) == pytest.approx(angle, abs=1e-9)


def test_undamped_scheme_keeps_the_energy_of_a_linear_body():
    problem = oscillator()
    totals = [
        state.energies["total"]
        for state in Dynamics(
            problem,
            end=5 * PERIOD,
            dt=PERIOD / 12,
            spectral_radius=1.0,
            rtol=1e-13,
            initial_displacement=["1e-3*x", 0],
        ).steps()
    ]
    assert totals[0] == pytest.approx(0.5 * STIFF / 2 * 1e-6, rel=1e-12)
    # The initial acceleration is the right one: nothing changes from the first step on.
    np.testing.assert_allclose(totals, totals[0], rtol=1e-10)


def test_damped_scheme_loses_energy_monotonically():
    problem = oscillator()
    totals = np.array(
        [
            state.energies["total"]
            for state in Dynamics(
                problem,
                end=3 * PERIOD,
                dt=PERIOD / 8,
                spectral_radius=0.5,
                rtol=1e-12,
                initial_displacement=["1e-3*x", 0],
            ).steps()
        ]
    )
    assert totals[-1] < 0.95 * totals[0]
    assert totals[-1] > 0.2 * totals[0]


@pytest.mark.long
def test_mean_deflection_is_the_static_one():
    """A dead load put on at once makes the oscillator swing about its static deflection."""
    load = Traction(on="bottom", value=[1e4, 0])
    static = oscillator(loads=[load])
    *_, state = Statics(static).steps()
    deflection = value_at(static, state.u.x.array, (1.0, 0.0))[0]
    assert deflection == pytest.approx(0.5e4 / (STIFF / 2), rel=1e-9)
    problem, n = oscillator(loads=[load]), 400
    found = [
        tip(problem, s)[0]
        for s in Dynamics(problem, end=PERIOD, dt=PERIOD / n, spectral_radius=1.0).steps()
    ]
    # Sum over one period; the period itself is off by (omega dt)^2/12 = 2e-5.
    assert np.mean(found[:-1]) == pytest.approx(deflection, rel=1e-3)
    assert max(found) == pytest.approx(2 * deflection, rel=1e-3)


def test_adaptive_steps_reach_the_end_within_the_tolerance():
    """Tighter tolerance, more steps, smaller error."""
    end, exact = 2.3 * PERIOD, 1e-3 * np.cos(OMEGA * 2.3 * PERIOD)
    counts, errors = [], []
    for tolerance in (1e-2, 1e-4):
        rows = swing(PERIOD / 50, end, adaptive=True, tolerance=tolerance)
        assert rows[-1, 0] == pytest.approx(end, rel=1e-12)
        counts.append(len(rows))
        errors.append(abs(rows[-1, 1] - exact) / 1e-3)
    assert len({round(s, 12) for s in np.diff(rows[:, 0]) / PERIOD}) > 3
    assert counts[1] > 2 * counts[0]
    assert errors[1] < 0.2 * errors[0]
    assert errors[1] < 2e-2


def test_the_last_step_ends_exactly():
    rows = swing(0.3 * PERIOD, PERIOD)
    np.testing.assert_allclose(rows[:, 0] / PERIOD, [0, 0.3, 0.6, 0.9, 1.0], rtol=1e-12)


# --- gravity and supports ---


@pytest.mark.parametrize("radius", [1.0, 0.8])
def test_free_fall_is_exact(radius):
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    problem = Problem(body, NeoHookean(E=E, nu=NU, density=RHO), loads=[Gravity()], degree=1)
    for state in Dynamics(
        problem, end=0.5, dt=0.1, spectral_radius=radius, rtol=1e-12, initial_velocity=[2.0, 3.0]
    ).steps():
        exact = np.array([2 * state.t, 3 * state.t - 9.81 / 2 * state.t**2])
        off = np.abs(problem.u.x.array.reshape(-1, 2) - exact).max(initial=0.0)
        assert body.comm.allreduce(float(off), op=MPI.MAX) < 1e-11
        assert state.energies["strain"] < 1e-12 * RHO


@pytest.mark.parametrize("law", [LinearElastic, NeoHookean])
def test_equilibrium_stays(law):
    """Started from the static state under its own weight, a column does not move."""
    body = rectangle_body(size=(1.0, 2.0), cells=(2, 4))
    problem = Problem(
        body,
        law(E=1e5, nu=NU, density=RHO),
        loads=[Gravity()],
        supports=[Support(on="bottom", displacement=[0, 0])],
        degree=1,
    )
    *_, static = Statics(problem, rtol=1e-13).steps()
    deflection, reaction = static.max_displacement, static.reactions["bottom"][1]
    assert deflection > 0.1
    start = problem.u.x.array.copy()
    for state in Dynamics(problem, end=0.5, dt=0.05, rtol=1e-10).steps():
        off = float(np.abs(problem.u.x.array - start).max(initial=0.0))
        assert body.comm.allreduce(off, op=MPI.MAX) < 1e-9 * deflection
        if state.step:
            assert state.reactions["bottom"][1] == pytest.approx(reaction, rel=1e-8)


@pytest.mark.parametrize("scheme", ["generalized-alpha", "symplectic-euler"])
def test_the_initial_state_knows_its_reactions(scheme):
    """Started from equilibrium, the supports carry the weight from the first state on."""
    body = rectangle_body(size=(1.0, 2.0), cells=(2, 4))
    problem = Problem(
        body,
        LinearElastic(E=1e5, nu=NU, density=RHO),
        loads=[Gravity()],
        supports=[Support(on="bottom", displacement=[0, 0])],
        degree=1,
    )
    _ = [*Statics(problem, rtol=1e-13).steps()]
    first = next(Dynamics(problem, scheme=scheme, end=0.01, dt=1e-4).steps())
    assert first.reactions["bottom"][1] == pytest.approx(RHO * 9.81 * 2, rel=1e-9)


@pytest.mark.parametrize("scheme", ["generalized-alpha", "symplectic-euler"])
def test_moving_supports_hold_at_every_step(scheme):
    """A formula in t is met exactly at t_n; its velocity agrees to the scheme's order."""
    body = rectangle_body(size=(1.0, 0.5), cells=(4, 2))
    moved = Support(on="left", displacement=["0.01*sin(200*t)", "0.02*(1 - cos(100*t))*y"])
    problem = Problem(body, NeoHookean(E=E, nu=NU, density=RHO), supports=[moved], degree=1)
    dt = {} if scheme == "symplectic-euler" else {"dt": 1e-3}
    held = problem.constraints
    places = problem.V.tabulate_dof_coordinates()
    worst = speed = 0.0
    times = []
    for state in Dynamics(problem, scheme=scheme, end=0.02, **dt).steps():
        times.append(state.t)
        t, y = state.t, places[held.prescribed_dofs // 2, 1]
        exact = np.where(
            held.prescribed_dofs % 2 == 0, 0.01 * np.sin(200 * t), 0.02 * (1 - np.cos(100 * t)) * y
        )
        rate = np.where(held.prescribed_dofs % 2 == 0, 2 * np.cos(200 * t), 2 * np.sin(100 * t) * y)
        worst = max(worst, np.abs(state.u.x.array[held.prescribed_dofs] - exact).max(initial=0.0))
        speed = max(speed, np.abs(state.v.x.array[held.prescribed_dofs] - rate).max(initial=0.0))
    assert body.comm.allreduce(float(worst), op=MPI.MAX) < 1e-14
    # A difference of places lags by half a step, times the acceleration of 400 m/s^2.
    assert body.comm.allreduce(float(speed), op=MPI.MAX) < 0.55 * np.diff(times).max() * 400


def test_loads_follow_their_curves_in_time():
    """Loading over 23 periods follows the static deflection to 1/(omega T) = 0.7 %."""
    problem = oscillator(loads=[Traction(on="bottom", value=["1e4*t/0.5", 0])])
    assert problem.loads[0].amplitude is CONSTANT
    *_, state = Dynamics(problem, end=0.5, dt=PERIOD / 8, spectral_radius=0.5).steps()
    assert state.t == pytest.approx(0.5)
    assert tip(problem, state)[0] == pytest.approx(0.5e4 / (STIFF / 2), rel=5e-3)


# --- a free body ---


def test_free_body_keeps_its_momenta():
    """Linear and angular momentum over two turns; values are integrals over the brick."""
    problem, start = brick()
    turn = 2 * np.pi / np.linalg.norm(SPIN)
    states = [
        (s.momenta["linear"], s.momenta["angular"], s.energies["total"])
        for s in Dynamics(
            problem, end=2 * turn, dt=turn / 60, spectral_radius=1.0, rtol=1e-12, **start
        ).steps()
    ]
    linear, angular, total = zip(*states, strict=True)
    np.testing.assert_allclose(linear[0], [180, 360, -90], rtol=1e-12)
    np.testing.assert_allclose(angular[0], [-60.75, 39.3, 228], rtol=1e-12)
    assert total[0] == pytest.approx(790.575, rel=1e-12)
    # The scheme takes its forces at the middle of the step: both momenta are exact to Newton.
    assert drift(list(linear)) < 1e-13
    assert drift(list(angular)) < 1e-12
    # The energy is no invariant of it, but stays.
    assert np.ptp(total) < 2e-2 * total[0]


def test_damping_scheme_keeps_linear_momentum():
    problem, start = brick()
    rows = [
        s.momenta["linear"]
        for s in Dynamics(
            problem, end=0.3, dt=0.01, rtol=1e-12, spectral_radius=0.5, **start
        ).steps()
    ]
    assert drift(rows) < 1e-13


# --- a body that bends, and what is refused ---


def test_bending_column():
    """Plane-strain column, clamped, thrown sideways with v = 10 y/6 (after Aguirre et al. 2014).

    Top after 0.25 s by an independent high-order code: (2.3945, -0.6016) +- 0.002, energy
    110000 J/m at the start.
    """
    body = rectangle_body(size=(1.0, 6.0), cells=(3, 18), origin=(-0.5, 0.0))
    problem = Problem(
        body,
        NeoHookean(E=17e6, nu=NU, density=1100.0),
        degree=2,
        supports=[Support(on="bottom", displacement=[0, 0])],
    )
    # The middle of the top is a node of quadratic elements.
    energies = [
        state.energies["total"]
        for state in Dynamics(
            problem, end=0.25, dt=0.005, spectral_radius=1.0, initial_velocity=["10*y/6", 0]
        ).steps()
    ]
    top = value_at(problem, problem.u.x.array, (0.0, 6.0))
    assert energies[0] == pytest.approx(110000.0, rel=1e-12)
    np.testing.assert_allclose(top, [2.3945, -0.6016], atol=0.02)
    np.testing.assert_allclose(energies, 110000.0, rtol=5e-3)


def test_settings_are_checked():
    problem = oscillator()
    for wrong in (
        {"end": 1.0},
        {"end": -1.0, "dt": 0.1},
        {"end": 1.0, "dt": 0.0},
        {"end": 1.0, "dt": 0.1, "spectral_radius": 1.5},
        {"end": 1.0, "scheme": "symplectic-euler", "adaptive": True},
        {"end": 1.0, "dt": 0.1, "scheme": "leapfrog"},
    ):
        with pytest.raises(InputError):
            Dynamics(problem, **wrong)


def test_motion_needs_a_density():
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    problem = Problem(body, LinearElastic(E=E, nu=NU), degree=1)
    with pytest.raises(InputError, match="density"):
        _ = [*Dynamics(problem, end=1.0, dt=0.1).steps()]


@pytest.mark.long
def test_adaptive_steps_with_moving_supports():
    """Tightened tolerance, the same motion; prescribed places are met although steps vary."""
    body = rectangle_body(size=(1.0, 0.5), cells=(4, 2))
    moved = Support(on="left", displacement=["0.01*sin(200*t)", 0])
    ends = []
    for tolerance in (1e-3, 1e-5):
        problem = Problem(body, NeoHookean(E=E, nu=NU, density=RHO), supports=[moved], degree=1)
        held = problem.constraints.prescribed_dofs
        worst = 0.0
        for state in Dynamics(
            problem, end=0.02, dt=1e-4, adaptive=True, tolerance=tolerance
        ).steps():
            exact = np.where(held % 2 == 0, 0.01 * np.sin(200 * state.t), 0.0)
            worst = max(worst, np.abs(state.u.x.array[held] - exact).max(initial=0.0))
        assert body.comm.allreduce(float(worst), op=MPI.MAX) < 1e-14
        assert state.t == pytest.approx(0.02, rel=1e-12)
        ends.append(value_at(problem, problem.u.x.array, (1.0, 0.25)))
    # The looser tolerance allows 1e-3 of the largest displacement or velocity a step.
    assert np.linalg.norm(ends[0] - ends[1]) < 0.05 * np.linalg.norm(ends[1])


@pytest.mark.parametrize(
    ("pushed", "said", "advice"),
    [
        ("where(t < 0.015, 0, -2)", "jumps there, by 2 m at (1, 0) m", "that takes some time"),
        ("-200*t^2/0.015", "", "a smaller dt"),
    ],
)
def test_a_step_without_a_solution_says_so_and_keeps_its_state(pushed, said, advice):
    """A support that pushes through the body: no step, however small, gets past the wall."""
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    problem = Problem(
        body,
        NeoHookean(E=E, nu=NU, density=RHO),
        supports=[
            Support(on="left", displacement=[0, 0]),
            Support(on="right", displacement=[pushed, 0]),
        ],
        degree=1,
    )
    reached = []
    with pytest.raises(ConvergenceError) as caught:
        for state in Dynamics(problem, end=0.1, dt=0.01).steps():
            reached.append(state.t)
    if said:  # ever shorter steps come close to the jump
        assert reached[-1] == pytest.approx(0.015, rel=1e-3)
    start = f"no solution for the step from t = {reached[-1]:.6g} s: "
    assert str(caught.value).startswith((f"{start}Newton's method finds", f"{start}every step"))
    assert said in str(caught.value)
    assert ("jumps" in str(caught.value)) == bool(said)
    assert advice in str(caught.value)
    assert caught.value.state.t == reached[-1]
    assert np.isfinite(caught.value.state.max_displacement)


def test_the_first_step_has_no_solution():
    """As clear an error as later on."""
    loaded = oscillator(loads=[Traction(on="bottom", value=["1e4*sqrt(0.001 - t)", 0])])
    with pytest.raises(InputError, match=r"load\[0\]\.value\[0\]: '1e4.*' has .* at t = 0\.01; "):
        _ = [*Dynamics(loaded, end=0.1, dt=0.01).steps()]


def test_a_formula_without_a_value_later_on_is_said():
    loaded = oscillator(loads=[Traction(on="bottom", value=["1e4*sqrt(0.025 - t)", 0])])
    with pytest.raises(InputError, match=r"load\[0\]\.value\[0\]: .* no finite value at t = 0.03"):
        _ = [*Dynamics(loaded, end=0.1, dt=0.01).steps()]
    held = Problem(
        loaded.body,
        LinearElastic(E=E, nu=NU, density=RHO),
        supports=[Support(on="left", displacement=["sqrt(0.025 - t)*1e-3", 0])],
        degree=1,
    )
    with pytest.raises(InputError, match=r"support 'left': .* not finite at .0, 0. m at t = 0.03"):
        _ = [*Dynamics(held, end=0.1, dt=0.01).steps()]


@pytest.mark.parametrize(
    ("options", "warns"),
    [({"ksp_type": "gmres", "pc_type": "lu"}, False), ({"kps_type": "gmres"}, True)],
)
def test_unused_petsc_options_are_said_once(caplog, options, warns):
    problem = oscillator()
    with caplog.at_level("WARNING", logger="dolfin_elastic"):
        _ = [*Dynamics(problem, end=0.1, dt=0.02, petsc=options).steps()]
    said = [r for r in caplog.records if "was not used" in r.getMessage()]
    # Only rank 0 speaks.
    assert problem.body.comm.allreduce(len(said)) == int(warns)


def test_a_linear_body_is_assembled_once(monkeypatch):
    """Its tangent changes with the time step only, and so does its factorisation."""
    calls = []
    assemble = TangentMatrix.assemble
    monkeypatch.setattr(
        TangentMatrix,
        "assemble",
        lambda self, bcs, **unit: (calls.append(1), assemble(self, bcs, **unit)),
    )
    moved = ["1e-3*x", 0]
    _ = [*Dynamics(oscillator(), end=0.1, dt=0.01, initial_displacement=moved).steps()]
    assert len(calls) == 1
    calls.clear()
    problem = oscillator(loads=[Traction(on="bottom", value=[1e4, 0])])
    _ = [*Statics(problem, steps=4).steps()]
    assert len(calls) == 1


def _of_dolfinx(garbage):
    """Functions that call themselves, with which DOLFINx 0.11 packs coefficients, and their cells.

    They hold forms and arrays, nothing of PETSc.
    """
    for thing in garbage:
        if str(getattr(thing, "__module__", "")).startswith("dolfinx."):
            yield from (thing, thing.__closure__, *thing.__closure__)


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    "solver",
    [
        lambda problem: Dynamics(problem, end=1.0, dt=1e-3),
        lambda problem: Dynamics(problem, end=1.0, dt=1e-3, scheme="alpha2"),
        lambda problem: Dynamics(problem, end=1.0, scheme="central-differences"),
        lambda problem: Statics(problem, steps=200),
    ],
    ids=["implicit", "alpha2", "explicit", "statics"],
)
def test_steps_leave_no_cycles(solver):
    """All that a step makes is freed at its end: ranks that collect at other times would differ.

    PETSc's objects in cycles would be freed by the ranks one by one, which they must do together.
    """
    body = box_body(size=(1.0, 0.6, 0.3), cells=(2, 1, 1))
    law = NeoHookean(E=1e5, nu=NU, density=RHO)
    steps = solver(
        Problem(body, law, supports=[Support(on="left")], loads=[Gravity()], degree=1)
    ).steps()
    _ = [next(steps) for _ in range(3)]
    automatic, flags = gc.isenabled(), gc.get_debug()
    while gc.collect():  # what a finaliser of other tests' things lets go is found only once more
        pass
    gc.disable()
    try:
        gc.set_debug(gc.DEBUG_SAVEALL)
        _ = [next(steps) for _ in range(5)]
        gc.collect()
        own = {id(thing) for thing in _of_dolfinx(gc.garbage)}
        found = [str(type(thing)) for thing in gc.garbage if id(thing) not in own]
    finally:
        gc.set_debug(flags)
        gc.garbage.clear()
        if automatic:
            gc.enable()
    assert not found
