"""An exception on one rank of a user's Python ends all ranks, within ten seconds, with his text."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import pytest
from helpers.processes import started, until
from helpers.runs import case
from mpi4py import MPI

from dolfin_elastic.results.checkpoint.checkpoints import last_step

pytestmark = pytest.mark.skipif(
    MPI.COMM_WORLD.size > 1, reason="starts mpirun itself, which cannot be nested"
)
LONGEST = 10.0
"""Seconds from an exception on one rank to the end of all."""
HEAD = """\
from mpi4py import MPI
from dolfin_elastic import read_case, run
comm = MPI.COMM_WORLD
def fail():
    import time
    with open("failed", "w") as file:
        file.write(str(time.time()))
    raise KeyError("a fault of the user")
case = read_case("case.toml")
"""
AWAIT_LOAD = """\
    import os, time
    open("about", "w").close()
    while not os.path.exists("loaded"):
        time.sleep(0.01)
"""
LOOP = """
for state in run(case):
    if state.step == 2 and comm.rank == 1:
        fail()
"""
OTHERS_WAIT = """
for state in run(case):
    if state.step == 2 and comm.rank == 1:
        fail()
    comm.barrier()
"""
CLOSING = """
from contextlib import closing
with closing(run(case)) as states:
    for state in states:
        if state.step == 2 and comm.rank == 1:
            fail()
"""
CAUGHT = """
try:
    for state in run(case):
        if state.step == 2 and comm.rank == 1:
            fail()
except KeyError:
    pass
comm.barrier()
"""
ENDED = """
import sys, traceback
states = run(case)
for state in states:
    if state.step == 2 and comm.rank == 1:
        try:
            fail()
        except KeyError:
            traceback.print_exc()
            sys.exit(0)
"""
OUTPUT = """
import dolfin_elastic.results.writers.history as history
class Own(history.HistoryWriter):
    def write(self, state):
        if state.step == 2 and comm.rank == 1:
            fail()
        super().write(state)
import dolfin_elastic.results.outputs as outputs
outputs.HistoryWriter = history.HistoryWriter = Own
for state in run(case):
    pass
"""
ENERGY = """
from dolfin_elastic import Problem, Statics, Support, box_body
from dolfin_elastic import NeoHookean
class Own(NeoHookean):
    def energy(self, F):
        if comm.rank == 1:
            fail()
        return super().energy(F)
body = box_body(size=(1, 1, 1), cells=(2, 2, 2))
problem = Problem(body, Own(E=1e6, nu=0.3), supports=[Support(on="left")])
for state in Statics(problem, steps=1).steps():
    pass
"""

PARTS = """
from dolfin_elastic import Buckling, Dynamics, Modal, NeoHookean, Problem, Statics, Support
from dolfin_elastic import Traction, box_body
def bar(**more):
    body = box_body(size=(1, 0.1, 0.1), cells=(4, 1, 1))
    return Problem(body, NeoHookean(E=1e6, nu=0.3, density=1e3), supports=[Support(on="left")],
                   loads=[Traction(on="right", value=[-50, 0, -20])], **more)
"""
CURVE = (
    PARTS
    + """
def now(t):
    if t > 0.4 and comm.rank == 1:
        fail()
    return t
body = box_body(size=(1, 0.1, 0.1), cells=(4, 1, 1))
problem = Problem(body, NeoHookean(E=1e6, nu=0.3), supports=[Support(on="left")],
                  loads=[Traction(on="right", value=[-50, 0, -20], curve=now)])
solver = Statics(problem)
solver.advance(0.3)
solver.advance(0.6)
"""
)
STATES = """
for state in {states}:
    if state.step == 2 and comm.rank == 1:
        fail()
"""
SOLVERS = {
    "statics": "Statics(bar(), steps=4).steps()",
    "direct": 'Statics(bar(), steps=4, petsc={"pc_type": "lu"}).steps()',
    "implicit": "Dynamics(bar(), end=1.0, dt=1e-3).steps()",
    "alpha2": 'Dynamics(bar(), end=1.0, dt=1e-3, scheme="alpha2").steps()',
    "explicit": 'Dynamics(bar(degree=1), end=1.0, scheme="central-differences", every=1).steps()',
    "preload": "Modal(bar(), preload=True, statics=StaticsSettings(steps=4)).steps()",
}
MODES = """
for mode in {modes}:
    if mode.number == 2 and comm.rank == 1:
        fail()
