"""Implicit motion of bodies: waves, moving supports, damping, times, events, audit and restarts."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.checkpoints import through_json
from helpers.motion import (
    NU,
    PERIOD,
    RHO,
    STIFF,
    E,
    brick,
    drift,
    oscillator,
    value_at,
)
from mpi4py import MPI

from dolfin_elastic import (
    Body,
    Contact,
    Dashpot,
    Dynamics,
    FixedCorotated,
    Gravity,
    LinearElastic,
    NeoHookean,
    Problem,
    Spring,
    StVenantKirchhoff,
    Support,
    Traction,
    box_body,
    rectangle_body,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.results.writers.summary import peak_memory
from dolfin_elastic.solvers.dynamics.implicit.implicit import Implicit
from dolfin_elastic.solvers.dynamics.implicit.ts_scheme import GeneralizedAlphaScheme, ImpactError
from dolfin_elastic.solvers.linear.choice import LinearSettings

# --- waves ---


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
        degree=1,
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
            degree=1,
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
        degree=1,
    )
    rows = [
        (
            s.t,
            s.reactions["left+right"][0]
            if "left+right" in s.reactions
            else sum(f[0] for f in s.reactions.values()),
        )
        for s in Dynamics(problem, end=0.1, dt=1e-3, spectral_radius=0.9).steps()
    ]
    t, force = np.array(rows).T
    exact = RHO * 0.01 * 2 * w**2 * np.cos(2 * w * t)
    # Second order: (2 w dt)^2 = 4e-3 of it; at the time of the stage it would be off by 3 %.
    np.testing.assert_allclose(force, exact, rtol=0, atol=2e-3 * abs(exact).max())


# --- damping ---


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


@pytest.mark.parametrize("settings", [{}, {"spectral_radius": 0.5}, {"scheme": "newmark"}])
def test_a_start_that_does_not_fit_its_support_is_forgotten(settings):
    """The foot sets off at once, the body does not: stiff damping takes that up in the first steps.

    Generalized-alpha with Chung & Hulbert's beta throws the body off by many times its length.
    """
    body = rectangle_body(size=(0.2, 0.01), cells=(16, 2))
    moved = [0, "0.001*sin(2*pi*0.6*t)"]
    problem = Problem(
        body,
        LinearElastic(E=1e6, nu=NU, density=1000),
        supports=[Support(on="left", displacement=moved)],
        degree=2,
    )
    motion = Dynamics(problem, end=0.4, dt=0.02, rayleigh=[0.3, 0.005], **settings)
    states = list(motion.steps())
    lost = [state.energies["damping"] for state in states]
    # As implicit Euler and TSALPHA2 find it: some 1.3e-5 to 2.1e-5 J.
    assert max(state.energies["strain"] for state in states) < 1e-4
    assert min(lost) > -1e-6


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


@pytest.mark.parametrize("scheme", ["generalized-alpha", "newmark", "implicit-euler", "alpha2"])
@pytest.mark.sample(2)
def test_times_are_met_exactly_and_all_that_is_asked_for_is_shown(scheme):
    """Also those that are no multiples of dt, and where steps add up to them but for round-off."""

    def times(**how: Any) -> list[float]:
        motion = Dynamics(oscillator(), scheme=scheme, end=0.25, **how)
        return [state.t for state in motion.steps()]

    asked = [0.013, 0.1, 0.2499]
    every = [0.0, 0.013, 0.05, 0.1, 0.15000000000000002, 0.2, 0.2499, 0.25]
    for adaptive in (False, True)[: 2 if scheme == "generalized-alpha" else 1]:
        assert times(dt=0.01, every="50 ms", times=asked, adaptive=adaptive) == every
    found = times(dt=0.003, every=7, times=asked)
    assert set(asked) < set(found)
    assert found[-1] == 0.25
    assert found[:4] == pytest.approx([0.0, 0.013, 0.019, 0.04], rel=1e-12)  # steps 0, 5, 7, 14
    motion = Dynamics(oscillator(), scheme=scheme, end=0.1, dt=0.01, every=4, times=[0.05])
    assert [state.step for state in motion.steps()] == [0, 4, 5, 8, 10]


def test_long_steps_do_not_jump_into_an_obstacle():
    """A bar that flies on for 0.1 s, hits a wall end on, and leaves it after 2L/c as fast.

    Nothing changes in flight, and steps grow: one of 0.095 s ended deep in the wall, whose force
    was not there at its stage, and the bar left with twice its energy.  Source: K. L. Johnson,
    Contact Mechanics, Cambridge 1985, section 11.1.
    """
    speed, rho, cells = np.sqrt(1000.0), 1000.0, 20
    wall = Contact(on="left", plane={"axis": "x", "at": -0.1}, name="wall")
    problem = Problem(
        rectangle_body(size=(1.0, 1 / cells), cells=(cells, 1)),
        LinearElastic(E=rho * speed**2, nu=0.0, density=rho),
        contacts=[wall],
        degree=1,
    )
    pushed = []
    for state in Dynamics(
        problem,
        end=0.25,
        dt=1e-3,
        adaptive=True,
        spectral_radius=0.8,
        initial_velocity=[-1.0, 0],
    ).steps():
        assert state.audit.verdict == "pass"
        if abs(state.reactions["wall"][0]) > 0.1 * rho * speed / cells:
            pushed.append(state.t)
    # The front is some cells wide, and damping lets the bar swing a little less.
    assert pushed[0] == pytest.approx(0.1, abs=5e-3)
    assert pushed[-1] == pytest.approx(0.1 + 2 / speed, abs=5e-3)
    assert state.momenta["linear"][0] == pytest.approx(rho / cells, rel=0.05)


def test_a_cell_that_turns_inside_out_makes_the_step_smaller():
    """A patch of bar thrown together so fast that one whole step would fold it."""
    problem = Problem(
        rectangle_body(size=(1.0, 0.5), cells=(2, 1)),
        NeoHookean(E=1e5, nu=NU, density=RHO),
        supports=[Support(on="left", displacement=[0, 0])],
        degree=1,
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


def test_how_often_a_step_without_solution_is_tried_shorter():
    """Eight times a quarter, from 1 s to 15 microseconds; then the motion has failed."""
    size, tried = [1.0], []
    ts = SimpleNamespace(
        getSolution2=lambda: (None, None),
        getTime=lambda: 0.0,
        getTimeStep=lambda: size[0],
        setTimeStep=lambda h: size.__setitem__(0, h),
    )
    stages = SimpleNamespace(begin=lambda _: None, solve=lambda _, h: tried.append(h))
    scheme = SimpleNamespace(
        _present=lambda t: SimpleNamespace(t=t),
        _stages=stages,
        impact_error=None,
        context=SimpleNamespace(moving=SimpleNamespace(problem=SimpleNamespace(linear=True))),
        _put_back=lambda *_: None,
    )
    assert not GeneralizedAlphaScheme._take_step(scheme, ts)  # type: ignore[arg-type]
    assert tried == [0.25**n for n in range(9)]


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5])
def test_contact_forces_that_do_not_follow_a_line_are_the_error_of_an_impact(share):
    """Through start and stage, -h^2/(6 m) times what they are off by at the end."""
    first, end, off = np.array([2.0, 0.0]), np.array([3.0, 5.0]), np.array([0.0, 0.6])
    impact = SimpleNamespace(
        _share=share,
        _first=first,
        _stage=(1 - share) * end + share * first,
        _contact_forces=lambda: end + off,
        _mobility=np.array([1.0, 0.5]),
    )
    found = ImpactError.error(impact, 0.1)  # type: ignore[arg-type]
    np.testing.assert_allclose(found, [0.0, -0.01 / 6 * 0.6 * 0.5], rtol=0, atol=1e-16)


def test_between_the_ends_of_a_step_there_is_a_cubic():
    """Which an event within it is looked for on; as near to the cosine as the ends are."""
    problem, dt = oscillator(), PERIOD / 40
    motion = Dynamics(problem, end=PERIOD / 4, dt=dt, initial_displacement=["1e-3*x", 0])
    for state in motion.steps():
        U = motion.ts.getSolution().duplicate()
        for t in (state.t - 0.7 * dt, state.t - 0.2 * dt) if state.step else ():
            motion.ts.interpolate(t, U)
            found = problem.body.comm.allreduce(float(U.array_r.sum()))
            assert found == pytest.approx(1e-3 * np.cos(2 * np.pi * t / PERIOD), abs=5e-6)
        U.destroy()


# --- audit ---


@pytest.mark.long
def test_the_audit_balances_forces_with_inertia(monkeypatch):
    """A shaken column with springs, dashpots and weight: all sums up, and a false load is seen."""

    def last() -> Any:
        problem = column(tall())
        *_, state = Dynamics(problem, end=0.02, dt=2e-3, rayleigh=[1.0, 1e-4]).steps()
        return state

    good = last()
    assert good.audit.force < 1e-7
    assert good.audit.moment < 1e-7
    assert good.audit.verdict == "pass"
    from dolfin_elastic.solvers.assembly.assembler import Reactions

    true = Reactions.loads
    monkeypatch.setattr(Reactions, "loads", lambda self: 1.01 * true(self))
    bad = last()
    assert bad.audit.verdict == "warn"
    assert "do not balance" in bad.audit.so_far[0]


# --- restarts ---


def tall() -> Body:
    return rectangle_body(size=(0.5, 1.0), cells=(2, 3))


def column(body: Body, **more: Any) -> Problem:
    """Weight, a foot that is shaken, springs, dashpots, viscosity and an obstacle."""
    return Problem(
        body,
        NeoHookean(E=1e6, nu=NU, density=RHO, viscosity=300.0),
        loads=[Gravity(), Traction(on="top", value=["2e4*sin(300*t)", 0])],
        supports=[
            Support(on="bottom", displacement=["0.01*sin(200*t)^2", 0]),
            Spring(on="left", normal="1 MPa/m"),
            Dashpot(on="right", normal=2e3, tangential=1e3),
        ],
        contacts=[Contact(on="top", plane={"point": [0, 1.001], "normal": [0, -1]}, name="lid")],
        **{"degree": 1, **more},
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


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    ("scheme", "turns", "says"),
    [
        ("generalized-alpha", 0.03, True),
        ("generalized-alpha", 0.001, False),
        ("alpha2", 0.03, True),
        ("newmark", 0.03, False),
        ("implicit-euler", 0.03, False),
    ],
)
def test_strain_error_of_a_stiff_body_that_rotates(scheme, turns, says):
    """A free square of steel at 300 rad/s, strained by 1e-5 in truth.

    Steps of 0.03 rad have an error of 0.03^2/8 = 1.1e-4: the stage is right, the ends too large.
    """
    problem = Problem(
        rectangle_body(size=(0.1, 0.1), cells=(2, 2), origin=(-0.05, -0.05)),
        StVenantKirchhoff(E=2e11, nu=NU, density=7850),
        degree=1,
    )
    dt = turns / 300
    settings = {"end": 60 * dt, "dt": dt, "initial_velocity": ["-300*y", "300*x"]}
    *_, state = Dynamics(problem, scheme=scheme, **settings).steps()
    told = [reason for reason in state.audit.reasons if "strain error" in reason]
    assert bool(told) == says
    if says:
        assert told[0].startswith("the body rotates by 1.7 degrees a step, with a strain error of")
        assert "scheme = 'energy-momentum'" in told[0]


def test_little_energy_is_judged_like_much():
    """A short steel bar under its weight, steps much too long: the same words at any load."""
    said = []
    for g in (9.81, 9810.0):
        problem = Problem(
            rectangle_body(size=(0.1, 0.02), cells=(6, 2)),
            LinearElastic(E=2.1e11, nu=NU, density=7850),
            supports=[Support(on="left", displacement=[0, 0])],
            loads=[Gravity(value=[0, -g])],
            degree=1,
        )
        *_, state = Dynamics(problem, end=0.1, dt=2e-3).steps()
        said.append([reason[:21] for reason in state.audit.so_far])
    assert said[0] == said[1] == ["the scheme has damped"]


@pytest.mark.long
def test_a_motion_goes_on_as_if_it_had_never_stopped():
    """From copied arrays and numbers as JSON, in a new problem: the same states to round-off."""
    upright, lying = tall(), long()  # two of a kind can be parted and numbered in two ways
    cases: list[tuple[Callable[[Body], Problem], Body, dict[str, Any]]] = [
        (column, upright, {"rayleigh": [1.0, 1e-4], "spectral_radius": 0.8}),
        (
            column,
            upright,
            {"scheme": "newmark", "adaptive": True, "tolerance": 1e-3, "times": [0.01]},
        ),
        (mixed, lying, {"scheme": "generalized-alpha"}),
        (mixed, lying, {"scheme": "implicit-euler", "every": 2}),
    ]
    for make, body, settings in cases:
        given = {"end": 0.02, "dt": 1e-3, "rtol": 1e-12, **settings}
        motion = Dynamics(make(body), **given)
        whole: list[dict[str, Any]] = []
        saved: Any = None
        for state in motion.steps():
            whole.append(record(state))
            if saved is None and state.t >= 0.008:
                saved = through_json(motion.restart_state())
                number = len(whole)
        again = [record(state) for state in Dynamics(make(body), **given).steps(saved)]
        assert len(again) == len(whole) - number > 3
        for one, other in zip(again, whole[number:], strict=True):
            assert one.keys() == other.keys()
            for name, value in one.items():
                scale = np.abs(np.asarray(other[name])).max(initial=1e-9)
                np.testing.assert_allclose(value, other[name], rtol=0, atol=1e-12 * scale + 1e-15)


def test_a_motion_goes_on_with_the_linear_solver_it_has_come_to():
    """Conjugate gradients had failed: they are not tried again."""
    given: dict[str, Any] = {
        "end": 0.004,
        "dt": 1e-3,
        "spectral_radius": 0.9,  # with 1 the stress of steps has no symmetric tangent
        "linear": LinearSettings(method="iterative"),
    }

    def kind(motion: Dynamics) -> str:
        return str(motion.ts.getSNES().ksp.getType())

    body = tall()
    motion = Dynamics(column(body), **given)
    states = motion.steps()
    _ = next(states), next(states)
    assert kind(motion) == "cg"
    assert isinstance(motion._motion, Implicit)
    assert motion._motion.newton.fall_back()
    next(states)
    saved = through_json(motion.restart_state())
    known = next(states)
    again = Dynamics(column(body), **given)
    more = again.steps(saved)
    found = next(more)
    assert kind(again) == "gmres"
    # To the tolerance of the steps.
    assert found.max_displacement == pytest.approx(known.max_displacement, rel=1e-6)


def test_alpha2_falls_back_to_factors() -> None:
    """By way of GMRES, which TS did not take: conjugate gradients failed again and again."""
    body = box_body(size=(4, 0.3, 0.3), cells=(8, 1, 1))
    pull = Traction(on="right", value=[0, 0, -2e3])
    law = NeoHookean(E=1e7, nu=0.3, density=1000)
    problem = Problem(body, law, supports=[Support(on="left")], loads=[pull], degree=2)
    linear = LinearSettings(method="iterative", petsc={"ksp_max_it": 2})
    motion = Dynamics(problem, scheme="alpha2", dt=0.01, end=0.01, linear=linear)
    kinds = [(state.t, str(motion.ts.getSNES().ksp.getType())) for state in motion.steps()]
    assert kinds[0] == (0.0, "cg")
    assert kinds[-1] == (pytest.approx(0.01), "preonly")


def long() -> Body:
    return rectangle_body(size=(1.0, 0.25), cells=(4, 1))


def mixed(body: Body) -> Problem:
    """Incompressible rubber: the pressure is kept, too."""
    return Problem(
        body,
        NeoHookean(E=1e6, nu=0.4999, density=RHO),
        degree=2,
        supports=[Support(on="left", displacement=[0, 0])],
        loads=[Gravity()],
    )


@pytest.mark.long
def test_momenta_and_memory_over_ten_thousand_steps(comm):
    """D-3: a free brick that turns ten times and flies 23 m keeps momenta and energy to round-off.

    They are exact once Newton's method has converged; of the momenta 7e-15 and 4e-14
    found.  Accelerations as differences of places would be off by 1e-9 of what they are.
    The largest memory in use grows by less than 2 MB: a vector or matrix that is not freed at each
    step would take more.
    """
    problem = Problem(
        box_body(size=(1.0, 0.6, 0.3), cells=(2, 1, 1)),
        NeoHookean(E=1e5, nu=NU, density=1000),
        degree=1,
    )
    velocity = ["1 - 2*(z - 0.15) - 5*(y - 0.3)", "2 + 5*(x - 0.5) - 3*(z - 0.15)"]
    velocity.append("-0.5 + 3*(y - 0.3) + 2*(x - 0.5)")
    steps = 10_000 if comm.size == 1 else 1000  # so small a body is slower on more ranks
    dt = 2 * np.pi / np.sqrt(38) / 1000
    settings = {"spectral_radius": 1.0, "rtol": 1e-12, "every": steps // 20}
    rows, peak = [], []
    for state in Dynamics(
        problem, end=steps * dt, dt=dt, initial_velocity=velocity, **settings
    ).steps():
        momenta = [state.momenta["linear"], state.momenta["angular"], [state.energies["total"]]]
        rows.append(np.concatenate(momenta))
        peak.append(peak_memory(problem.body.comm)["largest_rank"])
    assert state.step == steps
    table = np.array(rows)
    np.testing.assert_allclose(table[0], [180, 360, -90, -60.75, 39.3, 228, 790.575], rtol=1e-12)
    assert drift(list(table[:, :3])) < 1e-13
    assert drift(list(table[:, 3:6])) < 1e-12
    assert np.ptp(table[:, 6]) < 1e-10 * table[0, 6]
    assert peak[-1] - peak[1] < 2e6


def test_there_is_nothing_to_keep_before_a_motion_and_after_it():
    motion = Dynamics(oscillator(), end=0.02, dt=0.01)
    with pytest.raises(RuntimeError, match="no state to save"):
        motion.restart_state()
    _ = [*motion.steps()]
    with pytest.raises(RuntimeError, match="no state to save"):
        motion.restart_state()


# --- inverted cells ---


@pytest.mark.long
def test_a_law_that_survives_inversion_goes_on(comm):
    """A jelly hits a plane at 6 m/s, twice its speed of sound: cells are inverted, and counted."""
    problem = Problem(
        box_body(size=(0.02, 0.02, 0.02), cells=(2, 2, 2), comm=comm),
        FixedCorotated(E=1e4, nu=0.4, density=1000.0),
        contacts=[Contact(on="bottom", plane={"axis": "z", "at": -1e-3})],
        degree=1,
    )
    states = list(Dynamics(problem, end=0.01, dt=2e-4, initial_velocity=[0, 0, -6]).steps())
    assert states[-1].t == pytest.approx(0.01)
    counts = [state.audit.inverted for state in states]
    assert counts[0] == 0
    assert max(counts) > 0
    assert any("elements inverted, smallest det F" in r for r in states[-1].audit.so_far)


@pytest.mark.long
@pytest.mark.parametrize("law", [FixedCorotated, StVenantKirchhoff])
def test_a_start_with_half_of_the_cells_inverted(law, comm):
    """One law turns them back; one that takes them for undeformed refuses to begin."""
    problem = Problem(
        box_body(size=(1, 1, 1), cells=(2, 1, 1), comm=comm),
        law(E=1e4, nu=0.3, density=1000.0),
        supports=[Support(on="left")],
        degree=1,
    )
    folded = {"initial_displacement": ["-1.5*max(x - 0.5, 0)", "0.05*x*sin(9*z)", "0.05*x*y"]}
    motion = Dynamics(problem, scheme="implicit-euler", end=40.0, dt=0.1, **folded)
    if law is StVenantKirchhoff:
        told = r"it turns elements inside out: .*a function of C alone.* would stay so"
        with pytest.raises(InputError, match=told) as refused:
            next(motion.steps())
        assert "or law = 'neo-hookean'" in refused.value.expected
        assert "law = 'fixed-corotated', which goes on" in refused.value.expected
        return
    first, *_, last = motion.steps()
    assert (first.audit.inverted, last.audit.inverted) == (6, 0)
    assert last.max_displacement < 1e-6


# --- what the audit says ---


@pytest.mark.parametrize(
    ("settings", "advice"),
    [
        ({}, "a smaller dt, or a larger spectral_radius, keeps it"),
        ({"spectral_radius": 1.0}, "a smaller dt keeps it"),
        ({"scheme": "newmark"}, "a smaller dt keeps it"),
    ],
)
def test_advice_names_only_keys_that_help(settings, advice):
    motion = Dynamics(oscillator(), end=0.02, dt=0.01, **settings)
    states = motion.steps()
    energies = next(states).energies
    balance = SimpleNamespace(relative_imbalance=lambda _: -0.5, scale=1.0)
    first, audit = (motion._motion.auditor.judge(0.0, balance, energies) for _ in range(2))
    assert first.reasons == ()  # once may be a kink's
    states.close()
    assert audit.reasons == (f"the scheme has damped 50 % of the energy away: {advice}",)


def test_moments_round_an_axis_are_not_judged():
    """They cancel there, in motion as in statics; forces along the axis do not."""
    problem = Problem(
        rectangle_body(size=(1, 0.5), cells=(2, 1)),
        NeoHookean(E=1e6, nu=0.3, density=1000.0),
        geometry="axisymmetric",
        supports=[Support(on="bottom", displacement=["free", 0])],
        loads=[Traction(on="top", value=[0, 1e3])],
        degree=1,
    )
    found = [state.audit for state in Dynamics(problem, end=0.01, dt=5e-3).steps()]
    assert all(np.isnan(audit.moment) for audit in found)
    # Newton's method leaves 1e-8 of the forces of the step.
    assert max(audit.force for audit in found) < 1e-7


# --- what is refused ---


@pytest.mark.parametrize(("option", "key"), [("-ts_type", "scheme"), ("ts_max_time", "end")])
def test_petsc_options_of_what_the_case_says(option, key):
    """Without effect otherwise, or, of `-ts_type`, with a fault of PETSc's."""
    motion = Dynamics(oscillator(), end=0.02, dt=0.01, petsc={option: "1"})
    with pytest.raises(InputError, match=rf"solver\.petsc: .* dynamics\.{key} says it"):
        next(motion.steps())


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
        ({"scheme": "symplectic-euler", "rayleigh": [1, 0]}, "has no rayleigh"),
        ({"scheme": "newmarc"}, "newmark"),
        ({"scheme": "alpha2", "adaptive": True}, "adaptive: PETSc's 'alpha2' judges"),
    ],
)
def test_wrong_settings_are_named(settings, said):
    with pytest.raises(InputError, match=said):
        Dynamics(oscillator(), end=1.0, dt=0.1, **settings)


