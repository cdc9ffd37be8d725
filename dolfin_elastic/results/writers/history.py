"""`history.csv`: one row of numbers for each step."""

from __future__ import annotations

import csv
import errno
import io
import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from dolfin_elastic.core.files.regular import fresh, open_regular
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.timing import stage
from dolfin_elastic.problem.state import Audit, State, plain
from dolfin_elastic.results.files import (
    make_folder,
    missing_results,
    sync,
    writing,
)
from dolfin_elastic.results.writer import Numbers

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem

Number = float | int
_AXES = ("x", "y", "z")


class HistoryWriter:
    """Writes a row per step (RFC 4180, first row names the columns).  All of it is collective.

    Columns, always in this order, in SI units:

    * ``step``, ``t`` [s; in statics the load parameter], ``load_factor``, ``newton`` and
      ``krylov`` iterations, ``max_displacement`` [m],
    * ``strain_energy`` [J] if the material has one; in motion ``kinetic_energy``,
      ``external_energy`` (work of the loads so far), ``total_energy``, and where there are such
      ``relaxing_energy`` and
      ``remembered_energy`` (parts of the strain energy), ``springs_energy``, ``contact_energy``,
      ``damping_energy``, ``bulk_viscosity_energy`` (part of it) and ``dashpots_energy`` (lost so
      far), ``friction_energy`` (the work
      against it), ``potential_energy`` (of dead loads), ``balance_energy`` (the energy error),
    * ``reaction_<support>_x``, ``_y``, ``_z`` [N] for each support,
    * further results by name, for example of probes, moments, obstacles and cavities,
    * in motion ``momentum_x`` ... [kg m/s] and ``angular_momentum_x`` ... [kg m^2/s],
    * the audit: ``balance_force`` and ``balance_moment`` (relative residuals), in statics
      ``external_work`` [J], ``min_jacobian``, ``max_jacobian``, ``inverted_cells`` where
      a law survives inversion, ``verdict`` (pass or warn).

    A row is on disk when `write` returns.

    Args:
        path: The file; an old one is overwritten.
        saved: Its restart state: rows after it are cut off.

    Raises:
        OutputError: The file cannot be written.
        RestartError: Rows from before the checkpoint are missing.
    """

    def __init__(self, problem: Problem, path: Path, saved: Numbers | None = None) -> None:
        self.comm, self.path = problem.body.comm, path
        self._file: BinaryIO | None = None
        self._columns: list[str] = []
        on_root(self.comm, self._open if saved is None else lambda: self._cut(saved["bytes"]))

    def _open(self) -> None:
        make_folder(self.path.parent)
        with writing(self.path):
            self._file = fresh(self.path).open("wb", buffering=0)

    def _cut(self, size: int) -> None:
        if not self.path.is_file() or self.path.stat().st_size < size:
            raise missing_results(self.path, "rows")
        with writing(self.path):
            self._file = os.fdopen(open_regular(self.path, os.O_RDWR), "r+b", buffering=0)
            head = self._file.readline() if size else b""
            self._file.truncate(size)
            self._file.seek(size)
        self._columns = next(csv.reader([head.decode()]), [])

    def restart_state(self) -> Numbers:
        """See `Writer`."""
        return {"bytes": on_root(self.comm, self._synced)}

    def _synced(self) -> int:
        sync(self.path)
        return self.path.stat().st_size

    def write(self, state: State) -> None:
        """Appends one row."""
        with stage("output"):
            on_root(self.comm, lambda: self._append(row(state)))

    def _append(self, values: dict[str, Number | str]) -> None:
        text = ""
        if not self._columns:
            self._columns = list(values)
            text = _line(self._columns)
        text += _line([values.get(name, "") for name in self._columns])
        with writing(self.path):
            assert self._file is not None
            if self._file.write(text.encode()) != len(text.encode()):
                raise OSError(errno.ENOSPC, "only a part was written")

    def close(self, status: str = "completed", error: object = None) -> None:
        """See `Writer`; closes the file."""
        if self._file is not None:
            self._file.close()
            self._file = None


def row(state: State) -> dict[str, Number | str]:
    """Column to value of one step in SI units, in the columns' order."""
    values: dict[str, Number] = {
        "step": state.step,
        "t": plain(state.t),
        "load_factor": plain(state.load_factor),
        "newton": state.newton,
        "krylov": state.krylov,
        "max_displacement": state.max_displacement,
    }
    energies = [
        name for name in ("strain", "kinetic", "external", "total") if name in state.energies
    ]
    energies += [name for name in state.energies if name not in energies]
    values.update({f"{name}_energy": state.energies[name] for name in energies})
    for support, force in state.reactions.items():
        values.update(_components(f"reaction_{support}", force))
    for name, column in (("linear", "momentum"), ("angular", "angular_momentum")):
        if name in state.momenta:
            values.update(_components(column, state.momenta[name]))
    values.update(state.numbers)
    numbers = {name: v if isinstance(v, int) else float(v) for name, v in values.items()}
    audited = _audit_columns(state.audit)
    if state.v is not None:  # in motion the work is among the energies
        audited.pop("external_work", None)
    return {**numbers, **audited}


def _audit_columns(audit: Audit | None) -> dict[str, Number | str]:
    """Columns of the audit, without the balances that do not exist for the problem."""
    if audit is None:
        return {}
    force = {} if math.isnan(audit.force) else {"balance_force": audit.force}
    moment = {} if math.isnan(audit.moment) else {"balance_moment": audit.moment}
    inverted = {} if audit.inverted is None else {"inverted_cells": audit.inverted}
    return {
        **force,
        **moment,
        "external_work": audit.work,
        "min_jacobian": audit.min_jacobian,
        "max_jacobian": audit.max_jacobian,
        **inverted,
        "verdict": audit.verdict,
    }


def _components(name: str, vector: Iterable[float]) -> dict[str, Number]:
    numbers = [float(v) for v in vector]
    # The angular momentum of a plane body has one component, about z.
    axes = ("z",) if len(numbers) == 1 else _AXES
    return {f"{name}_{axis}": v for axis, v in zip(axes, numbers, strict=False)}


def _line(cells: Sequence[object]) -> str:
    text = io.StringIO(newline="")
    csv.writer(text).writerow(cells)
    return text.getvalue()
