"""Obstacles with a mass in implicit motion: period, momentum, energy, restarts, refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dolfin_elastic import (
    Contact,
    Dynamics,
    LinearElastic,
    NeoHookean,
    Problem,
    Statics,
    Support,
    rectangle_body,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.problem.state import StateCopy

E, MASS, SPEED = 1e6, 1000.0, 1.0
FALLING = {"direction": [0, -1], "mass": MASS, "velocity": SPEED, "name": "hit"}


def on_a_bar(**keys: Any) -> Problem:
    """A light bar of unit length on a foot, and a heavy plate above it."""
    contact = {**FALLING, "plane": {"axis": "-y", "at": 1.0}, "stiffness": 1e9, **keys}
    return Problem(
        rectangle_body(size=(0.5, 1), cells=(1, 4)),
        LinearElastic(E=E, nu=0.0, density=1.0),
        supports=[Support(on="bottom")],
        contacts=[Contact(on="top", **contact)],
        degree=1,
    )


def test_a_mass_on_a_spring():
    """It falls on a light bar: v/w sin(w t), with its weight as a force (F/k)(1 - cos(w t)) more.

    A bar of 5e-4 of the mass and a penalty of 1/1000 of its flexibility lengthen the period.
    """
    k, force = E * 0.5, 5000.0
    w, rows = np.sqrt(k / MASS), []
    for state in Dynamics(on_a_bar(force=force), end=0.1, dt=1e-3).steps():
        n, e = state.numbers, state.energies
        s, v = n["obstacle_displacement_hit"], n["obstacle_velocity_hit"]
        rows.append((state.t, s, e["total"] + MASS * v**2 / 2 - force * s))
        assert state.audit is not None
        assert state.audit.verdict == "pass", state.audit.reasons
    t, s, energy = np.array(rows).T
    exact = SPEED / w * np.sin(w * t) + force / k * (1 - np.cos(w * t))
    assert s == pytest.approx(exact, abs=2e-3 * s.max())
    assert energy == pytest.approx(energy[0], rel=1e-9)


@pytest.mark.parametrize("degree", [1, 2])
def test_momentum_of_a_mass_and_a_body(degree):
    """A ball hits a free block off its middle: momentum and energy of both are those before."""
    problem = Problem(
        rectangle_body(size=(1, 1), cells=(4, 4)),
        NeoHookean(E=1e5, nu=0.3, density=100.0),
        contacts=[
            Contact(
                on="top",
                sphere={"center": [0.3, 1.51], "radius": 0.5},
                **{**FALLING, "mass": 30.0, "velocity": 2.0},
            )
        ],
        degree=degree,
    )
    rows = []
    for state in Dynamics(problem, end=0.06, dt=2e-3).steps():
        v = state.numbers["obstacle_velocity_hit"]
        momentum = state.momenta["linear"][1] - 30.0 * v
        rows.append((momentum, state.energies["total"] + 15.0 * v**2, v))
        assert state.energies["balance"] == pytest.approx(0.0, abs=1e-8 * 60)
    momentum, energy, v = np.array(rows).T
    assert v[-1] < 0.5 * v[0]
    assert momentum == pytest.approx(momentum[0], rel=1e-10)
    assert energy == pytest.approx(energy[0], rel=1e-8)


def test_a_motion_goes_on():
    """From a state on the way, with another problem."""

    def states(solver: Any, saved: Any = None) -> list[dict[str, float]]:
        return [dict(state.numbers) for state in solver.steps(saved)]

    whole, first = states(Dynamics(on_a_bar(), end=0.01, dt=1e-3)), None
    first = Dynamics(on_a_bar(), end=0.01, dt=1e-3)
    for count, _ in enumerate(first.steps()):
        if count == 5:
            saved = StateCopy(first.restart_state())
            break
    rest = states(Dynamics(on_a_bar(), end=0.01, dt=1e-3), saved)
    assert len(rest) == 5
    for again, before in zip(rest, whole[-5:], strict=True):
        assert again == pytest.approx(before, rel=1e-11, abs=1e-14)


@pytest.mark.parametrize(
    ("keys", "where"),
    [
        ({"mass": None}, "velocity"),
        ({"mass": -1.0}, "mass"),
        ({"direction": None}, "direction"),
        ({"friction": 0.1}, "friction"),
        ({"motion": [0, 1]}, "force"),
    ],
)
def test_keys_that_do_not_fit(keys, where):
    """One message, with the key."""
    with pytest.raises(InputError, match=where):
        on_a_bar(**keys)


@pytest.mark.parametrize(
    ("fields", "where"),
    [
        ({"preload": True, "dt": 1e-3}, r"dynamics\.preload"),
        ({"scheme": "alpha2", "dt": 1e-3}, r"dynamics\.scheme"),
        ({"scheme": "symplectic-euler"}, r"dynamics\.scheme"),
    ],
)
def test_motions_without_it(fields, where):
    """Where it does not move it is refused, and in statics, too."""
    with pytest.raises(InputError, match=where):
        list(Dynamics(on_a_bar(), end=0.01, **fields).steps())
    with pytest.raises(InputError, match=r"contact\[0\]\.mass"):
        list(Statics(on_a_bar()).steps())
