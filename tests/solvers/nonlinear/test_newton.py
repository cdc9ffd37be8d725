"""Newton's method: quadratic, forgiving (half steps), and clear about a failure."""

from __future__ import annotations

import logging
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from helpers.laws import make
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic import (
    Dynamics,
    LinearElastic,
    NeoHookean,
    Problem,
    Statics,
    StVenantKirchhoff,
    Support,
    Traction,
    rectangle_body,
)
from dolfin_elastic.core.errors import CaseError, ConvergenceError, InputError, StoppedError
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.problem.state import State
from dolfin_elastic.solvers.assembly.assembler import Assembler, Tangent
from dolfin_elastic.solvers.linear import hierarchy
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.solvers.linear.ksp import LinearSolver
from dolfin_elastic.solvers.nonlinear.convergence import ConvergenceTest, Tolerance

E, NU = 1e6, 0.3
FREE = "free"
NH = NeoHookean(E=E, nu=NU)


def block(law: Law, *, finer: int = 1, **more: Any) -> Problem:
    """A block that is pulled and sheared at its right end."""
    body = rectangle_body(size=(1.0, 0.6), cells=(4 * finer, 3 * finer))
    return Problem(
        body,
        law,
        supports=[Support(on="left", displacement=[0, 0])],
        loads=[Traction(on="right", value=[0.01 * E, 0.01 * E])],
        **{"degree": 1, **more},
    )


def stretched(law: Law, by: float) -> Problem:
    """The same block, pulled by a prescribed displacement alone."""
    body = rectangle_body(size=(1.0, 0.6), cells=(4, 3))
    return Problem(
        body,
        law,
        supports=[
            Support(on="left", displacement=[0, 0]),
            Support(on="right", displacement=[by, FREE]),
        ],
        degree=1,
    )


def beam(alpha: float) -> Problem:
    """A cantilever, L/h = 10, under a dead tip force alpha E I / L^2."""
    L, h = 10.0, 1.0
    force = alpha * E / (1 - NU**2) * h**3 / 12 / L**2
    body = rectangle_body(size=(L, h), cells=(20, 2))
    return Problem(
        body,
        NeoHookean(E=E, nu=NU),
        degree=2,
        supports=[Support(on="left", displacement=[0, 0])],
        loads=[Traction(on="right", value=[0, force / h])],
    )


def said(caplog: pytest.LogCaptureFixture, text: str) -> bool:
    """Whether any rank has logged it: the same answer on all of them."""
    return any(MPI.COMM_WORLD.allgather(text in caplog.text))


def order(residuals: tuple[float, ...], floor: float) -> float:
    """Order of convergence from the last three residuals above round-off."""
    r = [x for x in residuals if x > floor]
    assert len(r) >= 3, residuals
    return float(np.log(r[-1] / r[-2]) / np.log(r[-2] / r[-3]))


@pytest.mark.sample(3)
@pytest.mark.parametrize("load", ["traction", "displacement"])
@pytest.mark.parametrize("name", [n for n, kind in MATERIALS.items() if not kind.linear])
def test_quadratic(name, load):
    law = make(name)
    problem = block(law) if load == "traction" else stretched(law, 0.2)
    *_, state = Statics(problem, steps=1, rtol=1e-13).steps()
    # Round-off of the nodal forces of this mesh is 1e-10 N.
    # Between two and three residuals the estimate scatters: linear convergence gives 1.
    assert order(state.residuals, floor=1e-8) >= 1.6, state.residuals
    assert state.newton <= 7
    assert len(state.residuals) == state.newton + 1


def test_linear_problems_take_one_iteration():
    *_, state = Statics(block(LinearElastic(E=E, nu=NU)), rtol=1e-11).steps()
    assert state.newton == 1
    *_, state = Statics(stretched(LinearElastic(E=E, nu=NU), 0.2), rtol=1e-11).steps()
    assert state.newton == 1


def test_a_wrong_tangent_would_be_seen():
    """The measure of order can fail: keeping the first tangent converges linearly."""
    problem = block(NeoHookean(E=E, nu=NU))
    lagged = Statics(
        problem, steps=2, rtol=1e-10, max_iterations=60, petsc={"snes_lag_jacobian": -2}
    )
    _, state, *_ = lagged.steps()
    assert order(state.residuals, floor=1e-4) < 1.3, state.residuals


