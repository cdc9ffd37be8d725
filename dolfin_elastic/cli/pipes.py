"""Standard output and error: without control characters, and into pipes that somebody closes.

`dolfin-elastic run beam.toml | head -2` closes one.
"""

from __future__ import annotations

import io
import os
import re
import signal
import sys
from collections.abc import Buffer
from typing import TextIO

_LINE_MODES = ("line_buffering", "write_through")


_COMMANDS = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f"  # C0 without tab and line feed, DEL, C1
    "\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff"  # direction and width of text
    "\ud800-\udfff]"  # bytes of a file name that are no UTF-8
)


def printable(text: str) -> str:
    r"""The text with control characters as JSON writes them, ``\\u001b``: JSON stays JSON."""
    return _COMMANDS.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def guard_output() -> None:
    """Lets the program run to its end, silently, if the reader of its output goes away.

    From now on no text that is printed commands the terminal, see `printable`.
    """
    # Ignoring SIGPIPE is not enough: PETSc installs a handler of its own when it starts, which
    # aborts all ranks. A blocked signal reaches no handler; `write` fails with EPIPE instead.
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGPIPE})
    sys.stdout, sys.stderr = _surviving(sys.stdout), _surviving(sys.stderr)


def _surviving(stream: TextIO) -> TextIO:
    """The same stream, which discards what is written after its reader has gone."""
    try:
        raw = _PipeOrNull(stream.fileno(), "wb", closefd=False)
    except (AttributeError, OSError):  # the stream is closed, or is not a file
        return stream
    stream.flush()
    return _Printable(
        io.BufferedWriter(raw),
        encoding=stream.encoding,
        errors=stream.errors,
        line_buffering=any(getattr(stream, name, False) for name in _LINE_MODES),
    )


class _Printable(io.TextIOWrapper):
    """A stream for texts that may hold anything."""

    def write(self, text: str, /) -> int:
        super().write(printable(text))
        return len(text)

    @property
    def unfiltered(self) -> _Unfiltered:
        """The same stream for texts that command the terminal on purpose."""
        return _Unfiltered(self)


class _Unfiltered:
    """See `_Printable.unfiltered`: what a console asks of a file."""

    def __init__(self, stream: _Printable) -> None:
        self._stream = stream

    def write(self, text: str, /) -> int:
        return io.TextIOWrapper.write(self._stream, text)

    def flush(self) -> None:
        self._stream.flush()

    def fileno(self) -> int:
        return self._stream.fileno()

    def isatty(self) -> bool:
        return self._stream.isatty()

    @property
    def encoding(self) -> str:
        return self._stream.encoding


class _PipeOrNull(io.FileIO):
    """A pipe that becomes /dev/null when its reader has gone."""

    def write(self, data: Buffer, /) -> int:
        try:
            return super().write(data)
        except BrokenPipeError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.fileno())
            os.close(nowhere)
            return super().write(data)
