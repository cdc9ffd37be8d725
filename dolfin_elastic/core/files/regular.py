"""Files opened as what they are: no link is followed, no pipe or device is opened.

Whoever has made a folder decides what its names stand for: a link ``history.csv`` to a file
elsewhere would be written through, a pipe would be waited for, and a device has no end.
"""

from __future__ import annotations

import errno
import os
import stat
from contextlib import suppress
from pathlib import Path

_KINDS = {
    stat.S_IFLNK: "a link",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def irregular(path: str | os.PathLike[str]) -> str:
    """What a name stands for, where that is neither a file nor a folder; else empty.

    Not collective.
    """
    try:
        return _KINDS.get(stat.S_IFMT(os.lstat(path).st_mode), "")
    except (OSError, ValueError):
        return ""


def open_regular(path: Path, flags: int) -> int:
    """Opens a file that is neither link, pipe nor device. Not collective.

    Args:
        flags: Of `os.open`, in addition to those that keep it here.

    Returns:
        Its descriptor.

    Raises:
        OSError: It is something else, or cannot be opened.
    """
    # A pipe without a reader would be waited for.
    flags |= os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        descriptor = os.open(path, flags, 0o666)
    except OSError as error:
        if kind := irregular(path):
            raise OSError(errno.EINVAL, f"this is {kind}, not a file") from error
        raise
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, f"this is {irregular(path) or 'a folder'}, not a file")
    return descriptor


def fresh(path: Path) -> Path:
    """Makes an empty file that is nobody else's, in place of what has the name. Not collective.

    Returns:
        The same.

    Raises:
        OSError: It cannot be made.
    """
    with suppress(FileNotFoundError):
        os.unlink(path)
    os.close(open_regular(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL))
    return path


def read_regular(path: Path, most: int) -> bytes:
    """The content of a file that is neither link, pipe nor device. Not collective.

    Args:
        most: Bytes that it may have.

    Raises:
        OSError: It is something else, larger, or cannot be read.
    """
    with open(open_regular(path, os.O_RDONLY), "rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise OSError(errno.EFBIG, f"it has {size} bytes, more than {most}")
        return file.read(size)
