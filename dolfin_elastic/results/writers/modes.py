"""Modes as files: a table of all of them, and one animation for each in ParaView.

    modes.csv                 one row per mode
    mode_01.xdmf              frames over one period of the first mode
    modes_data/mesh.h5        points and cells of all animations
    modes_data/0001.h5        displacements in the first mode's frames

The second half of a period is the first one reversed, so that half the frames are stored.  Rigid
and buckling modes have no period; they are shown with one of 1 s.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import extent
from dolfin_elastic.problem.state import Mode, State
from dolfin_elastic.results import hdf5
from dolfin_elastic.results.files import make_folder, replace_text, writing
from dolfin_elastic.results.grid import Grid
from dolfin_elastic.results.writer import Numbers
from dolfin_elastic.results.writers.xdmf import item, mesh_rows, mesh_xml

if TYPE_CHECKING:
    from dolfinx import fem

    from dolfin_elastic.problem.problem import Problem

_DATA = "modes_data"
_OWN_FILES = re.compile(r"mesh\.h5|\d{4,}\.h5")
_ANIMATION = re.compile(r"mode_\d{2,}\.xdmf")


class ModesWriter:
    """Writes each mode when it is found.  All of it is collective.

    Args:
        path: The CSV file; animations go beside it, those of an earlier run are removed.
        amplitude: Largest displacement of an animation, over the body's longest side.

    Raises:
        OutputError: The files cannot be written.
    """

    def __init__(self, problem: Problem, path: Path, *, frames: int, amplitude: float) -> None:
        self.comm, self.path, self.frames = problem.body.comm, path, frames
        self._size = amplitude * max(extent(problem.body))
        self._rows: list[dict[str, object]] = []
        self._grid = Grid(problem.V, problem.places)
        self._data = path.parent / _DATA
        with stage("output"):
            on_root(self.comm, self._clear)

    def _clear(self) -> None:
        clear(self.path.parent)
        make_folder(self._data)

    def write(self, state: State) -> None:
        """Passes over a state: it is no mode."""

    def write_mode(self, mode: Mode) -> None:
        """Writes one mode: on return its files are complete."""
        with stage("output"):
            if not self._rows:
                hdf5.write(self.comm, self._data / "mesh.h5", mesh_rows(self._grid))
            self._rows.append(row(mode))
            self._animate(mode)
            on_root(self.comm, lambda: replace_text(self.path, _table(self._rows)))

    def _animate(self, mode: Mode) -> None:
        base, shape = self._nodal(mode.base), self._nodal(mode.u)
        half = range(self.frames // 2 + 1)
        arrays = {
            f"frame{k}": base + math.cos(2 * math.pi * k / self.frames) * self._size * shape
            for k in half
        }
        rows = {name: self._grid.rows("node", values) for name, values in arrays.items()}
        file = f"{mode.number:04d}.h5"
        hdf5.write(self.comm, self._data / file, rows)
        period = 1.0 / mode.frequency if mode.frequency > 0.0 else 1.0
        grids, mesh = [], mesh_xml(self._grid, f"{_DATA}/mesh.h5")
        for k in range(self.frames):
            name = f"frame{min(k, self.frames - k)}"
            grids.append(
                f'<Grid Name="frame {k}" GridType="Uniform">\n{mesh}'
                f'<Time Value="{k * period / self.frames!r}"/>\n'
                '<Attribute Name="displacement" AttributeType="Vector" Center="Node">'
                f"{item(rows[name], f'{_DATA}/{file}:/{name}')}</Attribute>\n</Grid>\n"
            )
        text = (
            '<?xml version="1.0" encoding="utf-8"?>\n<Xdmf Version="3.0">\n<Domain>\n'
            f'<Grid Name="mode {mode.number}" GridType="Collection" CollectionType="Temporal">\n'
            f"{''.join(grids)}</Grid>\n</Domain>\n</Xdmf>\n"
        )
        path = self.path.parent / f"mode_{mode.number:02d}.xdmf"
        on_root(self.comm, lambda: replace_text(path, text))

    def _nodal(self, function: fem.Function) -> FloatArray:
        """Displacements [m] of the owned points, shape (points, 3)."""
        dim, own = self._grid.mesh.geometry.dim, self._grid.own_points
        values = np.zeros((own, 3))
        values[:, :dim] = function.x.array[: own * dim].reshape(-1, dim)
        return values

    def restart_state(self) -> Numbers:
        """See `Writer`; runs of modes have no checkpoints."""
        return {}

    def close(self, status: str = "completed", error: object = None) -> None:
        """See `Writer`; all files are complete already."""


def clear(folder: Path) -> None:
    """Removes the modes of an earlier run. Not collective.

    Raises:
        OutputError: They cannot be removed.
    """
    data = folder / _DATA
    with writing(folder):
        for path in listing(folder):
            path.unlink()
        (folder / "modes.csv").unlink(missing_ok=True)
        for file in data.glob("*.h5"):
            if _OWN_FILES.fullmatch(file.name):
                file.unlink()
        if data.is_dir() and not any(data.iterdir()):
            data.rmdir()


def listing(folder: Path) -> list[Path]:
    """Files of the animations in a folder, in the order of the modes. Not collective."""
    if not folder.is_dir():
        return []
    files = [path for path in folder.iterdir() if _ANIMATION.fullmatch(path.name)]
    return sorted(files, key=lambda path: int(path.stem.removeprefix("mode_")))


def row(mode: Mode) -> dict[str, object]:
    """Column to value of a mode in SI units, in the columns' order."""
    if mode.kind == "buckling":
        return {"mode": mode.number, "kind": mode.kind, "load_factor": mode.load_factor}
    return {
        "mode": mode.number,
        "kind": mode.kind,
        "frequency": mode.frequency,
        "omega": mode.omega,
        "eigenvalue": mode.eigenvalue,
        "mass": mode.mass,
        **_columns("effective", mode.effective),
        **_columns("participation", mode.participation),
        "name": mode.name,
    }


def _columns(kind: str, values: Mapping[str, float]) -> dict[str, float]:
    return {f"{kind}_{name}": value for name, value in values.items()}


def _table(rows: list[dict[str, object]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\r\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
