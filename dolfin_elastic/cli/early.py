"""What a command that computes imports first, to start and to end sooner.

Debian's Open MPI is linked with libraries for the networks of clusters, whether there is one or
not, and each start waits for them:

- libpsm2, for Omni-Path, measures the clock as it is loaded, with 400 short sleeps: 0.1 s.  A
  thread loads it while Python imports what needs neither MPI nor another library.  (MPI's library
  itself is not to be loaded so: UCX moves the end of the heap as it is loaded, while Python
  allocates.)
- UCX tries out, as it is loaded, whether it sees that memory is freed, for what a network card has
  been told of: 0.04 s.  On one machine there is no card to be told.
- A rank takes its leave of the launcher, by PMIx, in two small packets over TCP.  The second waits
  until the first is acknowledged, which the launcher delays for 0.04 s (Nagle's algorithm, RFC 896,
  and delayed acknowledgements, RFC 1122, 4.2.3.2).

DOLFINx 0.9 makes functions of PETSc callable from Numba, whether there is Numba or not: it parses
their declarations and loads the library once more, 25 ms of each start.  Nothing here calls them.
And Debian keeps no byte code of DOLFINx's modules, which lie beside PETSc: Python compiles them at
each start, 30 ms, where it is not told of a folder that it may write to.

UFL and FFCx ask `importlib.metadata` for their version, which lists all packages and imports
readers of mail: 10 ms.  Basix's elements make a UFL cell, with a cell of each of its faces, edges
and vertices, each time that they are asked for theirs: 20 ms.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from stat import S_ISSOCK
from types import ModuleType

from dolfin_elastic.core.signals import launched
from dolfin_elastic.core.startup.libraries import start
from dolfin_elastic.core.startup.private import make_private, user_cache, why_foreign

_SLEEPS = b"libpsm2.so.2"
_FIRST = ("hashlib", "numpy", "pydantic_core", "uuid", "zoneinfo")
"""Modules with libraries: to load one waits for any that is being loaded."""
_MEANWHILE = (
    "dolfin_elastic.model.contact",
    "dolfin_elastic.model.loads.base",
    "dolfin_elastic.model.materials.law",
    "dolfin_elastic.model.materials.mixed",
    "dolfin_elastic.model.materials.spatial",
    "dolfin_elastic.model.supports.displacement",
    "dolfin_elastic.model.supports.rigid_surface",
    "dolfin_elastic.model.supports.springs",
    "dolfin_elastic.model.tie",
)
"""Modules of Python alone, once the first are there, with UFL: they import no other library."""
_COMPILED = ("basix.ufl", "ffcx", "cffi")
"""What DOLFINx imports and has byte code."""
_FOR_NUMBA = "dolfinx.utils"


def import_early(at_start: Sequence[str] = ()) -> None:
    """Imports what every computation needs, and starts MPI and PETSc. Collective.

    Args:
        at_start: Options that PETSc reads as it starts.
    """
    if "dolfinx" in sys.modules:
        return
    alone = _on_one_machine()
    if alone:
        os.environ.setdefault("UCX_MEM_EVENTS", "n")
    _import_beside_psm2()
    # Not from a disk that all of a cluster share.
    with _importing_dolfinx(_byte_code() if alone else None):
        start(at_start)
    if "PMIX_RANK" in os.environ:
        _send_at_once()


def _on_one_machine() -> bool:
    """Whether all ranks are on this machine, as far as their launcher says so."""
    there, here = (os.environ.get(f"OMPI_COMM_WORLD_{one}SIZE") for one in ("", "LOCAL_"))
    return there == here if there else not launched()


def _import_beside_psm2() -> None:
    """Imports what needs no MPI while libpsm2 sleeps; without that library, too."""
    import ctypes

    for name in _FIRST:
        import_module(name)
    load = ctypes.CDLL(None).dlopen  # which lets other threads go on, as ctypes.CDLL does not
    load.argtypes, load.restype = (ctypes.c_char_p, ctypes.c_int), ctypes.c_void_p
    loading = threading.Thread(target=load, args=(_SLEEPS, os.RTLD_NOW), daemon=True)
    # Nothing may change the environment while the library looks at it: pydantic's `schema` would.
    os.environ.setdefault("PYDANTIC_SKIP_VALIDATING_CORE_SCHEMAS", "1")
    loading.start()
    import_module("dolfin_elastic.core.schema")
    with _versions_alone():
        import_module("ufl")
    for name in _MEANWHILE:
        import_module(name)
    loading.join()


@contextmanager
def _importing_dolfinx(byte_code: str | None) -> Iterator[None]:
    """Without its utilities for Numba; who imports them later gets them.

    Args:
        byte_code: Folder of its modules' byte code; None: beside them, if at all.
    """
    with _versions_alone():
        for name in _COMPILED:
            import_module(name)
    _share_cells()
    sys.modules[_FOR_NUMBA] = ModuleType(_FOR_NUMBA)
    before, sys.pycache_prefix = sys.pycache_prefix, sys.pycache_prefix or byte_code
    try:
        yield
        vars(sys.modules["dolfinx"]).pop("utils", None)
    finally:
        sys.pycache_prefix = before
        del sys.modules[_FOR_NUMBA]


@contextmanager
def _versions_alone() -> Iterator[None]:
    """Gives who asks `importlib.metadata` for a version no more than that."""
    metadata = import_module("importlib.metadata")
    whole = metadata.version
    vars(metadata)["version"] = partial(_version, whole)
    try:
        yield
    finally:
        vars(metadata)["version"] = whole


def _version(whole: Callable[[str], str], name: str) -> str:
    """Version of a package, as the first folder of metadata on Python's path says.

    Args:
        whole: Is asked where there is no such folder.
        name: Of the package.
    """
    start = name.replace("-", "_") + "-"
    for root in map(Path, sys.path):
        with suppress(OSError):
            for folder in sorted(os.listdir(root)):
                if folder.startswith(start) and folder.endswith(".dist-info"):
                    for line in (root / folder / "METADATA").read_text("utf-8").splitlines():
                        if line.startswith("Version: "):
                            return line.removeprefix("Version: ").strip()
    return whole(name)


def _share_cells() -> None:
    """Gives all elements of a shape the same UFL cell, which nothing changes."""
    from basix.ufl import _ElementBase
    from ufl import Cell

    made = cache(Cell)
    _ElementBase.cell = property(lambda element: made(element._cellname))


def _byte_code() -> str | None:
    """Folder of byte code in the cache; None where others could have written there."""
    if sys.dont_write_bytecode:
        return None
    try:
        folder = user_cache() / "dolfin_elastic" / "python"
        make_private(folder)
        return None if why_foreign(folder, own=True) else str(folder)
    except (OSError, RuntimeError):  # there is no home
        return None


def _send_at_once() -> None:
    """Lets no packet to the launcher wait for the acknowledgement of the one before."""
    from socket import AF_INET, AF_INET6, IPPROTO_TCP, SOCK_STREAM, TCP_NODELAY, socket

    for number in map(int, os.listdir("/proc/self/fd")):
        with suppress(OSError):  # the folder's own is closed
            if S_ISSOCK(os.fstat(number).st_mode):
                with socket(fileno=os.dup(number)) as one:
                    if one.family in (AF_INET, AF_INET6) and one.type == SOCK_STREAM:
                        one.setsockopt(IPPROTO_TCP, TCP_NODELAY, 1)
