"""The command `sweep` in processes of its own: killed, with several jobs, and as an array job."""

from __future__ import annotations

import csv
import os
import signal
import stat
import subprocess
from pathlib import Path

import pytest
from helpers.processes import PROGRAM, clean_environment, cli, started, until
from mpi4py import MPI

pytestmark = pytest.mark.skipif(
    MPI.COMM_WORLD.size > 1, reason="starts mpirun itself, which cannot be nested"
)
CASE = """\
[mesh]
rectangle = { size = [1, 0.2], cells = [8, 2] }
[materials.rubber]
law = "neo-hookean"
E = "1 MPa"
nu = 0.3
[[support]]
on = "left"
[[load]]
kind = "traction"
on = "right"
value = [0, "-100 Pa"]
[statics]
steps = 4
[output.probes]
tip = [1, 0.1]
"""
TEN = ",".join(f"{n} MPa" for n in range(1, 11))


def table(folder: Path) -> list[dict[str, str]]:
    with (folder / "case_sweep" / "sweep.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.mark.long
@pytest.mark.parametrize("ranks", [1, 2])
def test_killed_and_again(tmp_path: Path, ranks: int) -> None:
    """Rows that have ended stay, with their seconds; the same command computes the others."""
    (tmp_path / "case.toml").write_text(CASE)
    words = ["sweep", "case.toml", "--set", f"materials.rubber.E={TEN}"]

    def ended() -> list[Path]:
        records = (tmp_path / "case_sweep").glob("*/row.json")
        return [path for path in records if '"status": "solved"' in path.read_text()]

    with started([*PROGRAM, *words], tmp_path, ranks) as process:
        until(lambda: len(ended()) >= 3, process)
        process.send_signal(signal.SIGKILL if ranks == 1 else signal.SIGTERM)
        process.communicate()
    before = {path: path.stat().st_mtime_ns for path in ended()}
    assert 3 <= len(before) < 10
    code, out, err = cli(*words, folder=tmp_path, ranks=ranks)
    assert code == 0, err
    assert f"{len(before)} of them known" in out
    assert {path: path.stat().st_mtime_ns for path in before} == before
    rows = table(tmp_path)
    assert [row["status"] for row in rows] == ["solved"] * 10
    tips = [abs(float(row["tip_y"])) for row in rows]
    assert tips == sorted(tips, reverse=True)


@pytest.mark.long
def test_stopped(tmp_path: Path) -> None:
    """SIGTERM ends it with code 130 and a table of the rows so far."""
    (tmp_path / "case.toml").write_text(CASE)
    words = ["sweep", "case.toml", "--set", f"materials.rubber.E={TEN}"]
    with started([*PROGRAM, *words], tmp_path, 1) as process:
        until((tmp_path / "case_sweep" / "sweep.csv").exists, process)
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate()
    assert process.returncode == 130, err
    statuses = [row["status"] for row in table(tmp_path)]
    assert statuses[0] == "solved"
    assert statuses[-1] == "planned"


@pytest.mark.long
def test_jobs(tmp_path: Path) -> None:
    """Two processes share the rows; each row is computed once, by one of them."""
    (tmp_path / "case.toml").write_text(CASE)
    words = ["sweep", "case.toml", "--set", f"materials.rubber.E={TEN}", "--jobs", "2"]
    code, out, err = cli(*words, folder=tmp_path)
    assert code == 0, err
    assert out.count(" of 10  E = ") == 10
    assert [row["status"] for row in table(tmp_path)] == ["solved"] * 10
    assert not list((tmp_path / "case_sweep").glob("*/row.lock"))
    code, _, err = cli(*words, "--tell", "nonsense", folder=tmp_path)
    assert code == 2
    assert "there is no result 'nonsense'" in err


@pytest.mark.long
def test_an_array_job(tmp_path: Path) -> None:
    """The script as Slurm would run it, with an `srun` that only starts; then the table."""
    (tmp_path / "case.toml").write_text(CASE)
    program = tmp_path / "dolfin-elastic"
    program.write_text(f'#!/bin/bash\nexec {PROGRAM[0]} -m dolfin_elastic "$@"\n')
    srun = tmp_path / "srun"
    srun.write_text('#!/bin/bash\nexec "$@"\n')
    for file in (program, srun):
        file.chmod(file.stat().st_mode | stat.S_IXUSR)
    words = ["sweep", "--set", "materials.rubber.E=1 MPa,2 MPa", "case.toml"]
    more = ("--jobs", "2", "--slurm", "job.sh", "--retry")
    code, out, err = cli(*words, *more, folder=tmp_path)
    assert code == 0, err
    script = (tmp_path / "job.sh").read_text()
    assert [line.endswith("--retry") for line in script.splitlines() if "sweep" in line][1:] == [
        *(False, True)
    ]
    assert "sbatch job.sh" in out
    assert "#SBATCH --array=1-2\n" in (tmp_path / "job.sh").read_text()
    assert not (tmp_path / "case_sweep" / "sweep.csv").exists()
    for task in ("1", "2"):
        environment = clean_environment() | {"SLURM_ARRAY_TASK_ID": task}
        environment["PATH"] = f"{tmp_path}:{os.environ['PATH']}"
        done = subprocess.run(["bash", "job.sh"], cwd=tmp_path, env=environment, check=False)
        assert done.returncode == 0
    code, out, err = cli(*words, folder=tmp_path)
    assert code == 0, err
    assert "2 of them known" in out
    assert [row["status"] for row in table(tmp_path)] == ["solved", "solved"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--set", "materials.ruber.E=1"], "did you mean 'rubber'"),
        (["--set", "materials.rubber.E"], "gives no key a value"),
        (["--set", "materials.rubber.E=1,-1"], "must be positive"),
        (["--set", "materials.rubber.E=1,2", "--tell", "displacement of tp"], "did you mean 'top'"),
    ],
)
def test_bad_input(tmp_path: Path, words: list[str], message: str) -> None:
    """Code 2, one message, nothing written."""
    (tmp_path / "case.toml").write_text(CASE)
    code, _, err = cli("sweep", "case.toml", *words, folder=tmp_path)
    assert code == 2
    assert message in err
    assert "Traceback" not in err
    assert os.listdir(tmp_path) == ["case.toml"]


