"""Standard output and error: without control characters, and where they cannot be written.

`dolfin-elastic run beam.toml | head -2` closes a pipe, which is no fault; `> /dev/full` is a full
disk, `>&-` closes standard output.  The program runs to its end and says at the end what is lost.
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
    return _COMMANDS.sub(lambda value: f"\\u{ord(value[0]):04x}", text)


def guard_output() -> None:
    """Lets the program run to its end where its output cannot be written; see `lost_output`.

    From now on no text that is printed commands the terminal, see `printable`.
    """
    # Ignoring SIGPIPE is not enough: PETSc installs a handler of its own when it starts, which
    # aborts all ranks. A blocked signal reaches no handler; `write` fails with EPIPE instead.
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGPIPE})
    closed = _open_closed()
    sys.stdout = _surviving(sys.stdout, 1, closed=1 in closed)
    # Who closes standard error wants no messages.
    sys.stderr = _surviving(sys.stderr, 2, closed=False)


def _open_closed() -> list[int]:
    """Opens what of input, output and error is closed, as /dev/null; their numbers.

    Else the next files to be opened, those of the results, would get these numbers, and whatever a
    library in C prints.
    """
    closed = []
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            closed.append(number)
            os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free
            os.set_inheritable(number, True)
    return closed


def lost_output() -> str:
    """Writes what is still to be written, and says what of it could not be; empty if nothing."""
    lost = []
    for stream, name in ((sys.stdout, "standard output"), (sys.stderr, "standard error")):
        if isinstance(stream, _Printable):
            stream.flush()
            lost += [f"{name} cannot be written: {stream.fault}"] if stream.fault else []
    return "; ".join(lost)


def _surviving(stream: TextIO | None, number: int, *, closed: bool) -> TextIO:
    """The same stream, which discards what cannot be written.

    Args:
        stream: Of Python; None where it was closed as Python started.
    """
    if stream is None:
        raw = _FileOrNull(number, "wb", closefd=False)
        raw.fault_of_all = "it is closed" if closed else ""
        return _Printable(raw, encoding="utf-8", errors="backslashreplace", line_buffering=True)
    try:
        raw = _FileOrNull(stream.fileno(), "wb", closefd=False)
    except (AttributeError, OSError):  # the stream is closed, or is not a file
        return stream
    stream.flush()
    return _Printable(
        raw,
        encoding=stream.encoding,
        errors=stream.errors or "strict",
        line_buffering=any(getattr(stream, name, False) for name in _LINE_MODES),
    )


class _Printable(io.TextIOWrapper):
    """A stream for texts that may hold anything.

    Args:
        raw: Where they are written.
        encoding: See `io.TextIOWrapper`.
        errors: See there.
        line_buffering: See there.
    """

    def __init__(
        self, raw: _FileOrNull, *, encoding: str, errors: str, line_buffering: bool
    ) -> None:
        super().__init__(
            io.BufferedWriter(raw), encoding=encoding, errors=errors, line_buffering=line_buffering
        )
        self._raw = raw

    @property
    def fault(self) -> str:
        """Why something of it is lost; empty where nothing is."""
        return self._raw.fault

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


class _FileOrNull(io.FileIO):
    """A file or pipe that becomes /dev/null when it cannot be written.

    Attributes:
        fault: Why something is lost; empty where nothing is, or its reader has gone.
        fault_of_all: The same, with the first write.
    """

    fault = fault_of_all = ""

    def write(self, data: Buffer, /) -> int:
        self.fault = self.fault or self.fault_of_all
        try:
            return super().write(data)
        except BrokenPipeError:
            pass
        except OSError as error:
            self.fault = os.strerror(error.errno or 0).lower()
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.fileno())
        os.close(nowhere)
        return super().write(data)