def test_large_displacements_need_no_smaller_steps(caplog):
    """A stretch of a half moves the boundary in one step: no retry, few iterations."""
    with caplog.at_level(logging.DEBUG, logger="dolfin_elastic"):
        states = [*Statics(stretched(NeoHookean(E=E, nu=NU), 0.5), steps=1).steps()]
    assert [s.load_factor for s in states] == [0.0, 1.0]
    assert states[-1].newton <= 7
    assert not said(caplog, "a smaller step")
    assert not said(caplog, "fails")


# --- half steps ---


def test_a_step_too_large_is_halved(caplog):
    """With few iterations allowed, half steps get there, and to the same place."""
    hasty, patient = beam(6.0), beam(6.0)
    with caplog.at_level(logging.INFO, logger="dolfin_elastic"):
        states = [*Statics(hasty, steps=1, max_iterations=5, rtol=1e-10).steps()]
    factors = [s.load_factor for s in states]
    assert factors[0] == 0.0
    assert factors[-1] == 1.0
    assert len(factors) > 3
    assert all(b > a for a, b in pairwise(factors))
    assert said(caplog, "a smaller step")
    assert all(s.newton <= 5 for s in states)
    *_, last = Statics(patient, steps=10, rtol=1e-10).steps()
    # Both are the same equilibrium to Newton's tolerance, quadratically below 1e-10.
    assert states[-1].energies["strain"] == pytest.approx(last.energies["strain"], rel=1e-9)
    assert states[-1].max_displacement == pytest.approx(last.max_displacement, rel=1e-9)


def test_steps_grow_back_and_keep_to_the_plan():
    states = [*Statics(beam(6.0), steps=2, max_iterations=5).steps()]
    factors = [s.load_factor for s in states]
    assert 0.5 in factors
    assert factors[-1] == 1.0
    sizes = np.diff(factors)
    assert sizes.max() <= 0.5 + 1e-12


# --- failure ---


def crushed() -> Problem:
    """St. Venant-Kirchhoff has no equilibrium beyond the limit load of 0.19 E in compression.

    Free sides, no friction: P = E s (s^2 - 1)/2 for uniaxial stress has its extreme at
    s = 1/sqrt(3); in plane strain E is E/(1 - nu^2).
    """
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    limit = E / (1 - NU**2) / (3 * np.sqrt(3))
    return Problem(
        body,
        StVenantKirchhoff(E=E, nu=NU),
        supports=[
            Support(on="left", displacement=[0, FREE]),
            Support(on="bottom", displacement=[FREE, 0]),
        ],
        loads=[Traction(on="right", value=[-2 * limit, 0])],
        degree=1,
    )


def until_failure(problem: Problem, **settings: Any) -> tuple[list[State], ConvergenceError]:
    """All states before the error, and the error."""
    states: list[State] = []
    with pytest.raises(ConvergenceError) as caught:
        states.extend(Statics(problem, **settings).steps())
    return states, caught.value


@pytest.mark.long
def test_failure_says_where_and_what_to_try():
    states, error = until_failure(crushed(), steps=4, max_iterations=12, min_step=1 / 16)
    displacement = [state.max_displacement for state in states]
    text = str(error)
    reached = states[-1].load_factor
    # The limit load is half of what was asked for; steps end 1/64 of the load below it.
    assert 0.5 - 2 / 64 <= reached <= 0.5
    assert f"no stable equilibrium beyond load factor {reached:.6g}" in text
    assert "Newton iterations" in text
    assert " N, is at (" in text
    assert "\n  try: " in text
    assert error.exit_code == 3
    assert all(b > a for a, b in pairwise(displacement))


@pytest.mark.long
def test_the_last_states_are_right_although_the_next_one_fails():
    """Just below the limit point the stretch is that of the closed form."""
    states, _ = until_failure(crushed(), steps=4, max_iterations=12, min_step=1 / 4, rtol=1e-12)
    factor, reaction = states[-1].load_factor, states[-1].reactions["left"]
    pressure = factor * 2 * E / (1 - NU**2) / (3 * np.sqrt(3))
    assert reaction[0] == pytest.approx(pressure, rel=1e-9)


def test_a_body_that_is_not_held_is_named():
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    problem = Problem(
        body, LinearElastic(E=E, nu=NU), loads=[Traction(on="right", value=[1.0, 0])], degree=1
    )
    with pytest.raises(InputError, match="no support: as a rigid body it can move and turn freely"):
        next(Statics(problem).steps())


