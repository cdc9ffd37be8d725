"""The command line in processes of its own, on any number of ranks."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

PROGRAM = [sys.executable, "-m", "dolfin_elastic"]


def clean_environment() -> dict[str, str]:
    """The environment without the variables by which a launcher describes this process."""
    pattern = re.compile(r"PMIX|PMI_|PRTE_(?!MCA)|OMPI_(?!MCA|ALLOW)")
    return {key: value for key, value in os.environ.items() if not pattern.match(key)}


def started(command: list[str], folder: Path, ranks: int) -> subprocess.Popen[str]:
    """Starts a program in a folder, with mpirun for more than one rank."""
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    return subprocess.Popen(
        [*launcher, *command],
        cwd=folder,
        env=clean_environment(),
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def until(met: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    """Waits; a process that ends before is a failure."""
    end = time.monotonic() + 120
    while not met():
        if process.poll() is not None or time.monotonic() > end:
            process.kill()  # else the end of a `with` waits for it
            raise AssertionError(process.communicate())
        time.sleep(0.01)


def cli(*words: str, folder: Path, ranks: int = 1) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of a command."""
    with started([*PROGRAM, *words], folder, ranks) as process:
        out, err = process.communicate(timeout=240)
    return process.returncode, out, err


IN_ONE = """\
import json, sys
from dolfin_elastic.cli.app import guarded
for words in json.loads(sys.argv[1]):
    sys.argv[1:] = words
    code = guarded()
    print(f"\\0{code}", flush=True)
"""


def of_copy(folder: Path, *commands: str) -> list[str]:
    """Code, on a line of its own, and output of commands of the copy in a folder.

    One process runs them all, whose start and first picture take longer than most commands.
    """
    done = subprocess.run(
        [sys.executable, "-c", IN_ONE, json.dumps([shlex.split(words) for words in commands])],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=300,
        check=False,
    )
    *said, _ = re.split(r"\0(\d+)\n", done.stdout)
    assert len(said) == 2 * len(commands), done.stdout
    return [f"{code}\n{text}" for text, code in zip(said[::2], said[1::2], strict=True)]


def ranks_of(launcher: subprocess.Popen[str]) -> list[int]:
    """Processes that a launcher has started."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(status.read_text().rsplit(")", 1)[1].split()[1])
        except OSError:
            continue
        if parent == launcher.pid:
            found.append(int(status.parent.name))
    return found
