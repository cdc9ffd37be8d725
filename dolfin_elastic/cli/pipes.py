"""Output into a pipe that somebody closes, as `dolfin-elastic run beam.toml | head -2` does."""

from __future__ import annotations

import io
import os
import signal
import sys
from typing import Any, TextIO

_AT_ONCE = ("line_buffering", "write_through")


def go_on_without_readers() -> None:
    """From now on a run goes on to its end, silently, when nobody reads what it prints."""
    # PETSc, when it starts, puts a handler in the place of Python's, which ends all ranks; what is
    # blocked reaches none.
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGPIPE})
    sys.stdout, sys.stderr = _lasting(sys.stdout), _lasting(sys.stderr)


def _lasting(stream: TextIO) -> TextIO:
    """The same stream, which nobody needs to read."""
    try:
        raw = _Lasting(stream.fileno(), "wb", closefd=False)
    except (AttributeError, OSError):  # closed from the start, or no file at all
        return stream
    stream.flush()
    return io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding=stream.encoding,
        errors=stream.errors,
        line_buffering=any(getattr(stream, name, False) for name in _AT_ONCE),
    )


class _Lasting(io.FileIO):
    """A file that leads nowhere from when its reader has gone."""

    def write(self, data: Any, /) -> int:
        try:
            return super().write(data)
        except BrokenPipeError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.fileno())
            os.close(nowhere)
            return super().write(data)