@pytest.mark.long
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_failed_rows_are_tried_again(tmp_path: Path, jobs: str) -> None:
    """Once, by the first process; without the option the table is all that is written."""
    (tmp_path / "case.toml").write_text(CASE.replace("steps = 4", "steps = 1"))
    words = ["sweep", "case.toml", "--set", "load.right.value[1]=-100 Pa,-1 GPa", "--jobs", jobs]
    assert cli(*words, folder=tmp_path)[0] == 0
    assert [row["status"] for row in table(tmp_path)] == ["solved", "failed"]
    records = [tmp_path / "case_sweep" / name / "row.json" for name in ("001", "002")]
    before = [path.stat().st_mtime_ns for path in records]
    code, out, err = cli(*words, folder=tmp_path)
    assert code == 0, err
    assert "2 of them known" in out and "of 2  value" not in out
    assert [path.stat().st_mtime_ns for path in records] == before
    code, out, err = cli(*words, "--retry", folder=tmp_path)
    assert code == 0, err
    assert "1 of them known" in out and out.count("of 2  value") == 1
    after = [path.stat().st_mtime_ns for path in records]
    assert (after[0] == before[0], after[1] > before[1]) == (True, True)
    assert [row["status"] for row in table(tmp_path)] == ["solved", "failed"]


@pytest.mark.long
def test_nothing_has_a_solution(tmp_path: Path) -> None:
    """Code 3 and the first cause."""
    (tmp_path / "case.toml").write_text(CASE.replace("steps = 4", "steps = 1"))
    words = ["--set", "load.right.value[0]=-1 GPa,-2 GPa"]
    code, out, err = cli("sweep", "case.toml", *words, folder=tmp_path)
    assert code == 3, out + err
    assert "no run of the sweep has a solution" in err
    assert len(table(tmp_path)) == 2
