"""Output into a pipe that somebody closes, as `dolfin-elastic run beam.toml | head -2` does."""

from __future__ import annotations

import io
import os
import signal
import sys
from collections.abc import Buffer
from typing import TextIO

_LINE_MODES = ("line_buffering", "write_through")


def survive_closed_pipes() -> None:
    """Lets the program run to its end, silently, if the reader of its output goes away."""
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
    return io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding=stream.encoding,
        errors=stream.errors,
        line_buffering=any(getattr(stream, name, False) for name in _LINE_MODES),
    )


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
