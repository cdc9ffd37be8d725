"""Explicit schemes: exact discrete answers, their orders, momenta kept, the stable step.

Source: Hairer, Lubich & Wanner, Geometric Numerical Integration (2006), sections I.1.2 and IX.
For an oscillator v += dt a, then u += dt v from rest at u_0 gives
u_n = u_0 (cos n theta - tan(theta/2) sin n theta), cos theta = 1 - (omega dt)^2/2; central
differences give u_n = u_0 cos n theta with the same theta, and v_n = (u_n+1 - u_n-1)/(2 dt).
"""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem
from helpers.matrices import dense
from helpers.motion import oscillator
from mpi4py import MPI

from dolfin_elastic import (
    Dynamics,
    Gravity,
    LinearElastic,
    NeoHookean,
    Problem,
    Support,
    Textbook,
    box_body,
    rectangle_body,
)
from dolfin_elastic.core.errors import InputError, StabilityError
from dolfin_elastic.solvers.dynamics.explicit.explicit import Explicit
from dolfin_elastic.solvers.dynamics.explicit.scheme import SymplecticEuler

FREE, SCHEME, CENTRAL = "free", "symplectic-euler", "central-differences"
BOTH = pytest.mark.parametrize("scheme", [SCHEME, CENTRAL])
E, NU, RHO = 1e7, 0.3, 1000.0
STIFF = E * (1 - NU) / ((1 + NU) * (1 - 2 * NU))
OMEGA = np.sqrt(3 * STIFF / RHO)
"""Of the oscillator: stiffness (lmbda + 2 mu)/2, lumped mass rho/6."""
PERIOD = 2 * np.pi / OMEGA


def swing(dt: float, end: float, scheme: str = SCHEME) -> np.ndarray:
    """Rows t, u, v and total energy from u = 1e-3 and v = 0."""
    problem, rows = oscillator(), []
    for state in Dynamics(
        problem, scheme=scheme, end=end, dt=dt, every=1, initial_displacement=["1e-3*x", 0]
    ).steps():
        u = state.max_displacement
        x = problem.V.tabulate_dof_coordinates()
        at = np.flatnonzero(np.abs(x[:, 0] - 1) < 1e-9)
        found = [(float(state.u.x.array[2 * i]), float(state.v.x.array[2 * i])) for i in at]
        u, v = next(pair for pairs in problem.body.comm.allgather(found) for pair in pairs)
        rows.append((state.t, u, v, state.energies["total"]))
    return np.array(rows)


@pytest.mark.parametrize("share", [0.1, 0.7, 0.99])
def test_every_step_is_the_discrete_solution(share):
    """Also just below the stability limit omega dt = 2."""
    dt = share * 2 / OMEGA
    u = swing(dt, 40.5 * dt)[:41, 1]
    theta, n = np.arccos(1 - (OMEGA * dt) ** 2 / 2), np.arange(41)
    exact = np.cos(n * theta) - np.tan(theta / 2) * np.sin(n * theta)
    # At 0.99 the solution grows to tan(theta/2) = 7 and rounding with it.
    np.testing.assert_allclose(u / 1e-3, exact, rtol=0, atol=1e-11)


@pytest.mark.parametrize("share", [0.1, 0.7, 0.99])
def test_every_step_is_the_discrete_solution_of_central_differences(share):
    """Place and velocity, which is that of the same time."""
    dt = share * 2 / OMEGA
    _, u, v, energy = swing(dt, 40.5 * dt, CENTRAL)[:41].T
    theta, n = np.arccos(1 - (OMEGA * dt) ** 2 / 2), np.arange(41)
    np.testing.assert_allclose(u / 1e-3, np.cos(n * theta), rtol=0, atol=1e-11)
    exact = -np.sin(n * theta) * np.sin(theta) / dt
    np.testing.assert_allclose(v / 1e-3, exact, rtol=0, atol=1e-11 * OMEGA)
    # k u^2/2 + m v^2/2 swings by (omega dt/2)^2 of it, the share of sin(theta)/(omega dt) below 1.
    below = (1 - (np.sin(theta) / (OMEGA * dt)) ** 2) * np.sin(n * theta) ** 2
    np.testing.assert_allclose(energy / energy[0], 1 - below, rtol=0, atol=1e-10)


