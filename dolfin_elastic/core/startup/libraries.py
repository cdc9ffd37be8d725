"""Starts MPI and PETSc, with no look at the current folder."""

from __future__ import annotations

import os
import pwd
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module

from dolfin_elastic.core.errors import OutputError
from dolfin_elastic.core.startup.elsewhere import elsewhere

_PETSC = "petsc4py.PETSc"
"""Who imports it starts PETSc."""
_NO_FILES = "-skip_petscrc"
"""PETSc reads options from no file: neither from the current folder nor from the user's home."""
_NOBODY = "/nonexistent"
"""Home of a user without one, as Debian has it."""
_TEMPORARY = ("TMPDIR", "TEMP", "TMP")
"""Variables that say where Open MPI keeps files of a run, in their order."""

_without = False


def stay_without() -> None:
    """In this process nothing starts MPI and PETSc: it is no rank of a run.

    To be called before anything else is imported from the package.
    """
    global _without  # noqa: PLW0603
    _without = True


def start(petsc: Sequence[str] = ()) -> None:
    """Starts MPI and PETSc, where nobody has started them before, and imports DOLFINx. Collective.

    DOLFINx is imported here since it looks for PETSc's library by petsc.cfg.

    Args:
        petsc: Options that PETSc reads as it starts, such as ``-log_view``.

    Raises:
        OutputError: The folder of temporary files cannot be written.
    """
    if _without or all(name in sys.modules for name in (_PETSC, "dolfinx")):
        return
    _have_home()
    _check_temporary_folder()
    with elsewhere():
        import_module("mpi4py.MPI")
        if _PETSC not in sys.modules:
            import_module("petsc4py").init([_NO_FILES, *petsc])
        import_module("dolfinx")


def _have_home() -> None:
    """Sets HOME where a service has none: Open MPI does not start without it."""
    if os.environ.get("HOME"):
        return
    home = _NOBODY
    with suppress(KeyError):  # a container's user may be a number alone
        home = pwd.getpwuid(os.getuid()).pw_dir or home
    os.environ["HOME"] = home


def _temporary_folder() -> str:
    return next((os.environ[one] for one in _TEMPORARY if os.environ.get(one)), "/tmp")


def _check_temporary_folder() -> None:
    """Open MPI dies where it can neither write nor make it, with thirty lines of its own."""
    folder = _temporary_folder()
    try:
        os.makedirs(folder, exist_ok=True)
        os.rmdir(tempfile.mkdtemp(prefix="dolfin-elastic-", dir=folder))
    except OSError as error:
        raise OutputError(
            f"MPI cannot start: {folder}, where it keeps temporary files, cannot be written: "
            f"{os.strerror(error.errno or 0).lower()}; TMPDIR names another folder"
        ) from error
