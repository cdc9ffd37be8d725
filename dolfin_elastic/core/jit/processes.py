"""Processes that this one has started, to end them where compiling is interrupted."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path


class NewProcesses:
    """Processes that this one starts from now on, and what they start.

    Python ends the C compiler, a driver, when an exception interrupts the waiting for it; the
    compiler proper, a process of the driver's, would go on for minutes.
    """

    def __init__(self) -> None:
        self._before = set(_children(os.getpid()))

    def end(self) -> None:
        """Kills them."""
        new = set(_children(os.getpid())) - self._before
        for process in [*new, *(one for parent in new for one in _descendants(parent))]:
            with suppress(OSError):  # it has ended meanwhile
                os.kill(process, signal.SIGKILL)


def _children(process: int) -> list[int]:
    """Those that a process has started; none where the system does not say."""
    found: list[int] = []
    with suppress(OSError):
        for thread in Path(f"/proc/{process}/task").iterdir():
            found += map(int, (thread / "children").read_text(encoding="ascii").split())
    return found


def _descendants(process: int) -> Iterator[int]:
    for child in _children(process):
        yield child
        yield from _descendants(child)
