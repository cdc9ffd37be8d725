"""What explicit motion says of itself: cells inside out, energy from nowhere, values that end."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import (
    Corotated,
    Dynamics,
    Gravity,
    NeoHookean,
    Problem,
    Rotation,
    StVenantKirchhoff,
    Support,
    Thermal,
    Traction,
    box_body,
    rectangle_body,
)
from dolfin_elastic.errors import InputError, StabilityError
from dolfin_elastic.model.law import Law
from dolfin_elastic.solvers.assembler import Assembler
from dolfin_elastic.solvers.lookout import Lookout
from dolfin_elastic.state import State

FREE, EULER, CENTRAL = "free", "symplectic-euler", "central-differences"
BOTH = pytest.mark.parametrize("scheme", [EULER, CENTRAL])
SOFT = {"E": 1e6, "nu": 0.3, "density": 1000.0}


def told(comm: MPI.Comm, caplog: pytest.LogCaptureFixture, words: str) -> list[str]:
    """Lines of the log with these words; those of rank 0 on all."""
    return comm.bcast([line for line in caplog.messages if words in line])


def pressed(law: Law, pressure: float, comm: MPI.Comm) -> Problem:
    body = box_body(size=(1, 1, 1), cells=(2, 2, 2), comm=comm)
    load = Traction(on="top", value=[0, 0, -pressure])
    return Problem(body, law, supports=[Support(on="bottom")], loads=[load])


def run(problem: Problem, **settings: Any) -> list[State]:
    """The states, with the displacement of the last one."""
    return list(Dynamics(problem, **settings).steps())


def test_cells_inside_out_are_told_of_once(
    comm: MPI.Comm, caplog: pytest.LogCaptureFixture
) -> None:
    """A law without a barrier goes on through them."""
    run(pressed(Corotated(**SOFT), 5e5, comm), scheme=CENTRAL, end=0.15)
    (line,) = told(comm, caplog, "inside out")
    assert "det F = -" in line
    assert "such as neo-hookean" in line
    caplog.clear()
    run(pressed(Corotated(**SOFT), 1e5, comm), scheme=CENTRAL, end=0.15)
    assert not told(comm, caplog, "inside out")


def test_what_is_lost_by_them_is_told_with_the_place(comm: MPI.Comm) -> None:
    with pytest.raises(StabilityError, match=r"no finite velocity at .* inside out by t = .* at"):
        run(pressed(StVenantKirchhoff(**SOFT), 1e6, comm), scheme=CENTRAL, end=0.15, every=5)


@BOTH
def test_a_sound_motion_is_not_accused(
    scheme: str, comm: MPI.Comm, caplog: pytest.LogCaptureFixture
) -> None:
    """A load that begins at once: the energy of one time swings about the one that is conserved.

    By some ten per cent in the first steps, when hardly any has come in yet.
    """
    body = box_body(size=(2, 1, 1), cells=(8, 4, 4), comm=comm)
    load = Traction(on="right", value=[10, 0, 0])
    problem = Problem(body, NeoHookean(**SOFT), supports=[Support(on="left")], loads=[load])
    run(problem, scheme=scheme, end=0.05, every=1)
    assert not told(comm, caplog, "nowhere")


def test_warmth_brings_energy_without_work(
    comm: MPI.Comm, caplog: pytest.LogCaptureFixture
) -> None:
    body = rectangle_body(size=(1, 1), cells=(4, 4), comm=comm)
    warm = Thermal(value=100, curve=[[0, 0], [0.05, 1]])
    problem = Problem(
        body,
        NeoHookean(**SOFT, expansion=1e-4),
        supports=[Support(on=["left", "right"])],
        loads=[warm],
    )
    run(problem, scheme=CENTRAL, end=0.1)
    assert not told(comm, caplog, "nowhere")


@BOTH
def test_the_first_acceleration(scheme: str, comm: MPI.Comm) -> None:
    """Of what is free by the forces, of supports by their motion: 0.2 t^2, exact at any step."""
    body = rectangle_body(size=(1, 1), cells=(2, 2), comm=comm)
    push = Support(on="left", displacement=["0.2*t^2", 0])
    problem = Problem(body, NeoHookean(**SOFT), supports=[push], loads=[Gravity(value=[0, -9.81])])
    states = Dynamics(problem, scheme=scheme, end=0.1).steps()
    first = next(states)
    assert first.a is not None
    a = first.a.x.array.reshape(-1, 2)
    left = problem.V.tabulate_dof_coordinates()[:, 0] < 1e-9
    # Euler's velocity is that of half a step before: its first change is half of what follows.
    share = 0.5 if scheme == EULER else 1.0
    assert a[left] == pytest.approx(np.tile([0.4 * share, 0], (left.sum(), 1)), rel=1e-9, abs=1e-9)
    assert a[~left] == pytest.approx(np.tile([0, -9.81], ((~left).sum(), 1)), rel=1e-12, abs=1e-12)
    states.close()


@BOTH
def test_supports_whose_values_end(scheme: str, comm: MPI.Comm) -> None:
    """With the motion: it is computed. Before: the support is named, not the step."""

    def lifted(until: float) -> Problem:
        body = rectangle_body(size=(1, 1), cells=(2, 2), comm=comm)
        lift = Support(on="top", displacement=[0, f"20*({until} - t)^1.5"], name="lift")
        still = Support(on="bottom")
        return Problem(body, NeoHookean(**SOFT), supports=[lift, still])

    motion = {"scheme": scheme, "end": 0.05, "initial_velocity": [0, "-30*sqrt(0.05)*y"]}
    start = {"initial_displacement": [0, "20*0.05^1.5*y"]}
    problem = lifted(0.05)
    (*_, last) = run(problem, **motion, **start)
    assert last.t == 0.05
    assert last.v is not None
    assert np.all(np.isfinite(last.v.x.array))
    with pytest.raises(InputError, match="support 'lift': the prescribed displacement is not"):
        run(lifted(0.02), **motion)


@BOTH
@pytest.mark.parametrize(
    "support",
    [
        Support(on="left", displacement=[0.1, 0], curve="t^1.5"),
        Support(on="left", displacement=[0.1, 0], curve="1 - sqrt(0.05)*sqrt(1 - t/0.05)"),
        Rotation(on="left", point=[0, 0], angle="t^1.5"),
        Rotation(on="left", point=[0, 0], angle="0.1*(0.05 - t)^1.5"),
    ],
    ids=["curve", "curve to the end", "angle", "angle to the end"],
)
def test_formulas_without_a_place(scheme: str, support: Any, comm: MPI.Comm) -> None:
    """They raise where they have no value, and are asked for none before the start or the end."""
    body = rectangle_body(size=(1, 1), cells=(2, 2), comm=comm)
    last = run(Problem(body, NeoHookean(**SOFT), supports=[support]), scheme=scheme, end=0.05)[-1]
    assert last.t == 0.05
    assert last.a is not None
    assert np.all(np.isfinite(last.a.x.array))


@pytest.mark.parametrize("swing", [0.0, 0.3])
def test_energy_that_creeps_in_beside_swings(
    swing: float, comm: MPI.Comm, caplog: pytest.LogCaptureFixture
) -> None:
    """A 25th a state is told of at the third, however much the energy of one time swings."""
    problem = pressed(NeoHookean(**SOFT), 1.0, comm)
    assembler = Assembler(problem)
    lookout = Lookout(problem, assembler)
    doubts = []
    for k in range(4):
        kept = 1.0 + 0.04 * k
        off = swing * (-1) ** k
        energies = {"kinetic": 1.0, "strain": 1.0, "total": kept + off, "external": 0.0}
        doubts.append(lookout.drifts(energies, -off / comm.size, float(k)))
        assert bool(told(comm, caplog, "nowhere")) == (k > 2)
    assert doubts == ([False, True, True, True] if swing else [False, False, False, True])
    assembler.destroy()


def test_loads_whose_values_end(comm: MPI.Comm) -> None:
    problem = pressed(NeoHookean(**SOFT), 0.0, comm)
    push = Traction(on="top", value=[0, 0, "1000*sqrt(0.02 - t)"])
    problem = Problem(problem.body, NeoHookean(**SOFT), supports=problem.supports, loads=[push])
    with pytest.raises(InputError, match="a load has no finite value at t = 0.0"):
        run(problem, scheme=CENTRAL, end=0.05)


def test_every_node_is_held(comm: MPI.Comm) -> None:
    """Then the cells alone say how long a step may be."""
    body = rectangle_body(size=(1, 1), cells=(1, 1), comm=comm)
    supports = [Support(on="left"), Support(on="right", displacement=["0.1*t^2", 0])]
    problem = Problem(body, NeoHookean(**SOFT), supports=supports)
    states = run(problem, scheme=CENTRAL, end=0.1)
    assert len(states) > 4
    assert states[-1].max_displacement == pytest.approx(1e-3, rel=1e-12)


@BOTH
def test_a_section_has_no_momenta(scheme: str, comm: MPI.Comm) -> None:
    """Of a ring those across its axis are zero, and so is what turns about another."""
    body = rectangle_body(size=(1, 1), cells=(2, 2), comm=comm)
    load = Traction(on="right", value=[1e3, 1e3])
    problem = Problem(body, NeoHookean(**SOFT), loads=[load], geometry="axisymmetric")
    last = run(problem, scheme=scheme, end=0.01)[-1]
    assert last.momenta["linear"][0] == 0.0
    # 2 pi of the outer surface, over 10 ms.
    assert last.momenta["linear"][1] == pytest.approx(1e3 * 2 * np.pi * 0.01, rel=0.1)
    assert not np.any(last.momenta["angular"])
