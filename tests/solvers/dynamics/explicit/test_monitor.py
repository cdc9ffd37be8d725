"""What explicit motion says of itself: cells inside out, energy from nowhere, values that end."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic import (
    Corotated,
    Dynamics,
    Gent,
    Gravity,
    LinearElastic,
    NeoHookean,
    Problem,
    Rotation,
    StVenantKirchhoff,
    Support,
    Thermal,
    Traction,
    box_body,
    read_case,
    rectangle_body,
)
from dolfin_elastic import run as run_case
from dolfin_elastic.core.errors import Diagnosis, InputError, StabilityError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.problem.state import State
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.dynamics.explicit import monitor as lookout
from dolfin_elastic.solvers.dynamics.explicit.explicit import Explicit
from dolfin_elastic.solvers.dynamics.explicit.monitor import StabilityMonitor
from dolfin_elastic.solvers.dynamics.schemes import SCHEMES, ExplicitRow

FREE, EULER, CENTRAL = "free", "symplectic-euler", "central-differences"
BOTH = pytest.mark.parametrize("scheme", [EULER, CENTRAL])
SOFT = {"E": 1e6, "nu": 0.3, "density": 1000.0}


def told(comm: MPI.Comm, caplog: pytest.LogCaptureFixture, words: str) -> list[str]:
    """Lines of the log with these words; those of rank 0 on all."""
    return comm.bcast([line for line in caplog.messages if words in line])


def pressed(law: Law, pressure: float, comm: MPI.Comm) -> Problem:
    body = box_body(size=(1, 1, 1), cells=(2, 2, 2), comm=comm)
    load = Traction(on="top", value=[0, 0, -pressure])
    return Problem(body, law, supports=[Support(on="bottom")], loads=[load], degree=1)


def run(problem: Problem, **settings: Any) -> list[State]:
    """The states, with the displacement of the last one."""
    return list(Dynamics(problem, **settings).steps())


@pytest.mark.long
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
    told = r"no finite motion after .* inside out by t = .* at.* a function of C alone"
    with pytest.raises(StabilityError, match=told) as caught:
        run(pressed(StVenantKirchhoff(**SOFT), 1e6, comm), scheme=CENTRAL, end=0.15, every=5)
    assert "law = 'fixed-corotated', which goes on with inverted elements" in caught.value.advice


def test_a_law_that_does_not_see_inversion_fails(
    comm: MPI.Comm, caplog: pytest.LogCaptureFixture
) -> None:
    """What implicit motion refuses is no result here, either: a block that begins mirrored.

    St. Venant-Kirchhoff's law has it at rest, so its energy says nothing.
    """
    problem = pressed(StVenantKirchhoff(**SOFT), 0.0, comm)
    explicit = SCHEMES[CENTRAL]
    assert isinstance(explicit, ExplicitRow)
    v = fem.Function(problem.V)
    problem.u.interpolate(lambda x: np.array([0 * x[0], 0 * x[1], -2 * x[2]]))
    motion = Explicit(problem, v, explicit.scheme, end=0.01, dt=None, safety=0.9)
    *_, last = motion.run()
    motion.destroy()
    assert last.energies["total"] == pytest.approx(0.0, abs=1e-9)
    assert "inside out by t = 0 s, det F = -1 at" in last.failure
    assert "a function of C alone" in last.failure
    assert "law = 'fixed-corotated', which goes on" in last.failure
    (line,) = told(comm, caplog, "inside out")
    assert line.startswith("audit: ")


# --- what is said of a motion that is lost ---


def struck(comm: MPI.Comm) -> Problem:
    """Pressed so hard at once that the step is too long for it."""
    body = box_body(size=(1, 1, 1), cells=(2, 2, 2), comm=comm)
    load = Traction(on="top", value=[9e4, 6e4, -3e5])
    return Problem(
        body, NeoHookean(**SOFT), supports=[Support(on="bottom")], loads=[load], degree=1
    )


def lost(problem: Problem, **settings: Any) -> tuple[StabilityError, Diagnosis, State]:
    """The error of a motion, the same on all ranks; all that it yields before is finite."""
    with pytest.raises(StabilityError) as caught:
        for state in Dynamics(problem, **settings).steps():
            assert np.isfinite(list(state.energies.values())).all()
            assert np.isfinite(np.concatenate([*state.reactions.values()])).all()
    error, comm = caught.value, problem.body.comm
    found, last = error.diagnosis, error.state
    assert found is not None
    assert isinstance(last, State)
    assert last.v is not None
    assert last.a is not None
    for field in (last.u, last.v, last.a):
        assert comm.allreduce(bool(np.isfinite(field.x.array).all()), op=MPI.LAND)
    assert np.isfinite(list(last.energies.values())).all()
    assert comm.allgather((str(error), found)) == [(str(error), found)] * comm.size
    assert found.text in str(error)
    assert f"\n  try: {found.advice}" in str(error)
    return error, found, last


@BOTH
def test_the_step_that_turns_cells_is_found(
    scheme: str, comm: MPI.Comm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However many steps there are from one state to the next; the logarithm ends there at once."""
    monkeypatch.setattr(lookout, "DRIFT", np.inf)  # else states with doubts shorten the steps
    found = [lost(struck(comm), scheme=scheme, end=0.2, every=every) for every in (1, 4, 1000)]
    error, diagnosis, last = found[0]
    for other, other_diagnosis, other_last in found[1:]:
        assert str(other) == str(error)
        assert other_diagnosis.place == pytest.approx(diagnosis.place)
        assert (other_last.step, other_last.t) == pytest.approx((last.step, last.t))
        assert other_last.energies == pytest.approx(dict(last.energies))
    assert diagnosis.cause == "inverted"
    said = r"turned inside out in the step to t = .* \(det F = -.*, at \(.*\) m\)"
    assert re.search(said, diagnosis.text)
    assert "a smaller dt or safety" in diagnosis.advice
    assert f"after t = {last.t:.6g} s" in str(error)
    assert len(diagnosis.place) == 3
    assert diagnosis.cells[0].jacobian < 0.0
    assert last.step == 6