@pytest.mark.parametrize(("scheme", "order"), [(SCHEME, 1), (CENTRAL, 2)])
def test_order_in_time(scheme, order):
    """Of place and velocity; Euler's velocity is better, as here it starts at rest."""
    end, steps = 0.9 * PERIOD, np.array([40, 80, 160, 320])
    exact = 1e-3 * np.array([np.cos(OMEGA * end), -np.sin(OMEGA * end)])
    last = [swing(end / n, end, scheme)[-1, 1:3] / [1, OMEGA] for n in steps]
    for error in np.abs(np.array(last) - exact).T[:order]:
        slope = np.polyfit(np.log(1 / steps), np.log(error), 1)[0]
        assert order - 0.1 <= slope <= order + 0.1


@BOTH
def test_energy_stays_in_a_band(scheme):
    """1000 steps: the energy swings by O(omega dt), and the band is the same at the end."""
    dt = 0.2 / OMEGA
    total = swing(dt, 1000.5 * dt, scheme)[:, 3]
    early, late = total[:200], total[-200:]
    assert np.ptp(total) < (0.25 if scheme == SCHEME else 0.011) * total[0]
    assert late.max() == pytest.approx(early.max(), rel=1e-3)
    assert late.min() == pytest.approx(early.min(), rel=1e-3)


@BOTH
@pytest.mark.parametrize("every", [1, 7])
def test_free_fall(scheme, every):
    """u_n = g dt^2 n (n + 1)/2 and g dt^2 n^2/2, exactly, however often it is looked at."""
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    problem = Problem(body, NeoHookean(E=E, nu=NU, density=RHO), loads=[Gravity()], degree=1)
    dt = 1e-3
    for state in Dynamics(problem, scheme=scheme, end=0.05, dt=dt, every=every).steps():
        n = state.step
        exact = [0.0, -9.81 * dt**2 * (n * (n + 1) if scheme == SCHEME else n**2) / 2]
        off = np.abs(problem.u.x.array.reshape(-1, 2) - exact).max(initial=0.0)
        assert body.comm.allreduce(float(off), op=MPI.MAX) < 1e-14
        assert state.momenta["linear"][1] == pytest.approx(-RHO * 9.81 * n * dt, rel=1e-12)
        work = RHO * 9.81 * -exact[1]
        assert state.energies["external"] == pytest.approx(work, rel=1e-12)


# --- a free body ---

CENTRE, SPIN, DRIFT = np.array([0.5, 0.3, 0.15]), np.array([3.0, -2, 5]), np.array([1.0, 2, -0.5])


