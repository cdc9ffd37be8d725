"""Runs from the command line that are stopped or killed, and go on: processes of their own."""

from __future__ import annotations

import ctypes
import os
import random
import re
import signal
import socket
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from helpers.processes import PROGRAM, cli, ranks_of, started, until
from helpers.runs import begun, case, check_same, check_same_frames, history, summary
from mpi4py import MPI

from dolfin_elastic import Case, read_case, run
from dolfin_elastic.results.checkpoint.checkpoints import FOLDER, last_step
from dolfin_elastic.results.checkpoint.lock import LOCK, FolderLease
from dolfin_elastic.results.writers.history import HistoryWriter

pytestmark = pytest.mark.skipif(
    MPI.COMM_WORLD.size > 1, reason="starts mpirun itself, which cannot be nested"
)
KILLS = int(os.environ.get("DOLFIN_ELASTIC_KILLS", "20"))
"""How often the run below is killed; by hand rather 100 times."""


def write_case(folder: Path, steps: int, **checkpoint: Any) -> None:
    """The case above in so many equal steps, on a few elements for speed."""
    small = case(
        mesh={"rectangle": {"size": [1, 0.2], "cells": [2, 1]}},
        statics={"steps": steps},
        output={"checkpoint": checkpoint},
    )
    (folder / "case.toml").write_text(small.to_toml())


def rows_written(folder: Path) -> int:
    file = folder / "case_results/history.csv"
    return max(file.read_text().count("\n") - 1, 0) if file.exists() else 0


@pytest.mark.long
@pytest.mark.parametrize("ranks", [1, 2])
def test_stopped_then_restarted(tmp_path: Path, ranks: int) -> None:
    """After the current step, with code 130 and the command that restarts it; then restarted.

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
    written = summary(tmp_path / "case_results")
    assert [(one["step"], one["ranks"]) for one in written["restarts"]] == [(last, 3 - ranks)]
    assert rows_written(tmp_path) == 151
    if ranks == 1:
        code, out, err = cli("restart", "case_results", folder=tmp_path)
        expected = "error: case_results: this run is complete; nothing is left to compute\n"
        assert (code, out, err) == (2, "", expected)


SLOW = """\
import sys, time
from dolfin_elastic.cli.app import main
from dolfin_elastic.solvers.dynamics.explicit.explicit import Explicit
from dolfin_elastic.solvers.nonlinear.convergence import ConvergenceTest
def slow(kind, name, seconds):
    method = getattr(kind, name)
    def call(*given):
        time.sleep(seconds)
        return method(*given)
    setattr(kind, name, call)
