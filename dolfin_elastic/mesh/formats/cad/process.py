"""`GmshProcess`: Gmsh in a process of its own, which can do no harm and can be ended.

Gmsh carries out what its scripts say, commands included, takes files for scripts by their content,
reads options from files beside a file, and ends its process on some damaged files; it has no option
against any of these.  So it reads copies in a private folder, in a process that Landlock lets
write its result and nothing else, with limits of time and memory.
"""

from __future__ import annotations

import json
import os
import resource
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.files.memory import free_memory as _free_memory
from dolfin_elastic.core.signals import raise_if_asked
from dolfin_elastic.mesh.formats.cad import landlock

_PROGRAM = """
import sys
sys.path[:] = {path}
from dolfin_elastic.core.startup.libraries import stay_without
stay_without()
from dolfin_elastic.mesh.formats.cad.worker import main
main()
"""
_ROOT = Path(__file__).resolve().parents[4]
"""The folder that holds the package."""
_ENVIRONMENT = ("PATH", "LANG", "LC_ALL", "LD_LIBRARY_PATH")
"""What a process needs to find its libraries: nothing of MPI, which would take it for a rank."""
_SHARE = 0.8
"""Share of the free memory that Gmsh may take."""
_LOOK = 0.5
"""Seconds from one look to the next whether the run shall stop."""
_LIBRARIES = 3e9
"""Addresses that its libraries reserve and do not use [byte]."""


@dataclass(frozen=True)
class Permission:
    """What Gmsh may do.

    Attributes:
        trusted: Everything that its user may: the file is his own.
        seconds: Time that each task may take [s].
    """

    trusted: bool = False
    seconds: float = 600.0


@dataclass(frozen=True)
class _Limits:
    """What a process may take.

    Attributes:
        memory: Of it [byte].
        disk: Size of its largest file [byte].
    """

    memory: int
    disk: int


class GmshProcess:
    """A running Gmsh; see `gmsh_process`.

    Args:
        path: Where it finds the file.
        seconds: Time that each task may take [s].
        limits: Memory that it may take, and size of its largest file.
    """

    def __init__(
        self, process: subprocess.Popen[bytes], path: Path, seconds: float, limits: _Limits
    ) -> None:
        self._process, self._name = process, path.name
        self._seconds, self._limits = seconds, limits
        self._read = b""

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    def ask(self, task: str, **arguments: Any) -> Any:
        """Lets Gmsh do something.

        Args:
            arguments: Its arguments, as JSON has them.

        Returns:
            Its answer, as JSON has it.

        Raises:
            MeshError: Gmsh cannot do it, or takes too long or too much memory.
            StoppedError: A signal has asked for the end of the run meanwhile.
        """
        line = json.dumps({"do": task, "with": arguments}).encode() + b"\n"
        answer = json.loads(self._exchange(line))
        if "refused" in answer:
            what, where, expected = answer["refused"]
            raise MeshError(what, where=where, expected=expected)
        if "short" in answer:
            raise self._needs("more memory")
        if "fault" in answer:
            raise RuntimeError(f"in the process of Gmsh: {answer['fault']}")
        return answer["answer"]

    def _exchange(self, line: bytes) -> bytes:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        until = time.monotonic() + self._seconds
        try:
            self._process.stdin.write(line)
            self._process.stdin.flush()
        except BrokenPipeError:
            raise self._ended() from None
        while b"\n" not in self._read[-1:]:
            left = until - time.monotonic()
            wait = min(max(left, 0.0), _LOOK)
            ready, _, _ = select.select([self._process.stdout], [], [], wait)
            if not ready and left > 0.0:
                raise_if_asked()
                continue
            if not ready:
                raise MeshError(
                    f"Gmsh was stopped after {self._seconds:g} s",
                    where=self._name,
                    expected="larger elements (mesh.size), or more time: mesh.time_limit",
                )
            part = os.read(self._process.stdout.fileno(), 1 << 20)
            if not part:
                raise self._ended()
            self._read += part
        result, self._read = self._read, b""
        return result

    def _ended(self) -> MeshError:
        """What is to be said of a process that has ended by itself."""
        code = self._process.wait()
        if -code == signal.SIGXFSZ:
            return self._needs("more room on the disk")
        how = f"exit code {code}" if code >= 0 else signal.Signals(-code).name
        if -code in (signal.SIGKILL, signal.SIGABRT):  # C++ aborts where it gets no memory
            return self._needs(f"more memory, or has failed ({how})")
        return MeshError(
            f"Gmsh has crashed ({how})", where=self._name, expected="a file that is not damaged"
        )

    def _needs(self, what: str) -> MeshError:
        most = f"{self._limits.memory / 1e9:.2g} GB, and write {self._limits.disk / 1e9:.2g} GB"
        return MeshError(
            f"Gmsh needs {what}; it may take {most} here",
            where=self._name,
            expected="larger elements (mesh.size), a machine with more free memory, or more room "
            "in the folder of temporary files (TMPDIR)",
        )


