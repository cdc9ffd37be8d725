"""When preconditioners are kept, and when they are set up anew."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from dolfin_elastic import Dynamics, NeoHookean, Problem, Statics, Support, Traction, box_body
from dolfin_elastic.problem.state import State
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.solvers.linear.ksp import Age

ITERATIVE = LinearSettings(method="iterative")
MOST = 60
"""Iterations of a Newton step that rubber may take."""


def beam(load: float, nu: float = 0.4999, cells: tuple[int, int, int] = (8, 2, 2)) -> Problem:
    """Rubber, 4 by 1 by 1, quadratic displacement and a pressure, bent by a traction at its end."""
    return Problem(
        box_body(size=(4.0, 1.0, 1.0), cells=cells),
        NeoHookean(E=1e6, nu=nu, density=1e3),
        degree=2,
        formulation="mixed",
        supports=[Support(on="left")],
        loads=[Traction(on="right", value=[0.0, 0.0, -load])],
    )


@contextmanager
def counted(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """The set-ups of preconditioners."""
    begun, begin = [0], Age.begin

    def count(age: Age, tangent: Any) -> None:
        begun[0] += 1
        begin(age, tangent)

    with monkeypatch.context() as patch:
        patch.setattr(Age, "begin", count)
        yield begun


def solved(problem: Problem, **settings: Any) -> list[State]:
    return [*Statics(problem, linear=ITERATIVE, **settings).steps()][1:]


def test_a_preconditioner_serves_while_the_tangent_hardly_changes(monkeypatch):
    """Two steps of four Newton iterations of a beam that is hardly bent: one set-up."""
    with counted(monkeypatch) as begun:
        states = solved(beam(2e2), steps=2)
    assert sum(state.newton for state in states) >= 4
    assert begun == [1]


def test_one_that_is_too_old_is_set_up_anew(monkeypatch):
    """Bent by a third of a turn; that of the straight beam took 483 iterations at the worst."""
    problem = beam(1e4)
    with counted(monkeypatch) as begun:
        states = solved(problem)
    assert max(state.max_displacement for state in states) > 1.0
    assert begun[0] > len(states)
    each = max(state.krylov / state.newton for state in states)
    assert each <= MOST


@pytest.mark.parametrize("option", [1, 20])
def test_the_users_option_decides(monkeypatch, option):
    """-snes_lag_preconditioner, and the same answer."""
    by_age, by_user = beam(2e3), beam(2e3)
    with counted(monkeypatch) as begun:
        [*_, state] = solved(by_user, petsc={"snes_lag_preconditioner": option})
        assert begun == [0]
    [*_, other] = solved(by_age)
    assert state.max_displacement == pytest.approx(other.max_displacement, rel=1e-6)


def test_motion_keeps_its_preconditioner(monkeypatch):
    """Over all steps of a beam that swings a little: the tangent hardly changes."""
    problem = beam(1e2)
    with counted(monkeypatch) as begun:
        states = [*Dynamics(problem, scheme="newmark", dt=5e-3, end=4e-2, linear=ITERATIVE).steps()]
    assert len(states) == 9
    assert begun[0] <= 2
    assert np.isfinite(states[-1].max_displacement)


@pytest.mark.long
@pytest.mark.parametrize("nu", [0.49, 0.4999, 0.5])
def test_rubber_takes_sixty_iterations_a_newton_step_at_most(nu):
    """At every load step, and no more on a finer mesh than a quarter more."""
    found = []
    for cells in ((8, 4, 4), (12, 6, 6)):
        body = box_body(size=(2.0, 1.0, 1.0), cells=cells)
        problem = Problem(
            body,
            NeoHookean(E=1e6, nu=nu),
            degree=2,
            formulation="mixed",
            supports=[Support(on="left")],
            loads=[Traction(on="right", value=[0.0, 0.0, -4e3])],
        )
        states = solved(problem, steps=3)
        found.append(max(state.krylov / state.newton for state in states))
    assert max(found) <= MOST / 2
    assert found[1] <= 1.25 * found[0]
