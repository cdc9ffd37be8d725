"""Which files a program and all that it starts look at, as strace sees it."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path

from helpers.processes import clean_environment

_CALL = re.compile(r"(\d+) +(\w+)\((.*)")
_RESUMED = re.compile(r"(\d+) +<\.\.\. (\w+) resumed>(.*)")
_PATH = re.compile(r'(?:(AT_FDCWD|\d+)<((?:[^>\\]|\\.)*)>, )?"((?:[^"\\]|\\.)*)"')
_FOLDER = re.compile(r"\d+<((?:[^>\\]|\\.)*)>")
_NEW_PROCESS = ("clone", "clone3", "fork", "vfork")
_TWO_PATHS = ("rename", "renameat", "renameat2", "link", "linkat")


def traced(
    command: Sequence[str], folder: Path, variables: dict[str, str]
) -> tuple[int, str, set[Path]]:
    """Runs a command under strace.

    Args:
        command: What is run.
        folder: Its current folder.
        variables: Of its environment, beside those of this process.

    Returns:
        Exit code, what it has printed, and all paths that it or a process of its own has opened,
        or looked for, or changed.
    """
    log = folder.with_name(f"{folder.name}.strace")
    calls = "trace=%file,%process,fchdir"
    done = subprocess.run(
        ["strace", "-f", "-y", "--seccomp-bpf", "-s", "4096", "-e", calls, "-o", log, *command],
        cwd=folder,
        env=clean_environment() | variables,
        capture_output=True,
        text=True,
        errors="replace",
        timeout=500,
        check=False,
    )
    lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    assert len(lines) > 1000, done.stderr  # a program of Python looks at thousands of files
    return done.returncode, done.stdout + done.stderr, set(_paths(lines, folder))


def _paths(lines: Sequence[str], folder: Path) -> Iterator[Path]:
    """All paths of a log; relative ones belong to the current folder of their process then."""
    current: dict[str, list[str]] = {}  # threads share one
    begun: dict[str, str] = {}
    for line in lines:
        called, resumed = _CALL.fullmatch(line), _RESUMED.fullmatch(line)
        found = called or resumed
        if found is None:  # an exit or a signal
            continue
        process, name, rest = found.groups()
        here = current.setdefault(process, [str(folder)])
        paths = list(_PATH.finditer(rest)) if called else []
        for one in paths[: 2 if name in _TWO_PATHS else 1]:
            if one[1] == "AT_FDCWD":
                here[0] = one[2]
            base = here[0] if one[2] is None else one[2]
            yield Path(os.path.normpath(os.path.join(base, one[3])))
        if rest.endswith("<unfinished ...>"):  # another process interrupts the line
            begun[process] = rest
            continue
        whole = rest if called else begun.pop(process, "") + rest
        if name in _NEW_PROCESS and (child := re.search(r"\) += (\d+)", whole)):
            current[child[1]] = here if "CLONE_FS" in whole else list(here)
        elif name in ("chdir", "fchdir") and whole.endswith("= 0"):
            into = _FOLDER.match(whole) if name == "fchdir" else _PATH.search(whole)
            assert into is not None, line
            named = into[into.lastindex or 0]
            here[0] = os.path.normpath(os.path.join(here[0], named))
