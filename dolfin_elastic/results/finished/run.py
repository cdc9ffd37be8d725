"""`FinishedRun`: a folder of results, to be shown, drawn or reported without computing again."""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dolfin_elastic.core.errors import InputError, nearest_file
from dolfin_elastic.core.files.links import refuse_links
from dolfin_elastic.core.help.notebook import Shown
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.results.finished.shape import SUMMARY, check_types
from dolfin_elastic.results.finished.xdmf import Frame, damaged, read_frames, read_grid

if TYPE_CHECKING:
    import pyvista


_EXACT = {
    "max_displacement": "m",
    "external_work": "J",
    "frequency": "Hz",
    "omega": "rad/s",
    "mass": "kg",
}
BEGINNINGS = {
    "reaction_": "N",
    "momentum_": "kg m/s",
    "angular_momentum_": "kg m^2/s",
    "moment_": "N m",
    "section_force_": "N",
    "section_moment_": "N m",
    "torque_": "N m",
    "penetration_": "m",
    "contact_area_": "m^2",
    "friction_dissipation_": "J",
    "bolt_force_": "N",
    "obstacle_force_": "N",
    "obstacle_displacement_": "m",
    "obstacle_velocity_": "m/s",
    "shortening_": "m",
    "pressure_": "Pa",
    "volume_": "m^3",
    "stick_share_": "",
}
"""How columns of a support, a load or another thing begin, before its name, to their units."""
_VECTORS = (
    "reaction_",
    "momentum_",
    "angular_momentum_",
    "moment_",
    "section_force_",
    "section_moment_",
)
_WITHOUT = ("step", "load_factor", "newton", "krylov", "balance_force", "balance_moment")
_WITHOUT_UNIT = (*_WITHOUT, "min_jacobian", "max_jacobian")
_AXES, _TURNS = ("x", "y", "z"), ("rx", "ry", "rz")
_SHIFTS = ("ux", "uy", "uz")
_STRESS = re.compile(r"P[1-3]{2}")
"""Of a periodic cell."""


def column_unit(column: str, *, timed: bool) -> str:
    """Unit of a column of `history.csv`; empty of a pure number.

    Probes are told by the end of the name, see [output] probes: a name and axis are a displacement,
    a name and a field have the field's unit.

    Args:
        timed: `t` is in seconds, see `FinishedRun`.
    """
    exact = {**_EXACT, **dict.fromkeys(_WITHOUT_UNIT, ""), "t": "s" if timed else ""}
    if column in exact:
        return exact[column]
    if column.endswith("_energy"):
        return "J"
    if _STRESS.fullmatch(column):
        return "Pa"
    last = column.rpartition("_")[2]
    begin = next((unit for begin, unit in BEGINNINGS.items() if column.startswith(begin)), None)
    # A support may be called as a field is.
    if begin is not None and column.startswith(_VECTORS) and last in _AXES:
        return begin
    if (unit := _field_unit(column)) is not None:
        return unit
    by_end = "m" if last in (*_AXES, *_SHIFTS) else "rad" if last in _TURNS else ""
    return by_end if begin is None else begin


def _field_unit(column: str) -> str | None:
    """Unit of the longest name of a field that a column ends in, but for components."""
    from dolfin_elastic.results.derived.reductions import reduced_unit
    from dolfin_elastic.results.fields import FIELDS

    if (unit := reduced_unit(column, _field_unit)) is not None:
        return unit
    name, _, last = column.rpartition("_")
    vector, tensor = last in _AXES, len(last) == 2 and set(last) <= set(_AXES)
    words = (name if vector or tensor else column).split("_")
    ends = ("_".join(words[i:]) for i in range(1, len(words)))
    return next((FIELDS[end].unit for end in ends if end in FIELDS), None)


ANALYSES = ("statics", "modal", "buckling", "dynamics")
"""Folders of the results of a case with several analyses."""
_SUMMARY, _HISTORY, _FIELDS = "summary.json", "history.csv", "results.xdmf"
_SWEEP = "sweep.json"


def folders_of_analyses(folder: Path) -> list[Path]:
    """Folders in that of a case with several analyses; none in that of a single one.

    Raises:
        InputError: One of them is a link: a page would be written elsewhere.
    """
    if (folder / _SUMMARY).is_file():
        return []
    refuse_links(folder)
    return [folder / one for one in ANALYSES if (folder / one / _SUMMARY).is_file()]