@pytest.mark.parametrize("scheme", ["generalized-alpha", "alpha2"])
def test_monitor_and_view_of_petsc(scheme, folder, caplog):
    """Each step is one line, however many states are asked for; TS is viewed once, at the end."""
    steps, view = folder / "steps.txt", folder / "ts.txt"
    petsc = {"ts_monitor": f":{steps}", "-ts_view": f"ascii:{view}", "snes_view_nonsense": None}
    for state in Dynamics(oscillator(), end=0.04, dt=0.01, scheme=scheme, petsc=petsc).steps():
        assert state.step == 0 or not view.exists()
        MPI.COMM_WORLD.barrier()  # rank 0 writes them, and is not to run ahead
    MPI.COMM_WORLD.barrier()
    assert steps.read_text() == (
        "0 TS dt 0.01 time 0.\n1 TS dt 0.01 time 0.01\n2 TS dt 0.01 time 0.02\n"
        "3 TS dt 0.01 time 0.03\n4 TS dt 0.01 time 0.04\n"
    )
    assert view.read_text().count("TS Object") == 1
    assert "SNES Object" in view.read_text()
    unused = [record.message for record in caplog.records if "not used" in record.message]
    if MPI.COMM_WORLD.rank == 0:  # the log is that of one rank
        assert unused == ["PETSc option '-snes_view_nonsense' was not used by any solver"]


