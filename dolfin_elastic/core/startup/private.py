"""Folders of code that is run: who may write to them."""

from __future__ import annotations

import os
import stat
from pathlib import Path

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
        link, found = folder.lstat(), folder.stat()
    except OSError as error:
        return os.strerror(error.errno or 0).lower()
    if not stat.S_ISDIR((link if own and ours else found).st_mode):
        return f"{folder} is no folder"
    users = {os.getuid()} if own else {os.getuid(), 0}
    if ours and not {link.st_uid, found.st_uid} <= users:
        return f"{folder} belongs to another user"
    if ours and found.st_mode & OTHERS:
        return f"other users may write to {folder} (chmod -R go-w {folder}, if nobody has)"
    if found.st_mode & stat.S_IWOTH and not found.st_mode & stat.S_ISVTX:
        return f"all may write to {folder}"
    return ""


def is_own(path: Path) -> bool:
    """Whether a file or folder is the user's or an administrator's, and for others to read only.

    A link is not.

    Raises:
        OSError: There is none.
    """
    found = path.lstat()
    private = not stat.S_ISLNK(found.st_mode) and not found.st_mode & OTHERS
    return private and found.st_uid in {os.getuid(), 0}
