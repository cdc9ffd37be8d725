"""The command line as a user meets it: what it prints, exit codes, on one rank and on several."""

from __future__ import annotations

import csv
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from helpers.processes import PROGRAM, cli, ranks_of, started
from mpi4py import MPI

from dolfin_elastic import __version__
from dolfin_elastic.cli.run import _written
from dolfin_elastic.core.errors import CaseError
from dolfin_elastic.core.petsc_options import parse_arguments
from dolfin_elastic.results.files import replace_text

pytestmark = pytest.mark.skipif(
    MPI.COMM_WORLD.size > 1, reason="starts mpirun itself, which cannot be nested"
)
CASE = """\
[mesh]
box = {size = [2, 1, 1], cells = [4, 2, 2]}
degree = 1
[materials.rubber]
law = "neo-hookean"
E = "1 MPa"
nu = 0.3
[[support]]
on = "left"
[[load]]
kind = "traction"
on = "right"
value = [0, 0, "10 kPa"]
[statics]
steps = 2
"""
CRASH = """\
import sys
from mpi4py import MPI
import dolfin_elastic.case.run, dolfin_elastic.cli.app
def broken(*args, **kwargs):
    if MPI.COMM_WORLD.rank == {rank} or {rank} < 0:
        raise RuntimeError("a fault of ours")
    MPI.COMM_WORLD.barrier()
    yield
dolfin_elastic.case.run.CaseRun.states = broken
sys.argv = ["dolfin-elastic", "run", "case.toml"]
dolfin_elastic.cli.app.main()
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a case."""
    (tmp_path / "case.toml").write_text(CASE)
    return tmp_path


def test_help_is_quick_and_teaches(tmp_path: Path) -> None:
    """Nothing heavy is imported for it."""
    code, out, err = cli("--help", folder=tmp_path)
    assert (code, err) == (0, "")
    assert "mpirun -n 4 dolfin-elastic run beam.toml" in out
    assert "Exit codes:" in out
    assert [int(line.split()[0]) for line in out.splitlines() if re.match(r" +\d+  +\S", line)] == [
        *range(7),
        130,
    ]
    modules = ("numpy", "mpi4py", "dolfinx", "pint", "matplotlib", "pydantic", "ufl")
    probe = (
        f"import sys, dolfin_elastic.cli.app; sys.exit(any(m in sys.modules for m in {modules}))"
    )
    assert subprocess.run([sys.executable, "-c", probe], check=False).returncode == 0


def test_version(tmp_path: Path) -> None:
    """One line."""
    assert cli("--version", folder=tmp_path) == (0, f"dolfin-elastic {__version__}\n", "")


@pytest.mark.parametrize("ranks", [1, 2])
def test_wrong_usage(tmp_path: Path, ranks: int) -> None:
    """Said once, exit code 2."""
    code, _, err = cli("run", "case.toml", "--ouptut", "x", folder=tmp_path, ranks=ranks)
    assert code == 2
    assert err.count("No such option: --ouptut") == 1


def test_new_check_and_refuse(tmp_path: Path) -> None:
    """The first case is written, right, and not overwritten."""
    assert cli("new", "first.toml", folder=tmp_path)[:2] == (
        0,
        "first.toml written; compute it with: dolfin-elastic run first.toml\n",
    )
    code, out, _ = cli("check", "first.toml", folder=tmp_path)
    assert code == 0
    assert out.startswith("first.toml: Cantilever\n")
    assert out.endswith("nothing is wrong\n")
    code, _, err = cli("new", "first.toml", folder=tmp_path)
    assert code == 2
    assert err == (
        "error: first.toml: this file exists already; choose another name, "
        "or --force to overwrite it\n"
    )


@pytest.mark.parametrize(
    "words", ["run case.toml", "restart {}", "report {}", "convert {}.msh b.xdmf", "new {}"]
)
@pytest.mark.sample(2)
def test_names_that_no_file_can_have(folder: Path, words: str) -> None:
    """One line, of files that a case names as of those of the command line."""
    text = CASE.replace("box = {size = [2, 1, 1], cells = [4, 2, 2]}", f'file = "{"x" * 256}.geo"')
    (folder / "case.toml").write_text(text)
    code, _, err = cli(*words.format("x" * 256).split(), folder=folder)
    assert (code, err.count("\n")) == (2, 1), err
    assert re.search(r"xxx.*: file name too long", err)


