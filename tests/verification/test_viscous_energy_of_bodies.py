"""What materials of linear laws that relax store and lose in bodies, against closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dolfin_elastic import (
    Dynamics,
    LinearElastic,
    NeoHookeanSplit,
    Problem,
    Statics,
    Support,
    box_body,
    rectangle_body,
)
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.state import State

MU, RATIOS, TIMES = 3.0, np.array([0.6, 0.4]), np.array([0.5, 0.05])
SERIES = [{"ratio": r, "time": t} for r, t in zip(RATIOS, TIMES, strict=True)]
SIDES = ["left", "right", "front", "back", "bottom", "top"]
FREE = "free"


def law(**keys: Any) -> LinearElastic:
    return LinearElastic(**{"mu": MU, "nu": 0.3, "viscous": SERIES, **keys})


def column(states: list[State], name: str) -> FloatArray:
    return np.array([state.energies[name] for state in states])


def judged(states: list[State]) -> list[State]:
    for state in states:
        assert state.audit is None or state.audit.verdict_so_far == "pass", state.audit.so_far
    return states


@pytest.mark.parametrize("degree", [1, 2])
def test_a_ramp_and_a_hold(degree: int) -> None:
    """A shear that grows to 0.01 in 0.4 s and stays, in steps of four shorter times.

    The spring of a branch is strained by s tau/0.4 (1 - exp(-t/tau)), and by that at 0.4 s times
    exp(-(t - 0.4)/tau) from there on; a dashpot takes mu w times its square over tau.
    """
    curve = [[0, 0], [0.4, 1], [2, 1]]
    moved = Support(on=SIDES, displacement=["0.01*z", 0, 0], curve=curve)
    body = box_body(size=(1, 1, 1), cells=(2, 2, 2))
    problem = Problem(body, law(), supports=[moved], degree=degree)
    states = judged(list(Statics(problem, steps=10, end=2).steps()))[1:]
    rate = 0.01 / 0.4
    for state in states:
        t, T = min(state.t, 0.4), max(state.t - 0.4, 0.0)
        E, e = np.exp(-t / TIMES), np.exp(-T / TIMES)
        spring = rate * TIMES * (1 - E)
        grown = rate**2 * TIMES**2 * (t - 2 * TIMES * (1 - E) + TIMES * (1 - E**2) / 2) / TIMES
        lost = grown + spring**2 * (1 - e**2) / 2
        assert state.energies["dissipated"] == pytest.approx(MU * RATIOS @ lost, rel=1e-11)
        held = MU / 2 * RATIOS @ (spring * e) ** 2
        assert state.energies["relaxing"] == pytest.approx(held, rel=1e-11)
        lasting = MU / 2 * (rate * t) ** 2
        strain = lasting + held + MU * RATIOS @ lost
        assert state.energies["strain"] == pytest.approx(strain, rel=1e-11)


PROBLEMS: dict[str, Any] = {
    "mixed": lambda keys: Problem(
        box_body(size=(2, 1, 1), cells=(2, 1, 1)), law(nu=0.4999), **keys
    ),
    "whole": lambda keys: Problem(
        box_body(size=(2, 1, 1), cells=(2, 1, 1)), law(viscous_on="whole"), **keys
    ),
    "plane stress": lambda keys: Problem(
        rectangle_body(size=(2, 1), cells=(2, 1)), law(), geometry="plane-stress", **keys
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("name", PROBLEMS)
def test_nothing_comes_back(name: str) -> None:
    """Pulled to and fro: the work is what is stored and lost, to second order in the step."""
    dim = 2 if name == "plane stress" else 3
    supports = [
        Support(on="left", displacement=[0] * dim),
        Support(on="right", displacement=[0.02, *[FREE] * (dim - 1)], curve="sin(6*t)"),
    ]
    off = []
    for steps in (20, 40):
        problem = PROBLEMS[name]({"supports": supports})
        states = list(Statics(problem, steps=steps).steps())
        for state in states:
            assert state.audit is not None
            assert state.audit.verdict == "pass", state.audit.reasons
        lost, held = column(states[1:], "dissipated"), column(states[1:], "relaxing")
        assert np.all(np.diff(lost) > 0)
        assert np.all(held > 0)
        work = np.array([s.audit.work for s in states[1:]])  # type: ignore[union-attr]
        off.append(np.abs(work - column(states[1:], "strain")).max() / work.max())
    assert off[1] < 0.3 * off[0]
    assert off[1] < 5e-3


@pytest.mark.long
def test_beside_a_law_of_large_strains() -> None:
    """There the work on the branches is one number, and the linear half has both."""
    body = box_body(size=(2, 1, 1), cells=(2, 1, 1))
    middle = body.mesh.geometry.x[body.mesh.geometry.dofmap].mean(axis=1)[:, 0]
    halves = {"small": np.flatnonzero(middle < 1), "large": np.flatnonzero(middle > 1)}
    body = body.named(regions={n: cells.astype(np.int32) for n, cells in halves.items()})
    laws = {"small": law(), "large": NeoHookeanSplit(mu=MU, nu=0.3, viscous=SERIES)}
    moved = Support(on=SIDES, displacement=["0.001*z", 0, 0], curve=[[0, 0], [0.4, 1], [1, 1]])
    states = list(Statics(Problem(body, laws, supports=[moved], degree=1), steps=40).steps())
    one = Problem(box_body(size=(1, 1, 1), cells=(1, 1, 1)), law(), supports=[moved], degree=1)
    alone = list(Statics(one, steps=40).steps())
    lost = column(alone[1:], "dissipated")
    assert column(states[1:], "dissipated") == pytest.approx(lost, rel=1e-9)
    both = column(alone[1:], "relaxing") * 2 + lost
    # The same work in the other half, by the trapezoidal rule in steps of half the shorter time.
    assert column(states[1:], "relaxing") == pytest.approx(both, rel=0.1)
    assert column(states[1:], "relaxing")[5:] == pytest.approx(both[5:], rel=0.01)


@pytest.mark.parametrize("scheme", ["generalized-alpha", "central-differences"])
def test_a_motion_dies_out(scheme: str) -> None:
    """A cube whose top is thrown sideways: energy becomes heat, and the balance holds.

    To second order in the step.
    """
    supports = [Support(on="bottom", displacement=[0, 0, 0])]
    off = []
    for n in (40, 80):
        body = box_body(size=(1, 1, 1), cells=(1, 1, 1))
        problem = Problem(body, law(density=0.5), supports=supports, degree=1)
        motion = Dynamics(
            problem, end=1, dt=1 / n, initial_velocity=["0.01*z", 0, 0], scheme=scheme
        )
        states = list(motion.steps())
        judged(states[1:])
        lost = column(states, "dissipated")
        assert np.all(np.diff(lost) >= 0)
        assert lost[-1] > 0.1 * column(states, "kinetic")[0]
        assert np.all(column(states, "relaxing") >= 0)
        total = column(states, "kinetic") + column(states, "strain")
        off.append(np.abs(total[-1] - total[0]) / lost[-1])
    assert off[1] < 0.35 * off[0] or off[1] < 1e-3
