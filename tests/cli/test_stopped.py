"""A request to stop counts at once, wherever a run is: processes of their own, and signals."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from helpers.processes import PROGRAM, cli, ranks_of, started, until
from helpers.runs import case, summary
from mpi4py import MPI

from dolfin_elastic import Case
from dolfin_elastic.results.checkpoint.checkpoints import last_step

pytestmark = [
    pytest.mark.skipif(
        MPI.COMM_WORLD.size > 1, reason="starts mpirun itself, which cannot be nested"
    ),
    pytest.mark.long,
]
AT_ONCE = 10.0
"""Seconds from the signal to the end of the process, which closes its files meanwhile.

Twice what it takes on a machine that is busy with other tests.
"""

SLOW = """\
import sys, time
from pathlib import Path
from dolfin_elastic.cli.app import main
{imports}
def slow(kind, name, seconds):
    method = getattr(kind, name)
    def call(*given, **more):
        Path("there").touch()
        time.sleep(seconds)
        return method(*given, **more)
    setattr(kind, name, call)
{patches}
sys.argv = ["dolfin-elastic", *{words}]
main()
"""
NEWTON = "from dolfin_elastic.solvers.nonlinear.convergence import ConvergenceTest"
FLOW = "from dolfin_elastic.solvers.statics import retry"
SLEPC = "from dolfin_elastic.solvers.eigen import slepc"
NEVER = """
test = ConvergenceTest.__call__
def never(self, snes, iteration, norms):
    found = test(self, snes, iteration, norms)
    if self._assembler.problem.t.value < 0.3 or found < 0:
        return found
    Path("there").touch()
    time.sleep(0.05)
    return 0 if iteration < 20 else -5  # DIVERGED_MAX_IT
