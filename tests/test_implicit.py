"""Schemes of implicit motion: discrete oracles, orders, damping, times, audit and restarts.

The oscillator of `test_dynamics` is one unknown with a known frequency, so that every step of every
scheme is known to round-off from the scheme's formulas alone.  Sources: N. M. Newmark (1959);
J. Chung & G. M. Hulbert (1993).
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from test_dynamics import (
    NU,
    OMEGA,
    PERIOD,
    RHO,
    STIFF,
    E,
    brick,
    drift,
    oscillator,
    swing,
    tip,
    value_at,
)

from dolfin_elastic import (
    Contact,
    Dashpot,
    Dynamics,
    Gravity,
    LinearElastic,
    NeoHookean,
    Problem,
    Spring,
    Support,
    Traction,
    rectangle_body,
)
from dolfin_elastic.errors import InputError
from dolfin_elastic.results.summary import peak_memory
from dolfin_elastic.solvers.alpha import Scheme

# --- discrete oracles ---


def by_hand(alpha: tuple[float, ...], x: float, steps: int) -> np.ndarray:
    """u_n of u'' = -u at times n x by a scheme typed anew, from u = 1, v = 0, a = -1.

    Args:
        alpha: alpha_m, alpha_f, beta, gamma and the weight of a0 in the displacement.
        x: omega dt.
        steps: How many.
    """
    m, f, beta, gamma, start = alpha
    # Unknown (u1, h v1, h^2 a1), known (u0, h v0, h^2 a0).
    left = np.array([[1, 0, -beta], [0, 1, -gamma], [(1 - f) * x**2, 0, 1 - m]])
    right = np.array([[1, 1, start], [0, 1, 1 - gamma], [-f * x**2, 0, -m]])
    step = np.linalg.solve(left, right)
    state, found = np.array([1.0, 0, -(x**2)]), [1.0]
    for _ in range(steps):
        state = step @ state
        found.append(state[0])
    return np.array(found)


def chung_hulbert(radius: float) -> tuple[float, ...]:
    m, f = (2 * radius - 1) / (radius + 1), radius / (radius + 1)
    beta = 0.25 * (1 - m + f) ** 2
    return m, f, beta, 0.5 - m + f, 0.5 - beta


def known(settings: dict[str, Any], x: float, n: np.ndarray) -> np.ndarray:
    """The same in closed form where there is one, else by the recursion."""
    scheme, radius = settings["scheme"], settings.get("spectral_radius")
    if scheme == "implicit-euler":
        return np.real((1 / (1 - 1j * x)) ** n)
    if radius == 1.0 or (scheme == "newmark" and "beta" not in settings):
        return np.cos(n * 2 * np.arctan(x / 2))
    if scheme == "newmark":
        beta, gamma = settings["beta"], settings["gamma"]
        return by_hand((0, 0, beta, gamma, 0.5 - beta), x, n[-1])
    return by_hand(chung_hulbert(radius), x, n[-1])


@pytest.mark.parametrize(
    "settings",
    [
        {"scheme": "newmark"},
        {"scheme": "newmark", "beta": 1 / 6, "gamma": 0.5},
        {"scheme": "newmark", "beta": 0.36, "gamma": 0.6},
        {"scheme": "implicit-euler"},
        *({"scheme": "generalized-alpha", "spectral_radius": r} for r in (1.0, 0.8, 0.5, 0.0)),
    ],
    ids=lambda s: "-".join(str(round(v, 2) if isinstance(v, float) else v) for v in s.values()),
)
@pytest.mark.parametrize("x", [0.2, 3.0])
def test_every_step_is_the_one_of_the_formulas(settings, x):
    """60 steps at omega dt = 0.2, and at 3, far beyond where explicit schemes are stable.

    Round-off grows with the number of steps, and the start needs a0 = -omega^2 u0: 1e-9 of it all.
    """
    if "beta" in settings and settings["beta"] < 0.25 and x > 2:
        pytest.skip("the linear acceleration is unstable there")
    rows = swing(x / OMEGA, 60 * x / OMEGA, **settings)
    expected = 1e-3 * known(settings, x, np.arange(61))
    np.testing.assert_allclose(rows[:, 1], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("scheme", ["generalized-alpha", "newmark", "implicit-euler"])
def test_constant_forces_are_exact(scheme):
    """Free fall: u = g t^2/2 at each step, for implicit Euler g dt^2 n (n + 1)/2."""
    problem = Problem(
        rectangle_body(size=(1.0, 1.0), cells=(1, 1)),
        NeoHookean(E=E, nu=NU, density=RHO),
        loads=[Gravity()],
    )
    for state in Dynamics(problem, scheme=scheme, end=0.5, dt=0.05, rtol=1e-12).steps():
        n = state.step * (state.step + 1) / 2 if scheme == "implicit-euler" else state.step**2 / 2
        fallen = -9.81 * 0.05**2 * n
        off = np.abs(problem.u.x.array.reshape(-1, 2) - [0, fallen]).max(initial=0.0)
        assert problem.body.comm.allreduce(float(off), op=MPI.MAX) < 1e-12
        # Of loads that do not change the potential is known: what falls gains what it loses.
        weight = RHO * 9.81
        assert state.energies["potential"] == pytest.approx(weight * fallen, abs=1e-8)
        assert state.energies["external"] == pytest.approx(-weight * fallen, abs=1e-8)


@pytest.mark.parametrize(
    ("settings", "order"),
    [
        ({"scheme": "newmark"}, 2),
        ({"scheme": "implicit-euler"}, 1),
        ({"scheme": "newmark", "beta": 0.36, "gamma": 0.7}, 1),
    ],
)
def test_order_of_displacement_and_velocity(settings, order):
    """Slope of the distance from the exact place in the plane of u and v/omega."""
    end, steps = 0.9 * PERIOD, np.array([100, 200, 300])
    exact = 1e-3 * np.array([np.cos(OMEGA * end), -np.sin(OMEGA * end)])
    error = [
        np.linalg.norm(swing(end / n, end, **settings)[-1, 1:] / [1, OMEGA] - exact) for n in steps
    ]
    assert np.polyfit(np.log(1 / steps), np.log(error), 1)[0] == pytest.approx(order, abs=0.08)


def test_a_wave_along_a_bar():
    """u = A sin(pi x/2L) cos(omega t) with omega = pi c/2L, lateral motion blocked: order 2."""
    body = rectangle_body(size=(1.0, 0.1), cells=(12, 1))
    speed = np.sqrt(STIFF / RHO)
    omega = np.pi * speed / 2
    end, errors, steps = 0.7 * 2 * np.pi / omega, [], (20, 40, 80)
    for n in steps:
        problem = Problem(
            body,
            LinearElastic(E=E, nu=NU, density=RHO),
            degree=2,
            supports=[
                Support(on=["top", "bottom"], displacement=["free", 0]),
                Support(on="left", displacement=[0, 0]),
            ],
        )
        *_, state = Dynamics(
            problem,
            end=end,
            dt=end / n,
            every=n,
            spectral_radius=0.8,
            initial_displacement=["1e-3*sin(pi*x/2)", 0],
        ).steps()
        u = value_at(problem, state.u.x.array, (1.0, 0.0))[0]
        v = value_at(problem, state.v.x.array, (1.0, 0.0))[0]
        exact = 1e-3 * np.array([np.cos(omega * end), -np.sin(omega * end)])
        errors.append(np.linalg.norm(np.array([u, v / omega]) - exact))
    # The mesh leaves 1e-5 of the amplitude.
    assert np.polyfit(np.log(1 / np.array(steps)), np.log(errors), 1)[0] == pytest.approx(
        2, abs=0.1
    )
    assert errors[-1] < 1.5e-6


def test_a_front_arrives_on_time():
    """A pull at one end is felt at the other after L/c; the step resolves it to a few steps."""
    body = rectangle_body(size=(1.0, 0.1), cells=(40, 1))
    problem = Problem(
        body,
        LinearElastic(E=E, nu=NU, density=RHO),
        supports=[
            Support(on=["top", "bottom"], displacement=["free", 0]),
            Support(on="left", displacement=[0, 0]),
        ],
        loads=[Traction(on="right", value=[1e4, 0])],
    )
    speed = np.sqrt(STIFF / RHO)
    dt, rows = 1 / speed / 80, []
    for state in Dynamics(problem, end=1.5 / speed, dt=dt, spectral_radius=0.5).steps():
        rows.append((state.t * speed, state.reactions["left"][0]))
    t, held = np.array(rows).T
    # The front is reflected: what is held jumps from nothing to twice the pull.
    assert abs(held[t < 0.85]).max() < 0.1 * 1e3
    np.testing.assert_allclose(held[t > 1.25], -2e3, rtol=0.15)
    arrival = np.interp(-1e3, held[::-1], t[::-1]) if held[0] > held[-1] else np.nan
    assert arrival == pytest.approx(1.0, abs=0.03)


def test_petsc_agrees_to_the_order_of_the_scheme():
    """TSALPHA2 is the same scheme but for its start, which it finds by two half steps."""
    body = rectangle_body(size=(1.0, 3.0), cells=(1, 3))
    gaps = []
    for dt in (0.02, 0.01, 0.005, 0.0025):
        ends = []
        for scheme in ("generalized-alpha", "alpha2"):
            problem = Problem(
                body,
                NeoHookean(E=1e6, nu=NU, density=1100.0),
                degree=2,
                supports=[Support(on="bottom", displacement=[0, 0])],
            )
            *_, state = Dynamics(
                problem,
                scheme=scheme,
                end=0.1,
                dt=dt,
                every=100,
                spectral_radius=0.8,
                rtol=1e-11,
                initial_velocity=["3*y", 0],
            ).steps()
            ends.append(value_at(problem, state.u.x.array, (0.5, 3.0)))
        gaps.append(np.linalg.norm(ends[1] - ends[0]))
    assert gaps[0] < 1e-3 * np.linalg.norm(ends[0])
    # It goes up and down a little: it is that of one moment of a vibration.
    slope = np.polyfit(np.log([8, 4, 2, 1]), np.log(gaps), 1)[0]
    assert slope == pytest.approx(2.0, abs=0.4)


# --- supports that move ---


def test_prescribed_motion_has_its_velocity_and_acceleration():
    """u = A (1 - cos w t): met exactly; v and a by the scheme, of second order."""
    A, w = 0.01, 40.0
    errors = []
    for n in (40, 80):
        problem = Problem(
            rectangle_body(size=(1.0, 0.5), cells=(2, 1)),
            LinearElastic(E=E, nu=NU, density=RHO),
            supports=[Support(on="left", displacement=[f"{A}*(1 - cos({w}*t))", 0])],
        )
        worst = np.zeros(3)
        for state in Dynamics(problem, end=0.2, dt=0.2 / n, spectral_radius=0.8).steps():
            t = state.t
            exact = A * np.array([1 - np.cos(w * t), w * np.sin(w * t), w * w * np.cos(w * t)])
            place = (0.0, 0.5)
            got = [value_at(problem, f.x.array, place)[0] for f in (state.u, state.v, state.a)]
            worst = np.maximum(worst, np.abs(np.array(got) - exact))
        errors.append(worst / [A, A * w, A * w * w])
    assert max(e[0] for e in errors) < 1e-14
    assert (errors[1][1:] < [2e-3, 2e-2]).all()
    assert (np.log2(errors[0][1:] / errors[1][1:]) > 1.8).all()


def test_reactions_are_those_of_the_end_of_the_step():
    """A rigid block that is shaken: what holds it is its mass times the acceleration then."""
    w = 30.0
    problem = Problem(
        rectangle_body(size=(1.0, 1.0), cells=(1, 1)),
        LinearElastic(E=1e12, nu=0.0, density=RHO),
        supports=[Support(on=["left", "right"], displacement=[f"0.01*sin({w}*t)^2", 0])],
    )
    rows = [
        (
            s.t,
            s.reactions["left+right"][0]
            if "left+right" in s.reactions
            else sum(f[0] for f in s.reactions.values()),
        )
        for s in Dynamics(problem, end=0.2, dt=1e-3, spectral_radius=0.9).steps()
    ]
    t, force = np.array(rows).T
    exact = RHO * 0.01 * 2 * w**2 * np.cos(2 * w * t)
    # Second order: (2 w dt)^2 = 4e-3 of it; at the time of the stage it would be off by 3 %.
    np.testing.assert_allclose(force, exact, rtol=0, atol=2e-3 * abs(exact).max())


# --- damping ---


def decay(problem: Problem, zeta: float, **more: Any) -> tuple[np.ndarray, np.ndarray, Any]:
    """The damped oscillator's displacement over two periods, and the exact one."""
    rows = []
    for state in Dynamics(
        problem,
        end=2 * PERIOD,
        dt=PERIOD / 200,
        spectral_radius=1.0,
        rtol=1e-12,
        initial_displacement=["1e-3*x", 0],
        **more,
    ).steps():
        rows.append((state.t, tip(problem, state)[0]))
    t, u = np.array(rows).T
    damped = OMEGA * np.sqrt(1 - zeta**2)
    exact = np.exp(-zeta * OMEGA * t) * (
        np.cos(damped * t) + zeta * OMEGA / damped * np.sin(damped * t)
    )
    return u / 1e-3, exact, state


