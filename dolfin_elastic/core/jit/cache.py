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
from contextlib import closing, contextmanager, suppress
from importlib import import_module
from pathlib import Path

from cffi import VerificationError

from dolfin_elastic.core.errors import OutputError
from dolfin_elastic.core.lease import Lease
from dolfin_elastic.core.signals import raise_if_asked
from dolfin_elastic.core.startup.elsewhere import elsewhere

log = logging.getLogger("dolfin_elastic")


EVERY_RANK = {"every_rank": True}
"""Marks a record that one rank alone may have, and that is shown from whichever has it."""

PATIENCE = 600.0
"""Seconds to wait for a process that compiles the same form, and may have been stopped meanwhile:
then this one compiles it, too, and the first to finish publishes it."""

_NO_LOCKS = (errno.EOPNOTSUPP, errno.ENOSYS, errno.ENOLCK)
"""Of file systems without locks, where several processes may compile the same form."""

OTHERS = 0o022
"""Rights to write of the group and of all."""
_OURS = "dolfin_elastic"
"""Folder of the cache from which on nobody else may write; what lies above is the user's affair."""


def user_cache() -> Path:
    """Folder of what can be made anew; a relative XDG_CACHE_HOME does not count, as XDG says."""
    root = os.environ.get("XDG_CACHE_HOME", "")
    return Path(root) if os.path.isabs(root) else Path.home() / ".cache"


def make_private(folder: Path) -> None:
    """Makes a folder, and those above it that are missing, for this user alone.

    Args:
        folder: Of code; the user's mask, which may let his group write, does not matter.
    """
    if not folder.parent.exists():
        make_private(folder.parent)
    folder.mkdir(mode=0o700, exist_ok=True)


def why_foreign(folder: Path, *, own: bool = False) -> str:
    """Why the code in a folder may be that of another user; empty where it cannot be.

    The folder, and those above it as far as this program has made them, must belong to the user, or
    to an administrator, and nobody else may write to them: neither a group, nor all, where a folder
    above is open to them. In a sticky folder, such as /tmp, nobody removes what is another's.

    Args:
        folder: An absolute path.
        own: It is the user's own, and no link.
    """
    parts = folder.parts
    first = max((i for i, name in enumerate(parts) if name == _OURS), default=len(parts) - 1)
    for i in range(len(parts)):
        if fault := _fault(Path(*parts[: i + 1]), own=own, ours=i >= first):
            return fault
    real = Path(os.path.realpath(folder))
    above = [] if real == folder else real.parents
    return next((fault for one in above if (fault := _fault(one, own=own, ours=False))), "")


def _fault(folder: Path, *, own: bool, ours: bool) -> str:
    try:
        link, status = folder.lstat(), folder.stat()
    except OSError as error:
        return os.strerror(error.errno or 0).lower()
    if not stat.S_ISDIR((link if own and ours else status).st_mode):
        return f"{folder} is no folder"
    users = {os.getuid()} if own else {os.getuid(), 0}
    if ours and not {link.st_uid, status.st_uid} <= users:
        return f"{folder} belongs to another user"
    if ours and status.st_mode & OTHERS:
        return f"other users may write to {folder} (chmod -R go-w {folder}, if nobody has)"
    if status.st_mode & stat.S_IWOTH and not status.st_mode & stat.S_ISVTX:
        return f"all may write to {folder}"
    return ""


def is_own(path: Path) -> bool:
    """Whether a file or folder is the user's or an administrator's, and for others to read only.

    A link is not.

    Raises:
        OSError: There is none.
    """
    status = path.lstat()
    private = not stat.S_ISLNK(status.st_mode) and not status.st_mode & OTHERS
    return private and status.st_uid in {os.getuid(), 0}


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
    if path := find(roots, key):
        return path
    faults: list[str] = []
    for number, root in enumerate(roots):
        try:
            folder = _compile(root, key, compile_into, private=number > 0)
        except (OSError, VerificationError) as error:
            faults.append(f"{root}: {_cause(error)}")
            if number == len(roots) - 1:
                raise OutputError(
                    f"finite-element code cannot be compiled: {'; '.join(faults)}"
                ) from error
        else:
            if faults:
                _warn_once(
                    f"compiled code cannot be stored ({'; '.join(faults)}): they are compiled anew "
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
        with closing(Lease(root / f".{key}.claim")) as lease:
            alone = _acquired(lease, target)
            if _is_whole(target):  # by another process, before this one had the lease
                return target
            if shutil.disk_usage(root).free < _ROOM:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            for left in root.glob(f".{key}.part-*") if alone else ():  # by a killed compilation
                shutil.rmtree(left, ignore_errors=True)
            if target.exists():
                _warn_once(
                    f"compiled code in {root} is damaged, or others may write to it: "
                    "it is compiled again"
                )
                _remove_damaged(target)
            try:
                return _publish(root, key, compile_into)
            except (OSError, VerificationError):
                if not lease.is_lost():
                    raise  # else another process has removed the folder, and compiles the form


def _acquired(lease: Lease, target: Path) -> bool:
    """Whether this process alone compiles a form; else none does any more, or nobody can tell."""

    def done() -> bool:
        raise_if_asked()
        return _is_whole(target)

    try:
        return lease.acquire(PATIENCE, done=done, speak=_say_for_whom)
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        return False


def _say_for_whom(owner: dict[str, str]) -> None:
    who = f"process {owner.get('pid', '?')} on {owner.get('host', '?')}"
    log.warning("waiting for %s, which compiles the same code", who, extra=EVERY_RANK)


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
