"""Explicit motion of materials that remember: free vibration with damping, restarts, replay.

A column of cubes in shear, fixed at its foot: G is complex, and so is the frequency.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.checkpoints import through_json

from dolfin_elastic import (
    Case,
    Dynamics,
    LinearElastic,
    NeoHookeanSplit,
    Problem,
    Support,
    Traction,
    box_body,
)
from dolfin_elastic.case.check.consistency import check
from dolfin_elastic.core.errors import InputError, StabilityError
from dolfin_elastic.core.parallel import largest
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.materials.laws.j2 import J2
from dolfin_elastic.model.materials.laws.j2_logarithmic import J2Logarithmic
from dolfin_elastic.problem.state import State

MU, RHO, TAU = 3.0, 1.0, 0.25
SIDES = ["left", "right", "front", "back", "top"]
BOTH = pytest.mark.parametrize("scheme", ["central-differences", "symplectic-euler"])


def column(g: float, n: int = 8) -> Problem:
    body = box_body(size=(1 / n, 1 / n, 1), cells=(1, 1, n))
    law = LinearElastic(mu=MU, nu=0.3, density=RHO, prony=[{"g": g, "tau": TAU}])
    supports = [
        Support(on=SIDES, displacement=["free", 0, 0]),
        Support(on="bottom", displacement=[0, 0, 0]),
    ]
    return Problem(body, law, supports=supports, degree=1)


def complex_frequency(g: float) -> complex:
    """rho s^2 + G(s) k^2 = 0, the root that vibrates; G(s) = mu (1 - g/(1 + s tau))."""
    k2 = (np.pi / 2) ** 2
    roots = np.roots([RHO * TAU, RHO, MU * k2 * TAU, MU * k2 * (1 - g)])
    return complex(roots[np.argmax(roots.imag)])


def peaks(problem: Problem, **keys: Any) -> tuple[FloatArray, list[State]]:
    """Largest displacements of the top, each the vertex of a parabola through three states."""
    start = ["0.01*sin(pi/2*z)", 0, 0]
    top = problem.places[:, 2] > 1 - 1e-9
    t, u, states = [], [], []
    for state in Dynamics(problem, end=8, initial_velocity=start, **keys).steps():
        local = state.u.x.array.reshape(-1, 3)[top, 0]
        u.append(largest(problem.body.comm, float(local.max(initial=-1.0))))
        t.append(state.t)
        states.append(state)
    found, times, values = [], np.array(t), np.array(u)
    for i in range(1, len(t) - 1):
        if values[i] > values[i - 1] and values[i] >= values[i + 1] and values[i] > 0:
            c = np.polyfit(times[i - 1 : i + 2] - times[i], values[i - 1 : i + 2], 2)
            found.append(c[2] - c[1] ** 2 / (4 * c[0]))
    return np.array(found), states


@pytest.mark.long
def test_a_bar_in_free_vibration_is_damped() -> None:
    """Logarithmic decrement pi tan(delta) of the series, up to its square (half a per cent)."""
    g = 0.03
    s = complex_frequency(g)
    modulus = MU * (1 - g / (1 + 1j * s.imag * TAU))
    found, states = peaks(column(g), scheme="central-differences", every=1)
    decrement = np.log(found[1] / found[2])
    assert decrement == pytest.approx(np.pi * modulus.imag / modulus.real, rel=0.01)
    # of the root itself: what is left is the error of the mesh, 0.1 %
    assert decrement == pytest.approx(-2 * np.pi * s.real / s.imag, rel=2e-3)
    last, first = states[-1].energies, states[0].energies["total"]
    assert last["dissipated"] > 0.1 * first > last["relaxing"] > 0
    lost = np.array([state.energies["dissipated"] for state in states])
    assert np.all(np.diff(lost) >= 0)
    # what the branches store and lose is the work of central differences: the sum hardly changes
    assert last["total"] == pytest.approx(first, rel=2e-3)
    assert not states[-1].failure


@pytest.mark.long
def test_explicit_and_implicit_agree() -> None:
    """Strong damping; lumped and consistent mass differ by the square of the mesh size."""
    off = []
    for n in (8, 16):
        explicit, _ = peaks(column(0.3, n), scheme="central-differences", every=1)
        implicit, _ = peaks(column(0.3, n), dt=0.02, spectral_radius=1)
        assert len(explicit) == len(implicit) == 3
        off.append(float(np.abs(explicit / implicit - 1).max()))
    assert off[1] < 1.5e-3
    assert off[1] < 0.3 * off[0]


# --- restarts and replay ---


def swung(law: Any = None, **keys: Any) -> Dynamics:
    """A cube of large strains whose top is thrown sideways and pulled."""
    law = law or NeoHookeanSplit(
        mu=MU, nu=0.3, density=0.5, prony=[{"g": 0.3, "tau": 0.5}, {"g": 0.2, "tau": 0.05}]
    )
    held = Support(on="bottom", displacement=[0, 0, 0])
    pull = Traction(on="top", value=[0, 0, 0.1], curve=[[0, 0], [1, 1]])
    body = box_body(size=(1, 1, 1), cells=(2, 2, 2))
    problem = Problem(body, law, supports=[held], loads=[pull], degree=1)
    settings = {"end": 1, "initial_velocity": ["0.5*z", 0, 0], "every": 3} | keys
    return Dynamics(problem, **settings)


@pytest.mark.long
@BOTH
def test_a_restart_is_exact(scheme: str) -> None:
    first, known, middle = swung(scheme=scheme), [], None
    for state in first.steps():
        known.append((state.t, state.u.x.array.copy(), dict(state.energies)))
        if len(known) == 4:
            middle = through_json(first.restart_state())
    assert len(known) > 6
    again = swung(scheme=scheme)
    for state, (t, u, energies) in zip(again.steps(middle), known[4:], strict=True):
        assert state.t == pytest.approx(t, rel=1e-14)
        assert state.u.x.array == pytest.approx(u, abs=1e-12)
        assert state.energies == pytest.approx(energies, rel=1e-12, abs=1e-13)


@BOTH
def test_a_run_knows_nothing_of_an_earlier_one(scheme: str) -> None:
    used, ends = swung(scheme=scheme), []
    for motion in (used, Dynamics(used.problem, used.settings), swung(scheme=scheme)):
        *_, last = motion.steps()
        ends.append(last.max_displacement)
        used.problem.w.x.array[:] = 0.0
    assert ends[1] == pytest.approx(ends[0], rel=1e-13)
    assert ends[2] == pytest.approx(ends[0], rel=1e-13)


@BOTH
def test_the_step_that_turns_cells_is_found(scheme: str) -> None:
    """Steps are repeated from the last state with the history that it had."""
    law = NeoHookeanSplit(mu=MU, nu=0.3, density=0.5, prony=[{"g": 0.5, "tau": 0.02}])
    found = []
    for every in (1, 1000):
        motion = swung(law, scheme=scheme, every=every, initial_velocity=[0, 0, "-200*z"])
        with pytest.raises(StabilityError) as error:
            list(motion.steps())
        found.append(error.value)
    assert "turned inside out in the step to t =" in str(found[0])
    assert str(found[1]) == str(found[0])


METALS = {
    "small": J2(E=10, nu=0.3, **{"yield": 0.3}, hardening=1, density=0.5),
    "large": J2Logarithmic(E=10, nu=0.3, **{"yield": 0.3}, hardening=1, density=0.5),
}


@pytest.mark.long
@pytest.mark.parametrize("name", METALS)
def test_metals_yield_and_spring_back(name: str) -> None:
    """What is dissipated is missing in the motion, and a restart goes on to round-off."""
    keys = {"scheme": "central-differences", "end": 3}
    first, known, middle = swung(METALS[name], **keys), [], None
    for state in first.steps():
        known.append((state.u.x.array.copy(), dict(state.energies)))
        if len(known) == 8:
            middle = through_json(first.restart_state())
        assert not state.failure
    start, end = known[0][1], known[-1][1]
    assert end["dissipated"] > 0.3 * start["total"]
    # the sum is that of central differences, which differs from it by the square of the step
    given = start["total"] + end["external"]
    assert end["total"] == pytest.approx(given, abs=0.02 * given)
    again = swung(METALS[name], **keys)
    for state, (u, energies) in zip(again.steps(middle), known[8:], strict=True):
        assert state.u.x.array == pytest.approx(u, abs=1e-12)
        assert state.energies == pytest.approx(energies, rel=1e-11, abs=1e-13)


def test_a_strain_at_the_start_is_sudden() -> None:
    """The acceleration of the first state is that of the instantaneous stiffness."""
    found = []
    for g in (0.5, 1e-300):
        motion = Dynamics(
            column(g),
            end=1,
            scheme="central-differences",
            initial_displacement=["1e-3*sin(pi/2*z)", 0, 0],
        )
        first = next(motion.steps())
        assert first.a is not None
        found.append(first.a.x.array)
    assert np.abs(found[1]).max(initial=0.0) > 0 or not len(found[1])
    assert found[0] == pytest.approx(found[1], abs=1e-13)


# --- in a case file ---

CASE: dict[str, Any] = {
    "mesh": {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}, "degree": 1},
    "materials": {
        "gel": {
            "law": "yeoh",
            "c10": "1 MPa",
            "nu": 0.3,
            "rho": 1000,
            "prony": [{"g": 0.3, "tau": "0.5 s"}],
        }
    },
    "support": [{"on": "left", "displacement": [0, 0, 0]}],
}


@BOTH
def test_check_permits(scheme: str) -> None:
    case = Case(**CASE, dynamics={"scheme": scheme, "end": 1})
    check(case, case.read_body())


def test_a_preload_of_what_relaxes_is_refused() -> None:
    with pytest.raises(InputError, match="no equilibrium before it begins"):
        swung(scheme="central-differences", preload=True)
