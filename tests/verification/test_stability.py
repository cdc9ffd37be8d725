"""Equilibria just below and just above buckling loads that have closed forms, and runs beyond them.

Whatever the solver, the pressure, the loads and the number of ranks, the verdict is that of the
inertia of L D L^T.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import buckling
from helpers.buckling import (
    CASES,
    INERTIA,
    LENGTH,
    NH,
    ONE_END,
    SQUARE,
    E,
    column,
    equilibrium,
    pipe,
    referee,
    rubber_column,
    square_column,
    two_columns,
)

from dolfin_elastic import (
    Case,
    LinearElastic,
    NeoHookean,
    Pressure,
    Problem,
    Spring,
    Statics,
    Support,
    Traction,
    box_body,
    rectangle_body,
    run,
)
from dolfin_elastic.cli.console import _end_rows, audit_rows
from dolfin_elastic.core.errors import ConvergenceError
from dolfin_elastic.model.amplitude import PROPORTIONAL
from dolfin_elastic.problem.state import Stability
from dolfin_elastic.report.contents import audit_of
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.solvers.diagnostics import negative_curvature
from dolfin_elastic.solvers.diagnostics.stability import LINEAR, judge
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.solvers.linear.hierarchy import _inverse
from dolfin_elastic.solvers.statics.retry import RetryStrategy

NEAR = 0.015
"""Distance from the critical load: closer to it Newton's method finds the branch that bends."""


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_closed_form_is_met(case: buckling.Case):
    """With pivots: stable below, unstable above; so the discrete load is known to 1.5 %."""
    assert abs(case.critical - 1.0) <= case.within
    for share, stable in ((1 - NEAR, True), (1 + NEAR, False)):
        problem = case.problem(share * case.critical)
        for method in ("direct",) if problem.symmetric else ("direct", "lu"):
            with equilibrium(case.problem(share * case.critical), method, case.steps) as newton:
                verdict, count = judge(newton), referee(newton)
            assert verdict.stable is stable, verdict.stability
            assert (count == 0) is stable
            assert verdict.stability.verdict == ("stable" if stable else "unstable")
            if not verdict.stability.at_least:
                assert verdict.stability.negative == count


@pytest.mark.parametrize("share", [0.5, 1 - NEAR, 1 + NEAR, 1.05, 1.2])
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
@pytest.mark.sample(12)
def test_iterative_solvers_agree_with_pivots(case: buckling.Case, share: float):
    """Of the same state, which beyond the critical load can be that of a branch that bends."""
    with equilibrium(case.problem(share * case.critical), "iterative", case.steps) as newton:
        verdict, count = judge(newton), referee(newton)
    assert verdict.stable is (count == 0), (verdict.stability, count)
    if not verdict.stability.at_least:
        assert verdict.stability.negative == count
    if verdict.stable is False and newton.bordered is None:
        assert verdict.direction is not None
        assert np.all(np.isfinite(verdict.direction))


@pytest.mark.long
@pytest.mark.parametrize("method", ["direct", "lu", "iterative"])
@pytest.mark.parametrize("share", [1 - NEAR, 1 + NEAR, 1.3])
def test_two_equal_modes_are_met(method: str, share: float):
    """Of a square column, whose determinant stays positive: a side pressure makes it of an LU."""
    problem = square_column(share * SQUARE)
    assert not problem.symmetric
    with equilibrium(problem, method) as newton:
        verdict, count = judge(newton), referee(newton)
    assert count == (0 if share < 1.0 else 2)
    assert verdict.stability.negative == count
    assert not verdict.stability.at_least


@pytest.mark.parametrize(("method", "share"), [("direct", 1.5), ("lu", 1.5), ("iterative", 1.05)])
def test_two_stiff_modes_are_met_behind_soft_ones(method: str, share: float):
    """Of two equal columns beside a material that is a million times softer.

    The soft one stands out in the inverse, so that a glance at a few solves sees neither; pivots of
    the symmetric part see both.
    """
    with equilibrium(two_columns(share), method) as newton:
        glance, verdict, count = judge(newton, surely=False), judge(newton), referee(newton)
    assert count == 2
    assert verdict.stability.negative == count
    assert verdict.direction is not None
    if method != "iterative":
        assert glance.stability.negative == (0 if method == "lu" else 2)


def under_a_follower(load: float) -> Problem:
    """A column whose load turns with its end, over EI/L^2."""
    return Problem(
        rectangle_body(size=(1, LENGTH), cells=(2, 16)),
        NH,
        degree=2,
        supports=[Support(on="bottom")],
        loads=[Pressure(on="top", value=load * E / (1 - 0.3**2) / 12 / LENGTH**2)],
    )