@pytest.mark.parametrize("kind", ["mass", "stiffness", "viscosity"])
def test_damped_oscillation(kind):
    """zeta = a/(2 omega), b omega/2, and c/(2 m omega) with c = 2 eta of the area 1/2.

    The step is off by (omega dt)^2/12 = 8e-5 of the phase, after two periods 1e-3.
    """
    zeta, eta = 0.05, 0.0
    rayleigh: Any = None
    if kind == "mass":
        rayleigh = [2 * zeta * OMEGA, 0]
    elif kind == "stiffness":
        rayleigh = {"stiffness": 2 * zeta / OMEGA}
    else:
        eta = 2 * zeta * OMEGA * RHO / 12
    problem = oscillator(viscosity=eta or None)
    u, exact, state = decay(problem, zeta, rayleigh=rayleigh)
    np.testing.assert_allclose(u, exact, rtol=0, atol=1.5e-3)
    lost = 0.25 * STIFF * 1e-6 - state.energies["total"]
    # The undamped trapezoidal rule and its work balance to round-off in a linear body.
    assert state.energies["damping"] == pytest.approx(lost, rel=1e-9)
    assert abs(state.energies["balance"]) < 1e-9 * lost
    assert state.audit.verdict == "pass"


@pytest.mark.parametrize("how", [{"viscosity": 200.0}, {"rayleigh": [0, 5e-3]}])
def test_damping_inside_a_body_does_not_feel_a_rotation(how):
    """A soft brick thrown with a spin keeps both its momenta; it loses what vibrates only."""
    law = {"viscosity": how["viscosity"]} if "viscosity" in how else {}
    settings = {"rayleigh": how["rayleigh"]} if "rayleigh" in how else {}
    problem, start = brick(**law)
    states = []
    for s in Dynamics(
        problem, end=0.4, dt=0.02, spectral_radius=1.0, rtol=1e-12, **settings, **start
    ).steps():
        states.append((s.momenta["linear"], s.momenta["angular"], s.energies["damping"]))
        assert s.audit.verdict == "pass"
        assert s.audit.force < 1e-9
        assert s.audit.moment < 1e-9
    linear, angular, damped = zip(*states, strict=True)
    assert drift(list(linear)) < 1e-9
    assert drift(list(angular)) < 1e-9
    assert (np.diff(damped) >= 0).all()
    # It stretches as it begins to turn, and that is damped: some of 790 J, which a force against
    # the velocity itself would take within a second.
    assert 0.0 < damped[-1] < 8.0