def test_no_mesh_inside_out_is_accepted():
    """Hooke's law knows no inversion: a body pushed through itself is refused by name."""
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    problem = Problem(
        body,
        LinearElastic(E=E, nu=NU),
        supports=[
            Support(on="left", displacement=[0, 0]),
            Support(on="right", displacement=[-1.5, 0]),
        ],
        degree=1,
    )
    factors: list[float] = []
    with pytest.raises(ConvergenceError) as caught:
        factors.extend(s.load_factor for s in Statics(problem, min_step=1 / 64).steps())
    assert factors[:2] == [0.0, 0.25], "after cells inside out a quarter is tried, not half"
    assert "no equilibrium beyond load factor 0.6" in str(caught.value)  # 1/1.5
    assert "inside out (det F = -" in str(caught.value)


# --- the user's options ---


def test_options_of_the_user_win_and_leave_no_trace(caplog):
    linear = LinearSettings(petsc={"ksp_type": "gmres", "pc_type": "lu"})
    problem = block(NeoHookean(E=E, nu=NU))
    before = dict(PETSc.Options().getAll())
    with caplog.at_level(logging.WARNING, logger="dolfin_elastic"):
        *_, state = Statics(problem, linear=linear, petsc={"snes_mistyped": 1}).steps()
    assert state.krylov >= 0
    assert dict(PETSc.Options().getAll()) == before
    assert said(caplog, "'-snes_mistyped' was not used")
    assert not said(caplog, "'-ksp_type'")


KEYS_OF_LIMITS = {
    "snes_rtol": "rtol",
    "-snes_atol": "atol",
    "elastic_snes_stol": "rtol",
    "snes_convergence_test": "rtol",
    "-snes_max_it": "max_iterations",
    "snes_max_funcs": "max_iterations",
    "snes_divergence_tolerance": "max_iterations",
}


@pytest.mark.parametrize("option", KEYS_OF_LIMITS)
def test_tolerances_of_snes_are_refused(option: str) -> None:
    """They were without effect: the residual is judged on forces, by the keys of the case."""
    name, key = option.lstrip("-").removeprefix("elastic_"), KEYS_OF_LIMITS[option]
    text = rf"solver\.petsc: the PETSc option -{name} has no effect here.*statics\.{key}, in motion"
    with pytest.raises(CaseError, match=text):
        list(Statics(block(NH), petsc={option: 1e-3}).steps())


REFUSED_INSIDE = {
    "level": ({"ksp_type": "gmres", "pc_type": "gamg"}, {"mg_coarse_pc_type": "nonsense"}),
    "block": ({"ksp_type": "gmres", "pc_type": "bjacobi"}, {"sub_pc_type": "nonsense"}),
    "factor": (
        {"ksp_type": "gmres", "pc_type": "bjacobi", "sub_pc_type": "lu"},
        {"sub_pc_factor_mat_ordering_type": "nonsense"},
    ),
}
"""Options that fit, and one that PETSc reads, and refuses, only inside a solve."""


@pytest.mark.parametrize("motion", [False, True])
@pytest.mark.parametrize("case", REFUSED_INSIDE)
def test_what_petsc_refuses_inside_a_solve_is_one_message(case: str, motion: bool) -> None:
    """It was a PETSc.Error with a number and a trace."""
    fitting, wrong = REFUSED_INSIDE[case]
    problem, petsc = block(NeoHookean(E=E, nu=NU, density=1000)), {**fitting, **wrong}
    with pytest.raises(InputError) as caught:
        if motion:
            list(Dynamics(problem, end=1e-3, dt=1e-3, petsc=petsc).steps())
        list(Statics(problem, petsc=petsc).steps())
    given = ", ".join(f"-{name} {value}" for name, value in petsc.items())
    what = caught.value.what.removeprefix(f"PETSc refuses the options {given}: ")
    assert what != caught.value.what
    assert "nonsense" in what
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("options", [{"pc_gamg_threshold": 0.01}, {}], ids=["entries", "blocks"])
def test_a_factorisation_in_place_of_a_failed_solver_is_renewed(options, caplog, monkeypatch):
    """Falling back, Newton's method is as quick as with the direct solver from the start.

    Also from a tangent by the half of its blocks, which nothing factorises.
    """
    mumps, linear = LinearSettings(method="direct"), LinearSettings(method="iterative")
    monkeypatch.setattr(hierarchy, "SMALL", 200)  # else an inverse, and done in one iteration
    way, failing = {"first_step": 0.25}, {"ksp_max_it": 1, **options}
    problem = block(NH, finer=4)
    direct = [s.newton for s in Statics(problem, linear=mumps, **way).steps()]
    problem = block(NH, finer=4)
    with caplog.at_level(logging.INFO, logger="dolfin_elastic"):
        fallen = [s.newton for s in Statics(problem, linear=linear, petsc=failing, **way).steps()]
    assert fallen == direct
    if MPI.COMM_WORLD.rank == 0:
        assert any("factorising" in record.getMessage() for record in caplog.records)


