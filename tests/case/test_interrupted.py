"""Ctrl-C in a program of the user's: KeyboardInterrupt on all ranks, and a run that can go on."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from helpers.runs import case, check_same, history, summary
from mpi4py import MPI

from dolfin_elastic import (
    Buckling,
    Dynamics,
    Modal,
    NeoHookean,
    Problem,
    Statics,
    Support,
    Traction,
    rectangle_body,
    restart,
    run,
)
from dolfin_elastic.core import signals
from dolfin_elastic.results.checkpoint.checkpoints import last_step
from dolfin_elastic.solvers.dynamics.explicit.explicit import Explicit
from dolfin_elastic.solvers.eigen import slepc
from dolfin_elastic.solvers.eigen.lobpcg import Lobpcg
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.solvers.nonlinear.convergence import ConvergenceTest

WORLD = MPI.COMM_WORLD
AT, LAST = 0.3, 0.6
"""Time or load factor from which Ctrl-C comes, and of a state that must not come any more."""
MOTION = {"end": 1.0, "dt": 0.05}
EXPLICIT = {"end": 1.0, "scheme": "central-differences", "every": "0.05 s"}


@pytest.fixture(autouse=True)
def _handler(monkeypatch: pytest.MonkeyPatch):
    """The handlers of before are there again: Python's own, whatever commands have left."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    monkeypatch.setattr(signals, "_current", [])
    yield
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert not signals.watched()


def interrupting(
    monkeypatch: pytest.MonkeyPatch,
    kind: Any,
    name: str,
    now: Callable[[Any], bool],
    times: int = 1,
) -> None:
    """Sends Ctrl-C to the last rank alone, as often as asked, the first time that it is due.

    Args:
        monkeypatch: Of the test.
        kind: Class or module.
        name: What is called while a solver works.
        now: Whether it is due, from the first argument.
        times: How often Ctrl-C is sent.
    """
    before, sent = getattr(kind, name), []

    def call(*given: Any) -> Any:
        if WORLD.rank == WORLD.size - 1 and not sent and now(given[0]):
            for _ in range(times):
                sent.append(1)
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.6 * (times > 1))
        return before(*given)

    monkeypatch.setattr(kind, name, call)


def newton_at(test: ConvergenceTest) -> bool:
    return float(test._assembler.problem.t.value) > AT


def explicit_at(motion: Explicit) -> bool:
    return float(motion.scheme.t) > AT


ANALYSES: dict[str, tuple[dict[str, Any], Any, str, Callable[[Any], bool]]] = {
    "statics": ({"statics": {"steps": 20}}, ConvergenceTest, "__call__", newton_at),
    "implicit": ({"dynamics": MOTION}, ConvergenceTest, "__call__", newton_at),
    "explicit": ({"dynamics": EXPLICIT}, Explicit, "step", explicit_at),
    "rare": ({"dynamics": {**EXPLICIT, "every": "1 s"}}, Explicit, "step", explicit_at),
}


def analysed(name: str) -> Any:
    more = ANALYSES[name][0]
    if "dynamics" not in more:
        return case(**more)
    density = 1e6 if name == "implicit" else 1e3
    rubber = {"law": "neo-hookean", "E": "1 MPa", "nu": 0.3, "density": density}
    mesh = {"rectangle": {"size": [1, 0.2], "cells": [5, 1]}, "degree": 1}
    return case(materials={"rubber": rubber}, mesh=mesh, statics=None, **more)