def notes_of(permission: Permission) -> list[str]:
    """What the user must know of how Gmsh is kept; nothing where it is confined, or trusted."""
    if permission.trusted or landlock.version() > 0:
        return []
    return [
        "the process of Gmsh is not confined, because this kernel has no Landlock (Linux 5.13 and "
        "later): a damaged file that takes Gmsh over could do what you can; read files of "
        "strangers in a container or a virtual machine"
    ]


@contextmanager
def gmsh_process(
    path: Path, files: Mapping[Path, bytes], permission: Permission
) -> Iterator[tuple[GmshProcess, Path]]:
    """Starts Gmsh with copies of a file and of those that it reads; ends it afterwards. Local.

    Args:
        files: Path relative to the file's folder, and content; of a trusted one they are not used.

    Yields:
        Gmsh, and the folder into which it writes.
    """
    with tempfile.TemporaryDirectory(prefix="dolfin_elastic-gmsh-") as name:
        readable, writable = Path(name, "read"), Path(name, "write")
        writable.mkdir()
        for file, content in files.items():
            copy = readable / file
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes(content)
        # The user's own limit (ulimit -v) cannot be raised.
        own = [one for one in resource.getrlimit(resource.RLIMIT_AS) if one >= 0]
        memory = min([int(_SHARE * _free_memory() + _LIBRARIES), *own])
        limits = _Limits(memory, _largest_file(writable))
        terms = {
            "file": str(path.absolute() if permission.trusted else readable / path.name),
            "readable": str(readable),
            "writable": str(writable),
            "memory": limits.memory,
            "disk": limits.disk,
            "confined": not permission.trusted and landlock.version() > 0,
        }
        with _started(permission, path, writable) as process:
            gmsh = GmshProcess(process, path, permission.seconds, limits)
            assert process.stdin is not None
            process.stdin.write(json.dumps(terms).encode() + b"\n")
            yield gmsh, writable


@contextmanager
def _started(
    permission: Permission, path: Path, writable: Path
) -> Iterator[subprocess.Popen[bytes]]:
    """The process, which does not outlive the context."""
    # Of the current folder nothing is imported.
    folders = [str(_ROOT), *(folder for folder in sys.path if os.path.isabs(folder))]
    environment = {name: os.environ[name] for name in _ENVIRONMENT if name in os.environ}
    # One thread: Landlock holds for those that are started later only.
    environment |= {"TMPDIR": str(writable), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    process = subprocess.Popen(
        [sys.executable, "-I", "-c", _PROGRAM.format(path=folders)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment,
        cwd=path.absolute().parent if permission.trusted else writable,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def _largest_file(folder: Path) -> int:
    """Size of a file [byte] that leaves as much free as it takes, within the user's own limit."""
    own = [one for one in resource.getrlimit(resource.RLIMIT_FSIZE) if one >= 0]
    return min([int(shutil.disk_usage(folder).free / 2), *own])
