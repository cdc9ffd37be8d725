"""Implicit schemes on one unknown, where every step is known: oracles, orders, damping, errors.

The oscillator of `test_dynamics` has a known frequency, so that every step of every scheme is known
to round-off from the scheme's formulas alone.  Sources: N. M. Newmark (1959); J. Chung & G. M.
Hulbert (1993).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.motion import (
    NU,
    OMEGA,
    PERIOD,
    RHO,
    STIFF,
    E,
    oscillator,
    swing,
    tip,
)
from mpi4py import MPI

from dolfin_elastic import (
    BodyForce,
    Dynamics,
    Gravity,
    LinearElastic,
    NeoHookean,
    Problem,
    Support,
    Traction,
    rectangle_body,
)
from dolfin_elastic.core.parallel import largest
from dolfin_elastic.solvers.dynamics.implicit.generalized_alpha import GeneralizedAlphaParameters

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
@pytest.mark.sample(4)
def test_every_step_is_the_one_of_the_formulas(settings, x):
    """30 steps at omega dt = 0.2, and at 3, far beyond where explicit schemes are stable.

    Round-off grows with the number of steps, and the start needs a0 = -omega^2 u0: 1e-9 of it all.
    """
    if "beta" in settings and settings["beta"] < 0.25 and x > 2:
        pytest.skip("the linear acceleration is unstable there")
    rows = swing(x / OMEGA, 30 * x / OMEGA, **settings)
    expected = 1e-3 * known(settings, x, np.arange(31))
    np.testing.assert_allclose(rows[:, 1], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("scheme", ["generalized-alpha", "newmark", "implicit-euler"])
def test_constant_forces_are_exact(scheme):
    """Free fall: u = g t^2/2 at each step, for implicit Euler g dt^2 n (n + 1)/2."""
    problem = Problem(
        rectangle_body(size=(1.0, 1.0), cells=(1, 1)),
        NeoHookean(E=E, nu=NU, density=RHO),
        loads=[Gravity()],
        degree=1,
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


@pytest.mark.sample(2)
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
    end, steps = 0.9 * PERIOD, np.array([100, 200])
    exact = 1e-3 * np.array([np.cos(OMEGA * end), -np.sin(OMEGA * end)])
    error = [
        np.linalg.norm(swing(end / n, end, **settings)[-1, 1:] / [1, OMEGA] - exact) for n in steps
    ]
    assert np.polyfit(np.log(1 / steps), np.log(error), 1)[0] == pytest.approx(order, abs=0.08)


# --- damping ---


def decay(problem: Problem, zeta: float, **more: Any) -> tuple[np.ndarray, np.ndarray, Any]:
    """The damped oscillator's displacement over a period, and the exact one."""
    rows = []
    for state in Dynamics(
        problem,
        end=PERIOD,
        dt=PERIOD / 100,
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

    The step is off by (omega dt)^2/12 = 3e-4 of the phase, after a period 2e-3.
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
    np.testing.assert_allclose(u, exact, rtol=0, atol=2.5e-3)
    lost = 0.25 * STIFF * 1e-6 - state.energies["total"]
    # The undamped trapezoidal rule and its work balance to round-off in a linear body.
    assert state.energies["damping"] == pytest.approx(lost, rel=1e-9)
    assert abs(state.energies["balance"]) < 1e-9 * lost
    assert state.audit.verdict == "pass"


# --- errors of a step, and of energy ---


def test_the_error_of_a_step_is_what_was_allowed():
    """The largest error that one step makes against the exact flow, over the amplitude."""
    for tolerance in (1e-3, 1e-4):
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


@pytest.mark.parametrize("start", ["velocity", "load"])
def test_the_first_step_is_as_long_as_the_error_allows(start):
    """From u = 0, where nothing has moved yet that an error could be a share of.

    The estimate of the undamped scheme allows omega h = (12 tolerance)^(1/3) = 0.23 where the
    acceleration changes most, and at least 0.1 where errors are judged against the first step
    itself.  Judged against nothing it was 0.016 from a velocity, whatever dt.
    """
    loads = [Gravity(value=[9.81, 0])] if start == "load" else []
    velocity = ["x", 0] if start == "velocity" else []
    # The load is half the weight of the corner, rho A/3: k u = rho g/6.
    size = 1 / OMEGA if start == "velocity" else RHO * 9.81 / 6 / (STIFF / 2)
    for dt in (PERIOD / 5, PERIOD / 60):
        problem, rows = oscillator(loads=loads), []
        for state in Dynamics(
            problem,
            end=PERIOD,
            dt=dt,
            adaptive=True,
            spectral_radius=1.0,
            rtol=1e-12,
            initial_velocity=velocity,
        ).steps():
            rows.append((state.t, *tip(problem, state)))
        t, u, v = np.array(rows).T
        still = 0.0 if start == "velocity" else size
        turn = np.exp(-1j * OMEGA * np.diff(t))
        exact = ((u - still) + 1j * v / OMEGA)[:-1] * turn
        off = np.abs(exact.real - (u - still)[1:])
        assert off.max() < 2e-3 * np.abs(u).max()  # twice the tolerance, as above
        if dt == PERIOD / 60:
            assert t[1] == dt
        else:
            assert 0.15 < OMEGA * t[1] < 0.3


def test_a_first_try_that_is_taken_back_says_nothing_of_later_steps():
    """A free body falls as far in a long try as in half a second: the first step is judged by that.

    The others took a third of the steps when it stayed: an error that is a share of 1.2 m.
    """
    counts = []
    for dt in (0.5, 1e-3):
        problem = Problem(
            rectangle_body(size=(0.1, 0.1), cells=(1, 1)),
            LinearElastic(E=1e5, nu=NU, density=RHO),
            loads=[Gravity(), Traction(on="right", value=["2000*sin(60*t)", 0])],
            degree=1,
        )
        *_, state = Dynamics(problem, end=0.5, dt=dt, adaptive=True).steps()
        counts.append(state.step)
    assert 0.7 * counts[1] < counts[0] < counts[1]


def test_supports_begin_with_their_own_acceleration_whatever_the_step():
    """Not with that of a first try as long as half a period: 900 m/s^2, 1206 then."""
    moved = Support(on="left", displacement=["0.01*(1 - cos(300*t))", 0])
    body = rectangle_body(size=(1, 0.5), cells=(2, 1))
    problem = Problem(body, LinearElastic(E=E, nu=NU, density=RHO), supports=[moved], degree=1)
    motion = Dynamics(problem, end=0.1, dt=0.03, adaptive=True)
    first = next(motion.steps())
    assert (first.newton, first.krylov) == (0, 0)
    most = largest(problem.body.comm, float(np.abs(first.a.x.array).max(initial=0.0)))
    assert most == pytest.approx(900, rel=1e-3)


@pytest.mark.parametrize("begins", ["curve", "formula"])
def test_a_body_at_rest_does_not_sleep_through_what_begins_later(begins, caplog):
    """Adaptive steps of a body at rest grow tenfold each: they pass over half a second in three.

    A pulse of 2 ms gives the oscillator the speed p/m, m = rho/12 and the force a third of 1/2
    times the traction's, whatever the steps; equal steps of 10 ms see nothing, and it is said.
    """
    pulse = {
        "curve": {"curve": [[0, 0], [0.5, 0], [0.501, 1], [0.502, 0]], "value": [100, 0]},
        "formula": {"value": ["100*heaviside(t - 0.5)", 0]},
    }[begins]
    for adaptive in (True, False) if begins == "curve" else (True,):
        caplog.clear()
        problem = oscillator(loads=[BodyForce(**pulse)])
        settings = {"adaptive": True} if adaptive else {}
        moved = [
            np.abs(state.u.x.array).max(initial=0.0)
            for state in Dynamics(problem, end=0.52, dt=0.01, **settings).steps()
        ]
        most = largest(problem.body.comm, float(max(moved)))
        said = any("closer than dt" in record.message for record in caplog.records)
        said = problem.body.comm.bcast(said)
        assert said == (not adaptive)
        if begins == "formula":
            # A load that comes at once moves twice as far as one that is there: f/k each.
            still = 100 / 6 / (STIFF / 2)
            assert most == pytest.approx(2 * still, rel=0.05)
        elif adaptive:
            speed = 100 / 6 * 1e-3 / (RHO / 12)
            assert most == pytest.approx(speed / OMEGA, rel=0.05)
        else:
            assert most == 0.0


@pytest.mark.parametrize(("apart", "said"), [(1.0, False), (0.99, True)])
def test_corners_as_far_apart_as_steps_are_all_met(apart, said, caplog):
    """Equal steps pass over nothing there; a hundredth closer it is said."""
    dt = 0.01
    curve = [[0, 0], [apart * dt, 1], [2 * apart * dt, 0]]
    problem = oscillator(loads=[BodyForce(value=[100, 0], curve=curve)])
    assert len([*Dynamics(problem, end=2 * dt, dt=dt).steps()]) == 3
    found = any("closer than dt" in record.message for record in caplog.records)
    assert problem.body.comm.bcast(found) == said


def test_times_that_are_met_make_no_other_step_shorter():
    """Times a crumb apart: one further step each, and at most one where they cut an interval.

    A step of 1e-5 of the usual one would need five more to grow again.
    """
    counts = []
    pairs = [k * PERIOD / 7 for k in range(1, 14)]
    for times in ([], [t * (1 + s) for t in pairs for s in (0, 1e-6)]):
        problem = oscillator()
        *_, state = Dynamics(
            problem,
            end=2 * PERIOD,
            dt=PERIOD / 40,
            adaptive=True,
            times=times,
            initial_displacement=["1e-3*x", 0],
        ).steps()
        counts.append(state.step)
    assert counts[0] < counts[1] <= counts[0] + 2 * len(pairs)


def test_the_audit_sees_energy_that_comes_from_nowhere():
    """Newmark's linear acceleration beyond its stable step, omega dt = 2 sqrt(3).

    Amplitudes grow without end, so that nearly all energy is from nowhere; the first state that was
    judged, with less of it, was all that was told.
    """
    last: Any = None
    shares: list[tuple[float, float]] = []
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
        shares += [(float(text.split(" %")[0]), state.t) for text in state.audit.reasons]
    assert last.audit.verdict == last.audit.verdict_so_far == "fail"
    worst, t = max(shares)
    assert worst > shares[0][0] + 1.0
    assert last.audit.so_far == (
        f"{worst:.3g} % of the energy has come from nowhere: a smaller dt is needed "
        f"(worst at t = {t:.6g} s, since t = {shares[0][1]:.6g} s)",
    )
    assert last.failure == last.audit.so_far[0]


def test_the_audit_sees_what_a_scheme_damps_away():
    settings: dict[str, Any] = {"end": 3 * PERIOD, "dt": PERIOD / 5, "rtol": 1e-12}
    settings["initial_displacement"] = ["1e-3*x", 0]
    *_, damped = Dynamics(oscillator(), spectral_radius=0.6, **settings).steps()
    assert "damped" in damped.audit.so_far[0]
    *_, kept = Dynamics(oscillator(), spectral_radius=1.0, **settings).steps()
    assert kept.audit.so_far == ()


def test_parameters_of_the_family():
    """rho = 1 is the midpoint rule; Chung & Hulbert's optimum for rho = 0 has beta = gamma = ..."""
    one, none = (GeneralizedAlphaParameters.generalized_alpha(radius) for radius in (1.0, 0.0))
    assert (one.alpha_m, one.alpha_f, one.beta, one.gamma) == (0.5, 0.5, 0.25, 0.5)
    assert (none.alpha_m, none.alpha_f, none.beta, none.gamma) == (-1.0, 0.0, 1.0, 1.5)