@pytest.mark.long
def test_check_as_json(folder: Path) -> None:
    """Scripts get numbers."""
    code, out, _ = cli("check", "case.toml", "--json", folder=folder, ranks=2)
    found = json.loads(out)
    assert code == 0
    assert (found["cells"], found["unknowns"]) == (96, 135)
    assert {part["name"] for part in found["surfaces"]} >= {"left", "right"}


@pytest.mark.long
def test_look(folder: Path) -> None:
    """The body of a case as a table in its unit, and as JSON in metres; pictures are PNG files."""
    code, out, err = cli("look", "case.toml", folder=folder)
    assert (code, err) == (0, ""), err
    assert re.search(r"^ *left +\d+ +\S+ +\(.*\) +-x +support", out, re.MULTILINE), out
    code, out, err = cli("look", "case.toml", "--json", folder=folder)
    assert (code, err) == (0, "") and {"left", "right"} <= {
        s["name"] for s in json.loads(out)["surfaces"]
    }
    code, _, err = cli("look", "case.toml", "-o", "look.jpg", folder=folder)
    assert code == 2 and "the picture 'look.jpg' is no .png; look.png" in err


def test_info(tmp_path: Path) -> None:
    """Versions of what the numbers depend on."""
    code, out, _ = cli("info", folder=tmp_path, ranks=2)
    assert code == 0
    assert re.search(r"^ranks +2$", out, re.MULTILINE)
    assert all(name in out for name in ("dolfinx", "petsc", "blas"))


@pytest.mark.long
def test_converge(folder: Path) -> None:
    """A line a mesh, the table, exit code 0; with less work allowed code 6 and the reason."""
    what = ["--until", "strain_energy"]
    code, out, err = cli("converge", "case.toml", *what, "20%", folder=folder, ranks=2)
    assert code == 0, err
    assert re.findall(r"^mesh (\d): \d+ elements, \d+ unknowns, strain_energy", out, re.M) == [
        "1",
        "2",
        "3",
    ]
    assert re.search(
        r"^reached: strain_energy = \S+ k?J, estimated error \S+ % \(wanted 20 %\)$", out, re.M
    )
    assert out.endswith("converge.csv, converge.json, converge.png, summary.json\n")
    code, out, _ = cli("converge", "case.toml", *what, "1%", "--unknowns", "200", folder=folder)
    assert code == 6
    assert "above the limit of 200 (--unknowns)" in out


@pytest.mark.parametrize("ranks", [1, 2])
def test_run(folder: Path, ranks: int) -> None:
    """A line a step, a summary, the files, and each of them once."""
    code, out, err = cli("run", "case.toml", "--profile", folder=folder, ranks=ranks)
    assert code == 0, err
    assert re.findall(r"^step +(\d)   load (\d+) %", out, re.MULTILINE) == [
        ("1", "50"),
        ("2", "100"),
    ]
    assert out.count("done: 2 steps") == 1
    assert "reaction of left" in out
    assert "slowest rank" in out
    assert out.endswith("results in case_results: history.csv, results.xdmf, summary.json\n")
    summary = json.loads((folder / "case_results/summary.json").read_text())
    assert summary["status"] == "completed"
    assert summary["ranks"] == ranks
    assert summary["reactions"]["left"][2] == pytest.approx(-1e4, rel=1e-6)