@pytest.mark.parametrize("method", ["direct", "lu", "iterative"])
def test_a_follower_force_does_not_buckle_a_column(method):
    """M. Beck, Z. angew. Math. Phys. 3 (1952) 225: no other equilibrium under any force.

    Its symmetric part alone has negative eigenvalues from Euler's load on: the force turns with
    the end.
    """
    with equilibrium(under_a_follower(1.5 * ONE_END), method) as newton:
        assert judge(newton).stable is not False


@pytest.mark.parametrize("method", ["direct", "lu"])
@pytest.mark.parametrize(("share", "verdict"), [(0.85, "stable"), (1.02, "not judged")])
def test_flutter_is_no_static_question(method: str, share: float, verdict: str):
    """Beck's column, whose two lowest frequencies become one at 20.05 EI/L^2.

    Shear and shortening lower this load in a column that is only ten times as long as thick.
    """
    with equilibrium(under_a_follower(share * 20.05), method, 4) as newton:
        found = judge(newton).stability
    assert found.verdict == verdict
    assert ("flutter" in found.reason) is (verdict == "not judged")


def at_the_end(problem: Problem, method: str, **settings: Any) -> Any:
    return [*Statics(problem, linear=LinearSettings(method=method), **settings).steps()][-1]


BEYOND = {
    "rubber column": (rubber_column, 0.3 * LENGTH),
    "column pressed sideways": (partial(column, factor=ONE_END, side=1e-3), 0.3 * LENGTH),
    "pipe with a free end": (pipe, 0.1),
}
"""Bodies, and the least displacement [m] of what bends at 1.5 times the critical load."""


@pytest.mark.long
@pytest.mark.parametrize("method", ["direct", "iterative"])
@pytest.mark.parametrize("name", BEYOND)
def test_nothing_stands_straight_beyond_its_critical_load(name: str, method: str):
    """Of rubber in space, and under pressures of which the tangent is not symmetric.

    What is found is the branch that bends, or none.
    """
    make, least = BEYOND[name]
    try:
        state = at_the_end(make(1.5), method, max_steps=60)
    except ConvergenceError as error:
        assert "unstable" in str(error)  # noqa: PT017  both ends are right
    else:
        assert state.max_displacement > least
        assert state.stability.verdict == "stable"
        assert state.audit.verdict == "pass"


