"""The cache of compiled forms: a folder for each, which appears there whole or not at all.

A form is compiled in a folder of its own beside the cache's and published by renaming that, so a
finished form is taken without any lock, and a killed compilation leaves nothing that looks like
one.  `whole.json` in the folder holds checksums: a cut or empty library would be a bus error.
"""

from __future__ import annotations

import atexit
import errno
import hashlib
import json
import logging
import os
import platform
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path

from cffi import VerificationError

from dolfin_elastic.core.errors import OutputError
from dolfin_elastic.core.jit.claim import EVERY_RANK, Claim
from dolfin_elastic.core.startup.elsewhere import elsewhere
from dolfin_elastic.core.startup.private import (
    OTHERS,
    is_own,
    make_private,
    user_cache,
    why_foreign,
)

log = logging.getLogger("dolfin_elastic")

Compile = Callable[[Path], object]
"""Compiles a form into a folder."""

_MANIFEST = "whole.json"
_ROOM = 32 << 20
"""Bytes that a disk must have free for a compilation."""


def cache_folder() -> Path:
    """Folder of compiled forms, one for each kind of processor.

    Forms are compiled with -march=native: in a home directory shared by unlike machines, none may
    load the code of another.
    """
    return user_cache() / "dolfin_elastic" / "forms" / _processor()


def _processor() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.machine()
    flags = next((line for line in text.splitlines() if line.startswith(("flags", "Features"))), "")
    return f"{platform.machine()}-{hashlib.sha256(flags.encode()).hexdigest()[:10]}"


def private_folders(name: str) -> list[Path]:
    """Where forms are compiled if the cache cannot take them: folders that need not exist.

    Args:
        name: One that nobody can guess, the same on all ranks of a run.
    """
    places = dict.fromkeys([tempfile.gettempdir(), "/dev/shm"])  # the temporary files' may be full
    return [Path(place) / f"dolfin_elastic-{name}" for place in places if Path(place).is_dir()]


def find(roots: Sequence[Path], key: str) -> Path | None:
    """Folder of a form that has been compiled before. Not collective.

    Args:
        roots: The cache, and folders in its place.
    """
    for number, root in enumerate(roots):
        if _is_whole(root / key) and not why_foreign(root.absolute(), own=number > 0):
            return root / key
    return None


def find_or_compile(roots: Sequence[Path], key: str, compile_into: Compile) -> Path:
    """Folder of a compiled form.  Not collective: no rank waits for another of its run.

    Args:
        roots: The cache, and folders to be used in its place where it cannot be written.
        key: Name of the form, by all that its code depends on.
        compile_into: Called if no root has the form.

    Raises:
        OutputError: It can be compiled in no folder.
        StoppedError: A signal has asked for the end of the run meanwhile.
    """
    if found := find(roots, key):
        return found
    faults: list[str] = []
    for number, root in enumerate(roots):
        try:
            folder = _compile(root, key, compile_into, private=number > 0)
        except (OSError, VerificationError) as error:
            faults.append(f"{root}: {_cause(error)}")
            if number == len(roots) - 1:
                raise OutputError("forms cannot be compiled: " + "; ".join(faults)) from error
        else:
            if faults:
                _warn_once(
                    f"compiled forms cannot be kept ({'; '.join(faults)}): they are compiled anew "
                    f"in each run, in {root}"
                )
            return folder
    raise AssertionError  # there is a root


def _cause(error: Exception) -> str:
    if isinstance(error, OSError) and error.errno:
        return os.strerror(error.errno).lower()
    return str(error)


def _compile(root: Path, key: str, compile_into: Compile, *, private: bool) -> Path:
    """Compiles a form into a root, unless another process does so meanwhile."""
    _make_root(root, private=private)
    target = root / key
    while True:
        with Claim(root / f".{key}.claim", lambda: _is_whole(target)) as claim:
            if _is_whole(target):  # by another process, before this one had the claim
                return target
            if shutil.disk_usage(root).free < _ROOM:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            for left in root.glob(f".{key}.part-*"):  # by a killed compilation
                shutil.rmtree(left, ignore_errors=True)
            if target.exists():
                _warn_once(
                    f"a compiled form in {root} is damaged, or others may write to it: "
                    "it is compiled again"
                )
                _remove_damaged(target)
            try:
                return _publish(root, key, compile_into)
            except (OSError, VerificationError):
                if not claim.is_lost():
                    raise  # else another process has removed the folder, and compiles the form


def _make_root(root: Path, *, private: bool) -> None:
    if not private:
        make_private(root)
    else:
        with suppress(FileExistsError):
            root.mkdir(mode=0o700)
            atexit.register(shutil.rmtree, root, ignore_errors=True)
    if fault := why_foreign(root.absolute(), own=private):
        raise OSError(fault)


def _publish(root: Path, key: str, compile_into: Compile) -> Path:
    target = root / key
    part = Path(tempfile.mkdtemp(prefix=f".{key}.part-", dir=root)).absolute()
    try:
        with elsewhere(), suppress(ImportError):
            # With it comes setuptools, which looks for a pybuilddir.txt in the current folder.
            import_module("cffi._shimmed_dist_utils")
        with _temporary_files_in(part):
            compile_into(part)
        for left in part.glob("*.o"):
            left.unlink()
        sums = {file.name: _checksum(file) for file in part.iterdir()}
        (part / _MANIFEST).write_text(json.dumps(sums), encoding="utf-8")
        for file in part.iterdir():  # whatever the user's mask
            file.chmod(stat.S_IMODE(file.stat().st_mode) & ~OTHERS)
        part.chmod(0o755)
        part.rename(target)
    except OSError:
        if not _is_whole(target):  # by another process that took this one for dead
            raise
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return target


def _remove_damaged(target: Path) -> None:
    """Removes a folder in one step, for others may look into it."""
    away = Path(tempfile.mkdtemp(prefix=f"{target.name}.", dir=target.parent))
    with suppress(FileNotFoundError):
        target.rename(away / target.name)
    shutil.rmtree(away, ignore_errors=True)


def _is_whole(folder: Path) -> bool:
    """Whether a compiled form is as it was written, by nobody else; false where there is none."""
    try:
        if not (is_own(folder) and is_own(folder / _MANIFEST)):
            return False
        sums = json.loads((folder / _MANIFEST).read_text(encoding="utf-8"))
        return bool(sums) and all(
            is_own(folder / name) and _checksum(folder / name) == sums[name] for name in sums
        )
    except (OSError, ValueError, TypeError, AttributeError):
        return False


def _checksum(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


@contextmanager
def _temporary_files_in(folder: Path) -> Iterator[None]:
    """Makes the C compiler use no other folder, which may be full."""
    before = os.environ.get("TMPDIR")
    os.environ["TMPDIR"] = str(folder)
    try:
        yield
    finally:
        if before is None:
            del os.environ["TMPDIR"]
        else:
            os.environ["TMPDIR"] = before


_told: set[str] = set()


def _warn_once(text: str) -> None:
    kind = text.partition("(")[0]
    if kind not in _told:
        _told.add(kind)
        log.warning("%s", text, extra=EVERY_RANK)