@pytest.mark.parametrize("name", ANALYSES)
def test_a_run(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is stopped amid a step, with a checkpoint; `restart` goes on to the same end."""
    _, *where = ANALYSES[name]
    times = [state.t for state in run(analysed(name), output=folder / "whole")]
    met = []
    with monkeypatch.context() as patch:
        interrupting(patch, *where)
        with pytest.raises(KeyboardInterrupt):
            for state in run(analysed(name), output=folder / "stopped"):
                met.append(state.t)
    assert name == "rare" or met[-1] > AT - 0.1
    assert met[-1] < LAST
    assert met == times[: len(met)], "states between those that were asked for are for commands"
    assert summary(folder / "stopped")["status"] == "stopped"
    last = last_step(folder / "stopped")
    assert last
    assert last >= summary(folder / "stopped")["steps"]
    rest = [state.t for state in restart(folder / "stopped")]
    assert rest[-1] == times[-1]
    assert summary(folder / "stopped")["status"] == "completed"
    check_same(history(folder / "stopped"), history(folder / "whole"))


def bar(degree: int = 1) -> Problem:
    """The strip of the cases, whose forms are compiled, under a small load."""
    return Problem(
        rectangle_body(size=(1, 0.2), cells=(5, 1)),
        NeoHookean(E=1e6, nu=0.3, density=1e3),
        supports=[Support(on="left")],
        loads=[Traction(on="right", value=[-50.0, -20.0])],
        degree=degree,
    )


LOOPS: dict[str, tuple[Callable[[], Any], Any, str, Callable[[Any], bool]]] = {
    "statics": (lambda: Statics(bar(2), steps=20).steps(), ConvergenceTest, "__call__", newton_at),
    "implicit": (lambda: Dynamics(bar(), **MOTION).steps(), ConvergenceTest, "__call__", newton_at),
    "alpha2": (
        lambda: Dynamics(bar(), scheme="alpha2", **MOTION).steps(),
        ConvergenceTest,
        "__call__",
        newton_at,
    ),
    "explicit": (lambda: Dynamics(bar(), **EXPLICIT).steps(), Explicit, "step", explicit_at),
    "modal": (lambda: Modal(bar(), count=2).modes(), slepc, "_stops", lambda eps: True),
    "modal without factors": (
        lambda: Modal(bar(), count=2, linear=LinearSettings(method="iterative")).modes(),
        Lobpcg,
        "_take_residuals",
        lambda block: True,
    ),
    "buckling": (lambda: Buckling(bar(), count=2).modes(), slepc, "_stops", lambda eps: True),
}


@pytest.mark.parametrize("name", LOOPS)
def test_a_loop_over_states(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a case there is nothing to save, but the exception is Python's own on all ranks."""
    make, *where = LOOPS[name]
    interrupting(monkeypatch, *where)
    met = []
    with pytest.raises(KeyboardInterrupt):
        met += list(make())
    assert met == []  # the list was not made


def test_after_the_last_state(monkeypatch: pytest.MonkeyPatch) -> None:
    """A request that comes too late for the solver to hear it is not lost."""
    states = Statics(bar(2), steps=2).steps()
    interrupting(monkeypatch, Statics, "_forget", lambda statics: True)
    with pytest.raises(KeyboardInterrupt):
        list(states)


def test_a_second_time_at_once(folder: Path, serial_only: None, monkeypatch) -> None:
    """Amid a function that PETSc calls; the results say that they were stopped."""
    _, *where = ANALYSES["implicit"]
    interrupting(monkeypatch, *where, times=2)
    with pytest.raises(KeyboardInterrupt):
        list(run(analysed("implicit"), output=folder / "stopped"))
    assert summary(folder / "stopped")["status"] == "stopped"


def test_in_the_body_of_the_loop(folder: Path) -> None:
    """Python's own handler is there: the run is closed with a checkpoint."""
    with pytest.raises(KeyboardInterrupt):
        for state in run(analysed("implicit"), output=folder / "stopped"):
            if state.step == 3:
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(1.0)
    assert last_step(folder / "stopped") == 3
    assert summary(folder / "stopped")["status"] == "stopped"


def test_a_handler_of_the_user(monkeypatch: pytest.MonkeyPatch) -> None:
    """It stays in force, and the motion goes on."""
    heard = []
    before = signal.signal(signal.SIGINT, lambda *_: heard.append(1))
    try:
        interrupting(monkeypatch, ConvergenceTest, "__call__", newton_at)
        states = list(Dynamics(bar(), **MOTION).steps())
    finally:
        signal.signal(signal.SIGINT, before)
    assert states[-1].done == 1.0
    assert WORLD.allreduce(len(heard)) == 1
