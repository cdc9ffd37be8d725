"""Bodies thrown at rigid obstacles by explicit schemes: rebound, contact time, force, energy.

A bar of length L that hits a wall end on with v0 is stopped by a wave that runs through it at
c = sqrt(E/rho) and back: the force is rho c v0 A for the time 2L/c, and it leaves with v0.
Source: K. L. Johnson, Contact Mechanics, Cambridge 1985, section 11.1; St. Venant (1867).
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import (
    Contact,
    Dynamics,
    Gravity,
    LinearElastic,
    NeoHookean,
    Problem,
    Spring,
    Support,
    Traction,
    box_body,
    rectangle_body,
)
from dolfin_elastic.solvers.dynamics.residual import DynamicResidual
from dolfin_elastic.solvers.dynamics.schemes import SCHEMES, ExplicitRow

E, RHO, L, N = 1e6, 1000.0, 1.0, 40
C = np.sqrt(E / RHO)
HIGH = L / N
MASS, FACE = RHO * L * HIGH, HIGH
BOTH = pytest.mark.parametrize(
    "scheme", [name for name, row in SCHEMES.items() if isinstance(row, ExplicitRow)]
)


def bar(**more: Any) -> Problem:
    """N squares of two triangles; without lateral contraction it is a bar exactly."""
    body = rectangle_body(size=(L, HIGH), cells=(N, 1))
    return Problem(body, LinearElastic(E=E, nu=0.0, density=RHO), **{"degree": 1, **more})


def hit(scheme: str, v0: float, stiffness: float | None = None, **settings: Any) -> np.ndarray:
    """Rows t c/L, momentum, force of the wall, contact energy and energy out of balance, scaled."""
    wall = Contact(on="left", plane={"axis": "x", "at": 0.0}, name="wall", stiffness=stiffness)
    rows = []
    for state in Dynamics(
        bar(contacts=[wall]),
        scheme=scheme,
        end=3 * L / C,
        every=1,
        initial_velocity=[-v0, 0],
        **settings,
    ).steps():
        energies, kinetic = state.energies, MASS * v0**2 / 2
        rows.append(
            [
                state.t * C / L,
                state.momenta["linear"][0] / (MASS * v0),
                state.reactions["wall"][0] / (RHO * C * v0 * FACE),
                energies["contact"] / kinetic,
                (energies["total"] - energies["external"]) / kinetic - 1,
            ]
        )
    return np.array(rows).T


@BOTH
def test_a_bar_bounces_off_a_wall(scheme):
    t, momentum, force, stored, off = hit(scheme, v0=0.01 * C)
    # The front of the wave is some cells wide, N^(1/3) by dispersion: 2 % and 0.6 % found.
    assert t[force > 0.1][-1] == pytest.approx(2.0, rel=0.04)
    assert momentum[-1] == pytest.approx(1.0, abs=0.01)
    assert force[(t > 0.2) & (t < 1.8)].mean() == pytest.approx(1.0, abs=2e-3)
    # The impulse of the wall is the change of momentum, step by step and to round-off: Euler has
    # the force at the start of each step, central differences the trapezoidal rule.
    mean = force[:-1] if scheme == "symplectic-euler" else (force[1:] + force[:-1]) / 2
    impulse = np.concatenate([[0], np.cumsum(np.diff(t) * mean)])
    assert np.abs(momentum + 1 - impulse).max() < 1e-11
    assert stored.max() > 0.01
    assert stored[-1] == force[-1] == 0.0
    # A bar in motion swings little: Euler's energy swings by omega dt of the front's share.
    assert np.abs(off).max() < (0.02 if scheme == "symplectic-euler" else 5e-3)
    assert abs(off[-1]) < 3e-3


@pytest.mark.long
def test_stiff_walls_ask_for_shorter_steps(caplog):
    """With the step of stability alone the energy would grow threefold: a node hits in mid-step."""
    stiff = 10 * E / HIGH
    t, *_, off = hit("central-differences", v0=0.01 * C, stiffness=stiff)
    assert np.abs(off).max() < 0.02
    nodes = 2 * stiff / (RHO * HIGH)  # omega^2 of the two at the wall; their mean mass
    assert 0.5 < np.diff(t)[0] * L / C * np.sqrt(nodes) < 1.3
    with caplog.at_level("WARNING", logger="dolfin_elastic"):
        *_, thrown = hit("central-differences", v0=0.01 * C, stiffness=stiff, dt=2.6e-4)
    said = "a node that hits an obstacle may be thrown back too fast" in caplog.text
    assert any(MPI.COMM_WORLD.allgather(said))
    assert np.abs(thrown).max() > 0.5


@pytest.mark.sample(2)
@BOTH
@pytest.mark.parametrize(
    "shape",
    [
        {"plane": {"point": [0, 0, -0.01], "normal": [0.3, 0, 1]}},
        {"sphere": {"center": [0.4, 0.5, -1.02], "radius": 1.0}},
        {"cylinder": {"axis": "y", "point": [0.5, 0, 1], "radius": 1.2, "inside": True}},
    ],
    ids=lambda shape: next(iter(shape)),
)
def test_a_block_bounces_off_any_obstacle(shape, scheme):
    """Dropped on a slope, a ball and into a bore: energy and impulse balance, and it comes back."""
    body = box_body(size=(1, 1, 1), cells=(2, 2, 2))
    problem = Problem(
        body,
        NeoHookean(E=1e5, nu=0.3, density=RHO),
        loads=[Gravity()],
        contacts=[Contact(on=["bottom", "left", "right"], name="obstacle", **shape)],
        degree=1,
    )
    rows, impulse, before, last = [], np.zeros(3), np.zeros(3), 0.0
    short = 0.05 if scheme == "symplectic-euler" else 0.5
    for state in Dynamics(
        problem, scheme=scheme, end=0.5, every=1, safety=short, initial_velocity=[0, 0, -1.0]
    ).steps():
        force = state.reactions["obstacle"] - [0, 0, RHO * 9.81]
        mean = before if scheme == "symplectic-euler" else (before + force) / 2
        impulse, before, last = impulse + mean * (state.t - last), force, state.t
        momentum = state.momenta["linear"]
        if not rows:
            impulse, start = np.zeros(3), momentum
        assert np.abs(momentum - start - impulse).max() < 1e-11 * RHO
        energies = state.energies
        rows.append([momentum[2], energies["total"] - energies["external"], energies["contact"]])
    up, off, stored = np.array(rows).T
    assert up.max() > 0.3 * RHO  # the rest rings, turns or slides off sideways
    assert stored.max() > 1.0
    # Nodes hit and leave within steps, and there are 27 of them: 2.9 % found.  Euler's place and
    # velocity are half a step apart, which counts as energy: 4 % with a tenth of the step.
    assert np.ptp(off) < (0.06 if scheme == "symplectic-euler" else 0.04) * off[0]


@pytest.mark.long
@pytest.mark.parametrize("scheme", ["generalized-alpha", "newmark", "alpha2"])
def test_obstacles_do_work_only_where_they_move(scheme):
    """Dropped on a floor, gravity alone does work; beaten from below, the floor does, too."""
    for rise in (0.0, 0.05):
        floor = {"axis": "z", "at": -0.02}
        motion = {"motion": [0, 0, f"{rise}*sin(pi*t/0.1)"]} if rise else {}
        problem = Problem(
            box_body(size=(1, 1, 1), cells=(1, 1, 1)),
            NeoHookean(E=1e5, nu=0.3, density=RHO),
            loads=[Gravity()],
            contacts=[Contact(on="bottom", name="floor", plane=floor, stiffness=1e7, **motion)],
            degree=1,
        )
        radius = {"spectral_radius": 1.0} if scheme != "newmark" else {}
        rows = [
            (s.t, s.momenta["linear"][2], s.reactions["floor"][2], s.energies)
            for s in Dynamics(problem, scheme=scheme, end=0.13, dt=1e-3, **radius).steps()
        ]
        t, momentum, force, energies = zip(*rows, strict=True)
        work = np.array([e["external"] + e["potential"] for e in energies])
        stored = max(e["contact"] for e in energies)
        assert stored > 0.1
        gained = np.array([e["total"] + e["potential"] for e in energies])
        if not rise:
            assert np.abs(work).max() < 1e-9
            assert np.abs(gained - gained[0]).max() < 0.02 * stored
            continue
        # The force on the floor over the floor's own way.
        place, mean = rise * np.sin(np.pi * np.array(t) / 0.1), np.array(force)
        exact = np.sum((mean[1:] + mean[:-1]) / 2 * np.diff(place))
        assert work[-1] == pytest.approx(exact, abs=0.02 * np.ptp(work))
        assert np.abs(gained - gained[0] - work).max() < 0.02 * np.ptp(work)
        assert max(momentum) > 100.0


def test_obstacles_are_assembled_once(monkeypatch):
    """For their own sake and as a part of all that holds, also beside a spring of one name."""
    problem = Problem(
        rectangle_body(size=(1, 1), cells=(2, 2)),
        NeoHookean(E=1e5, nu=0.3, density=RHO),
        supports=[
            Spring(on="left", stiffness=[1e3, 1e3], name="wall"),
            Spring(on="right", stiffness=[5e2, 0]),
        ],
        contacts=[
            Contact(on="bottom", name="floor", plane={"axis": "y", "at": 0.1}, stiffness=1e4),
            Contact(on="left", name="wall", plane={"axis": "x", "at": 0.2}, stiffness=1e4),
        ],
        degree=1,
    )
    problem.u.x.array[:] = np.random.default_rng(1).uniform(0.0, 0.01, problem.u.x.array.size)
    problem.u.x.scatter_forward()
    moving, asked = DynamicResidual(problem), []
    nodal = moving.assembler.reactions.nodal
    monkeypatch.setattr(
        moving.assembler.reactions, "nodal", lambda form: [asked.append(form), nodal(form)][1]
    )
    forces = moving.forces()
    assert len(asked) == 4  # both obstacles, the wall with its spring, the other spring
    assert np.allclose(
        forces.restraints, moving.assembler.reactions.restraints(), rtol=1e-14, atol=1e-12
    )
    largest = problem.body.comm.allreduce(np.abs(forces.restraints).max(initial=0.0), op=MPI.MAX)
    assert largest > 10.0
    moving.destroy()


@pytest.mark.parametrize(("scheme", "looks"), [("generalized-alpha", True), ("newmark", False)])
def test_where_an_obstacle_may_be_met_unseen(scheme, looks):
    """Not where the stage, whose forces count, is the end of the step."""
    floor = Contact(on="bottom", plane={"axis": "y", "at": -0.01})
    problem = Problem(
        rectangle_body(size=(1, 1), cells=(1, 1)),
        NeoHookean(E=1e5, nu=0.3, density=RHO),
        contacts=[floor],
        degree=1,
    )
    motion = Dynamics(problem, scheme=scheme, end=0.1, dt=0.01, adaptive=True)
    states = motion.steps()
    next(states)
    assert (motion._motion.scheme.impact_error is not None) is looks
    states.close()


@BOTH
def test_a_wave_arrives_on_time(scheme):
    """Pushed at one end, the other stays where it is until L/c, and then moves at twice v0."""
    pushed = bar(
        loads=[Traction(on="left", value=[1e-3 * E, 0])],
        supports=[Support(on="bottom", displacement=["free", 0])],
    )
    x = pushed.V.tabulate_dof_coordinates()
    own = pushed.V.dofmap.index_map.size_local
    end = np.flatnonzero(np.abs(x[:own, 0] - L) < 1e-9)
    v0, t, v = 1e-3 * C, [], []
    for state in Dynamics(pushed, scheme=scheme, end=1.6 * L / C, every=1).steps():
        mine = state.v.x.array.reshape(-1, 2)[end, 0]
        count, speed = pushed.body.comm.allreduce(np.array([len(mine), mine.sum()]))
        t.append(state.t * C / L)
        v.append(speed / count / v0)
    t, v = np.array(t), np.array(v)
    # The front is N^(1/3) cells wide, and its middle lags by a part of that: 1.025 found.
    assert np.abs(v[t < 0.9]).max() < 0.05
    assert t[v > 1.0][0] == pytest.approx(1.0, abs=0.04)
    assert v[(t > 1.1)].mean() == pytest.approx(2.0, abs=0.04)


@pytest.mark.long
def test_a_cube_that_bounces_keeps_its_energy(comm: MPI.Comm, caplog) -> None:
    """Shaken by each hit it rings at all frequencies of its mesh, without damping.

    With nine tenths of the stable step the lightest corner was thrown off at 0.56 s.  The energy's
    error is that of hits within a step: 0.7 % found.
    """
    given = {"scheme": "central-differences", "end": 0.9}

    def cube() -> Problem:
        floor = Contact(on="bottom", plane={"axis": "z", "at": 0})
        body = box_body(size=(0.1, 0.1, 0.1), cells=(8, 8, 8), origin=(0, 0, 0.05), comm=comm)
        law = NeoHookean(E=1e5, nu=0.3, density=1000)
        return Problem(body, law, loads=[Gravity()], contacts=[floor], degree=1)

    with caplog.at_level("INFO", logger="dolfin_elastic"):
        states = Dynamics(cube(), **given).steps()
        total, external = np.array(
            [(s.energies["total"], s.energies["external"]) for s in states]
        ).T
    assert np.max(np.abs(total - total[0] - external)) < 0.02 * np.max(external)
    assert np.max(external) > 0.4
    stable = 0.0
    if comm.rank == 0:
        assert "from nowhere" not in caplog.text
        found = re.search(
            r"stable step (\S+) s, used .* s, about \d+ in all \(safety 0.6; obstacles may be hit",
            caplog.text,
        )
        assert found
        stable = float(found[1])
    stable = comm.bcast(stable)
    caplog.clear()
    next(Dynamics(cube(), **given, dt=0.7 * stable).steps())
    if comm.rank == 0:
        assert "may gain energy at each step" in caplog.text
