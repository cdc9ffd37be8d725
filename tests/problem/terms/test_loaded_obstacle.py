"""Obstacles that a force moves: the force they carry, how far they go, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.states import last

from dolfin_elastic import (
    Contact,
    Dynamics,
    LinearElastic,
    NeoHookean,
    Problem,
    Rigid,
    Statics,
    Support,
    box_body,
    rectangle_body,
)
from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.report import report
from dolfin_elastic.case.run import run
from dolfin_elastic.cli.console import _end_rows
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.problem.state import StateCopy
from dolfin_elastic.results.finished.draw import obstacles_of
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.solvers.nonlinear.convergence import ConvergenceTest

FREE = "free"
E, NU, FORCE, GAP = 1e6, 0.3, 3e4, 0.25
PLATE = {"plane": {"axis": "-y", "at": 1 + GAP}}
BALL = {"sphere": {"center": [0.5, 1.5 + GAP], "radius": 0.5}}
PUNCH = {"box": {"center": [0.5, 1.5 + GAP], "size": [0.6, 1.0]}}
TIP = {"cone": {"tip": [0.5, 1 + GAP], "axis": "y", "half_angle": 80}}
DOWN = {"force": FORCE, "direction": [0, -2]}
TIGHT = {"gap_tolerance": 1e-10}
"""The pressure of a depth of 1e-10 is 1e-8 of those here."""


def pressed(law: Any = None, degree: int = 1, **contact: Any) -> Problem:
    """A block of unit sides on a foot, under an obstacle at the distance GAP."""
    return Problem(
        rectangle_body(size=(1, 1), cells=(4, 4)),
        law or NeoHookean(E=E, nu=NU),
        supports=[Support(on="bottom")],
        contacts=[Contact(**{"on": "top", "name": "stamp", **TIGHT, **contact})],
        degree=degree,
    )


def way(state: Any) -> float:
    return float(state.numbers["obstacle_displacement_stamp"])


@pytest.mark.parametrize(
    ("shape", "degree", "direction"),
    [
        (PLATE, 1, [0, -2]),
        (PLATE, 1, [1, -1]),
        (BALL, 1, [0, -1]),
        (BALL, 2, [0, -1]),
        (PUNCH, 1, [0, -1]),
        (TIP, 2, [0, -1]),
    ],
)
def test_a_stamp_carries_its_force_and_goes_as_far_as_one_that_is_moved(shape, degree, direction):
    """Moved by the displacement that the force gives, an obstacle carries that force."""
    state = last(pressed(degree=degree, force=FORCE, direction=direction, **shape))
    unit = np.array(direction) / np.hypot(*direction)
    np.testing.assert_allclose(state.reactions["stamp"] @ unit, FORCE, rtol=1e-10)
    assert state.numbers["obstacle_force_stamp"] == pytest.approx(FORCE, rel=1e-10)
    assert state.audit.verdict == "pass"
    shown = dict(_end_rows(state, motion=False))["displacement of stamp"]
    assert shown == f"{way(state):.5g} m"
    moved = last(pressed(degree=degree, motion=(way(state) * unit).tolist(), **shape))
    np.testing.assert_allclose(moved.reactions["stamp"] @ unit, FORCE, rtol=1e-6)
    assert moved.max_displacement == pytest.approx(state.max_displacement, rel=1e-6)


def test_a_bar_is_shortened_by_the_force_over_its_stiffness():
    """Without Poisson's ratio the block is a bar of the stiffness E: F/E after the gap."""
    state = last(pressed(LinearElastic(E=E, nu=0.0), **PLATE, **DOWN))
    assert way(state) == pytest.approx(GAP + FORCE / E, rel=1e-7)


@pytest.mark.long
def test_a_thin_stamp_takes_the_steps_of_a_thick_one():
    """It moves with the body, by more than it is thick: nothing passes through it."""
    paths = [
        [
            way(state)
            for state in Statics(
                pressed(box={"center": [0.5, 1 + GAP + h / 2], "size": [2, h]}, **DOWN), steps=2
            ).steps()
        ]
        for h in (1.0, 1e-3)
    ]
    assert paths[0] == pytest.approx(paths[1], rel=1e-9)


def test_steps_are_shortened_with_the_obstacle(monkeypatch):
    """As those between states that alternate are: also where none does, to the same end."""
    ends = [way(last(pressed(degree=2, **PLATE, **DOWN)))]
    monkeypatch.setattr(ConvergenceTest, "alternates", lambda self: True)
    ends.append(way(last(pressed(degree=2, **PLATE, **DOWN))))
    assert ends[0] == pytest.approx(ends[1], rel=1e-8)


