"""Monitors of solvers that write into files: -snes_monitor ascii:FILE, -ksp_monitor ascii:FILE.

PETSc opens the file anew, and adds a monitor, each time that a solver reads its options, which ours
do before each solve: ten monitors would be too many, and each would empty the file.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import ClassVar

from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.solvers.petsc.options import Options

_ASCII = "ascii:"


class FileMonitors:
    """The monitors of one Newton's method that write into files.  Collective to make.

    Args:
        options: From which the options of these monitors are taken.

    Attributes:
        NAMES: The options, without prefix.

    Raises:
        InputError: A file cannot be written.
    """

    NAMES: ClassVar[frozenset[str]] = frozenset({"snes_monitor", "ksp_monitor"})

    def __init__(self, snes: PETSc.SNES, ksp: PETSc.KSP, options: Options) -> None:
        self._viewers: list[PETSc.Viewer] = []
        if viewer := self._viewer(snes.comm.tompi4py(), "snes_monitor", options):
            snes.setMonitor(lambda _, i, norm: _write(viewer, f"{i:3d} SNES Function norm", norm))
        if of_ksp := self._viewer(snes.comm.tompi4py(), "ksp_monitor", options):
            ksp.setMonitor(lambda _, i, norm: _write(of_ksp, f"{i:5d} KSP Residual norm", norm))

    def _viewer(self, comm: MPI.Comm, name: str, options: Options) -> PETSc.Viewer | None:
        value = options.users.get(name)
        if not isinstance(value, str) or not value.startswith(_ASCII):
            return None
        file = value.removeprefix(_ASCII).split(":")[0]
        options.take(name)
        fault = on_root(comm, lambda: _why_not_written(file))
        if fault:
            raise InputError(
                f"the file {file} cannot be written: {fault}",
                where=f"PETSc option -{name}",
                expected="a folder you may write to",
            )
        viewer = PETSc.Viewer().createASCII(file, mode=PETSc.Viewer.Mode.WRITE, comm=comm)
        self._viewers.append(viewer)
        return viewer

    def close(self) -> None:
        """Closes the files. Collective."""
        for viewer in self._viewers:
            with suppress(PETSc.Error):  # a full disk
                viewer.destroy()
        self._viewers.clear()


def _write(viewer: PETSc.Viewer, text: str, norm: float) -> None:
    viewer.printfASCII(f"{text} {norm:14.12e}\n")
    viewer.flush()


def _why_not_written(file: str) -> str:
    try:
        Path(file).write_text("", encoding="utf-8")
    except (OSError, ValueError) as error:
        return (getattr(error, "strerror", None) or str(error)).lower()
    return ""
