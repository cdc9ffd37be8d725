"""Runs from the command line that are stopped or killed, and go on: processes of their own."""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mpi4py import MPI
from test_cli import PROGRAM, _ranks_of, cli, started
from test_restart import begun, case, check_same, check_same_frames, history, summary

from dolfin_elastic import read_case, run
from dolfin_elastic.results.checkpoints import FOLDER, last_step

pytestmark = pytest.mark.skipif(
    MPI.COMM_WORLD.size > 1, reason="starts mpirun itself, which cannot be nested"
)
KILLS = int(os.environ.get("DOLFIN_ELASTIC_KILLS", "6"))
"""How often the run below is killed; by hand rather 100 times."""


def write_case(folder: Path, steps: int, **checkpoint: Any) -> None:
    """The case above in so many equal steps, linear elements for speed."""
    small = case(
        mesh={"rectangle": {"size": [1, 0.2], "cells": [3, 1]}},
        statics={"steps": steps},
        output={"checkpoint": checkpoint},
    )
    (folder / "case.toml").write_text(small.to_toml())


def rows_written(folder: Path) -> int:
    file = folder / "case_results/history.csv"
    return max(file.read_text().count("\n") - 1, 0) if file.exists() else 0


def until(met: Callable[[], bool], process: Any) -> None:
    """Waits; a process that ends before is a failure."""
    end = time.monotonic() + 120
    while not met():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.parametrize("ranks", [1, 2])
def test_stopped_then_restarted(tmp_path: Path, ranks: int) -> None:
    """After the current step, with code 130, and told how to go on; then gone on with.

    A launcher that gets SIGTERM kills, but it hands SIGUSR2 on.
    """
    write_case(tmp_path, 150, time="1 h")
    with started([*PROGRAM, "run", "case.toml"], tmp_path, ranks) as process:
        until(lambda: rows_written(tmp_path) > 3, process)
        process.send_signal(signal.SIGTERM if ranks == 1 else signal.SIGUSR2)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    last = rows_written(tmp_path) - 1
    advice = f"to go on after step {last}: dolfin-elastic restart case_results\n"
    assert out.endswith(advice), (out, err)
    code, out, err = cli("restart", "case_results", folder=tmp_path, ranks=3 - ranks)
    assert code == 0, err
    assert f"going on after step {last} (load {last / 1.5:.4g} %)" in err
    assert f"step {last + 1:>4}   load" in out
    assert f"step {last:>4}   load" not in out
    assert "done: 150 steps" in out
    assert f"since step {last}\n" in out
    told = summary(tmp_path / "case_results")
    assert [(one["step"], one["ranks"]) for one in told["restarts"]] == [(last, 3 - ranks)]
    assert rows_written(tmp_path) == 151
    if ranks == 1:
        code, out, err = cli("restart", "case_results", folder=tmp_path)
        said = "error: case_results: this run is complete; nothing is left to compute\n"
        assert (code, out, err) == (2, "", said)


def test_sigusr1_makes_a_checkpoint(tmp_path: Path) -> None:
    """And the run goes on, whatever is done to it afterwards; PETSc options go on, too."""
    write_case(tmp_path, 5000, time="1 h")
    words = ["run", "case.toml", "-q", "--", "-ksp_type", "gmres", "-ksp_tpye", "x"]
    with started([*PROGRAM, *words], tmp_path, 1) as process:
        until(lambda: rows_written(tmp_path) > 3, process)
        process.send_signal(signal.SIGUSR1)
        path = tmp_path / "case_results" / FOLDER
        until(lambda: any(path.glob("*.json")), process)
        rows = rows_written(tmp_path)
        until(lambda: rows_written(tmp_path) > rows, process)
        process.kill()
    step = int(next(path.glob("*.json")).stem.removeprefix("step_"))
    (tmp_path / "case_results/stop").touch()
    code, out, err = cli("restart", "case_results", folder=tmp_path)
    assert code == 130
    assert f"step {step + 1:>4}   load" in out
    assert "PETSc option '-ksp_tpye' was not used" in err


def test_a_changed_case_file_is_told_of(tmp_path: Path) -> None:
    """The run goes on with the case as it was."""
    write_case(tmp_path, 4, every=1)
    (tmp_path / "sub").mkdir()
    begun(read_case(tmp_path / "case.toml"), tmp_path / "sub/out", 2)
    write_case(tmp_path, 9, every=1)
    code, out, err = cli("restart", "out", folder=tmp_path / "sub")
    assert code == 0, err
    assert "case.toml has been changed (statics.steps); the run goes on with the case as it" in err
    assert "done: 4 steps" in out


def test_killed_again_and_again(tmp_path: Path) -> None:
    """SIGKILL to all ranks at any moment, also amid a checkpoint: each restart goes on.

    With a checkpoint at every step a third of the time is spent on them.  Each run has other
    ranks than the one before.  What comes out is what comes out of a run that nothing has happened
    to, to the tolerance of Newton's method, for other ranks sum up in another order.
    """
    write_case(tmp_path, 100 + 10 * KILLS, every=1)
    for _ in run(read_case(tmp_path / "case.toml"), output=tmp_path / "whole"):
        pass
    chance, folder, steps = random.Random(7), tmp_path / "case_results", [0]
    for kill_number in range(KILLS):
        words = ["restart", "case_results"] if kill_number else ["run", "case.toml"]
        ranks = 1 + kill_number % 3
        with started([*PROGRAM, *words, "-q"], tmp_path, ranks) as process:
            until(lambda: _newest_step(folder) > steps[-1], process)
            time.sleep(chance.uniform(0.0, 0.2))
            for child in [*(_ranks_of(process) if ranks > 1 else []), process.pid]:
                os.kill(child, signal.SIGKILL)
            process.communicate(timeout=60)
        steps.append(_newest_step(folder))
    assert steps == sorted(set(steps)), "each run gets further"
    code, _, err = cli("restart", "case_results", "-q", folder=tmp_path)
    assert code == 0, err
    check_same(history(folder), history(tmp_path / "whole"), near=1e-7)
    check_same_frames(folder, tmp_path / "whole")
    assert len(summary(folder)["restarts"]) == KILLS


def _newest_step(folder: Path) -> int:
    return last_step(folder) or 0
