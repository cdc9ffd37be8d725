"""The energy-momentum scheme: what spectral_radius = 1 conserves, and with what around the body.

The motions are those of a free block at 60 rad/s, 0.12 rad a step, whose strains are 4 %: the
midpoint rule with the stress of the mean displacement has 5 % more energy after 6 steps there, and
finds no seventh.
"""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import (
    Dynamics,
    Gravity,
    NeoHookean,
    Pressure,
    Problem,
    StVenantKirchhoff,
    Support,
    Textbook,
    Traction,
    box_body,
)
from dolfin_elastic.core.errors import ConvergenceError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.mesh.selection import name_parts
from dolfin_elastic.mesh.selectors import Selector
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.user import FormulaEnergy
from dolfin_elastic.problem.state import State, StateCopy
from dolfin_elastic.solvers.linear.choice import LinearSettings

RUBBER = {"E": 1e6, "nu": 0.3, "density": 1000.0}
SPIN = ["-60*y", "60*x", "20*x"]
SVK, NH = StVenantKirchhoff(**RUBBER), NeoHookean(**RUBBER)
WRITTEN = FormulaEnergy(
    energy="mu/2*(I1 - 3 - 2*ln(J)) + lmbda/2*ln(J)^2",
    parameters={"mu": 4e5, "lmbda": 6e5},
    density=1000.0,
)


ROUND_OFF = 40 * 1.1e-16 * (1e6 / 2.6 * 1.2e-5) / 0.00792
"""Of an energy of invariants after 40 steps, if all are rounded alike: half a last digit of shear
modulus times volume each, over the kinetic energy at the start [J]."""


def block(comm: MPI.Comm, law: Law, **keys: Any) -> Problem:
    body = box_body(
        size=(0.06, 0.02, 0.01), cells=(4, 2, 1), origin=(-0.03, -0.01, -0.005), comm=comm
    )
    return Problem(body, law, **{"degree": 1, **keys})


def motion(problem: Problem, steps: int, **settings: Any) -> list[State]:
    """The states; their fields are those of the last one."""
    keys = {"dt": 2e-3, "end": steps * 2e-3, "initial_velocity": SPIN, "spectral_radius": 1.0}
    return list(Dynamics(problem, **{**keys, **settings}).steps())


def drifts(states: list[State]) -> tuple[float, float, float]:
    """Relative changes of the energy, and of angular and linear momentum over m v."""
    total = np.array([state.energies["total"] for state in states])
    turn, push = (
        np.array([state.momenta[name] for state in states]) for name in ("angular", "linear")
    )
    moving = np.sqrt(2 * states[0].energies["kinetic"] * 1000 * 1.2e-5)
    return (
        float(np.abs(total / total[0] - 1).max()),
        float(np.linalg.norm(turn - turn[0], axis=1).max() / np.linalg.norm(turn[0])),
        float(np.linalg.norm(push - push[0], axis=1).max() / moving),
    )


# --- a free body ---


@pytest.mark.long
@pytest.mark.parametrize(
    ("law", "keys", "limit"),
    [
        (SVK, {"degree": 2}, 1e-14),
        (NH, {}, ROUND_OFF),
        (WRITTEN, {}, ROUND_OFF),
        (NeoHookean(E=1e6, nu=0.5, density=1000.0), {"degree": 2}, 1e-12),
        pytest.param(
            NeoHookean(E=1e6, nu=0.499, density=1000.0),
            {"degree": 2},
            1e-12,
            marks=pytest.mark.long,
        ),
    ],
    ids=["st-venant-kirchhoff", "neo-hookean", "of a user", "incompressible", "nearly"],
)
def test_free_flight(comm: MPI.Comm, law: Law, keys: dict[str, Any], limit: float) -> None:
    """Energy, angular and linear momentum in 40 steps, 0.77 of a turn.

    What Newton's method leaves at round-off, 1e-16 of the forces, adds up over steps.  A quadratic
    energy has 1e-16 of itself; one of invariants has 1e-16 of its modulus each step, see
    `ROUND_OFF`: 4e-13 to 1.0e-12 were found on one to three ranks.
    """
    states = motion(block(comm, law, **keys), 40)
    energy, turn, push = drifts(states)
    assert energy < limit
    assert turn < 1e-12
    assert push < 1e-12
    assert all(state.audit is not None and state.audit.verdict == "pass" for state in states)