def test_rayleigh_mass_brakes_a_free_body():
    """p = p0 exp(-a t): the trapezoidal rule is off by (a dt)^2/12."""
    problem, start = brick()
    for state in Dynamics(
        problem, end=0.5, dt=0.01, every=50, spectral_radius=1.0, rayleigh=[2.0, 0], **start
    ).steps():
        exact = np.array([180, 360, -90]) * np.exp(-2.0 * state.t)
        np.testing.assert_allclose(state.momenta["linear"], exact, rtol=1e-4)
        assert state.audit.verdict == "pass"


# --- the control of the step, and times that are met ---


def test_times_are_met_exactly_and_all_that_is_asked_for_is_shown():
    asked = [0.013, 0.1, 0.2499]
    for adaptive in (False, True):
        shown = [
            state.t
            for state in Dynamics(
                oscillator(), end=0.25, dt=0.01, every="50 ms", times=asked, adaptive=adaptive
            ).steps()
        ]
        assert shown == [0.0, 0.013, 0.05, 0.1, 0.15000000000000002, 0.2, 0.2499, 0.25]
    steps = [
        s.step for s in Dynamics(oscillator(), end=0.1, dt=0.01, every=4, times=[0.05]).steps()
    ]
    assert steps == [0, 4, 5, 8, 10]


