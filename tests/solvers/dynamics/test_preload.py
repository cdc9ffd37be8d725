"""Motion that starts from a static equilibrium."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import (
    Case,
    Contact,
    Dynamics,
    Gravity,
    LinearElastic,
    NeoHookean,
    Problem,
    Statics,
    Support,
    Traction,
    rectangle_body,
    run,
)
from dolfin_elastic.case.check.report import report
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import largest, total

SOUND, LENGTH = 10.0, 1.0
LAW = LinearElastic(E=1e5, nu=0.0, density=1000)
PERIOD = 4 * LENGTH / SOUND
"""Of a bar that is held at one end, with the speed of sound sqrt(E/density)."""
STEP = PERIOD / 400
PULLED = 2e-3
"""Strain of the bar before it is released."""
SCHEMES: list[dict[str, Any]] = [
    {"scheme": "energy-momentum", "dt": STEP},
    {"scheme": "symplectic-euler"},
]


def bar(comm: MPI.Comm, law: Any, loads: list[Any], cells: int = 40) -> Problem:
    body = rectangle_body(size=[LENGTH, 0.05], cells=[cells, 1], comm=comm)
    return Problem(body, law, supports=[Support(on="left")], loads=loads, degree=1)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda keys: str(keys["scheme"]))
def test_a_hanging_bar_stays_at_rest(comm: MPI.Comm, scheme: dict[str, Any]) -> None:
    """Under its weight, to round-off; of a curve its value at t = 0 acts, a formula at t = 0."""
    law = NeoHookean(E=1e5, nu=0.3, density=1000)
    loads = [
        Gravity(value=[0.5, 0]),
        Traction(on="right", value=[100.0, 0], curve=[[0, 2], [1, 2]]),
        Traction(on="right", value=["50*cos(0*t)", 0]),
    ]
    problem = bar(comm, law, loads, cells=8)
    states = Dynamics(problem, end=20 * STEP, preload=True, every=5, **scheme).steps()
    first = next(states)
    start = problem.u.x.array.copy()
    assert first.max_displacement > 1e-3
    for state in states:
        assert largest(comm, float(np.max(np.abs(problem.u.x.array - start)))) < 1e-10
        assert state.v is not None
        assert largest(comm, float(np.max(np.abs(state.v.x.array)))) < 1e-9
    same = bar(comm, law, [loads[0], Traction(on="right", value=[250.0, 0])], cells=8)
    *_, known = Statics(same).steps()
    assert first.max_displacement == pytest.approx(known.max_displacement, rel=1e-9)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda keys: str(keys["scheme"]))
def test_a_bar_that_is_released(comm: MPI.Comm, scheme: dict[str, Any]) -> None:
    """Its end moves along a triangular wave between the static displacement and its opposite.

    Held at x = 0, pulled by E times a strain and let go: u(L, t) = strain L (1 - 4 |t|/T) for
    |t| < T/2, with T = 4 L/c.
    """
    curve = [[0, 1], [1e-9, 0]]
    problem = bar(comm, LAW, [Traction(on="right", value=[PULLED * 1e5, 0], curve=curve)])
    x = problem.V.tabulate_dof_coordinates()
    end = np.flatnonzero(x[: problem.V.dofmap.index_map.size_local, 0] > LENGTH - 1e-9)
    found = []
    for state in Dynamics(problem, end=PERIOD, preload=True, every=20, **scheme).steps():
        tips = problem.u.x.array.reshape(-1, 2)[end, 0]
        tip = total(comm, float(np.sum(tips))) / total(comm, len(end))
        found.append((state.t, tip / (PULLED * LENGTH)))
    times, tips = np.array(found).T
    wave = np.abs(4 * times / PERIOD - 2) - 1
    assert tips[0] == pytest.approx(1.0, rel=1e-9)
    assert np.max(np.abs(tips - wave)) < 0.06  # the corners of the wave have no highest frequency
    assert np.mean(np.abs(tips - wave)) < 0.02


def case(**motion: Any) -> Case:
    tables = {
        "mesh": {"rectangle": {"size": [1, 0.1], "cells": [8, 1]}},
        "materials": {"rubber": {"law": "neo-hookean", "E": 1e5, "nu": 0.3, "density": 1000}},
        "support": [{"on": "left"}],
        "load": [{"kind": "gravity", "value": [0, -0.01]}],
        "dynamics": {"end": "0.2 s", "dt": "20 ms", "preload": True, **motion},
    }
    return Case.from_dict(tables, file="case.toml")


def test_in_a_case(folder: Any, comm: MPI.Comm) -> None:
    """With or without [statics]; check sees what the equilibrium needs."""
    alone = list(run(case(), output=folder / "a", comm=comm))
    assert alone[0].max_displacement == pytest.approx(alone[-1].max_displacement, rel=1e-8)
    tables = {**case().to_dict(), "statics": {"steps": 2, "end": 1.5}}
    both = Case.from_dict(tables, file="case.toml")
    *_, last = run(both, output=folder / "b", comm=comm)
    assert last.max_displacement == pytest.approx(alone[0].max_displacement, rel=1e-8)
    free = Case.from_dict({**case().to_dict(), "support": []}, file="case.toml")
    with pytest.raises(InputError, match="there is no support"):
        report(free, comm=comm)


def test_what_does_not_go_with_it() -> None:
    with pytest.raises(InputError, match="dynamics.initial_displacement: the motion starts from"):
        case(initial_displacement=[0, 0])
    relaxing = case().to_dict()
    relaxing["materials"]["rubber"] |= {"law": "linear-elastic", "prony": [{"g": 0.2, "tau": 1.0}]}
    with pytest.raises(InputError, match="dynamics.preload: materials that depend on time"):
        report(Case.from_dict(relaxing, file="case.toml"))


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda keys: str(keys["scheme"]))
def test_a_block_that_lies_on_an_obstacle_stays_at_rest(
    comm: MPI.Comm, scheme: dict[str, Any], caplog: pytest.LogCaptureFixture
) -> None:
    """The equilibrium has the contact law of motion: the penalty alone, a tenth of that of statics.

    A column of the height h and the weight q on the area has the depth q/eps.
    """
    problem = Problem(
        rectangle_body(size=[0.2, 0.2], cells=[2, 2], comm=comm),
        NeoHookean(E=1e5, nu=0.3, density=1000),
        supports=[Support(on="left", displacement=[0, "free"])],
        loads=[Gravity(value=[0, -10.0])],
        contacts=[Contact(on="bottom", name="floor", plane={"axis": "y", "at": 0}, stiffness=1e6)],
        degree=1,
    )
    states = Dynamics(problem, end=20 * STEP, preload=True, every=5, **scheme).steps()
    first = next(states)
    start = problem.u.x.array.copy()
    assert first.numbers["penetration_floor"] == pytest.approx(2000 / 1e6, rel=0.2)
    for state in states:
        assert largest(comm, float(np.max(np.abs(problem.u.x.array - start)))) < 1e-10
        assert state.v is not None
        assert largest(comm, float(np.max(np.abs(state.v.x.array)))) < 1e-9
    assert not [record for record in caplog.records if "throws it off" in record.message]