def test_the_users_factorisation_is_renewed_too():
    """And one that is not MUMPS's, which counts no pivots, is judged by conjugate gradients."""
    chosen = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
    linear = LinearSettings(method="iterative")
    *_, state = Statics(block(NH), linear=linear, petsc=chosen, first_step=0.25).steps()
    factorising = LinearSettings(method="direct")
    *_, direct = Statics(block(NH), linear=factorising, first_step=0.25).steps()
    assert state.newton == direct.newton
    if MPI.COMM_WORLD.size == 1:
        own = {"ksp_type": "preonly", "pc_type": "cholesky"}
        *_, state = Statics(block(NH), linear=linear, petsc=own).steps()
        assert state.negative == 0


@pytest.mark.parametrize(
    ("share", "iterates", "stalled"), [(0.95, 7, True), (0.9, 7, False), (0.95, 6, False)]
)
def test_when_backtracking_stalls(share, iterates, stalled):
    """Where six iterations take less than a third off: 0.95^6 = 0.74, but 0.9^6 = 0.53."""
    problem = block(NH)
    assembler = Assembler(problem)
    try:
        test = ConvergenceTest(assembler, Tolerance())
        for backtracks in (True, False):
            test.begin(backtracks=backtracks)
            test.residuals += [share**n for n in range(iterates)]
            assert test._stalled() is (stalled and backtracks)
    finally:
        assembler.destroy()


@pytest.mark.parametrize(
    ("residuals", "lands"),
    [
        ([1e2], False),
        ([1e6, 1e2], True),
        ([1e3, 1e2], False),
        ([1e2, 1e6], False),
        ([1e10, 1e6], False),  # a solve to 5e-7 is not asked for
    ],
)
def test_which_linear_solve_may_be_the_last(residuals, lands):
    """Where the square of the last fall leaves less than half of what is wanted: 1e2 1e-4^2."""
    assembler = Assembler(block(NH))
    try:
        test = ConvergenceTest(assembler, Tolerance())
        test.begin()
        target = test.target()
        assert target > 0.0
        test.residuals += [factor * target for factor in residuals]
        test._norm = test.residuals[-1]
        assert test.may_be_last() is lands
    finally:
        assembler.destroy()


def test_the_last_linear_solve_ends_by_the_residual(monkeypatch):
    """By the preconditioned one it may end above what is wanted, which takes another tangent."""
    monkeypatch.setattr(hierarchy, "SMALL", 50)  # else an inverse, exact whatever is asked for
    judged = []
    judge = LinearSolver.judge

    def noted(solver: LinearSolver, *, may_be_last: bool) -> None:
        judge(solver, may_be_last=may_be_last)
        judged.append((may_be_last, solver.ksp.getNormType()))

    monkeypatch.setattr(LinearSolver, "judge", noted)
    *_, state = Statics(block(NH, finer=2), linear=LinearSettings(method="iterative")).steps()
    assert state.newton == len(judged)
    true_residual = PETSc.KSP.NormType.UNPRECONDITIONED
    assert judged[-1] == (True, true_residual)
    assert all((norm == true_residual) == last for last, norm in judged)
    assert [last for last, _ in judged].count(True) == 1


@pytest.mark.parametrize("motion", [False, True])
def test_a_tangent_that_is_stopped_ends_the_run(
    motion: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where a signal comes while its form is compiled, which is when it is first needed."""
    problem = block(NeoHookean(E=E, nu=NU, density=1000))
    analysis = Dynamics(problem, end=1e-3, dt=1e-3) if motion else Statics(problem)
    states = analysis.steps()
    next(states)

    def stopped(*given: Any) -> None:
        raise StoppedError("stopped on request")

    monkeypatch.setattr(Tangent, "assemble", stopped)
    # The latter where the loop listens to signals itself: in the main thread, under Python's own
    # handler, which a worker of pytest-xdist has not.
    with pytest.raises((StoppedError, KeyboardInterrupt)):
        next(states)
