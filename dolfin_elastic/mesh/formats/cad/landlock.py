"""Landlock, by which a process of Linux (5.13 and later) gives up rights without any privilege.

It works in containers too, unlike a sandbox of namespaces.  There are no wrappers of its three
system calls in the C library, and none in Debian for Python.
Source: https://docs.kernel.org/userspace-api/landlock.html and linux/landlock.h.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterable
from pathlib import Path

_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446
"""Numbers of the system calls, the same on all architectures."""
_VERSION = 1
"""Flag that asks for the version of the interface."""
_PATH_BENEATH = 1
_NO_NEW_PRIVS = 38
_READ = 1 << 2 | 1 << 3
"""Read files, list folders."""
_WRITE = 1 << 1 | 1 << 4 | 1 << 5 | 1 << 7 | 1 << 8
"""Write files; remove and make files and folders."""
_TRUNCATE = 1 << 14
_FILE_RIGHTS = {1: 13, 2: 14, 3: 15, 4: 15}
"""Version to how many rights on files it knows: execution is the first; later ones know 16."""
_NETWORK = 3
"""Bind and connect TCP sockets, from version 4 on."""


class _Ruleset(ctypes.Structure):
    _fields_ = (("files", ctypes.c_uint64), ("network", ctypes.c_uint64))


class _PathBeneath(ctypes.Structure):
    _pack_ = 1
    _fields_ = (("allowed", ctypes.c_uint64), ("folder", ctypes.c_int32))


def version() -> int:
    """Version of the kernel's interface; 0: there is none."""
    return max(ctypes.CDLL(None).syscall(_CREATE_RULESET, None, ctypes.c_size_t(0), _VERSION), 0)


def confine(readable: Iterable[Path], writable: Path) -> None:
    """Lets this process read some folders and write one, run no program and connect nowhere.

    It holds from now on, for threads and processes that are started later, and not for other
    threads that run already.  Files that are open stay open.

    Args:
        readable: Folders; those that are not there are left out.
        writable: A folder, which can be read too.

    Raises:
        OSError: The kernel refuses; nothing has changed.
    """
    known = version()
    every = (1 << _FILE_RIGHTS.get(known, 16)) - 1
    rules = _Ruleset(every, _NETWORK)
    size = ctypes.c_size_t(ctypes.sizeof(rules) if known >= 4 else 8)
    ruleset = _call(_CREATE_RULESET, ctypes.byref(rules), size, 0)
    try:
        rights = [(folder, _READ) for folder in readable if folder.is_dir()]
        for folder, allowed in [*rights, (writable, _READ | _WRITE | _TRUNCATE)]:
            opened = os.open(folder, os.O_PATH | os.O_DIRECTORY)
            try:
                rule = _PathBeneath(allowed & every, opened)
                _call(_ADD_RULE, ruleset, _PATH_BENEATH, ctypes.byref(rule), 0)
            finally:
                os.close(opened)
        ctypes.CDLL(None).prctl(_NO_NEW_PRIVS, *map(ctypes.c_ulong, (1, 0, 0, 0)))
        _call(_RESTRICT_SELF, ruleset, 0)
    finally:
        os.close(ruleset)


def _call(number: int, *arguments: object) -> int:
    library = ctypes.CDLL(None, use_errno=True)
    wide = [ctypes.c_long(a) if isinstance(a, int) else a for a in arguments]
    result = int(library.syscall(ctypes.c_long(number), *wide))
    if result < 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))
    return result