def test_the_error_of_a_step_is_what_was_allowed():
    """The largest error that one step makes against the exact flow, over the amplitude."""
    for tolerance in (1e-3, 1e-5):
        problem = oscillator()
        before: Any = None
        worst = 0.0
        for state in Dynamics(
            problem,
            end=3 * PERIOD,
            dt=PERIOD / 40,
            adaptive=True,
            tolerance=tolerance,
            spectral_radius=1.0,
            rtol=1e-12,
            initial_displacement=["1e-3*x", 0],
        ).steps():
            now = state.t, *tip(problem, state)
            if before is not None:
                angle = OMEGA * (now[0] - before[0])
                exact = before[1] * np.cos(angle) + before[2] / OMEGA * np.sin(angle)
                worst = max(worst, abs(now[1] - exact) / 1e-3)
            before = now
        # The estimate is the leading term of the error, of accelerations that are off themselves.
        assert 0.3 * tolerance < worst < 2.0 * tolerance


def test_a_cell_that_turns_inside_out_makes_the_step_smaller():
    """A patch of bar thrown together so fast that one whole step would fold it."""
    problem = Problem(
        rectangle_body(size=(1.0, 0.5), cells=(2, 1)),
        NeoHookean(E=1e5, nu=NU, density=RHO),
        supports=[Support(on="left", displacement=[0, 0])],
    )
    states = list(
        Dynamics(
            problem, end=0.1, dt=0.1, initial_velocity=["-25*x", 0], spectral_radius=0.5
        ).steps()
    )
    assert len(states) > 2
    assert all(state.audit.min_jacobian > 0 for state in states)
    assert states[-1].t == pytest.approx(0.1)


