"""`Lease`: one process at a time has what a file stands for, and the others see which one.

The file is locked (flock, which network file systems know, too) and has in it who that is.  The
lock is the sign of life: the operating system releases it when the process ends in any way, so
what a killed process leaves behind locks nothing, whatever clocks and names of machines say.
"""

from __future__ import annotations

import fcntl
import json
import os
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from dolfin_elastic.core.files.regular import open_regular, read_regular

QUIET = 5.0
"""Seconds of waiting before a line says what for."""

POLL = 0.1


class Lease:
    """Exclusive right, from `acquire` to `close` or the process's end.  Not collective.

    Args:
        file: Exists as long as somebody has the right; it may be left behind by a killed process.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._descriptor: int | None = None

    def acquire(
        self,
        patience: float,
        *,
        done: Callable[[], bool] = lambda: False,
        speak: Callable[[dict[str, str]], None] = lambda owner: None,
    ) -> bool:
        """Waits for the right; whether it was got.

        Args:
            patience: Seconds to wait for another process at most; while the machine is suspended
                none pass.
            done: Whether nobody needs it any more: waiting ends then.
            speak: Called once, with the `owner`, if the wait is long.

        Raises:
            OSError: The file cannot be made, written or locked.
        """
        waited, told = 0.0, False
        while not done():
            if self._taken():
                return True
            if waited >= patience:
                break
            if not told and waited >= QUIET:
                told = True
                speak(self.owner())
            time.sleep(POLL)
            waited += POLL
        return False

    def close(self) -> None:
        """Gives it back, and removes the file."""
        if self._descriptor is not None:
            if not self.is_lost():
                with suppress(OSError):
                    self._file.unlink()
            os.close(self._descriptor)
            self._descriptor = None

    def is_lost(self) -> bool:
        """Whether the file was removed or replaced since this process got it."""
        return self._descriptor is not None and not self._has_name(self._descriptor)

    def owner(self) -> dict[str, str]:
        """Who has it: pid, host and since (a date); empty if that is unknown."""
        with suppress(OSError, ValueError, KeyError, TypeError):
            content = json.loads(read_regular(self._file, 4096))
            return {key: str(content[key]) for key in ("pid", "host", "since")}
        return {}

    def _taken(self) -> bool:
        while True:
            descriptor = open_regular(self._file, os.O_RDWR | os.O_CREAT)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if self._has_name(descriptor):  # else its former owner has just removed it
                    text = _this_process()
                    os.ftruncate(descriptor, 0)
                    os.pwrite(descriptor, text, 0)
                    self._descriptor = descriptor
                    return True
            except BlockingIOError:
                os.close(descriptor)
                return False
            except OSError:
                # An empty file was created above: a process that locks one writes into it.
                if not os.fstat(descriptor).st_size:
                    with suppress(OSError):
                        self._file.unlink()
                os.close(descriptor)
                raise
            os.close(descriptor)

    def _has_name(self, descriptor: int) -> bool:
        try:
            return os.path.samestat(os.fstat(descriptor), self._file.stat())
        except FileNotFoundError:
            return False


def _this_process() -> bytes:
    since = datetime.now(UTC).isoformat(timespec="seconds")
    return json.dumps({"host": socket.gethostname(), "pid": os.getpid(), "since": since}).encode()
