"""Files that are never half-written, and errors that say which file could not be."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mpi4py import MPI

from dolfin_elastic.core.errors import OutputError, RestartError

_SPARE = 1 << 20


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turns what the operating system or MPI says about a file into an `OutputError`.

    Not collective: use it inside `parallel.on_root` or before `parallel.agree`.

    Raises:
        OutputError: Names the file, the cause and what helps.
    """
    try:
        yield
    except OSError as error:
        raise OutputError(f"cannot write {path}: {_cause(error)}") from error
    except MPI.Exception as error:
        raise OutputError(f"cannot write {path}: {error.Get_error_string()}") from error


def _cause(error: OSError) -> str:
    reason = os.strerror(error.errno).lower() if error.errno else str(error)
    advice = {
        errno.ENOSPC: "; make room or write fewer steps (every = 10)",
        errno.EDQUOT: "; your quota is used up",
        errno.EACCES: "; choose a folder you may write to",
        errno.EROFS: "; choose a folder you may write to",
    }
    return reason + advice.get(error.errno or 0, "")


def replace_text(path: Path, text: str, *, durable: bool = False) -> None:
    """Writes a whole file under another name and renames it. Not collective.

    Whoever opens `path`, at any moment and also after the program was killed, finds either the
    old text or the new one, complete.

    Args:
        path: The file.
        text: What it shall hold.
        durable: Also after a loss of power.
    """
    draft = path.with_name(f".{path.name}.part")
    with writing(path):
        draft.write_text(text, encoding="utf-8")
        if durable:
            sync(draft)
        draft.replace(path)


def sync(path: Path) -> None:
    """Waits until a file or folder is on the disk itself. Not collective."""
    with writing(path):
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def missing_results(path: Path, what: str) -> RestartError:
    """The error of results that are not there any more. Not collective."""
    return RestartError(
        f"{what} that the checkpoint knows of are not there",
        where=str(path),
        expected="put the results back as the run has left them, or compute the case anew",
    )


def make_folder(folder: Path) -> None:
    """Makes a folder and its parents, and sees that it can be written to. Not collective."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, "no write permission")


def need_space(folder: Path, size: int) -> None:
    """Checks that `size` bytes (and a little more) are free. Not collective.

    Raises:
        OutputError: They are not.
    """
    with writing(folder):
        if shutil.disk_usage(folder).free < size + _SPARE:
            raise OSError(errno.ENOSPC, "disk full")
