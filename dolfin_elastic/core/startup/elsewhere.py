"""Where libraries start that read settings in the current folder.

UCX reads ucx.conf there as it is loaded, PETSc .petscrc and petscrc, petsc4py petsc.cfg, slepc4py
slepc.cfg, FFCx ffcx_options.json, DOLFINx dolfinx_jit_options.json, matplotlib matplotlibrc.  Such
a file comes with any folder from elsewhere: some of them load native code, overwrite files or
change the compiled forms, and a pipe of that name is waited for without an end.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

EMPTY = next((folder for folder in ("/proc", "/") if os.path.isdir(folder)), "/")
"""A folder in which nobody can put a file: that of the kernel.  A folder of our own would have to
be made, on a disk that may be full."""

_HOME = ("HOME", "XDG_CONFIG_HOME")
"""Variables that say where a user's settings are."""


@contextmanager
def elsewhere() -> Iterator[None]:
    """Inside, the current folder is `EMPTY`; afterwards what it was, also if that is gone by now.

    It is the current folder of all threads.
    """
    here = os.open(os.curdir, os.O_PATH | os.O_DIRECTORY)
    try:
        os.chdir(EMPTY)
        try:
            yield
        finally:
            os.fchdir(here)
    finally:
        os.close(here)


@contextmanager
def without_settings() -> Iterator[None]:
    """Inside, neither the current folder nor the user's home has settings."""
    before = {name: os.environ.get(name) for name in _HOME}
    with elsewhere():
        try:
            os.environ.update(dict.fromkeys(_HOME, EMPTY))
            yield
        finally:
            for name, value in before.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value


@contextmanager
def plain_matplotlib() -> Iterator[None]:
    """Inside, matplotlib draws with its own defaults, whatever a matplotlibrc says.

    It also works as a decorator.
    """
    with elsewhere():
        import matplotlib as mpl
    with mpl.rc_context():
        mpl.rcdefaults()
        yield