def test_events_of_ts_find_their_time():
    """PETSc takes a step back and looks for the zero of u within it: a quarter of the period.

    Work and steps that were taken back do not count.
    """
    problem = oscillator()
    motion = Dynamics(
        problem,
        end=0.4 * PERIOD,
        dt=PERIOD / 40,
        spectral_radius=0.8,
        rtol=1e-12,
        initial_displacement=["1e-3*x", 0],
    )
    states, met = motion.steps(), []
    next(states)
    comm = problem.body.comm

    def place(ts: Any, t: float, U: Any, values: Any) -> None:
        values[0] = comm.allreduce(float(U.array_r.sum()))  # one unknown is not held

    def note(ts: Any, events: Any, t: float, U: Any, forward: bool) -> None:
        met.append(t)

    motion.ts.setEventHandler([0], [False], place, note)
    motion.ts.setEventTolerances(1e-12)
    seen = []
    motion.ts.setMonitor(lambda ts, step, t, U: seen.append(step))
    for state in states:
        assert abs(state.energies["balance"]) < 1e-3 * 0.25 * STIFF * 1e-6
    assert len(met) == 1
    # Of second order: (omega dt)^2/12 = 2e-3 of the phase.
    assert met[0] == pytest.approx(PERIOD / 4, rel=3e-3)
    assert state.t == pytest.approx(0.4 * PERIOD)
    assert max(seen) == state.step


# --- audit ---