@pytest.mark.parametrize("option", ["pc_type", "ts_adapt_type"])
@pytest.mark.parametrize("scheme", ["generalized-alpha", "alpha2"])
def test_what_petsc_refuses_leaves_nothing_behind(scheme, option, monkeypatch):
    """Neither when Newton's method is made nor when TS is: all that was made is destroyed."""
    made, prepare = [], Implicit._prepare
    monkeypatch.setattr(
        Implicit, "_prepare", lambda self, *a: [made.append(self), prepare(self, *a)]
    )
    motion = Dynamics(oscillator(), end=0.02, dt=0.01, scheme=scheme, petsc={option: "nonsense"})
    with pytest.raises(InputError, match=f"PETSc refuses the option -{option} nonsense"):
        next(motion.steps())
    march = made[0]
    owned = [march.ts, march.moving.mass, march.assembler.tangent.matrix]
    if option == "ts_adapt_type":
        residual = march.scheme if scheme == "alpha2" else march.scheme._stages
        owned += [march._U, march._V, residual._F]
    assert not any(map(bool, owned))


def test_viscosity_is_for_implicit_schemes():
    with pytest.raises(InputError, match=r"materials.body.viscosity: .* knows no viscosity"):
        next(Dynamics(oscillator(viscosity=1.0), scheme="symplectic-euler", end=1.0).steps())


def test_units_of_damping():
    found = Dynamics(oscillator(), end="1 s", dt="1 ms", rayleigh=[1, "2 ms"]).settings
    assert (found.rayleigh.mass, found.rayleigh.stiffness) == (1.0, 2e-3)
    law = LinearElastic(E=1, nu=0, viscosity="2 kPa*s")
    assert law.viscosity == pytest.approx(2000.0)
