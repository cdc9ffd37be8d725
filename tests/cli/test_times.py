"""Times as people see them: without round-off, and how long a run still takes."""

from __future__ import annotations

import csv
import json
import re
import time
from pathlib import Path

import pytest
from mpi4py import MPI

from dolfin_elastic import (
    Case,
    Dynamics,
    LinearElastic,
    Problem,
    Support,
    rectangle_body,
    run,
)
from dolfin_elastic.cli.console import Estimate
from dolfin_elastic.core import timing
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.problem.state import plain

WORLD = MPI.COMM_WORLD


def square() -> Problem:
    body = rectangle_body(size=(1, 1), cells=(1, 1))
    return Problem(
        body, LinearElastic(E=1.0, nu=0.0, density=1), supports=[Support(on="left")], degree=1
    )


@pytest.mark.parametrize("scheme", ["symplectic-euler", "central-differences", "newmark"])
@pytest.mark.parametrize(("end", "dt"), [(1.0, 0.1), (0.7, 0.07), (0.25, 0.1), (0.3, 0.1)])
def test_equal_steps_have_times_without_a_sum(scheme, end, dt):
    """Each is the multiple of the step, the last one the end; a sum is off by several digits."""
    motion = Dynamics(square(), scheme=scheme, end=end, dt=dt, every=1)
    times = [state.t for state in motion.steps()]
    whole = [k * dt for k in range(int(end / dt * (1 + 1e-9)) + 1)]
    assert times == [t for t in whole if t < end * (1 - 1e-9)] + [end]


def test_files_show_no_round_off(folder: Path):
    """0.30000000000000004 of 3 x 0.1 is 0.3 in all that is written."""
    case = Case(
        mesh={"rectangle": {"size": [1, 1], "cells": [1, 1]}, "degree": 1},
        materials={"gel": {"law": "linear-elastic", "E": 1.0, "nu": 0.0, "density": 1}},
        support=[{"on": "left"}],
        dynamics={"scheme": "central-differences", "end": 0.3, "dt": 0.1, "every": 1},
    )
    *_, state = run(case, output=folder)
    assert [plain(0.1 + 0.2), plain(1.0000000000000007), plain(state.t)] == [0.3, 1.0, 0.3]

    def shown() -> tuple[list[str], list[str], float]:
        rows = list(csv.DictReader((folder / "history.csv").open()))
        series = re.findall(r'Time Value="([^"]+)"', (folder / "results.xdmf").read_text())
        return (
            [r["t"] for r in rows],
            series,
            json.loads((folder / "summary.json").read_text())["t"],
        )

    times = ["0.0", "0.1", "0.2", "0.3"]
    assert on_root(WORLD, shown) == (times, times, 0.3)


def test_compilation_is_not_counted_among_the_steps(monkeypatch):
    """80 s for meshes and forms and then 1 s for each of ten steps: 8 s after the second."""
    clock = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: clock[0])
    with timing.timed():
        estimate = Estimate()
        with timing.stage("mesh"):
            clock[0] += 30.0
        with timing.stage("assemble"), timing.stage("compile"):
            clock[0] += 40.0
        clock[0] += 5.0  # what else is done before the first state
        shown = [estimate.left(0.0)]
        for step in (1, 2, 3):
            clock[0] += 1.0
            if step == 1:
                with timing.stage("compile"):
                    clock[0] += 10.0
            shown.append(estimate.left(step / 10))
    assert shown == ["", "  0:09 left", "  0:08 left", "  0:07 left"]


def test_a_restart_judges_by_its_own_steps(monkeypatch):
    """Nothing is known at its first state; then by what has been done since."""
    clock = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: clock[0])
    with timing.timed():
        estimate = Estimate()
        clock[0] = 100.0
        shown = [estimate.left(0.5)]
        clock[0] = 102.0
        shown.append(estimate.left(0.6))
    assert shown == ["", "  0:08 left"]


def test_no_time_is_told_that_may_be_twice_as_long(monkeypatch):
    """A first step that is hard, 14 s for 0.04 %, as the duck's; then 20 % in 9 s each."""
    clock = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: clock[0])
    with timing.timed():
        estimate = Estimate()
        shown = [estimate.left(0.0)]
        for seconds, done in ((14.0, 0.0004), (9.0, 0.2), (9.0, 0.4), (9.0, 0.6), (9.0, 0.8)):
            clock[0] += seconds
            shown.append(estimate.left(done))
    assert shown[:3] == ["", "", ""]
    left = [60.0 * int(t.split(":")[0]) + int(t.split(":")[1][:2]) for t in shown[3:]]
    for told, really in zip(left, (27.0, 18.0, 9.0), strict=True):
        assert really / 2 <= told <= 2 * really


def test_explicit_states_at_times():
    """The first state at or after each 0.1 s, and the end; steps of 0.03 s meet none of them."""
    motion = Dynamics(square(), scheme="central-differences", end=0.35, dt=0.03, every="100 ms")
    assert [round(state.t, 12) for state in motion.steps()] == [0.0, 0.12, 0.21, 0.3, 0.35]