def test_what_cannot_be_judged_is_no_pass(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(negative_curvature, "ITERATIONS", 1)
    state = at_the_end(column(0.5, ONE_END, side=1e-3), "iterative")
    assert state.stability.verdict == "not judged"
    assert state.negative is None
    assert state.audit.verdict == state.audit.verdict_so_far == "warn"
    assert "stability not judged: conjugate gradients need more than 1" in state.audit.so_far[0]


def test_small_strains_are_stable_without_a_look(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(negative_curvature, "ITERATIONS", 1)
    state = at_the_end(column(0.5, ONE_END, law=LinearElastic(E=E, nu=0.3)), "iterative")
    assert state.stability == Stability(0, reason=LINEAR)


class Negated(LinearElastic):
    """Of negative shear modulus."""

    law: Any = "negated"

    def shape_energy(self, F: Any) -> Any:
        """See `LinearElastic`."""
        return -super().shape_energy(F)


@pytest.mark.parametrize("method", ["direct", "iterative"])
@pytest.mark.parametrize(
    ("law", "springs", "stable"),
    [
        (LinearElastic(E=E, nu=0.3), "-10*E*y/4", False),
        (LinearElastic(E=E, nu=0.3), "-1e-3*E*y/4", True),
        (Negated(E=E, nu=0.3), "0*y", False),
    ],
    ids=["springs", "weak springs", "law"],
)
def test_small_strains_of_negative_stiffness(method: str, law: Any, springs: str, stable: bool):
    """Formulas and laws of Python may have any sign, and are judged."""
    problem = Problem(
        rectangle_body(size=(1, 4), cells=(2, 8)),
        law,
        degree=2,
        supports=[Support(on="bottom"), Spring(on="left", normal=springs.replace("E", f"{E:g}"))],
        loads=[Traction(on="top", value=[0, -1])],
    )
    if stable:
        assert at_the_end(problem, method).stability.verdict == "stable"
        return
    with pytest.raises(ConvergenceError, match="unstable"):
        at_the_end(problem, method)


def test_a_stiffer_rubber_is_judged_by_few_directions():
    """At 0.985 of the load the softer volume has two directions, of which none is negative."""
    case = next(c for c in CASES if c.name == "a rubber column")
    with equilibrium(case.problem((1 - NEAR) * case.critical), "iterative") as newton:
        found = negative_curvature.count_negative(newton)
    assert found.negative == 0
    assert found.direction is not None


def test_motions_of_the_state_before_are_begun_with():
    """Near the critical load; the verdicts are those of pivots below and above it."""
    case = next(c for c in CASES if c.name == "a rubber column")
    with equilibrium(case.problem(case.critical), "iterative") as newton:
        solve, problem = RetryStrategy(newton).solve, newton.assembler.problem
        for share in (0.3, 0.96, 1 - NEAR, 1 + NEAR, 1.1, 0.3):
            problem.set_time(share, default=PROPORTIONAL)
            assert solve([("", newton.unknowns())]).converged
            verdict = judge(newton)
            assert verdict.stable is (referee(newton) == 0)
            assert bool(newton.soft.motions) is (share > 0.9)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
@pytest.mark.sample(4)
def test_responses_of_the_states_before_hide_nothing(case: buckling.Case):
    """From state to state, there and back, the verdict is that of pivots.

    What states before have left is tried on states that are stiffer, softer, and unstable.
    """
    stable: set[bool] = set()
    below = 1 - NEAR
    with equilibrium(case.problem(below * case.critical), "iterative", case.steps) as newton:
        solve, problem = RetryStrategy(newton).solve, newton.assembler.problem
        start = newton.unknowns()
        for share in (0.3, 0.5, 0.8, 0.9, 1 - NEAR, 1 + NEAR, 1.1, 0.8, 1 - NEAR, 1.2, 0.3):
            problem.set_time(share / below, default=PROPORTIONAL)
            if not solve([("", newton.unknowns()), ("", share / below * start)]).converged:
                continue
            verdict, count = judge(newton), referee(newton)
            assert verdict.stable is (count == 0), (share, verdict.stability, count)
            assert len(newton.soft.responses) <= negative_curvature.RESPONSES
            stable.add(verdict.stable)
    assert stable == {True, False}


@pytest.mark.parametrize(("nu", "share"), [(0.3, 0.5), (0.4999, 0.9)])
def test_a_follower_pressure_that_bends_is_judged(nu: float, share: float):
    """Iterating: its tangent is so far from symmetric that its products alone do not serve."""
    force = share * ONE_END * E * INERTIA / 8.0**2
    problem = Problem(
        box_body(size=(1, 1, 8), cells=(2, 2, 9)),
        NeoHookean(E=E, nu=nu),
        degree=2,
        supports=[Support(on="bottom")],
        loads=[Traction(on="top", value=[0, 0, -force]), Pressure(on="left", value=400.0)],
    )
    with equilibrium(problem, "iterative", 10) as newton:
        verdict, count = judge(newton), referee(newton)
    assert count == 0
    assert verdict.stable is True, verdict.stability


def test_multigrid_stays_positive_definite():
    """Of a positive definite matrix its inverse, of another one that of its absolute value."""
    rng = np.random.default_rng(1)
    Q = np.linalg.qr(rng.normal(size=(6, 6)))[0]
    sizes = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    for signs in (np.ones(6), np.array([1, -1, 1, 1, 1, -1])):
        found = _inverse(Q * (signs * sizes) @ Q.T)
        assert found == pytest.approx(Q / sizes @ Q.T, abs=1e-13)


@pytest.mark.parametrize(("most", "verdict"), [(200, "stable"), (1, "not judged")])
def test_summary_and_report(folder: Path, monkeypatch: pytest.MonkeyPatch, most: int, verdict: str):
    """`summary.json` has the verdict, the console and the report's page the words."""
    monkeypatch.setattr(negative_curvature, "ITERATIONS", most)
    case = Case.model_validate(
        {
            "mesh": {"rectangle": {"size": [1, 10], "cells": [2, 16]}, "unit": "m"},
            "materials": {"m": {"law": "neo-hookean", "E": 1e6, "nu": 0.3}},
            "support": [{"on": "bottom"}],
            "load": [{"kind": "pressure", "on": "top", "value": 100}],
            "solver": {"method": "iterative"},
        }
    )
    state = [*run(case, output=folder)][-1]
    judged = verdict == "stable"
    summary = FinishedRun(folder).summary
    assert summary["stability"]["verdict"] == verdict
    assert summary["stability"]["negative_eigenvalues"] == (0 if judged else None)
    assert summary["audit"]["verdict"] == ("pass" if judged else "warn")
    rows = audit_rows(state)
    page = audit_of(FinishedRun(folder))
    if judged:
        assert rows == [("audit", "pass")]
        assert any("is stable" in line for line in page.lines)
    else:
        assert rows[0][1].startswith("stability not judged: ")
        assert page.reasons[0].startswith("stability not judged: ")
        assert page.kind == "warn"


def test_an_unstable_end_of_an_arc_is_told():
    found = Stability(2, at_least=True)
    assert str(found) == "unstable: its tangent has at least 2 negative eigenvalues"
    state = replace(at_the_end(column(0.5, ONE_END), "direct"), stability=found)
    assert ("stability", str(found)) in _end_rows(state, motion=False)