ConvergenceTest.__call__ = never
"""
"""No iteration converges any more from a load factor of 0.3 on: trials follow on trials."""


def program(imports: str, patches: str, *words: str) -> list[str]:
    """A program in which something takes long, and makes a file "there" each time."""
    text = SLOW.format(imports=imports, patches=patches, words=list(words))
    return [sys.executable, "-c", text]


def small(**tables: Any) -> Case:
    mesh = {"rectangle": {"size": [1, 0.2], "cells": [2, 1]}}
    return case(**{"mesh": mesh, "output": {"checkpoint": {"time": "1 h"}}, **tables})


def modes(kind: str, **settings: Any) -> Case:
    tables = small(mesh={"rectangle": {"size": [1, 0.2], "cells": [20, 4]}}).to_dict()
    del tables["statics"], tables["output"]
    tables[kind] = settings
    tables["materials"]["rubber"]["density"] = 1000.0
    if kind == "modal":
        del tables["load"]
    return Case.from_dict(tables)


def stopped(process: Any, signals: int, number: int = signal.SIGTERM) -> tuple[str, str]:
    """Stops a process, which must end at once with code 130; what it has printed."""
    for _ in range(signals):
        time.sleep(0.6)
        process.send_signal(number)
    begin = time.monotonic()
    try:
        out, err = process.communicate(timeout=30)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    assert process.returncode == 130, f"{out}\n{err}"
    assert time.monotonic() - begin < AT_ONCE
    assert "Traceback" not in err
    return out, err


ARCH = """\
Point(1) = {0, 0, 0}; Point(2) = {1, 0.2, 0}; Point(3) = {1, 0.23, 0}; Point(4) = {0, 0.03, 0};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4}; Plane Surface(1) = {1};
Transfinite Curve {1, 3} = 9; Transfinite Curve {2, 4} = 2; Transfinite Surface {1};
Physical Curve("left") = {4}; Physical Curve("right") = {2}; Physical Surface("beam") = {1};
"""
"""Half of a shallow arch, which snaps through."""

LONG = {
    "trials": (small(statics={"max_step": 0.1}), NEWTON, NEVER),
    "flow": (
        small(
            mesh={"file": "arch.geo"},
            support=[{"on": "left"}, {"on": "right", "displacement": [0, "free"]}],
            load=[{"kind": "traction", "on": "right", "value": [0, "-1 kPa"]}],
            statics={"max_step": 0.25},
            output={"checkpoint": {"time": "1 h"}},
        ),
        FLOW,
        "slow(retry._Shift, '__call__', 0.4)",
    ),
}


@pytest.mark.parametrize("signals", [2, 1])
@pytest.mark.parametrize("where", LONG)
def test_in_statics(where: str, signals: int, tmp_path: Path) -> None:
    """Amid trial after trial of a step, and in the flow to another equilibrium.

    A checkpoint of the last complete step is left, from which a restart goes on.  The flow finds
    no equilibrium of this arch, whether it was stopped or not.
    """
    whole, imports, patches = LONG[where]
    (tmp_path / "arch.geo").write_text(ARCH)
    (tmp_path / "case.toml").write_text(whole.to_toml())
    folder = tmp_path / "case_results"
    with started(program(imports, patches, "run", "case.toml"), tmp_path, 1) as process:
        until((tmp_path / "there").exists, process)
        out, _ = stopped(process, signals)
    assert summary(folder)["status"] == "stopped"
    last = last_step(folder)
    assert last is not None
    assert last == summary(folder)["steps"] > 0
    assert f"to go on after step {last}: dolfin-elastic restart case_results" in out
    code, out, err = cli("restart", "case_results", folder=tmp_path)
    assert code == {"trials": 0, "flow": 3}[where], err
    assert f"going on after step {last} " in err


@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize("kind", ["modal", "buckling"])
def test_in_slepc(kind: str, ranks: int, tmp_path: Path) -> None:
    """After a restart of Krylov-Schur, which here would go on for ever."""
    (tmp_path / "case.toml").write_text(modes(kind, count=1).to_toml())
    words = ["run", "case.toml", "--", "-eps_tol", "1e-60", "-eps_max_it", "100000000"]
    command = program(SLEPC, "slow(slepc, '_stops', 0.2)", *words)
    with started(command, tmp_path, ranks) as process:
        until((tmp_path / "there").exists, process)
        stopped(process, 1, signal.SIGTERM if ranks == 1 else signal.SIGUSR2)
    assert not (tmp_path / "case_results").exists(), "no mode was found yet"


@pytest.mark.parametrize("signals", [2, 1])
def test_converge(signals: int, tmp_path: Path) -> None:
    """The results of the last complete mesh stay, and say that more were to come."""
    (tmp_path / "case.toml").write_text(small(statics={"steps": 2}).to_toml())
    words = ["converge", "case.toml", "--until", "strain_energy", "0.0001%"]
    command = program(NEWTON, "slow(ConvergenceTest, '__call__', 0.3)", *words)
    folder = tmp_path / "case_converged"
    with started(command, tmp_path, 1) as process:
        until((folder / "converge.json").exists, process)
        out, _ = stopped(process, signals)
    report = json.loads((folder / "converge.json").read_text())
    assert (report["verdict"], len(report["meshes"])) == ("stopped", 1)
    assert "stopped on request" in out
    written = summary(folder)
    assert (written["status"], written["dofs"]) == ("stopped", report["meshes"][0]["unknowns"])
    with started([*PROGRAM, *words], tmp_path, 1) as process:
        until((folder / ".lock").exists, process)
        while process.poll() is None:  # once may be too early: what an earlier user left is removed
            (folder / "stop").touch()
            time.sleep(0.05)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert f"there was a file {folder.name}/stop" in err


@pytest.mark.parametrize("ranks", [1, 2])
def test_while_gmsh_meshes(ranks: int, tmp_path: Path, monkeypatch) -> None:
    """A script without an end; its process ends, too, and its folder is removed."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    box = 'SetFactory("OpenCASCADE");\nBox(1) = {0, 0, 0, 1, 1, 1};\n'
    (tmp_path / "a.geo").write_text(f"{box}For i In {{1:1e18}}\n x = i;\nEndFor\n")
    (tmp_path / "case.toml").write_text(small(mesh={"file": "a.geo"}).to_toml())
    with started([*PROGRAM, "run", "case.toml"], tmp_path, ranks) as process:
        until(lambda: bool(gmsh(tmp_path)), process)
        stopped(process, 1, signal.SIGTERM if ranks == 1 else signal.SIGUSR2)
    assert not gmsh(tmp_path)
    assert not [*tmp_path.glob("dolfin_elastic-gmsh-*")]
    assert not (tmp_path / "case_results").exists()