@pytest.mark.long
@pytest.mark.parametrize(
    ("law", "steps", "limit"),
    [(SVK, 2_000, 2e-11), (NH, 10_000, 1e-10)],
    ids=["st-venant-kirchhoff", "neo-hookean"],
)
def test_ten_thousand_steps(comm: MPI.Comm, law: Law, steps: int, limit: float) -> None:
    """191 turns, and no more than 1e-14 a step of energy or momenta; 2e-12 was found in all.

    What is gained or lost at each step adds up: a fifth of the steps shows it by a fifth as much.
    """
    steps = steps if comm.size == 1 else 500
    assert max(drifts(motion(block(comm, law), steps, every=steps // 20))) < limit


@pytest.mark.long
def test_turn_of_half_a_radian_a_step(comm: MPI.Comm) -> None:
    """Steps may be long; they are not accurate then, but nothing comes from nowhere."""
    states = motion(block(comm, SVK), 40, dt=8e-3, end=0.32)
    assert max(drifts(states)) < 1e-12


@pytest.mark.long
def test_second_order(comm: MPI.Comm) -> None:
    """Against a motion of quarter steps, once waves through the thickness are resolved."""
    ends = [
        motion(block(comm, NH), 1, end=2e-3, dt=2e-3 / n, every=n)[-1].u.x.array.copy()
        for n in (20, 40, 80, 320)
    ]
    errors = [np.sqrt(comm.allreduce(float(np.sum((end - ends[-1]) ** 2)))) for end in ends[:-1]]
    slope = np.polyfit(np.log([20, 40, 80]), np.log(errors), 1)[0]
    assert slope == pytest.approx(-2, abs=0.15)  # 1/16 of the error is that of the reference


def test_scheme_by_its_name(comm: MPI.Comm) -> None:
    """The row of its own is the same scheme."""
    problem = block(comm, NH)
    settings = {"dt": 2e-3, "end": 0.01, "initial_velocity": SPIN}
    *_, named = Dynamics(problem, scheme="energy-momentum", **settings).steps()
    found = dict(named.energies)
    # the same to round-off: on several ranks MUMPS adds in the order in which messages arrive
    size = 1e-12 * found["total"]
    assert motion(block(comm, NH), 5)[-1].energies == pytest.approx(found, rel=1e-12, abs=size)


# --- solvers and steps ---


@pytest.mark.parametrize(
    ("law", "degree"),
    [(SVK, 2), (NeoHookean(E=1e6, nu=0.5, density=1000.0), 2)],
    ids=["displacement", "mixed"],
)
def test_iterative_solver(comm: MPI.Comm, law: Law, degree: int) -> None:
    """GMRES with multigrid leaves as little as factors do."""
    problem = block(comm, law, degree=degree)
    states = motion(problem, 10, linear=LinearSettings(method="iterative"))
    assert max(drifts(states)) < 1e-12
    assert states[-1].krylov > 0


def test_adaptive_steps_that_meet_times(comm: MPI.Comm) -> None:
    """Whatever the length of the steps, and where they end."""
    keys = {"adaptive": True, "tolerance": 1e-3, "times": [0.0123], "every": "0.01 s"}
    states = motion(block(comm, NH), 20, **keys)
    assert [state.t for state in states] == pytest.approx([0, 0.01, 0.0123, 0.02, 0.03, 0.04])
    assert max(drifts(states)) < 1e-12


def test_goes_on_exactly(comm: MPI.Comm) -> None:
    """From a checkpoint as if it had never been stopped."""
    settings = {"dt": 2e-3, "end": 0.02, "initial_velocity": SPIN, "spectral_radius": 1.0}
    whole, saved = [], None
    solver = Dynamics(block(comm, NH), **settings)
    for state in solver.steps():
        whole.append([*state.energies.values(), *state.momenta["angular"]])
        if state.step == 4:
            saved = StateCopy(solver.restart_state())
    again = [
        [*state.energies.values(), *state.momenta["angular"]]
        for state in Dynamics(block(comm, NH), **settings).steps(saved)
    ]
    assert np.array_equal(again, whole[5:])


# --- what acts on the body ---


def test_work_of_dead_loads_is_exact(comm: MPI.Comm) -> None:
    """A load that is constant does the work that the energy grows by; held, thrown and pulled."""
    loads = [Gravity(value=[0, 0, -9.81]), Traction(on="right", value=[0, 2e3, 1e3])]
    held = Support(on="left", displacement=[0, 0, 0])
    states = motion(block(comm, NH, loads=loads, supports=[held]), 40, initial_velocity=[])
    energies = states[-1].energies
    sizes = max(state.energies["total"] for state in states)
    assert energies["external"] == pytest.approx(-energies["potential"], rel=1e-12)
    assert max(abs(state.energies["balance"]) for state in states) < 1e-12 * sizes


SHAKEN = {
    "smooth": {"displacement": ["0.01*sin(100*t)", 0, 0]},
    "kinked": {"displacement": [0.01, 0, 0], "curve": [[0, 0], [0.0231, 1], [0.05, 0.2], [1, 0]]},
}


@pytest.mark.parametrize("how", SHAKEN)
@pytest.mark.parametrize("law", ["neo-hookean", "incompressible"])
@pytest.mark.sample(2)
def test_a_support_that_moves(comm: MPI.Comm, how: str, law: str) -> None:
    """What it does is the work of its reactions in the middle of steps, and so is what is kept."""
    made, degree, steps = NH, 1, 40
    if law == "incompressible":
        made, degree, steps = NeoHookean(E=1e6, nu=0.5, density=1000.0), 2, 20
    problem = block(comm, made, degree=degree, supports=[Support(on="left", **SHAKEN[how])])
    states = motion(problem, steps, initial_velocity=[])
    sizes = max(state.energies["total"] for state in states)
    assert sizes > 1e-4
    assert max(abs(state.energies["balance"]) for state in states) < 1e-9 * sizes


@pytest.mark.long
def test_damping_takes_what_it_dissipates(comm: MPI.Comm) -> None:
    """The balance holds with what damping has taken."""
    viscous = NeoHookean(E=1e6, nu=0.3, density=1000.0, viscosity=20.0)
    states = motion(block(comm, viscous), 40, rayleigh=[2.0, 0.0])
    energies = states[-1].energies
    assert energies["damping"] > 0.1 * states[0].energies["total"]
    assert abs(energies["balance"]) < 1e-11 * states[0].energies["total"]


def test_pressure_that_follows_does_the_work_of_the_middle(comm: MPI.Comm) -> None:
    """Its work over a step is that of its force at the mean place: the balance is exact with it."""
    load = Pressure(on=["left", "right", "top", "bottom", "front", "back"], value=2e4)
    states = motion(block(comm, NH, loads=[load]), 20)
    total = states[0].energies["total"]
    assert abs(states[-1].energies["external"]) > 1e-3 * total
    assert max(abs(state.energies["balance"]) for state in states) < 1e-11 * total


# --- what it does not conserve ---


def test_what_is_not_conserved_is_told(comm: MPI.Comm, caplog: pytest.LogCaptureFixture) -> None:
    """A law without energy keeps the stress of the middle, and is named beside one that has one."""
    caplog.set_level(logging.INFO)
    body = box_body(size=(0.06, 0.02, 0.01), cells=(4, 2, 1), comm=comm)
    halves = {"left half": Selector(box=((0, 0, 0), (0.03, 1, 1)))}
    halves["right half"] = Selector(box=((0.03, 0, 0), (1, 1, 1)))
    laws = {"left half": NH, "right half": Textbook(**RUBBER)}
    motion(Problem(name_parts(body, regions=halves), laws, degree=1), 1)
    assert on_root(comm, lambda: "the stress of 'right half' is that of the middle" in caplog.text)
    caplog.clear()
    motion(block(comm, Textbook(**RUBBER)), 1)
    assert on_root(comm, lambda: "energy-momentum" not in caplog.text)


@pytest.mark.long
def test_a_scheme_that_makes_energy_is_named(comm: MPI.Comm) -> None:
    """The trapezoidal rule feeds the block until nothing is in balance; the law is not to blame."""
    problem = block(comm, SVK)
    settings = {"dt": 4e-3, "end": 4.0, "every": 100, "initial_velocity": SPIN}
    with pytest.raises(
        ConvergenceError, match="nowhere before: the scheme .newmark. make"
    ) as caught:
        list(Dynamics(problem, scheme="newmark", **settings).steps())
    assert caught.value.diagnosis.cause == "energy"
    assert "energy-momentum" in caught.value.advice
    assert "law" not in str(caught.value)