@BOTH
def test_a_law_that_lets_cells_turn(scheme: str, comm: MPI.Comm) -> None:
    """Its forces end later, when all has flown apart; what can be looked at is how it began."""
    problem = pressed(StVenantKirchhoff(**SOFT), 1e6, comm)
    error, found, last = lost(problem, scheme=scheme, end=0.15, every=200)
    assert found.cause == "inverted"
    assert "such as neo-hookean" in found.advice
    assert f"in the step to t = {last.t:.6g} s" in str(error)
    assert last.max_displacement < 2.0


@pytest.mark.long
def test_a_formula_without_a_value(comm: MPI.Comm) -> None:
    """No cell has turned, but the material is stretched beyond its limit."""
    body = box_body(size=(1, 1, 1), cells=(2, 2, 2), comm=comm)
    pull = Traction(on="top", value=[0, 0, 3e5])
    law = Gent(mu=1e5, limit=0.5, nu=0.4, density=1000.0)
    problem = Problem(body, law, supports=[Support(on="bottom")], loads=[pull], degree=1)
    error, found, _ = lost(problem, scheme=CENTRAL, end=0.3, every=9)
    assert found.cause == "nan"
    assert "the formula of its energy takes the ln of a negative number" in str(error)
    assert "cannot be strained further" in found.advice


@BOTH
def test_a_motion_without_bounds(scheme: str, comm: MPI.Comm) -> None:
    """What is linear has no cells inside out; a support runs away until energies overflow."""
    body = rectangle_body(size=(1, 1), cells=(2, 2), comm=comm)
    away = Support(on="right", displacement=["1e-9*(exp(4000*t) - 1)", 0])
    problem = Problem(body, LinearElastic(**SOFT), supports=[Support(on="left"), away], degree=1)
    _, found, last = lost(problem, scheme=scheme, end=0.2, every=1000)
    assert found.cause == "unbounded"
    assert "grown beyond all bounds in the step to t = " in found.text
    assert found.place[0] > 0.4
    assert last.max_displacement < 1e7


CASE = """
[mesh]
box = {size = [1, 1, 1], cells = [2, 2, 2]}
[materials.rubber]
law = "neo-hookean"
E = "1 MPa"
nu = 0.3
density = 1000
[[support]]
on = "bottom"
[[load]]
kind = "traction"
on = "top"
value = ["90 kPa", "60 kPa", "-300 kPa"]
[dynamics]
scheme = "symplectic-euler"
end = 0.2
every = 4
"""


def test_results_of_a_motion_that_is_lost(folder: Path, comm: MPI.Comm) -> None:
    """The diagnosis, the last state, and a history that ends before it."""
    path = folder / "case.toml"
    on_root(comm, lambda: path.write_text(CASE) and None)
    with pytest.raises(StabilityError) as caught:
        _ = [*run_case(read_case(path), output=folder / "out")]
    found = caught.value.diagnosis
    assert found is not None
    assert any("failed_state.xdmf" in note for note in caught.value.__notes__)
    told = on_root(comm, lambda: json.loads((folder / "out/summary.json").read_text()))
    assert told["status"] == "failed"
    for name in ("cause", "text", "advice"):
        assert told["diagnosis"][name] == getattr(found, name)
    assert told["diagnosis"]["place"] == pytest.approx(list(found.place))
    assert told["diagnosis"]["cells"][0]["material"] == "rubber"
    text = on_root(comm, (folder / "out/failed_state.xdmf").read_text)
    for name in ("displacement", "jacobian", "energy_density", "von_mises"):
        assert f'Name="{name}"' in text
    history = on_root(comm, (folder / "out/history.csv").read_text)
    assert len(history.splitlines()) > 2
    assert "nan" not in history
    assert "inf" not in history
    assert not [key for key, energy in told["energies"].items() if energy is None]