def test_the_audit_sees_energy_that_comes_from_nowhere():
    """Newmark's linear acceleration beyond its stable step, omega dt = 2 sqrt(3)."""
    last: Any = None
    for state in Dynamics(
        oscillator(),
        scheme="newmark",
        beta=1 / 6,
        gamma=0.5,
        end=30 / OMEGA,
        dt=3.6 / OMEGA,
        initial_displacement=["1e-3*x", 0],
        rtol=1e-12,
    ).steps():
        last = state
    assert last.audit.verdict == "warn"
    assert "come from nowhere" in last.audit.so_far[0]


def test_the_audit_sees_what_a_scheme_damps_away():
    settings: dict[str, Any] = {"end": 3 * PERIOD, "dt": PERIOD / 5, "rtol": 1e-12}
    settings["initial_displacement"] = ["1e-3*x", 0]
    *_, damped = Dynamics(oscillator(), spectral_radius=0.6, **settings).steps()
    assert "damped" in damped.audit.so_far[0]
    *_, kept = Dynamics(oscillator(), spectral_radius=1.0, **settings).steps()
    assert kept.audit.so_far == ()


def test_the_audit_balances_forces_with_inertia(monkeypatch):
    """A shaken column with springs, dashpots and weight: all sums up, and a false load is seen."""

    def last() -> Any:
        problem = column()
        *_, state = Dynamics(problem, end=0.02, dt=2e-3, rayleigh=[1.0, 1e-4]).steps()
        return state

    good = last()
    assert good.audit.force < 1e-7
    assert good.audit.moment < 1e-7
    assert good.audit.verdict == "pass"
    from dolfin_elastic.solvers.assembler import Assembler

    true = Assembler.external_forces
    monkeypatch.setattr(Assembler, "external_forces", lambda self: 1.01 * true(self))
    bad = last()
    assert bad.audit.verdict == "warn"
    assert "do not balance" in bad.audit.so_far[0]


# --- restarts ---


def column(**more: Any) -> Problem:
    """Weight, a foot that is shaken, springs, dashpots, viscosity and an obstacle."""
    return Problem(
        rectangle_body(size=(0.5, 1.0), cells=(2, 3)),
        NeoHookean(E=1e6, nu=NU, density=RHO, viscosity=300.0),
        loads=[Gravity(), Traction(on="top", value=["2e4*sin(300*t)", 0])],
        supports=[
            Support(on="bottom", displacement=["0.01*sin(200*t)^2", 0]),
            Spring(on="left", normal="1 MPa/m"),
            Dashpot(on="right", normal=2e3, tangential=1e3),
        ],
        contacts=[Contact(on="top", plane={"point": [0, 1.001], "normal": [0, -1]}, name="lid")],
        **more,
    )


def record(state: Any) -> dict[str, Any]:
    return {
        "t": state.t,
        "step": state.step,
        **{f"energy {k}": v for k, v in state.energies.items()},
        **{f"reaction {k} {i}": x for k, v in state.reactions.items() for i, x in enumerate(v)},
        "u": state.w.x.array.copy(),
        "v": state.v.x.array.copy(),
        "a": state.a.x.array.copy(),
    }


def test_a_motion_goes_on_as_if_it_had_never_stopped():
    """From copied arrays and numbers as JSON, in a new problem: the same states to round-off."""
    cases: list[tuple[Callable[[], Problem], dict[str, Any]]] = [
        (column, {"rayleigh": [1.0, 1e-4], "spectral_radius": 0.8}),
        (column, {"scheme": "newmark", "adaptive": True, "tolerance": 1e-3, "times": [0.01]}),
        (mixed, {"scheme": "generalized-alpha"}),
        (mixed, {"scheme": "implicit-euler", "every": 2}),
    ]
    for make, settings in cases:
        given = {"end": 0.02, "dt": 1e-3, "rtol": 1e-12, **settings}
        motion = Dynamics(make(), **given)
        whole: list[dict[str, Any]] = []
        saved: Any = None
        for state in motion.steps():
            whole.append(record(state))
            if saved is None and state.t >= 0.008:
                kept = motion.kept()
                arrays = {name: f.x.array.copy() for name, f in kept.fields.items()}
                saved = len(whole), arrays, json.dumps(kept.numbers)
        number, arrays, numbers = saved

        def restore(fields: Any, arrays: Any = arrays, numbers: Any = numbers) -> Any:
            assert fields.keys() == arrays.keys()
            for name, field in fields.items():
                field.x.array[:] = arrays[name]
            return json.loads(numbers)

        again = [record(state) for state in Dynamics(make(), **given).steps(restore)]
        assert len(again) == len(whole) - number > 3
        for one, other in zip(again, whole[number:], strict=True):
            assert one.keys() == other.keys()
            for name, value in one.items():
                scale = np.abs(np.asarray(other[name])).max(initial=1e-9)
                np.testing.assert_allclose(value, other[name], rtol=0, atol=1e-12 * scale + 1e-15)


