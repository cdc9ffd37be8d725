"""Output that cannot be written, and services without a home: no traceback, the right exit code."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.cube import cube
from helpers.processes import PROGRAM, clean_environment

pytestmark = pytest.mark.usefixtures("serial_only")

CASE = cube()


def shell(
    redirections: str,
    *words: str,
    folder: Path,
    environment: dict[str, str] | None = None,
) -> subprocess.CompletedProcess[str]:
    """The program, with its streams as a shell redirects them."""
    (folder / "case.toml").write_text(CASE)
    return subprocess.run(
        ["sh", "-c", f'exec "$@" {redirections}', "sh", *PROGRAM, *words],
        cwd=folder,
        env=clean_environment() if environment is None else environment,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )


FULL, CLOSED = "no space left on device", "it is closed"


@pytest.mark.sample(3)
@pytest.mark.parametrize(
    "words",
    [
        ["run", "case.toml"],
        ["run", "case.toml", "--json"],
        ["check", "case.toml"],
        ["check", "case.toml", "--json"],
        ["material", "case.toml"],
        ["materials"],
        ["schema"],
        ["info"],
        ["look", "case.toml"],
        ["--help"],
        ["--version"],
    ],
    ids=" ".join,
)
@pytest.mark.parametrize(("redirections", "why"), [(">/dev/full", FULL), (">&-", CLOSED)])
def test_output_that_cannot_be_written(
    redirections: str, why: str, words: list[str], tmp_path: Path
) -> None:
    """The work is done to its end; one line says at the end that what was printed is lost."""
    done = shell(redirections, *words, folder=tmp_path)
    last = done.stderr.splitlines()[-1]
    assert (done.returncode, last) == (4, f"error: standard output cannot be written: {why}")
    assert "Traceback" not in done.stderr
    if words[0] == "run":
        summary = json.loads((tmp_path / "case_results/summary.json").read_text())
        assert summary["status"] == "completed"


@pytest.mark.parametrize("words", ["check", "look", "check --json"])
def test_a_terminal_of_ascii(words: str, tmp_path: Path) -> None:
    """Units and signs of sentences are printed as they are typed."""
    environment = {**clean_environment(), "PYTHONIOENCODING": "ascii"}
    load = '[[load]]\nkind = "body-force"\nvalue = [0, 0, "-0.1 N/m^3"]\n'
    (tmp_path / "pulled.toml").write_text(CASE + load)
    name, *options = words.split()
    done = shell("", name, "pulled.toml", *options, folder=tmp_path, environment=environment)
    assert (done.returncode, done.stderr) == (0, "")
    assert "force per volume of (0, 0, " in done.stdout


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    ("redirections", "code"),
    [
        ("2>/dev/full", 4),  # what the solver says is lost
        ("2>&-", 0),  # nobody wants it
        ("<&-", 0),
        (">/dev/full 2>/dev/full", 4),
        ("<&- >&- 2>&-", 4),
    ],
)
def test_messages_that_cannot_be_written(redirections: str, code: int, tmp_path: Path) -> None:
    """Nor do files of the results get the numbers of closed streams, and what C prints."""
    done = shell(redirections, "run", "case.toml", "--", "-ksp_view", folder=tmp_path)
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    results = tmp_path / "case_results"
    assert json.loads((results / "summary.json").read_text())["status"] == "completed"
    files = [one for one in results.rglob("*") if one.is_file()]
    assert not [one for one in files if b"KSP Object" in one.read_bytes()]


@pytest.mark.parametrize("redirections", [">/dev/full", ">&-", "2>/dev/full", "2>&-", "<&-"])
def test_errors_keep_their_code(redirections: str, tmp_path: Path) -> None:
    assert shell(redirections, "run", "none.toml", folder=tmp_path).returncode == 2


@pytest.mark.parametrize("redirections", [">/dev/full", ">&-"])
def test_nothing_is_lost_where_nothing_is_printed(redirections: str, tmp_path: Path) -> None:
    done = shell(redirections, "run", "case.toml", "--quiet", folder=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    "words",
    [
        ["run", "case.toml", "--output", ""],
        ["run", "case.toml", "--output="],
        ["run", ""],
        ["report", "case_results", "-o", ""],
    ],
)
def test_empty_arguments(words: list[str], tmp_path: Path) -> None:
    """An unset variable of a script is no name; it stood for the current folder."""
    done = shell("", *words, folder=tmp_path)
    assert done.returncode == 2
    assert "There is an empty argument behind" in done.stderr
    assert os.listdir(tmp_path) == ["case.toml"]


HOMES = {
    "none": {},
    "empty": {"HOME": ""},
    "cannot be made": {"HOME": "/proc/nobody"},
    "is no folder": {"HOME": "/dev/null"},
}


@pytest.mark.long
@pytest.mark.parametrize("home", HOMES)
def test_services_without_a_home(home: str, tmp_path: Path) -> None:
    """Open MPI does not start without HOME; without a cache forms are compiled each time."""
    given = HOMES[home]
    bare = {name: os.environ.get(name, "") for name in ("PATH", "PYTHONPATH")} | given
    bare["OMP_NUM_THREADS"] = "1"
    cached = not given.get("HOME")
    if cached:
        bare["XDG_CACHE_HOME"] = str(tmp_path / "cache")
    done = shell("", "run", "case.toml", "-q", folder=tmp_path, environment=bare)
    assert done.returncode == 0, done.stderr
    lines = done.stderr.splitlines()
    assert len(lines) == (0 if cached else 1), done.stderr
    assert cached or lines[0].startswith("warning: compiled code cannot be stored (")


def test_a_user_without_a_name(tmp_path: Path) -> None:
    """A container's user may be a number alone: Python then knows no home of his either."""
    program = """
import os, pwd
def unknown(user):
    raise KeyError(user)
pwd.getpwuid = unknown
del os.environ["HOME"]
from dolfin_elastic.core.startup.libraries import start
start()
print(os.environ["HOME"])
"""
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=clean_environment(),
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout == "/nonexistent\n", done.stderr


def test_no_temporary_files(tmp_path: Path) -> None:
    """Open MPI would die with thirty lines of its own, and PETSc with a broken segment."""
    there = clean_environment() | {"TMPDIR": "/proc/nowhere"}
    done = shell("", "check", "case.toml", folder=tmp_path, environment=there)
    assert done.returncode == 4
    assert done.stderr.startswith(
        "error: MPI cannot start: /proc/nowhere, where it keeps temporary"
    )
    assert len(done.stderr.splitlines()) == 1