@pytest.mark.long
def test_only_own_files_are_listed(folder: Path) -> None:
    """Files of others stay and are not named; what an older run has left goes."""
    (folder / "case.toml").write_text(
        f'title = "A beam"\n{CASE}[output]\npictures = [{{every = 1, field = "material"}}]\n'
    )
    results = folder / "case_results"
    (results / "failed_state_data").mkdir(parents=True)
    old = ("picture_000007.png", "failed_state.xdmf", "failed_state_data/000000.h5")
    for name in (*old, "notes.txt"):
        (results / name).touch()
    code, out, err = cli("run", "case.toml", folder=folder)
    assert code == 0, err
    pictures = "picture_000000.png, picture_000001.png, picture_000002.png"
    assert out.endswith(
        f"results in case_results: history.csv, {pictures}, results.xdmf, summary.json\n"
    )
    left = {path.name for path in results.iterdir()} - {"results_data"}
    assert left == {
        *pictures.split(", "),
        "history.csv",
        "results.xdmf",
        "summary.json",
        "notes.txt",
    }


def test_a_summary_of_another_run_is_told_from_ones_own(tmp_path: Path) -> None:
    """`--json` prints what this run has written, also where the text is the same."""
    found = [_written(tmp_path)]
    for _ in range(2):
        replace_text(tmp_path / "summary.json", "{}")
        found.append(_written(tmp_path))
    assert found[0] is None
    assert len(set(found)) == 3
    assert _written(tmp_path) == found[-1]


def test_quiet_and_folder(folder: Path) -> None:
    """Nothing to say, results where they are wanted."""
    assert cli("run", "case.toml", "-q", "-o", "deep/er", folder=folder) == (0, "", "")
    assert (folder / "deep/er/summary.json").exists()
    assert not (folder / "case_results").exists()


@pytest.mark.sample(2)
@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_wrong_case(folder: Path, ranks: int) -> None:
    """A line for each error, exit code 2, no folder, on any number of ranks."""
    wrong = CASE.replace('on = "left"', 'on = ["lft", "right", "rigt"]')
    (folder / "case.toml").write_text(wrong)
    code, out, err = cli("run", "case.toml", folder=folder, ranks=ranks)
    message = (
        "error: case.toml: support[0].on[0]: there is no surface 'lft'; did you mean 'left'?\n"
        "error: case.toml: support[0].on[2]: there is no surface 'rigt'; did you mean 'right'?\n"
    )
    assert code == 2
    assert out == ""
    assert err.count(message) == 1
    assert "Traceback" not in err
    assert [path.name for path in folder.iterdir()] == ["case.toml"]


@pytest.mark.long
def test_motion(folder: Path) -> None:
    """Time instead of load; a step above the stable one is refused before anything is written."""
    text = CASE.replace("nu = 0.3", "nu = 0.3\ndensity = 1000").replace(
        "[statics]\nsteps = 2", '[dynamics]\nscheme = "symplectic-euler"\nend = "50 ms"'
    )
    (folder / "case.toml").write_text(text)
    code, out, _ = cli("run", "case.toml", "-o", "good", folder=folder)
    assert code == 0
    assert re.search(r"^step +1   t 0.00\d+ s +max", out, re.MULTILINE)
    assert "kinetic energy" in out
    (folder / "case.toml").write_text(text + 'dt = "40 ms"\n')
    code, _, err = cli("run", "case.toml", folder=folder)
    assert code == 2
    assert err.startswith("error: case.toml: dynamics.dt: 0.04 s is above the stable step")
    assert not (folder / "case_results").exists()


@pytest.mark.long
@pytest.mark.parametrize("ranks", [1, 2])
def test_no_solution(folder: Path, ranks: int) -> None:
    """Exit code 3, the reason on screen and in the summary, results so far complete."""
    text = CASE.replace('[0, 0, "10 kPa"]', '["-9 MPa", 0, 0]').replace(
        "steps = 2", "steps = 2\nmin_step = 0.5\nmax_iterations = 4"
    )
    (folder / "case.toml").write_text(text)
    code, _, err = cli("run", "case.toml", folder=folder, ranks=ranks)
    assert code == 3
    assert len(re.findall(r"^error: no equilibrium beyond load factor", err, re.MULTILINE)) == 1
    assert "results so far are in case_results" in err
    summary = json.loads((folder / "case_results/summary.json").read_text())
    assert summary["status"] == "failed"
    assert "no equilibrium" in summary["reason"]


