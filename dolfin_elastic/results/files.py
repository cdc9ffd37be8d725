"""Files that are replaced as a whole, and errors that name the file and the cause."""

from __future__ import annotations

import errno
import math
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import cast

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.errors import OutputError, RestartError
from dolfin_elastic.core.files.regular import fresh
from dolfin_elastic.core.parallel import agree
from dolfin_elastic.core.types import AnyArray

_SPARE = 1 << 20
LONGEST_NAME = 255
"""Bytes of a file's name."""


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turns an `OSError` or MPI error of a file into an `OutputError`.

    Not collective: use it inside `parallel.on_root` or before `parallel.agree`.

    Args:
        path: The file or folder that is written, for the message.

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


def open_together(comm: MPI.Comm, path: Path) -> MPI.File:
    """Opens a file that is there, for all ranks to write into. Collective.

    Open MPI would prepare a file pointer that ranks share, which nobody uses, with a semaphore
    named after the file, one for all runs of a machine: a run that is killed while it has it leaves
    it taken, and whoever opens a file of that name waits for ever (`sharedfp_sm_file_open.c`).

    Args:
        comm: The ranks.
        path: The file, on a file system that all ranks see.

    Raises:
        OutputError: On all ranks, when one of them cannot open it.
    """
    os.environ.setdefault("OMPI_MCA_sharedfp", "individual")  # read when the first file is opened
    error, file = None, MPI.FILE_NULL
    try:
        with writing(path):
            file = MPI.File.Open(cast(MPI.Intracomm, comm), str(path), MPI.MODE_WRONLY)
    except OutputError as caught:
        error = caught
    agree(comm, error)
    return file


def write_at(file: MPI.File, path: Path, offset: int, values: AnyArray) -> OutputError | None:
    """Writes an array into a file; returns an error, which all ranks then raise. Not collective.

    Args:
        file: From `open_together`.
    """
    status = MPI.Status()
    try:
        with writing(path):
            file.Write_at(offset, values, status)
    except OutputError as caught:
        return caught
    if status.Get_count(MPI.BYTE) != values.nbytes:
        return OutputError(f"cannot write {path}: only a part was written; is the disk full?")
    return None


def why_not_made(folder: Path) -> str:
    """Why a folder cannot be made or written into, found out by trying; empty where it can.

    Not collective: use it inside `parallel.on_root`.  Leaves nothing behind.

    Args:
        folder: The folder, which need not exist.
    """
    if not str(folder).isprintable():
        return "that is no name"
    whole = folder.absolute()
    try:
        there = next(path for path in (whole, *whole.parents) if path.exists())
        if not there.is_dir():
            return f"{there} is a file"
        if any(len(os.fsencode(part)) > LONGEST_NAME for part in folder.parts):
            return os.strerror(errno.ENAMETOOLONG).lower()
        os.rmdir(tempfile.mkdtemp(prefix=".dolfin-elastic-", dir=there))
    except OSError as error:
        return _cause(error)
    return ""


def json_data(value: object) -> object:
    """A value in JSON's types; numbers that are not finite become null, for JSON has none."""
    if isinstance(value, Mapping):
        return {str(key): json_data(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [json_data(item) for item in value]
    if isinstance(value, np.generic):
        return json_data(value.item())
    return None if isinstance(value, float) and not math.isfinite(value) else value


@contextmanager
def drafted(path: Path) -> Iterator[Path]:
    """An empty file that takes the name once it is whole, and is gone else. Not collective.

    Yields:
        The file to write.

    Raises:
        OutputError: It cannot be written.
    """
    draft = path.with_name(f".{path.name}.part")
    with writing(path):
        try:
            yield fresh(draft)
            draft.replace(path)
        finally:
            draft.unlink(missing_ok=True)


def replace_text(path: Path, text: str, *, durable: bool = False) -> None:
    """Writes a whole file under another name and renames it. Not collective.

    At any moment, also after a kill, `path` holds the whole old text or the whole new one.

    Args:
        path: The file.
        durable: Brings the text to the disk before the renaming (fsync), so that the same holds
            after a loss of power.

    Raises:
        OutputError: The file cannot be written.
    """
    draft = path.with_name(f".{path.name}.part")
    with writing(path):
        fresh(draft).write_text(text, encoding="utf-8")
        if durable:
            sync(draft)
        draft.replace(path)


def sync(path: Path) -> None:
    """Brings a file or folder from the cache to the disk (fsync). Not collective."""
    with writing(path):
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def missing_results(path: Path, what: str) -> RestartError:
    """The error of a restart whose results have been removed or shortened. Not collective.

    Args:
        path: The file.
        what: Its content, in the plural: "rows" or "steps".
    """
    return RestartError(
        f"{what} that the checkpoint knows of are not there",
        where=str(path),
        expected="put the results back as the run has left them, or compute the case anew",
    )


def make_folder(folder: Path) -> None:
    """Makes a folder and its parents, and checks that it can be written to. Not collective.

    Raises:
        OutputError: It cannot be made or written to.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, "no write permission")


def need_space(folder: Path, size: int) -> None:
    """Checks that a disk has room. Not collective.

    Args:
        size: Bytes that are needed, beside a reserve of 1 MiB.

    Raises:
        OutputError: Less is free.
    """
    with writing(folder):
        if shutil.disk_usage(folder).free < size + _SPARE:
            raise OSError(errno.ENOSPC, "disk full")