@BOTH
def test_free_body_keeps_its_momenta(scheme):
    """A neo-Hookean brick thrown with a spin, five turns: both momenta to round-off."""
    problem = Problem(
        box_body(size=(1.0, 0.6, 0.3), cells=(3, 2, 1)),
        NeoHookean(E=1e5, nu=NU, density=RHO),
        degree=1,
    )
    x = ["x - 0.5", "y - 0.3", "z - 0.15"]
    velocity = [
        f"{DRIFT[i]} + ({SPIN[j]})*({x[k]}) - ({SPIN[k]})*({x[j]})"
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    ]
    states = [
        (s.momenta["linear"], s.momenta["angular"], s.energies["total"], s.step)
        for s in Dynamics(
            problem, scheme=scheme, end=5.0, initial_velocity=velocity, every=20
        ).steps()
    ]
    linear, angular, total, step = (np.array(column) for column in zip(*states, strict=True))
    assert step[-1] > 300
    assert step[1] == 20
    np.testing.assert_allclose(linear[0], [180, 360, -90], rtol=1e-12)
    # Each step keeps x cross p exactly: a = f/m, sum of x cross f vanishes, v is parallel to dx.
    assert np.abs(linear - linear[0]).max() < 1e-11 * np.abs(linear[0]).max()
    assert np.abs(angular - angular[0]).max() < 1e-11 * np.abs(angular[0]).max()
    assert np.ptp(total) < 0.1 * total[0]
    assert abs(total[len(total) // 2 :].mean() - total[: len(total) // 2].mean()) < 0.02 * total[0]


# --- the stable step ---


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("held", [False, True])
def test_stable_step_against_all_eigenvalues(comm, dim, held):
    """2/omega_max from a dense eigenvalue solve of the same small body."""
    body = box_body(size=(1.0, 0.6, 0.5)[:dim], cells=(4, 2, 2)[:dim])
    supports = [Support(on="left", displacement=[0] * dim)] if held else []
    law = LinearElastic(E=E, nu=0.4, density=RHO)
    problem = Problem(body, law, supports=supports, degree=1)
    explicit = Explicit(
        problem, fem.Function(problem.V), SymplecticEuler, end=1.0, dt=None, safety=0.9, every=1
    )
    estimate = explicit.size.step_for(explicit.size.largest_frequency())
    x = explicit.assembler.create_vector()
    explicit.assembler.get(x)
    explicit.assembler.tangent.assemble(x)
    K = dense(explicit.assembler.tangent.matrix, comm)
    mass = np.concatenate(comm.allgather(explicit.mass))
    first = explicit.assembler.tangent.matrix.getOwnershipRange()[0]
    fixed = first + problem.constraints.prescribed_dofs
    free = np.setdiff1d(np.arange(len(mass)), np.concatenate(comm.allgather(fixed)))
    scaled = (K / np.sqrt(np.outer(mass, mass)))[np.ix_(free, free)]
    exact = 2 / np.sqrt(np.linalg.eigvalsh(scaled).max())
    # The eigenvalue is asked for to 1e-3; an estimate from below only lengthens the step so much.
    assert estimate == pytest.approx(exact, rel=2e-2)
    assert estimate <= exact * 1.01
    total = comm.allreduce(float(explicit.mass.sum()), op=MPI.SUM)
    assert total == pytest.approx(dim * RHO * np.prod((1.0, 0.6, 0.5)[:dim]), rel=1e-12)
    x.destroy()
    explicit.assembler.destroy()


def test_a_step_above_the_stable_one_is_refused():
    stable = 2 / OMEGA
    with pytest.raises(InputError) as caught:
        _ = [*Dynamics(oscillator(), scheme=SCHEME, end=1.0, dt=1.05 * stable).steps()]
    assert "above the stable step" in str(caught.value)
    assert f"{stable:.4g} s" in str(caught.value)
    assert caught.value.where == "dynamics.dt"


def test_the_chosen_step_is_the_stable_one_times_safety():
    stable = 2 / OMEGA
    for safety in (0.9, 0.5):
        states = Dynamics(oscillator(), scheme=SCHEME, end=1.0, safety=safety, every=1).steps()
        next(states)
        assert next(states).t == pytest.approx(safety * stable, rel=1e-3)
        states.close()


def test_a_step_that_becomes_too_long_is_noticed():
    """A neo-Hookean body crushed by its support stiffens, and the given step is too long."""
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    law = NeoHookean(E=E, nu=NU, density=RHO)
    left = Support(on="left", displacement=[0, 0])
    still = Problem(body, law, supports=[left, Support(on="right", displacement=[0, 0])], degree=1)
    explicit = Explicit(
        still, fem.Function(still.V), SymplecticEuler, end=1.0, dt=None, safety=1.0, every=1
    )
    dt = 0.95 * explicit.size.step_for(explicit.size.largest_frequency())
    explicit.assembler.destroy()
    # Late enough that the next look at the stable step comes before the instability has grown.
    crush = f"-0.3*smoothstep((t - {180 * dt})/{19 * dt})"
    problem = Problem(
        body, law, supports=[left, Support(on="right", displacement=[crush, 0])], degree=1
    )
    with pytest.raises(StabilityError) as caught:
        _ = [*Dynamics(problem, scheme=SCHEME, end=300 * dt, dt=dt).steps()]
    assert "stable step has fallen to" in str(caught.value)
    assert "leave dt out" in str(caught.value)
    found, state = caught.value.diagnosis, caught.value.state
    assert found is not None
    assert (found.cause, len(found.place)) == ("step", 2)
    assert "m ask for it" in str(caught.value)
    assert np.isfinite(state.v.x.array).all()
    assert np.isfinite(state.energies["total"])


def test_a_chosen_step_follows_a_body_that_stiffens():
    """Crushed to a half over many steps, with the step left to the solver: nothing blows up."""
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    problem = Problem(
        body,
        NeoHookean(E=E, nu=NU, density=RHO),
        supports=[
            Support(on="left", displacement=[0, 0]),
            Support(on="right", displacement=["-0.5*smoothstep(t)", 0]),
        ],
        degree=1,
    )
    times = [0.0]
    for state in Dynamics(problem, scheme=SCHEME, end=1.2).steps():
        times.append(state.t)
        assert state.max_displacement < 0.8
    steps = np.diff(times[1:])
    assert steps[-2] < 0.8 * steps[0]


@pytest.mark.parametrize(("steps", "every"), [(1, 1), (200, 1), (201, 2), (400, 2), (401, 3)])
def test_about_two_hundred_states_are_yielded(steps, every):
    problem, dt = oscillator(), 2.0**-20
    v = fem.Function(problem.V)
    march = Explicit(problem, v, SymplecticEuler, end=steps * dt, dt=dt, safety=0.9)
    try:
        assert march.every == every
    finally:
        march.destroy()


def test_quadratic_elements_are_refused():
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    problem = Problem(body, LinearElastic(E=E, nu=NU, density=RHO), degree=2)
    with pytest.raises(InputError, match="linear elements"):
        _ = [*Dynamics(problem, scheme=SCHEME, end=1.0).steps()]


def test_work_of_loads_becomes_energy():
    """A falling and swinging block: the energy is the work of its weight, to first order."""
    body = rectangle_body(size=(1.0, 1.0), cells=(3, 3))
    problem = Problem(
        body,
        NeoHookean(E=1e5, nu=NU, density=RHO),
        loads=[Gravity()],
        supports=[Support(on="left", displacement=[0, 0])],
        degree=1,
    )
    *_, state = Dynamics(problem, scheme=SCHEME, end=0.2, safety=0.2).steps()
    gained, work = state.energies["total"], state.energies["external"]
    assert gained > 100.0
    assert gained == pytest.approx(work, rel=2e-2)


def test_laws_without_energy_move_too():
    """No strain energy to report, but a step and a motion."""
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    problem = Problem(
        body,
        Textbook(E=E, nu=NU, density=RHO),
        loads=[Gravity()],
        supports=[Support(on="left", displacement=[0, 0])],
        degree=1,
    )
    *_, state = Dynamics(problem, scheme=SCHEME, end=0.01).steps()
    assert np.isnan(state.energies["strain"])
    assert state.max_displacement > 0


def test_work_of_a_moving_support_becomes_energy():
    """Pulled by its support, also where few states are looked at: work is kept every step."""
    body = rectangle_body(size=(1.0, 1.0), cells=(3, 3))
    found = []
    for safety, every in ((0.1, 1), (0.1, 50), (0.025, 50)):
        problem = Problem(
            body,
            NeoHookean(E=1e5, nu=NU, density=RHO),
            supports=[Support(on="left", displacement=["0.1*sin(10*t)", "0.05*t"])],
            degree=1,
        )
        states = Dynamics(problem, scheme=SCHEME, end=0.3, safety=safety, every=every).steps()
        start = next(states).energies["total"]  # its left end moves already
        *_, state = states
        found.append((state.energies["total"] - start, state.energies["external"]))
    assert found[0] == pytest.approx(found[1], rel=1e-12)
    coarse, fine = (abs(gained / work - 1) for gained, work in found[1:])
    assert coarse < 0.03  # energy swings by O(dt) in this scheme
    assert fine < coarse / 3.5  # a fourth of the step
