"""Sizes of load steps: what is tried after a step that failed or took many iterations."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import pytest

from dolfin_elastic import J2Logarithmic, Problem, Rigid, Statics, Support, rectangle_body
from dolfin_elastic.solvers.nonlinear.newton import Newton
from dolfin_elastic.solvers.statics.step_size import StepSizes

EASY, FAIR, MANY = 4, 7, 15


def sizes(*, remembers: bool = True, stops: tuple[float, ...] = ()) -> StepSizes:
    return StepSizes(100.0, first=8.0, largest=8.0, smallest=0.01, stops=stops, remembers=remembers)


def march(plan: StepSizes, needs: Callable[[float], int]) -> list[tuple[float, float, bool]]:
    """Beginning, end, and success of each step that is tried; one of more than 30 fails.

    Args:
        needs: Newton iterations of a step of a size.
    """
    t, tried = 0.0, []
    while not plan.done(t):
        goal = plan.goal(t)
        newton = needs(goal - t)
        tried.append((t, goal, newton <= 30))
        if newton > 30:
            assert plan.failed(t, goal, inverted=False)
        else:
            plan.succeeded(t, goal, newton)
            t = goal
    return tried


def fails_above(limit: float) -> Callable[[float], int]:
    return lambda size: 31 if size > limit else EASY


def test_a_size_that_fails_is_tried_ever_more_rarely():
    """Of a material that remembers; else after every three steps."""
    failed = [t for t, _, ok in march(sizes(), fails_above(5.0)) if not ok]
    assert failed[0] == 0.0
    waits = [round((b - a) / 4.0) for a, b in pairwise(failed)]
    assert waits[:3] == [3, 6, 12]
    always = march(sizes(remembers=False), fails_above(5.0))
    assert sum(not ok for *_, ok in always) >= 2 * len(failed)


def test_steps_grow_again_once_it_is_easy():
    """After three easy steps each twice as long, up to the first size."""
    plan = sizes()
    assert plan.failed(0.0, 8.0, inverted=True)  # a quarter
    tried = march(plan, lambda size: EASY)
    assert [b - a for a, b, _ in tried[:8]] == [2.0, 2.0, 2.0, 4.0, 4.0, 4.0, 8.0, 8.0]


def test_many_iterations_halve_the_next_step():
    """Though the user has chosen its size: it is that of the longest steps."""
    plan = StepSizes(8.0, first=2.0, largest=2.0, smallest=0.01, steady=True, remembers=True)
    tried = march(plan, lambda size: MANY if size > 1.5 else FAIR)
    assert [b - a for a, b, _ in tried] == [2.0, 1.0, 1.0, 1.0, 1.0, 2.0]


def test_stops_are_met_exactly():
    stops = (1.0, 17.3, 55.5)
    ends = {goal for _, goal, ok in march(sizes(stops=stops), fails_above(3.0)) if ok}
    assert {*stops, 100.0} <= ends


def test_what_was_too_long_is_known_after_a_restart():
    one, other = sizes(), sizes()
    assert one.failed(0.0, 8.0, inverted=False)
    one.succeeded(0.0, 4.0, EASY)
    other.restore(one.restart_state())
    needs = fails_above(5.0)
    assert march(one, needs) == march(other, needs)


@pytest.mark.long
def test_a_bar_that_is_bent_beyond_its_yield_stress(monkeypatch):
    """By 120 degrees in ten steps, which are too long: 270 Newton iterations, failed ones too.

    They were 338 where each size was tried again after one or two steps; two elements more over the
    height have 248 in place of 355.  The heat is that of forty steps to 2e-5, measured: the rest is
    the error of backward Euler.
    """
    counted = []
    solve = Newton.solve

    def counting(self, *args, **keys):
        result = solve(self, *args, **keys)
        counted.append(result.newton)
        return result

    monkeypatch.setattr(Newton, "solve", counting)
    law = J2Logarithmic(E=200e9, nu=0.3, yield_stress=300e6, hardening=2e9)
    energies, iterations = [], []
    for steps in (10, 40):
        problem = Problem(
            rectangle_body(size=(0.1, 0.01), cells=(10, 1)),
            law,
            supports=[
                Support(on="left"),
                Rigid(on="right", displacement=["free", "free"], rotation="120 deg"),
            ],
            degree=2,
        )
        counted.clear()
        states = list(Statics(problem, steps=steps).steps())
        assert {round(i / steps, 12) for i in range(steps + 1)} <= {round(s.t, 12) for s in states}
        energies.append(states[-1].energies["dissipated"])
        iterations.append(sum(counted))
    assert iterations[0] < 300
    assert energies[0] == pytest.approx(energies[1], rel=1e-4)
