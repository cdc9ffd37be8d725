"""Solvers that a program drives: advanced, saved, restored; loads that change from outside.

The references are the loop over `steps`, and oscillators whose motion is known.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem

from dolfin_elastic import (
    Body,
    Dynamics,
    NeoHookean,
    OwnLoad,
    Problem,
    Statics,
    Support,
    Traction,
    box_body,
)
from dolfin_elastic.core.errors import ConvergenceError, InputError
from dolfin_elastic.model.loads import Load

BODY = {"size": [1, 0.2], "cells": [4, 1]}


def pulled(load: Load | None = None, body: Body | None = None, **law: Any) -> Problem:
    """A bar that is held at the left and pulled at the right."""
    return Problem(
        body or box_body(**BODY),
        NeoHookean(**{"E": 1e6, "nu": 0.3, "density": 1000, **law}),
        supports=[Support(on="left")],
        loads=[load or Traction(on="right", value=[2e4, -1e3])],
        degree=1,
    )


SOLVERS: list[Callable[[Problem], Any]] = [
    lambda problem: Statics(problem, end=1.0),
    lambda problem: Dynamics(problem, end=1.0, dt=0.05),
    lambda problem: Dynamics(problem, end=1.0, scheme="symplectic-euler", every=1),
]
NAMES = ["statics", "implicit", "explicit"]


@pytest.mark.parametrize("make", SOLVERS, ids=NAMES)
def test_a_window_is_taken_again(make: Callable[[Problem], Any]) -> None:
    """From a saved state the same comes out to round-off, also by another solver."""
    solver = make(pulled())
    solver.advance(0.3)
    saved = solver.save()
    first = solver.advance(0.5)
    end, t, energy = first.u.x.array.copy(), first.t, first.energies["strain"]
    for _ in range(2):
        solver.restore(saved)
        again = solver.advance(0.5)
        assert again.t == t
        np.testing.assert_allclose(again.u.x.array, end, rtol=0, atol=1e-7 * np.abs(end).max())
        assert again.energies["strain"] == pytest.approx(energy, rel=1e-6)
    other = make(pulled(body=solver.problem.body))
    other.restore(saved)
    assert other.advance(0.5).energies["strain"] == pytest.approx(energy, rel=1e-6)
    assert solver.advance(1.0).done == pytest.approx(1.0)
    solver.restore(saved)  # also after the end
    assert solver.advance(0.5).energies["strain"] == pytest.approx(energy, rel=1e-6)


def test_times_are_met() -> None:
    """Those of implicit motion and of statics exactly; what is no time to come is refused."""
    for make in SOLVERS[:2]:
        solver = make(pulled())
        assert solver.advance(0).step == 0
        assert [solver.advance(t).t for t in (0.033, 0.1, 0.1, 0.9)] == [0.033, 0.1, 0.1, 0.9]
        for t in (0.5, 1.1):
            with pytest.raises(InputError, match=r"the run is at t = 0\.9 and cannot go to"):
                solver.advance(t)
        assert solver.advance(1.0).done == 1.0


def test_the_loop_gives_the_same() -> None:
    """Windows of a motion are those of `steps`, step by step."""
    loop = [state.u.x.array.copy() for state in Dynamics(pulled(), end=0.2, dt=0.05).steps()]
    solver = Dynamics(pulled(), end=0.2, dt=0.05)
    states = [solver.advance(t).u.x.array.copy() for t in (0.0, 0.05, 0.1, 0.15, 0.2)]
    np.testing.assert_allclose(states, loop, rtol=0, atol=1e-12)


def test_after_a_failure_the_solver_is_restored() -> None:
    """A window without a solution leaves a session that can go on."""
    force = fem.Constant(box_body(**BODY).mesh, 0.0)
    problem = pulled(OwnLoad(lambda v: force * v[0], surface="right", curve="constant"))
    solver = Statics(problem, end=2.0, snap=False, min_step=0.2)
    solver.advance(1.0)
    saved = solver.save()
    force.value = -1e9
    with pytest.raises(ConvergenceError):
        solver.advance(2.0)
    with pytest.raises(RuntimeError, match="restore a state that was saved"):
        solver.advance(2.0)
    force.value = 1e4
    solver.restore(saved)
    assert solver.advance(2.0).max_displacement == pytest.approx(0.01, rel=0.1)


@pytest.mark.parametrize("kind", ["constant", "function", "curve", "deformed"])
def test_a_load_from_outside(kind: str) -> None:
    """An own load by each kind of value is the traction of the same size, at every load."""
    body = box_body(**BODY)
    value: Any = fem.Constant(body.mesh, 0.0)
    if kind == "function":
        value = fem.Function(fem.functionspace(body.mesh, ("Lagrange", 1)))
    size = {"now": 0.0}

    def work(v: Any) -> Any:
        return value * v[0]

    def stretched(v: Any, F: Any) -> Any:  # J/J: a follower in form, dead in size
        return value * v[0] * ufl.det(F) / ufl.det(F)

    def now(t: float) -> float:
        return size["now"]

    if kind == "curve":
        load: Load = Traction(on="right", value=[1.0, 0.0], curve=now)
    else:
        own = stretched if kind == "deformed" else work
        load = OwnLoad(own, surface="right", curve="constant")
    solver = Statics(pulled(load, body), end=3.0)
    for t, p in ((1.0, 2e4), (2.0, 6e4), (3.0, -3e4)):
        size["now"] = p
        if kind == "function":
            value.x.array[:] = p
        elif kind != "curve":
            value.value = p
        state = solver.advance(t)
        *_, reference = Statics(pulled(Traction(on="right", value=[p, 0.0]))).steps()
        assert state.max_displacement == pytest.approx(reference.max_displacement, rel=1e-6)
        assert state.reactions["left"][0] == pytest.approx(-0.2 * p, rel=1e-6)
        assert state.audit is not None and state.audit.verdict == "pass", state.audit


def test_what_is_no_load() -> None:
    """Unknown arguments, and what is no scalar."""
    with pytest.raises(InputError, match="the load has no argument 'w'"):
        pulled(OwnLoad(lambda w: w[0], surface="right"))
    with pytest.raises(InputError, match="returned no scalar expression"):
        pulled(OwnLoad(lambda v: v, surface="right"))


def test_motion_from_an_equilibrium() -> None:
    """A problem in static equilibrium that is let go on with its load stays where it is."""
    body = box_body(**BODY)
    problem = pulled(Traction(on="right", value=[1e5, 0]), body)
    *_, rest = Statics(problem).steps()
    largest = rest.max_displacement
    for state in Dynamics(problem, end=0.01, dt=2e-3).steps():
        assert state.max_displacement == pytest.approx(largest, rel=1e-7)
        assert state.energies["kinetic"] < 1e-12 * state.energies["strain"]


def test_parameters_change_between_windows() -> None:
    """A constant of a material has a new value from the next window on."""
    solver = Statics(pulled(Traction(on="right", value=[1e3, 0], curve="constant")), end=2.0)
    soft = solver.advance(1.0).max_displacement
    solver.problem.parameters["materials.body.E"].value = 2e6
    assert solver.advance(2.0).max_displacement == pytest.approx(soft / 2, rel=1e-3)