slow(ConvergenceTest, "__call__", 0.4)
slow(Explicit, "step", 0.02)
sys.argv = ["dolfin-elastic", "run", "case.toml"]
main()
"""
MOTION = {"end": "20 ms", "dt": "4 ms"}


@pytest.mark.long
@pytest.mark.parametrize("signals", [2, 1])
@pytest.mark.parametrize(
    "analysis",
    [
        {"statics": {"steps": 4}},
        {"statics": {"method": "arc-length", "first_step": 0.02}},
        {"dynamics": MOTION},
        {"dynamics": {**MOTION, "scheme": "alpha2"}},
        {"dynamics": {"end": "3 s", "scheme": "central-differences", "every": 150}},
    ],
)
def test_stopped_amid_a_step(analysis: dict[str, Any], signals: int, tmp_path: Path) -> None:
    """At the next Newton iteration, with a checkpoint of the last complete step, and restarted.

    Each iteration takes 0.4 s here and a step several; 20 explicit steps take as long.  The second
    signal changes nothing: what comes out is what comes out of a run that was never stopped.
    """
    tables: dict[str, Any] = case(
        mesh={"rectangle": {"size": [1, 0.2], "cells": [2, 1]}, "degree": 1},
        output={"checkpoint": {"time": "1 h"}},
    ).to_dict()
    del tables["statics"]
    tables["materials"]["rubber"]["density"] = 1000.0
    whole = Case.from_dict({**tables, **analysis})
    (tmp_path / "case.toml").write_text(whole.to_toml())
    folder = tmp_path / "case_results"
    with started([sys.executable, "-c", SLOW], tmp_path, 1) as process:
        until(lambda: rows_written(tmp_path) > 2, process)
        for _ in range(signals):
            time.sleep(0.6)
            process.send_signal(signal.SIGTERM)
        begin = time.monotonic()
        out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert time.monotonic() - begin < 6.0, "TS tries eight times what was interrupted"
    assert summary(folder)["status"] == "stopped"
    last = last_step(folder)
    written = int(history(folder)[-1]["step"])
    assert written > 0
    if "central" in str(analysis):  # also between two states that outputs take
        assert last > written
        assert last % 20 == 0
    else:
        assert last == written
    assert f"to go on after step {last}: dolfin-elastic restart case_results" in out
    code, out, err = cli("restart", "case_results", folder=tmp_path)
    assert code == 0, err
    for _ in run(whole, output=tmp_path / "whole"):
        pass
    found, known = history(folder), history(tmp_path / "whole")
    if "alpha2" in str(analysis):  # its steps differ a little after a restart, see the README
        assert len(found) == len(known)
        assert found[-1]["max_displacement"] == pytest.approx(
            known[-1]["max_displacement"], rel=0.02
        )
    else:
        check_same(found, known, near=1e-7)


@pytest.mark.long
def test_the_third_signal_ends_at_once(tmp_path: Path) -> None:
    """Wherever the program is, here asleep; the summary says that it was stopped."""
    write_case(tmp_path, 3000)
    module = HistoryWriter.__module__
    asleep = SLOW.replace("time.sleep(seconds)", "[time.sleep(1) for _ in range(100)]")
    asleep = asleep.replace('ConvergenceTest, "__call__"', 'HistoryWriter, "write"')
    asleep = f"from {module} import HistoryWriter\n{asleep}"
    with started([sys.executable, "-c", asleep], tmp_path, 1) as process:
        file = tmp_path / "case_results/summary.json"
        until(file.exists, process)
        for _ in range(3):
            time.sleep(0.7)
            process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=10)
    assert process.returncode == 130, err
    assert err.count("stopping") == 2
    assert summary(tmp_path / "case_results")["status"] == "stopped"


@pytest.mark.long
def test_sigusr1_makes_a_checkpoint(tmp_path: Path) -> None:
    """And the run goes on, whatever is done to it afterwards; options of solvers go on, too."""
    write_case(tmp_path, 5000, time="1 h")
    words = ["run", "case.toml", "-q", "--", "-pc_gamg_threshold", "0.1", "-ksp_tpye", "x"]
    with started([*PROGRAM, *words], tmp_path, 1) as process:
        until(lambda: rows_written(tmp_path) > 3, process)
        process.send_signal(signal.SIGUSR1)
        path = tmp_path / "case_results" / FOLDER
        until(lambda: any(path.glob("*.json")), process)
        rows = rows_written(tmp_path)
        until(lambda: rows_written(tmp_path) > rows, process)
        process.kill()
    step = int(next(path.glob("*.json")).stem.removeprefix("step_"))
    (tmp_path / "case_results/stop").touch()  # meant for the run that was killed
    rows = rows_written(tmp_path)
    with started([*PROGRAM, "restart", "case_results"], tmp_path, 1) as process:
        until(lambda: rows_written(tmp_path) > rows, process)
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert f"step {step + 1:>4}   load" in out
    assert "PETSc option '-pc_gamg_threshold' was not used" in err
    assert "PETSc options of the first run are left out, give them again: -ksp_tpye" in err


def test_a_file_that_stopped_another_run_is_forgotten(tmp_path: Path) -> None:
    write_case(tmp_path, 3)
    folder = tmp_path / "case_results"
    folder.mkdir()
    (folder / "stop").touch()
    code, out, err = cli("run", "case.toml", folder=tmp_path)
    assert code == 0, err
    assert "done: 3 steps" in out
    assert not (folder / "stop").exists()


@pytest.mark.long
def test_a_run_that_is_refused_leaves_the_stop_file_of_another(tmp_path: Path) -> None:
    """Whose run it shall end is going."""
    write_case(tmp_path, 3)
    folder = tmp_path / "case_results"
    folder.mkdir()
    with closing(FolderLease(MPI.COMM_SELF, folder)) as lock:
        lock.acquire()
        (folder / "stop").touch()
        code, _, err = cli("run", "case.toml", folder=tmp_path)
    assert code == 2
    assert "a run is still going in this folder" in err
    assert (folder / "stop").exists()


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


@pytest.mark.long
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
            for child in [*(ranks_of(process) if ranks > 1 else []), process.pid]:
                os.kill(child, signal.SIGKILL)
            process.communicate(timeout=60)
        steps.append(_newest_step(folder))
    assert steps == sorted(set(steps)), "each run gets further"
    code, _, err = cli("restart", "case_results", "-q", folder=tmp_path)
    assert code == 0, err
    check_same(history(folder), history(tmp_path / "whole"), near=1e-7)
    check_same_frames(folder, tmp_path / "whole")
    assert len(summary(folder)["restarts"]) == KILLS


def test_a_semaphore_that_a_killed_run_has_left(tmp_path: Path) -> None:
    """Open MPI's, named after a file, and taken: it stops no other run from opening such a file."""
    file, library = tmp_path / f"{tmp_path.name}-{os.getpid()}.h5", ctypes.CDLL(None)
    file.touch()
    name = f"OMPIO_{file.name}".encode()
    library.sem_open.restype = ctypes.c_void_p
    assert library.sem_open(name, os.O_CREAT, 0o600, 0)
    opens = (
        "import sys; from pathlib import Path; from mpi4py import MPI\n"
        "from dolfin_elastic.results.files import open_together\n"
        "open_together(MPI.COMM_WORLD, Path(sys.argv[1])).Close()"
    )
    try:
        subprocess.run([sys.executable, "-c", opens, file], timeout=60, check=True)
    finally:
        library.sem_unlink(name)


