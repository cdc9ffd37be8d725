"""The whole load in one step where nothing speaks against it, load steps where something does."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.arch import RISE, arch
from mpi4py import MPI

from dolfin_elastic import (
    NeoHookean,
    Problem,
    Statics,
    Support,
    Traction,
    box_body,
    rectangle_body,
)
from dolfin_elastic.problem.state import State
from dolfin_elastic.problem.term import Term
from dolfin_elastic.solvers.linear.choice import LinearSettings

E, NU = 1e6, 0.3
NH = NeoHookean(E=E, nu=NU)
EULER = np.pi**2 * E / (1 - NU**2) / 12 / 4 / 100
"""Critical pressure on the top of `column`, clamped below, L/h = 10 [Pa]."""


def block() -> Problem:
    """Twice as long as wide, 1 MPa, bent by 13 kPa: what `benchmarks/run` solves."""
    body = box_body(size=(2, 1, 1), cells=(6, 3, 3))
    load = Traction(on="right", value=[0, 0, -13e3])
    return Problem(body, NH, degree=1, supports=[Support(on="left")], loads=[load])


def column(factor: float, side: float = 0.0) -> Problem:
    """Under `factor` times Euler's load, and a side load."""
    return Problem(
        rectangle_body(size=(1, 10), cells=(2, 20)),
        NH,
        degree=2,
        supports=[Support(on="bottom")],
        loads=[Traction(on="top", value=[side * EULER, -factor * EULER])],
    )


def solved(problem: Problem, method: str = "auto", **settings: Any) -> list[State]:
    return [*Statics(problem, linear=LinearSettings(method=method), **settings).steps()]


def off(a: Problem, b: Problem) -> float:
    """Largest difference of two displacements over the largest displacement."""
    comm, u, v = MPI.COMM_WORLD, a.u.x.array, b.u.x.array
    sizes = [float(np.abs(x).max(initial=0.0)) for x in (u - v, u)]
    difference, size = (comm.allreduce(x, op=MPI.MAX) for x in sizes)
    return difference / size


@pytest.mark.parametrize("method", ["direct", "iterative"])
def test_a_block_takes_one_step(method):
    """25, 75 and 100 % of the load take 12 Newton iterations, the whole load 5 or 6."""
    at_once, stepwise = block(), block()
    _, state = solved(at_once, method)
    many = solved(stepwise, method, steps=3)
    assert state.newton <= 6
    assert sum(s.newton for s in many) >= 10
    assert state.audit is not None
    assert state.audit.verdict == "pass"
    # Newton's 1e-8 in force, softened by the block's condition.
    assert off(at_once, stepwise) < 1e-6
    assert state.energies["strain"] == pytest.approx(many[-1].energies["strain"], rel=1e-7)


@pytest.mark.parametrize("settings", [{"first_step": 0.25}, {"max_step": 1.0}, {"times": [0.5]}])
def test_states_that_are_asked_for_are_computed(settings):
    states = solved(block(), **settings)
    assert [s.t for s in states] == pytest.approx([0, 0.25, *settings.get("times", [0.75]), 1.0])


class Learning(Term):
    """Has to be solved with again once."""

    label, learnt = "learning", 0

    def unsettled(self) -> bool:
        return self.learnt == 0

    def augment(self) -> None:
        self.learnt += 1


def test_a_term_that_has_to_learn_takes_load_steps():
    problem = block()
    problem.terms.append(Learning())
    assert len(solved(problem)) > 2
    assert problem.terms[-1].learnt == 1


def test_states_on_the_way_are_computed_where_an_output_shows_them():
    states = [*Statics(block(), gradual=True).steps()]
    assert [s.t for s in states] == pytest.approx([0, 0.25, 0.75, 1])


def test_a_crooked_column_takes_its_steps():
    """Under 1.5 times Euler's load Newton's method finds, in four iterations, the branch that bends
    against the imperfection; its energy is that of a straight column, only its tangent tells."""
    found, patient = column(1.5, 1e-3), column(1.5, 1e-3)
    states = solved(found)
    solved(patient, steps=40)
    assert len(states) > 5
    assert off(found, patient) < 1e-4


@pytest.mark.parametrize(
    ("factor", "side", "first"), [(0.9, 0.0, 1.0), (1.1, 0.0, 0.25), (1.5, 1e-3, 0.25)]
)
def test_conjugate_gradients_tell_a_buckled_column(factor, side, first):
    """Straight and crooked, where nothing but negative curvature shows that it is unstable."""
    linear = LinearSettings(method="iterative")
    states = Statics(column(factor, side), linear=linear).steps()
    assert [next(states).t, next(states).t] == [0.0, first]
    states.close()


@pytest.mark.parametrize(("factor", "first"), [(0.7, 1.0), (1.1, 0.25)])
def test_eliminated_pressures_tell_a_straight_column(factor, first):
    """Of rubber, with an iterative solver for displacement and pressure.

    Softer pressures take a sixth of the column's stiffness, so 0.7 of its critical load counts.
    """
    nu = 0.4999
    critical = EULER * (1 - NU**2) / (1 - nu**2)
    problem = Problem(
        rectangle_body(size=(1, 10), cells=(2, 20)),
        NeoHookean(E=E, nu=nu),
        degree=2,
        formulation="mixed",
        supports=[Support(on="bottom")],
        loads=[Traction(on="top", value=[0.0, -factor * critical])],
    )
    states = Statics(problem, linear=LinearSettings(method="iterative")).steps()
    assert [next(states).t, next(states).t] == [0.0, first]
    states.close()


@pytest.mark.long
@pytest.mark.parametrize("side", [0.0, 1e-3])
def test_iterative_solvers_see_the_column_buckle(side):
    """Steps that end on the straight or the wrong branch are refused, as with pivots.

    Without a look at the tangent GMRES, which takes over from conjugate gradients, solves for the
    straight column under any load.  The deflection is ten times the column's thickness: 1e-8 in
    force, softened by the condition of a column near its critical load.
    """
    direct, iterative = column(1.5, side), column(1.5, side)
    steps = [solved(direct, "direct"), solved(iterative, "iterative")]
    assert steps[0][-1].max_displacement > 1.0
    assert off(direct, iterative) < 1e-6 or off(mirrored(direct), iterative) < 1e-6


def mirrored(problem: Problem) -> Problem:
    """Bent to the other side."""
    problem.u.x.array[::2] *= -1.0
    return problem


def test_nothing_to_do():
    """No iteration, and no tangent before the one that is looked at."""
    problem = Problem(
        box_body(size=(1, 1, 1), cells=(2, 2, 2)), NH, degree=1, supports=[Support(on="left")]
    )
    _, state = solved(problem, "iterative")
    assert (state.newton, state.max_displacement) == (0, 0.0)


def test_an_arch_that_snaps_takes_its_steps(caplog):
    """Beyond its limit points there is another stable equilibrium, which is told as one."""
    states = solved(arch(RISE, 0.4, (10, 1)))
    assert len(states) > 3
    assert any(MPI.COMM_WORLD.allgather("the part has snapped" in caplog.text))