@pytest.mark.long
def test_a_ring_is_pressed_by_the_force_on_all_of_it():
    """The force is that on the whole ring, as the forces of loads are."""
    problem = Problem(
        rectangle_body(size=(1, 1), cells=(2, 2)),
        LinearElastic(E=E, nu=0.0),
        supports=[Support(on="bottom", displacement=[FREE, 0])],
        contacts=[Contact(on="top", name="stamp", **PLATE, **DOWN, **TIGHT)],
        geometry="axisymmetric",
        degree=1,
    )
    assert way(last(problem)) == pytest.approx(GAP + FORCE / (np.pi * E), rel=1e-9)


def test_a_stamp_comes_to_rest_where_it_touches_when_the_force_is_gone():
    states = list(Statics(pressed(**PLATE, **DOWN, curve="load-unload"), steps=4).steps())
    assert [round(s.numbers["obstacle_force_stamp"] / FORCE, 9) for s in states] == [
        0.0,
        0.5,
        1.0,
        0.5,
        0.0,
    ]
    assert way(states[0]) == pytest.approx(GAP, rel=1e-9)
    assert way(states[-1]) == pytest.approx(GAP, rel=1e-9)
    assert states[-1].max_displacement < 1e-9


def test_a_block_between_a_floor_and_a_stamp():
    """What only obstacles hold lies still where one of them does."""
    sides = [Support(on="left", displacement=[0, FREE])]
    stamp = Contact(on="top", name="stamp", **PLATE, **DOWN, **TIGHT)
    floor: dict[str, Any] = {"on": "bottom", "plane": {"axis": "y", "at": 0}, **TIGHT}

    def block(low: Contact) -> Problem:
        return Problem(
            rectangle_body(size=(1, 1), cells=(2, 2)),
            LinearElastic(E=E, nu=0.0),
            supports=sides,
            contacts=[stamp, low],
            degree=1,
        )

    assert way(last(block(Contact(**floor)))) == pytest.approx(GAP + FORCE / E, rel=1e-9)
    with pytest.raises(InputError, match="can move along y"):
        last(block(Contact(**floor, force=FORCE, direction="y")))


@pytest.mark.long
def test_a_rigid_plate_under_a_stamp():
    """Two scalar unknowns, each of which is in the equation of the other."""
    problem = Problem(
        box_body(size=(1, 1, 1), cells=(2, 2, 2)),
        NeoHookean(E=E, nu=NU),
        supports=[Support(on="bottom"), Rigid(on="top", displacement=[0, 0, FREE])],
        contacts=[
            Contact(
                on="top",
                name="stamp",
                plane={"axis": "-z", "at": 1 + GAP},
                force="30 kN",
                direction="-z",
                **TIGHT,
            )
        ],
        degree=1,
    )
    state = last(problem)
    assert state.numbers["obstacle_force_stamp"] == pytest.approx(FORCE, rel=1e-10)
    assert way(state) == pytest.approx(GAP - state.numbers["top_uz"], rel=1e-9)
    assert state.reactions["bottom"][2] == pytest.approx(FORCE, rel=1e-7)


@pytest.mark.long
def test_a_run_goes_on_with_the_obstacle_where_it_was():
    first, second = (Statics(pressed(**BALL, **DOWN), steps=4) for _ in range(2))
    for state in first.steps():
        if 0.4 < state.t < 0.6:
            saved = StateCopy(first.restart_state())
        whole = dict(state.numbers)
    *_, end = second.steps(saved)
    # To the last digit on one rank; on several the factorisation sums in any order.
    assert dict(end.numbers) == pytest.approx(whole, rel=1e-12, abs=1e-13)


def test_arc_length_follows_the_same_path():
    by_load, by_length = (
        last(pressed(**PLATE, **DOWN), **s) for s in ({}, {"method": "arc-length"})
    )
    assert way(by_length) == pytest.approx(way(by_load), rel=1e-7)


@pytest.mark.parametrize("gap", [GAP, 0.0])
@pytest.mark.parametrize("direction", [[0, 1], [1, 0]])
def test_an_obstacle_that_meets_nothing(direction, gap):
    plate = {"axis": "-y", "at": 1 + gap}
    with pytest.raises(InputError, match="'stamp' meets nothing") as caught:
        last(pressed(plane=plate, force=1.0, direction=direction))
    assert caught.value.where == "contact[0].direction"