def _newest_step(folder: Path) -> int:
    return last_step(folder) or 0


# --- one run at a time ---

BUSY = re.compile(
    r"error: case_results: a run is still going in this folder \(process (\d+) on (\S+), since "
    r"[-0-9T:+]+\); wait for its end, or stop it: touch case_results/stop\n"
)


@pytest.mark.long
@pytest.mark.parametrize("ranks", [1, 2])
def test_a_folder_belongs_to_one_run_at_a_time(tmp_path: Path, ranks: int) -> None:
    """Neither `run` nor `restart` touches it, on any number of ranks; a killed run frees it."""
    write_case(tmp_path, 5000, every=1)
    folder = tmp_path / "case_results"
    with started([*PROGRAM, "run", "case.toml", "-q"], tmp_path, ranks) as process:
        until(lambda: _newest_step(folder) > 2, process)
        for words in (["run", "case.toml"], ["restart", "case_results"]):
            code, out, err = cli(*words, folder=tmp_path, ranks=3 - ranks)
            assert (code, out) == (2, ""), err
            busy = BUSY.match(err)  # what mpirun adds comes after
            assert busy, err
            assert busy[2] == socket.gethostname()
        rows = rows_written(tmp_path)
        until(lambda: rows_written(tmp_path) > rows, process)
        for child in [*(ranks_of(process) if ranks > 1 else []), process.pid]:
            os.kill(child, signal.SIGKILL)
        process.communicate(timeout=60)
    assert (folder / LOCK).exists()
    rows = rows_written(tmp_path)
    with started([*PROGRAM, "restart", "case_results", "-q"], tmp_path, 1) as process:
        until(lambda: rows_written(tmp_path) > rows, process)
        (folder / "stop").touch()
        _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (130, "stopping: there was a file case_results/stop\n")
    assert not (folder / LOCK).exists()


@pytest.mark.long
def test_two_that_begin_at_once(tmp_path: Path) -> None:
    """Where there is no folder yet: one of them gets it, and its results are whole."""
    write_case(tmp_path, 300, every=1)
    words = [*PROGRAM, "run", "case.toml", "-q"]
    with started(words, tmp_path, 1) as first, started(words, tmp_path, 1) as second:
        ends = {p.communicate(timeout=120)[1]: p.returncode for p in (first, second)}
    assert sorted(ends.values()) == [0, 2]
    assert ends[""] == 0
    assert all(BUSY.fullmatch(err) for err in ends if err)
    assert rows_written(tmp_path) == 301
    assert summary(tmp_path / "case_results")["status"] == "completed"


@pytest.mark.long
def test_an_explicit_motion_is_stopped_before_its_first_output(tmp_path: Path) -> None:
    """It tells of itself in a pipe, has a checkpoint of its last step, and goes on from it."""
    tables: dict[str, Any] = case(
        mesh={"rectangle": {"size": [1, 0.2], "cells": [2, 1]}, "degree": 1}
    ).to_dict()
    del tables["statics"]
    tables["materials"]["rubber"]["density"] = 1000.0
    motion = {"end": "3 s", "scheme": "central-differences", "every": 400}
    (tmp_path / "case.toml").write_text(Case.from_dict({**tables, "dynamics": motion}).to_toml())
    module = "dolfin_elastic.solvers.dynamics.explicit.explicit"
    often = SLOW.replace("main()", f"import {module} as e; e.BETWEEN = 1.0\nmain()")
    with started([sys.executable, "-c", often], tmp_path, 1) as process:
        lines = iter(process.stdout.readline, "")
        shown = next((line for line in lines if line.startswith("step")), "")
        assert shown, (process.communicate(), process.returncode)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    step = int(shown.split()[1])
    assert 0 < step < 400
    last = last_step(tmp_path / "case_results")
    assert last is not None
    assert step <= last < 400
    assert f"to go on after step {last}: dolfin-elastic restart case_results" in out
    code, out, err = cli("restart", "case_results", folder=tmp_path)
    assert code == 0, err
    assert f"going on after step {last} (t = " in err
    assert history(tmp_path / "case_results")[1]["step"] == 400