class FinishedRun(Shown):
    """A folder of results.  One process reads it, and nothing is written; no MPI, no DOLFINx.

    The run may also be going on or have failed: `summary["status"]` says so.

    Attributes:
        folder: As given, as a path.
        summary: `summary.json`.
        case: The tables of the case as it was computed, with the curves of CSV files in it and of
            the mesh's file the name alone; empty of a case with Python functions.
        frames: The steps that `results.xdmf` holds; none where only modes were computed.
        history: Column of `history.csv` to its numbers, shape (rows,), SI units; an empty cell is
            nan, columns of words are left out; empty where only modes were computed.
        modal: `frames` are modes, and their t frequencies [Hz] or load factors, see `as_modes`.
        units: Column to its SI unit, empty where it has none.

    Raises:
        InputError: It is no folder of results, or a file in it cannot be read.
    """

    def __init__(self, folder: Path | str) -> None:
        self.folder = folder = Path(folder)
        self._check_folder()
        self.summary: dict[str, Any] = _read_json(folder / _SUMMARY)
        check_types(self.summary, SUMMARY, str(folder / _SUMMARY))
        self.case: dict[str, Any] = self.summary.get("case") or {}
        self.history = _read_history(folder / _HISTORY)
        self.frames: list[Frame] = read_frames(folder / _FIELDS)
        self.modal = False

    def _check_folder(self) -> None:
        folder, where = self.folder, str(self.folder)
        expected = "expected the folder of the results of a run"
        if folder.is_file():
            raise InputError("this is a file", where=where, expected=expected)
        if not folder.is_dir():
            others = [path.parent.name for path in folder.parent.glob(f"*/{_SUMMARY}")]
            hint = nearest_file(folder.name, others) if others else expected
            raise InputError("there is no such folder", where=where, expected=hint)
        refuse_links(folder)
        if several := folders_of_analyses(folder):
            raise InputError(
                "it holds the results of several analyses",
                where=where,
                expected=f"the folder of one: {' or '.join(map(str, several))}",
            )
        if (folder / _SWEEP).is_file():
            one = next((f": {path.parent}" for path in sorted(folder.glob(f"*/{_SUMMARY}"))), "")
            raise InputError(
                "it holds the results of a sweep",
                where=where,
                expected=f"sweep.html there shows all; expected the folder of one run{one}",
            )
        if not (folder / _SUMMARY).is_file():
            raise InputError(f"it holds no {_SUMMARY}", where=where, expected=expected)

    @cached_property
    def units(self) -> dict[str, str]:
        """See the class."""
        from dolfin_elastic.results.fields import FIELDS

        output = self.case.get("output") or {}
        probes = probes if isinstance(probes := output.get("probes"), Mapping) else {}
        asked = {n: row.get("fields") for n, row in probes.items() if isinstance(row, Mapping)}
        # Fields of the body have no unit that is known; names of columns may suggest one.
        of_body = tuple(
            f"{name}_{field}_"
            for name, fields in asked.items()
            for field in (fields if isinstance(fields, list | tuple) else ())
            if field not in FIELDS
        )
        return {
            name: "" if f"{name}_".startswith(of_body) else column_unit(name, timed=self.timed)
            for name in self.history
        }

    @cached_property
    def model(self) -> Mapping[str, Any]:
        """The record of its model in the summary; empty of older runs."""
        record = self.summary.get("model")
        return record if isinstance(record, Mapping) else {}

    @property
    def moving(self) -> bool:
        """The run was a motion."""
        return "kinetic_energy" in self.history

    @property
    def timed(self) -> bool:
        """t is a time [s]: in motion, and in statics where materials or the case say so."""
        old = "relaxing_energy" in self.history  # before `summary.json` had the key
        return self.moving or old or bool(self.summary.get("timed"))

    @property
    def steps(self) -> list[float]:
        """The times [s], in statics load parameters, that `results.xdmf` holds."""
        return [frame.t for frame in self.frames]

    @property
    def dim(self) -> int:
        """2 of a plane or axisymmetric body, 3 of a solid.

        Raises:
            InputError: The folder holds no fields.
        """
        return self.frame().dim

    def frame(self, step: int = -1) -> Frame:
        """One of `frames`.

        Args:
            step: Its index in `steps`; negative ones count from the end.

        Raises:
            InputError: There is none.
        """
        if not self.frames:
            raise InputError(
                f"it holds no fields of steps ({_FIELDS})",
                where=str(self.folder),
                expected="of modes each has a file of its own",
            )
        if not -len(self.frames) <= step < len(self.frames):
            raise InputError(
                f"there is no step {step}",
                where=str(self.folder),
                expected=f"0 to {len(self.frames) - 1}, or -1 for the last",
            )
        return self.frames[step]

    @property
    def metres(self) -> float:
        """Metres per unit of length of the mesh, in which places beside it are written."""
        mesh = self.model.get("mesh")
        result = mesh.get("metres", 1.0) if isinstance(mesh, dict) else 1.0
        return float(result) if isinstance(result, int | float) and result > 0 else 1.0

    def fields(self, step: int = -1) -> tuple[str, ...]:
        """Names of the fields of a step.

        Args:
            step: See `frame`.
        """
        return tuple(self.frame(step).arrays)

    def grid(self, step: int = -1) -> pyvista.UnstructuredGrid:
        """The undeformed body, quadratic cells as such, with all fields of a step.

        Fields of nodes are point data, those of cells cell data, of shape (n,) or (n, columns), in
        SI units; a tensor has nine components, row by row.

        Args:
            step: See `frame`.

        Raises:
            InputError: There is no such step, or its files are missing or damaged.
        """
        return read_grid(self.folder, self.frame(step))


def _read_json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise damaged(f"cannot be read: {error}", str(path)) from None
    if not isinstance(content, dict):
        raise damaged("this is no summary of a run", str(path))
    return content


def _read_history(path: Path) -> dict[str, FloatArray]:
    """Columns of numbers; none without the file."""
    if not path.is_file():
        return {}
    try:
        with path.open(encoding="utf-8", newline="") as file:
            head, *rows = [*csv.reader(file)] or [[]]
    except (OSError, ValueError, csv.Error) as error:
        raise damaged(f"cannot be read: {error}", str(path)) from None
    # The last row may be in the making.
    whole = [row for row in rows if len(row) == len(head)]
    columns = {name: [row[i] for row in whole] for i, name in enumerate(head)}
    result = {name: _numbers(column) for name, column in columns.items()}
    return {name: numbers for name, numbers in result.items() if numbers is not None}


def _numbers(column: list[str]) -> FloatArray | None:
    """A column as numbers; None if it holds words."""
    try:
        return np.array([float(cell) if cell else math.nan for cell in column])
    except ValueError:
        return None