@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGHUP])
def test_check_while_gmsh_meshes(sent: signal.Signals, tmp_path: Path, monkeypatch) -> None:
    """A command without results leaves nothing behind either."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    (tmp_path / "a.geo").write_text("For i In {1:1e18}\n x = i;\nEndFor\n")
    (tmp_path / "case.toml").write_text(small(mesh={"file": "a.geo"}).to_toml())
    with started([*PROGRAM, "check", "case.toml"], tmp_path, 1) as process:
        until(lambda: bool(gmsh(tmp_path)), process)
        stopped(process, 1, sent)
    assert not gmsh(tmp_path)
    assert not [*tmp_path.glob("dolfin_elastic-gmsh-*")]


@pytest.mark.parametrize("ignored", [False, True])
def test_a_terminal_that_is_closed(ignored: bool, tmp_path: Path) -> None:
    """SIGHUP stops a run in order, unless nohup has told it to go on."""
    patches = f'slow(ConvergenceTest, "__call__", {0.1 if ignored else 0.4})'
    words = program(NEWTON, patches, "run", "case.toml")
    (tmp_path / "case.toml").write_text(small().to_toml())
    with started([*(["nohup"] if ignored else []), *words], tmp_path, 1) as process:
        until((tmp_path / "there").exists, process)
        process.send_signal(signal.SIGHUP)
        process.communicate(timeout=60)
    assert process.returncode == (0 if ignored else 130)
    status = summary(tmp_path / "case_results")["status"]
    assert status == ("completed" if ignored else "stopped")


def gmsh(folder: Path) -> list[int]:
    """Processes of Gmsh whose private folder is in this one."""
    found = []
    for link in Path("/proc").glob("[0-9]*/cwd"):
        with suppress(OSError):
            if folder in link.readlink().parents:
                found.append(int(link.parent.name))
    return found


@pytest.mark.parametrize(("ranks", "by_file"), [(1, False), (2, False), (1, True), (2, True)])
def test_while_a_form_is_compiled(ranks: int, by_file: bool, tmp_path: Path, monkeypatch) -> None:
    """By a C compiler whose own process takes an hour; nothing is left, in the cache neither.

    The folder of results is there for the file: it is of an older run.
    """
    compiler, folder = tmp_path / "cc", tmp_path / "case_results"
    compiler.write_text(f"#!/bin/sh\nsleep 3600 &\necho $! >> {tmp_path}/there\nwait\n")
    compiler.chmod(0o755)
    if by_file:
        folder.mkdir()
    monkeypatch.setenv("CC", str(compiler))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "case.toml").write_text(small().to_toml())
    with started([*PROGRAM, "run", "case.toml"], tmp_path, ranks) as process:
        until((tmp_path / "there").exists, process)
        if by_file:
            (folder / "stop").touch()
        stopped(process, not by_file, signal.SIGTERM if ranks == 1 else signal.SIGUSR2)
    assert not [file for file in (tmp_path / "cache").rglob("*") if file.suffix == ".claim"]
    assert not any(alive(int(line)) for line in (tmp_path / "there").read_text().split())
    assert {path.name for path in folder.glob("*")} <= {".lock"}
    assert folder.exists() == by_file


@pytest.mark.parametrize("ranks", [1, 2])
def test_while_a_form_gets_its_name(ranks: int, tmp_path: Path) -> None:
    """UFL looks through large expressions for minutes, before anything is compiled."""
    (tmp_path / "case.toml").write_text(small().to_toml())
    patches = "slow(compile, 'compute_signature', 60)"
    command = program("from dolfin_elastic.core.jit import compile", patches, "run", "case.toml")
    with started(command, tmp_path, ranks) as process:
        until((tmp_path / "there").exists, process)
        stopped(process, 1, signal.SIGTERM if ranks == 1 else signal.SIGUSR2)


def alive(process: int) -> bool:
    """Whether a process runs; one that has ended may be there until its parent has noticed."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV])
def test_a_dead_rank(number: int, tmp_path: Path) -> None:
    """The launcher ends the others within 10 s, and a restart goes on."""
    whole = small(statics={"steps": 2000}, output={"checkpoint": {"every": 1}})
    (tmp_path / "case.toml").write_text(whole.to_toml())
    folder = tmp_path / "case_results"
    with started([*PROGRAM, "run", "case.toml", "-q"], tmp_path, 2) as process:
        until(lambda: (last_step(folder) or 0) > 2, process)
        ranks = ranks_of(process)
        os.kill(ranks[-1], number)
        begin = time.monotonic()
        process.communicate(timeout=60)
    assert time.monotonic() - begin < 10.0
    assert process.returncode != 0
    assert not any(alive(rank) for rank in ranks)
    last = last_step(folder) or 0
    with started([*PROGRAM, "restart", "case_results", "-q"], tmp_path, 1) as process:
        until(lambda: (last_step(folder) or 0) > last, process)
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