"""
MODE_SOLVERS = {
    "modal": "Modal(bar(), count=4).modes()",
    "steps": "Modal(bar(), count=4).steps()",
    "buckling": "Buckling(bar(), count=4).modes()",
}
IN_THE_SOLVER = """
import dolfin_elastic.solvers.nonlinear.convergence as convergence
test = convergence.ConvergenceTest.__call__
def failing(self, snes, iteration, norms):
    if comm.rank == 1 and iteration == 1:
        fail()
    return test(self, snes, iteration, norms)
convergence.ConvergenceTest.__call__ = failing
for state in {states}:
    pass
"""


def small(folder: Path) -> None:
    made = case(mesh={"rectangle": {"size": [1, 0.2], "cells": [2, 1]}}, statics={"steps": 40})
    (folder / "case.toml").write_text(made.to_toml())


@pytest.mark.long
@pytest.mark.parametrize("body", [LOOP, OTHERS_WAIT, CLOSING, CAUGHT, ENDED, OUTPUT, ENERGY, CURVE])
def test_all_ranks_end(body: str, tmp_path: Path) -> None:
    """Also where the others wait for it in a call of the user's own."""
    assert seconds_to_the_end(body, tmp_path) < LONGEST


@pytest.mark.long
@pytest.mark.parametrize("solver", SOLVERS)
def test_all_ranks_end_without_a_case(solver: str, tmp_path: Path) -> None:
    """In the loop over the states of a solver that no case describes."""
    setting = "from dolfin_elastic.solvers.statics.settings import StaticsSettings\n"
    body = setting + PARTS + STATES.format(states=SOLVERS[solver])
    assert seconds_to_the_end(body, tmp_path) < LONGEST


@pytest.mark.long
@pytest.mark.parametrize("solver", MODE_SOLVERS)
def test_all_ranks_end_among_modes(solver: str, tmp_path: Path) -> None:
    assert seconds_to_the_end(PARTS + MODES.format(modes=MODE_SOLVERS[solver]), tmp_path) < LONGEST


@pytest.mark.long
@pytest.mark.parametrize("solver", ["direct", "implicit"])
def test_all_ranks_end_amid_a_step(solver: str, tmp_path: Path) -> None:
    """Where a function that PETSc calls fails on one rank: factors are freed by all together."""
    body = PARTS + IN_THE_SOLVER.format(states=SOLVERS[solver])
    assert seconds_to_the_end(body, tmp_path) < LONGEST


@pytest.mark.long
@pytest.mark.parametrize("body", [LOOP, OTHERS_WAIT, ENERGY])
def test_all_ranks_end_under_load(body: str, tmp_path: Path) -> None:
    """Where four other processes want each core of this machine, from just before the exception."""
    assert seconds_to_the_end(body, tmp_path, load=True) < LONGEST


@contextmanager
def busy_cores() -> Iterator[None]:
    busy = [sys.executable, "-uc", "print()\nwhile True: pass"]
    number = 4 * len(os.sched_getaffinity(0))
    others = [subprocess.Popen(busy, stdout=subprocess.PIPE) for _ in range(number)]
    try:
        for other in others:
            assert other.stdout is not None
            other.stdout.readline()
        yield
    finally:
        for other in others:
            other.kill()
            other.communicate()


def seconds_to_the_end(body: str, folder: Path, load: bool = False) -> float:
    """Time from the exception on one rank to the end of the launcher [s]."""
    small(folder)
    head = HEAD.replace("    import time\n", AWAIT_LOAD) if load else HEAD
    (folder / "script.py").write_text(head + body)
    with started([sys.executable, "script.py"], folder, 2) as process:
        if load:
            until((folder / "about").exists, process)
        with busy_cores() if load else nullcontext():
            (folder / "loaded").touch()
            _, err = process.communicate(timeout=120)
            end = time.time()
    assert process.returncode != 0
    assert "KeyError: 'a fault of the user'" in err
    assert "in fail" in err
    seconds = end - float((folder / "failed").read_text())
    print(f"{seconds:.3g} s")
    return seconds


@pytest.mark.long
def test_a_loop_that_all_leave(tmp_path: Path) -> None:
    """A `break` is no fault: a checkpoint is left, however late one rank is; exit code 0."""
    small(tmp_path)
    late = """
import time
for state in run(case):
    if state.step == 3:
        time.sleep(6.0 * comm.rank)
        break
"""
    (tmp_path / "script.py").write_text(HEAD + late)
    with started([sys.executable, "script.py"], tmp_path, 2) as process:
        _, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert last_step(tmp_path / "case_results") == 3