def test_a_force_that_pulls_at_some_time():
    with pytest.raises(InputError, match=r"is -\S+ N at load factor 0.51: it pulls") as caught:
        last(pressed(**PLATE, **DOWN, curve=[[0, 0], [0.5, 0], [1, -1]]))
    assert caught.value.where == "contact[0].force"


@pytest.mark.parametrize(
    ("force", "settings"),
    [
        ("3e4*t*(1.5 - t)", {"end": 2.0}),
        ("3e4*(1 - 2*exp(-1e6*(t - 0.505)^2))", {"times": [0.505]}),
    ],
)
def test_a_force_that_pulls_after_the_full_load_or_for_a_short_time(force, settings):
    """No state has it: nothing but what leads an obstacle to the body would be in balance."""
    with pytest.raises(InputError, match="it pulls the obstacle off") as caught:
        last(pressed(**{**PLATE, **DOWN, "force": force}), steps=4, **settings)
    assert caught.value.where == "contact[0].force"


def test_round_off_of_a_force_that_is_gone_is_no_pull():
    """At its end the force is -1e-11 N."""
    states = Statics(pressed(**{**PLATE, **DOWN, "force": "3e4*(1 + cos(pi*t)) - 1e-11"}), steps=2)
    *_, state = states.steps()
    assert way(state) == pytest.approx(GAP, rel=1e-9)


@pytest.mark.parametrize(
    ("keys", "where", "said"),
    [
        ({"force": 1.0}, "direction", "needs the force and its direction"),
        ({"direction": [0, 1]}, "force", "needs the force and its direction"),
        ({**DOWN, "motion": [0, 1]}, "force", "motion and force are given together"),
        ({"force": 1.0, "direction": [0, 0]}, "direction", "cannot be zero"),
        ({"force": "x", "direction": [0, 1]}, "force", "depends on t only"),
        ({"force": "1 m", "direction": [0, 1]}, "force", "N"),
    ],
)
def test_what_is_refused(keys, where, said):
    with pytest.raises(InputError, match=said) as caught:
        Contact(on="top", **PLATE, **keys)
    assert caught.value.where == where


def test_motion_and_modes_know_no_such_obstacle():
    problem = pressed(NeoHookean(E=E, nu=NU, density=1000), **PLATE, **DOWN)
    with pytest.raises(InputError, match="in statics only") as caught:
        Dynamics(problem, end=1.0)
    assert caught.value.where == "contact[0].force"


def test_directions_and_names_that_do_not_fit():
    with pytest.raises(InputError) as caught:
        pressed(**PLATE, force=1.0, direction=[0, 0, 1])
    assert caught.value.where == "contact[0].direction"
    stamp = Contact(on="top", name="stamp", **PLATE, **DOWN)
    body, law = rectangle_body(size=(1, 1), cells=(1, 1)), NeoHookean(E=E, nu=NU)
    beside = Contact(on="left", name="stamp", plane={"axis": "x", "at": 0})
    for other in (stamp, beside):
        with pytest.raises(InputError, match=r"contact\[0\] is called 'stamp', too") as caught:
            Problem(body, law, contacts=[stamp, other], degree=1)
        assert caught.value.where == "contact[1].name"


def test_in_a_case(comm, folder):
    """`check` has the gap that is given; pictures draw the obstacle where it has gone."""
    tables = {
        "mesh": {"rectangle": {"size": [1, 1], "cells": [4, 4]}, "degree": 1},
        "materials": {"rubber": {"law": "neo-hookean", "E": E, "nu": NU}},
        "support": [{"on": "bottom"}],
        "contact": [{"on": "top", "name": "stamp", **PLATE, **DOWN, "force": "30 kN"}],
        "statics": {"steps": 2},
    }
    case = Case.from_dict(tables)
    assert Case.from_dict(case.to_dict()) == case
    found = report(case, comm=comm)
    assert found.notes == ()
    (start,) = found.contacts
    assert start.gap == pytest.approx(GAP)
    *_, state = run(case, output=folder / "out", comm=comm)
    finished = FinishedRun(folder / "out")
    for t, moved in ((0.0, GAP), (1.0, way(state))):
        ((name, _, shift),) = obstacles_of(finished, t)
        assert name == "stamp"
        np.testing.assert_allclose(shift, [0, -moved], rtol=1e-12)
    assert finished.units["obstacle_displacement_stamp"] == "m"
    assert finished.units["obstacle_force_stamp"] == "N"