@pytest.mark.parametrize("ranks", [1, 2])
def test_no_place_for_results(folder: Path, ranks: int) -> None:
    """Exit code 4 with the file and the cause."""
    code, _, err = cli("run", "case.toml", "-o", "case.toml/results", folder=folder, ranks=ranks)
    assert code == 4
    assert err.count("error: cannot write case.toml/results") == 1


@pytest.mark.parametrize(("ranks", "broken"), [(1, 0), (2, 1), (3, 2), (2, -1)])
def test_fault_of_the_program(folder: Path, ranks: int, broken: int) -> None:
    """One traceback, and no rank waits for ever."""
    with started([sys.executable, "-c", CRASH.format(rank=broken)], folder, ranks) as process:
        _, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert err.count("RuntimeError: a fault of ours") == 1
    if ranks > 1:
        assert f"rank {max(broken, 0)} of {ranks}:" in err


@pytest.mark.parametrize("ranks", [1, 2])
def test_interrupted(folder: Path, ranks: int) -> None:
    """Ctrl-C ends the run with the last complete step; what is written can be read."""
    (folder / "case.toml").write_text(CASE.replace("steps = 2", "steps = 5000"))
    with started([*PROGRAM, "run", "case.toml"], folder, ranks) as process:
        history = folder / "case_results/history.csv"
        until = time.monotonic() + 120
        while not (history.exists() and len(history.read_text().splitlines()) > 5):
            assert time.monotonic() < until
            assert process.poll() is None
            time.sleep(0.05)
        for child in ranks_of(process) if ranks > 1 else [process.pid]:
            os.kill(child, signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert err.count("stopping with a checkpoint of the last complete step") == 1
    rows = list(csv.DictReader(history.read_text().splitlines()))
    assert 0 < float(rows[-1]["load_factor"]) < 1
    assert json.loads((folder / "case_results/summary.json").read_text())["status"] == "stopped"
    assert "results in case_results" in out


def piped(end: str, folder: Path) -> tuple[str, str]:
    """What a run shows at the end of a pipe, with its exit code in the last line."""
    line = f"{shlex.join([*PROGRAM, 'run', 'case.toml'])} {end}; echo ${{PIPESTATUS[0]}}"
    with started(["bash", "-c", line], folder, 1) as process:
        out, err = process.communicate(timeout=240)
    return out, err


@pytest.mark.long
@pytest.mark.parametrize("redirect", ["", "2>&1"])
def test_nobody_reads_on(folder: Path, redirect: str) -> None:
    """Where a pipe is closed, as `head` does, the run goes on to its own end, silently."""
    (folder / "case.toml").write_text(CASE.replace("steps = 2", "steps = 40"))
    out, err = piped(f"{redirect} | head -1", folder)
    assert out.splitlines()[1:] == ["0"]
    assert not re.search("PETSC|Abort|Traceback|BrokenPipe", err + out)
    assert json.loads((folder / "case_results/summary.json").read_text())["status"] == "completed"
    rows = list(csv.DictReader((folder / "case_results/history.csv").read_text().splitlines()))
    assert float(rows[-1]["load_factor"]) == 1.0


@pytest.mark.parametrize("redirect", ["", "2>&1"])
def test_errors_that_nobody_reads(folder: Path, redirect: str) -> None:
    """The exit code is the run's own."""
    (folder / "case.toml").write_text(CASE.replace("10 kPa", "-1e4 MPa"))
    assert piped(f"{redirect} | true", folder)[0] == "3\n"


GAINS = """\
[mesh]
rectangle = {size = [1, 0.2], cells = [4, 1]}
degree = 1
[materials.soft]
law = "linear-elastic"
E = "1 MPa"
nu = 0.3
density = 1000
[[support]]
on = "left"
[[load]]
kind = "traction"
on = "right"
value = [0, -1]
[dynamics]
scheme = "newmark"
beta = 0.1
end = 0.3
dt = 0.01
"""
"""Newmark's scheme far beyond its stable step; nothing else is wrong."""


@pytest.mark.long
def test_energy_from_nowhere_has_its_own_exit_code(folder: Path) -> None:
    """Such a run ended with code 0; its results are complete."""
    (folder / "gains.toml").write_text(GAINS)
    code, out, err = cli("run", "gains.toml", folder=folder)
    assert code == 5, out + err
    found = json.loads((folder / "gains_results/summary.json").read_text())
    assert found["status"] == "completed"
    assert found["audit"]["verdict"] == "fail"
    line = found["audit"]["reasons"][0]
    assert re.match(r"\d+ % of the energy has come from nowhere: a smaller dt is needed", line)
    assert f"audit FAIL {line}" in " ".join(out.split())
    rows = list(csv.DictReader((folder / "gains_results/history.csv").read_text().splitlines()))
    assert rows[-1]["verdict"] == "fail"
    assert float(rows[-1]["t"]) == 0.3
    code, out, err = cli("run", "gains.toml", "-q", folder=folder)
    assert (code, out) == (5, "")
    assert f"audit FAIL: {line}" in err


@pytest.mark.long
def test_petsc_options(folder: Path) -> None:
    """They reach the solver; there is a warning of those that no solver asks for."""
    code, _, err = cli(
        "run", "case.toml", "--", "-ksp_type", "gmres", "-ksp_tpye", "cg", folder=folder
    )
    assert code == 0
    assert err.count("warning: PETSc option '-ksp_tpye' was not used by any solver") == 1
    code, out, _ = cli("run", "case.toml", "--", "-log_view", folder=folder)
    assert code == 0
    assert "PETSc Performance Summary" in out
    stages = re.findall(r"^ *\d+: +(\w[\w ]*): \d", out, re.MULTILINE)
    assert stages[0] == "Main Stage"
    assert {"mesh", "assemble", "solve", "output"} <= set(stages)  # see core/timing.py


@pytest.mark.long
@pytest.mark.sample(2)
@pytest.mark.parametrize("command", ["run", "check"])
@pytest.mark.parametrize("option", ["snes_rtol", "snes_atol", "snes_stol", "snes_max_it"])
def test_tolerances_of_snes_are_refused(folder: Path, option: str, command: str) -> None:
    """PETSc would take them, and nothing would ask for them."""
    solver = f"\n[solver]\npetsc = {{{option} = 1e-3}}\n"
    (folder / "own.toml").write_text(CASE + solver)
    given = {"own.toml": ("solver.petsc", [])}
    if command == "run":
        given["case.toml"] = ("command line", ["--", f"-{option}", "1e-3"])
    for case, (where, more) in given.items():
        code, out, err = cli(command, case, *more, folder=folder)
        assert code == 2, out + err
        assert err.count(f"the PETSc option -{option} has no effect here") == 1
        assert where in err
        key = {"snes_atol": "atol", "snes_max_it": "max_iterations"}.get(option, "rtol")
        assert f"statics.{key}" in err
        assert "Traceback" not in err


def test_options_refused_inside_a_solve(folder: Path) -> None:
    """They ended with code 1, a number of PETSc's and a trace."""
    petsc = ["-ksp_type", "gmres", "-pc_type", "bjacobi", "-sub_pc_type", "ilux"]
    code, out, err = cli("run", "case.toml", "--", *petsc, folder=folder)
    assert code == 2, out + err
    assert err.count("solver.petsc: PETSc refuses the options") == 1
    assert "Unable to find requested PC type ilux" in err.replace("\n      ", " ").replace(
        "\n", " "
    )
    assert "Traceback" not in err
    assert "error code" not in err


def test_reading_petsc_options() -> None:
    """Words after two dashes; negative numbers are values."""
    assert parse_arguments(["-a", "-b", "3", "-c", "-1e-3", "--d", "x"]) == (
        {"a": None, "b": "3", "c": "-1e-3", "d": "x"},
        [],
    )
    assert parse_arguments(["-log_view", ":f.txt", "-info"]) == (
        {},
        ["-log_view", ":f.txt", "-info"],
    )
    with pytest.raises(CaseError, match="'cg' is no PETSc option"):
        parse_arguments(["cg"])