@BOTH
def test_a_sound_motion_is_not_accused(
    scheme: str, comm: MPI.Comm, caplog: pytest.LogCaptureFixture
) -> None:
    """A load that begins at once: the energy of one time swings about the one that is conserved.

    By some ten per cent in the first steps, when hardly any has come in yet.
    """
    body = box_body(size=(2, 1, 1), cells=(8, 4, 4), comm=comm)
    load = Traction(on="right", value=[10, 0, 0])
    problem = Problem(
        body, NeoHookean(**SOFT), supports=[Support(on="left")], loads=[load], degree=1
    )
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
        degree=1,
    )
    run(problem, scheme=CENTRAL, end=0.1)
    assert not told(comm, caplog, "nowhere")


@BOTH
def test_the_first_acceleration(scheme: str, comm: MPI.Comm) -> None:
    """Of what is free by the forces, of supports by their motion: 0.2 t^2, exact at any step."""
    body = rectangle_body(size=(1, 1), cells=(2, 2), comm=comm)
    push = Support(on="left", displacement=["0.2*t^2", 0])
    problem = Problem(
        body, NeoHookean(**SOFT), supports=[push], loads=[Gravity(value=[0, -9.81])], degree=1
    )
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
        return Problem(body, NeoHookean(**SOFT), supports=[lift, still], degree=1)

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
    last = run(
        Problem(body, NeoHookean(**SOFT), supports=[support], degree=1), scheme=scheme, end=0.05
    )[-1]
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
    looking = StabilityMonitor(problem, assembler)
    doubts = []
    for k in range(4):
        kept = 1.0 + 0.04 * k
        off = swing * (-1) ** k
        energies = {"kinetic": 1.0, "strain": 1.0, "total": kept + off, "external": 0.0}
        doubts.append(looking.drifts(energies, -off / comm.size, float(k)))
        assert bool(told(comm, caplog, "nowhere")) == (k > 2)
    assert doubts == ([False, True, True, True] if swing else [False, False, False, True])
    assembler.destroy()


def test_energy_that_makes_an_explicit_motion_fail(comm: MPI.Comm) -> None:
    """A fifth of the largest energy, and told is the worst: 2/2 at t = 2 s, not 1.5/3 after it."""
    problem = pressed(NeoHookean(**SOFT), 1.0, comm)
    assembler = Assembler(problem)
    looking, again = (StabilityMonitor(problem, assembler) for _ in range(2))
    for t, (kept, most) in enumerate([(1.0, 2.0), (1.3, 2.0), (1.5, 2.0), (3.0, 2.0), (2.5, 3.0)]):
        assert bool(looking.failure) == (t > 2)  # 15 % before
        energies = {"kinetic": most, "strain": 1.0, "total": kept, "external": 0.0}
        looking.drifts(energies, 0.0, float(t))
        again.restore(looking.restart_state())
        assert again.failure == looking.failure
    assert looking.failure == (
        "100 % of the energy has come from nowhere: a smaller dt or safety "
        "(worst at t = 3 s, since t = 2 s)"
    )
    assembler.destroy()


def test_loads_whose_values_end(comm: MPI.Comm) -> None:
    problem = pressed(NeoHookean(**SOFT), 0.0, comm)
    push = Traction(on="top", value=[0, 0, "1000*sqrt(0.02 - t)"])
    problem = Problem(
        problem.body, NeoHookean(**SOFT), supports=problem.supports, loads=[push], degree=1
    )
    with pytest.raises(InputError, match=r"load\[0\]\.value\[2\]: '1000.*' has no .* at t = 0\.0"):
        run(problem, scheme=CENTRAL, end=0.05)


def test_every_node_is_held(comm: MPI.Comm) -> None:
    """Then the cells alone say how long a step may be."""
    body = rectangle_body(size=(1, 1), cells=(1, 1), comm=comm)
    supports = [Support(on="left"), Support(on="right", displacement=["0.1*t^2", 0])]
    problem = Problem(body, NeoHookean(**SOFT), supports=supports, degree=1)
    states = run(problem, scheme=CENTRAL, end=0.1)
    assert len(states) > 4
    assert states[-1].max_displacement == pytest.approx(1e-3, rel=1e-12)


@BOTH
def test_a_section_has_no_momenta(scheme: str, comm: MPI.Comm) -> None:
    """Of a ring those across its axis are zero, and so is what turns about another."""
    body = rectangle_body(size=(1, 1), cells=(2, 2), comm=comm)
    load = Traction(on="right", value=[1e3, 1e3])
    problem = Problem(body, NeoHookean(**SOFT), loads=[load], geometry="axisymmetric", degree=1)
    last = run(problem, scheme=scheme, end=0.01)[-1]
    assert last.momenta["linear"][0] == 0.0
    # 2 pi of the outer surface, over 10 ms.
    assert last.momenta["linear"][1] == pytest.approx(1e3 * 2 * np.pi * 0.01, rel=0.1)
    assert not np.any(last.momenta["angular"])