def mixed() -> Problem:
    """Incompressible rubber: the pressure is kept, too."""
    return Problem(
        rectangle_body(size=(1.0, 0.25), cells=(4, 1)),
        NeoHookean(E=1e6, nu=0.4999, density=RHO),
        degree=2,
        supports=[Support(on="left", displacement=[0, 0])],
        loads=[Gravity()],
    )


def test_memory_stays_flat():
    """Over 500 steps of a small body the largest memory in use grows by less than 2 MB.

    A vector or matrix that is not freed, 40 of each a step, would take some 10 MB.
    """
    problem = column()
    peak: list[int] = []
    for state in Dynamics(problem, end=0.55, dt=1e-3, every=10).steps():
        if state.step in (50, 550):
            peak.append(peak_memory(problem.body.comm)["largest_rank"])
    assert peak[1] - peak[0] < 2e6


def test_there_is_nothing_to_keep_before_a_motion_and_after_it():
    motion = Dynamics(oscillator(), end=0.02, dt=0.01)
    with pytest.raises(RuntimeError, match="nothing to keep"):
        motion.kept()
    _ = [*motion.steps()]
    with pytest.raises(RuntimeError, match="nothing to keep"):
        motion.kept()


# --- what is refused ---


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"beta": 0.3}, "beta: the scheme 'generalized-alpha' has no beta"),
        ({"scheme": "newmark", "gamma": 0.4}, "gamma"),
        ({"scheme": "newmark", "beta": 0.0}, "beta"),
        ({"rayleigh": [1.0]}, "rayleigh"),
        ({"rayleigh": [-1.0, 0]}, "rayleigh.mass"),
        ({"rayleigh": {"stifness": 1.0}}, "stiffness"),
        ({"times": [2.0]}, r"times\[0\]: 2 s lies beyond the end"),
        ({"every": 0}, "every"),
        ({"scheme": "symplectic-euler", "every": "1 ms"}, "counts steps"),
        ({"scheme": "symplectic-euler", "rayleigh": [1, 0]}, "has no rayleigh"),
        ({"scheme": "newmarc"}, "newmark"),
    ],
)
def test_wrong_settings_are_named(settings, said):
    with pytest.raises(InputError, match=said):
        Dynamics(oscillator(), end=1.0, dt=0.1, **settings)


def test_viscosity_is_for_implicit_schemes():
    with pytest.raises(InputError, match=r"materials.body.viscosity: .* knows no viscosity"):
        next(Dynamics(oscillator(viscosity=1.0), scheme="symplectic-euler", end=1.0).steps())


def test_units_of_damping():
    found = Dynamics(oscillator(), end="1 s", dt="1 ms", rayleigh=[1, "2 ms"]).settings
    assert (found.rayleigh.mass, found.rayleigh.stiffness) == (1.0, 2e-3)
    law = LinearElastic(E=1, nu=0, viscosity="2 kPa*s")
    assert law.viscosity == pytest.approx(2000.0)


def test_parameters_of_the_family():
    """rho = 1 is the midpoint rule; Chung & Hulbert's optimum for rho = 0 has beta = gamma = ..."""
    one, none = Scheme.generalized_alpha(1.0), Scheme.generalized_alpha(0.0)
    assert (one.alpha_m, one.alpha_f, one.beta, one.gamma) == (0.5, 0.5, 0.25, 0.5)
    assert (none.alpha_m, none.alpha_f, none.beta, none.gamma) == (-1.0, 0.0, 1.0, 1.5)
