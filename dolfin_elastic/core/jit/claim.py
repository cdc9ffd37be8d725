"""`Claim`: one process compiles a form, and the others that need it wait as long as it lives.

A claim is a file with the host, the process and a count that its holder raises each second.  A
holder is dead if its process is gone, where that can be seen, or if the count has not changed for
`PATIENCE`: nothing depends on locks of the file system, on clocks of several machines, or on their
names.  Should a holder that only slept be taken for dead, two processes compile the same form, and
the first to finish publishes it.
"""

from __future__ import annotations

import json
import logging
import os
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self
from uuid import uuid4

from dolfin_elastic.core.signals import raise_if_asked

log = logging.getLogger("dolfin_elastic")

BEAT = 1.0
"""Seconds from one sign of life to the next."""

PATIENCE = 20.0
"""Seconds without a sign of life after which a holder counts as dead.  Network file systems show a
change within one or two; a process that compiles is never still for so long."""

QUIET = 5.0
"""Seconds of waiting before a line says what for."""

POLL = 0.1


class Claim:
    """The right to compile one form, from `with` to its end.  Not collective.

    Args:
        file: Its file, which exists as long as somebody has the claim.
        done: Whether there is nothing left to do: waiting ends then, and `held` is false.

    Attributes:
        held: This process has it.
    """

    def __init__(self, file: Path, done: Callable[[], bool]) -> None:
        self._file, self._done = file, done
        self._token = uuid4().hex
        self._end = threading.Event()
        self._thread: threading.Thread | None = None
        self.held = False

    def __enter__(self) -> Self:
        """Waits until it is this process's turn or nothing is left to do.

        Raises:
            OSError: The file cannot be made.
            StoppedError: A signal has asked for the end of the run.
        """
        watch = _Watch(self._file)
        while not self._done():
            if self._taken():
                self._thread = threading.Thread(target=self._beat, daemon=True)
                self._thread.start()
                self.held = True
                break
            raise_if_asked()
            if watch.holder_is_dead():
                with suppress(OSError):
                    self._file.unlink()
            time.sleep(POLL)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Gives it back."""
        if not self.held or self._thread is None:
            return
        self._end.set()
        self._thread.join()
        if _read(self._file).get("token") == self._token:  # else it was taken from a sleeper
            with suppress(OSError):
                self._file.unlink()

    def is_lost(self) -> bool:
        """Whether another process has taken it, as this one slept and seemed dead."""
        return self.held and _read(self._file).get("token") != self._token

    def _taken(self) -> bool:
        try:
            file = self._file.open("x", encoding="utf-8")
        except FileExistsError:
            return False
        try:
            with file:
                file.write(self._text(0))
        except OSError:  # a full disk: others would wait for a holder that there is not
            with suppress(OSError):
                self._file.unlink()
            raise
        return True

    def _text(self, count: int) -> str:
        return json.dumps({"token": self._token, "beat": count, **_this_process()})

    def _beat(self) -> None:
        count, new = 0, self._file.with_name(f"{self._file.name}.{self._token}")
        while not self._end.wait(BEAT):
            count += 1
            with suppress(OSError):
                if _read(self._file).get("token") == self._token:
                    # By renaming: whoever looks, this process too, reads the whole of it.
                    new.write_text(self._text(count), encoding="utf-8")
                    new.replace(self._file)


class _Watch:
    """Watches the holder of a claim."""

    def __init__(self, file: Path) -> None:
        self._file, self._seen = file, ""
        self._still, self._waited, self._last, self._told = 0.0, 0.0, time.monotonic(), False

    def holder_is_dead(self) -> bool:
        """Whether the claim may be taken away; call it again and again while waiting."""
        now = time.monotonic()
        # One look counts for a second at most: this process may have been stopped in between, and
        # the holder with it.
        passed, self._last = min(now - self._last, 1.0), now
        holder = _read(self._file)
        seen = f"{holder.get('token')} {holder.get('beat')}"
        self._still = self._still + passed if seen == self._seen else 0.0
        self._seen = seen
        self._waited += passed
        if not self._told and self._waited >= QUIET:
            self._told = True
            who = f"process {holder.get('pid', '?')} on {holder.get('host', '?')}"
            log.warning("waiting for %s, which compiles the same form", who, extra=EVERY_RANK)
        return self._still >= PATIENCE or _is_gone(holder)


EVERY_RANK = {"every_rank": True}
"""Marks a record that one rank alone may have, and that is shown from whichever has it."""


def _read(file: Path) -> dict[str, str | int]:
    """What is in a claim; empty where there is none or it is just being written."""
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _this_process() -> dict[str, str | int]:
    pid = os.getpid()
    return {"host": socket.gethostname(), "pid": pid, "started": _started(pid), "where": _where()}


def _where() -> str:
    """Boot of this machine and space of process numbers: where a number means the same process.

    Not the host's name, which may change, or be that of many containers.
    """
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        return f"{boot} {os.readlink('/proc/self/ns/pid')}"
    except OSError:
        return ""


def _started(pid: int) -> str:
    """When a process began, in ticks since the boot, which no clock changes; empty if gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if fields[0] in "ZX" else fields[19]


def _is_gone(holder: dict[str, str | int]) -> bool:
    """Whether a holder is known to have ended: only of processes that can be seen from here."""
    where = _where()
    pid = holder.get("pid")
    if not where or holder.get("where") != where or not isinstance(pid, int):
        return False
    return _started(pid) != holder.get("started")
