"""XDMF for ParaView: every field of a step in one grid.

Files:

    results.xdmf              XML that refers to the arrays in the other files
    results_data/mesh.h5      points, cells, and fields that are the same at all steps
    results_data/000000.h5    fields of the first written step
    results_data/000001.h5    ... one file for each further step
    results_data/mesh_000007.h5   points and cells from that step on, where a run was continued
                              from a checkpoint on another number of ranks

There is one HDF5 file per step, because a run may be killed at any moment: a file that is open then
is lost with all steps in it.  So only the step that is being written can be lost, to which no
`.xdmf` refers yet: the XML is replaced (written under another name and renamed) after the step's
file is closed, and all arrays it refers to are complete at any moment.  The costs are a few
milliseconds and 2 kB per step; runs of many thousand steps reduce them by `every`.

Every grid refers to the mesh's arrays directly, without xi:include: ParaView's default reader
crashes at one.  A new run into the same folder removes the old results first, the `.xdmf` before
the files that it refers to.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.parallel import largest, on_root
from dolfin_elastic.core.timing import stage
from dolfin_elastic.problem.state import State, plain
from dolfin_elastic.results import hdf5
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.fields import DEFAULT, FIELDS, IN_MOTION
from dolfin_elastic.results.files import (
    make_folder,
    missing_results,
    replace_text,
    sync,
    writing,
)
from dolfin_elastic.results.grid import Grid
from dolfin_elastic.results.hdf5 import Rows
from dolfin_elastic.results.writer import LastState, Numbers, StepInterval

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem

_OWN_FILES = re.compile(r"mesh\.h5|(?:mesh_)?(\d{6,})\.h5")
_MESH = re.compile(r"/([^/:<>]+\.h5):/points<")
_FRAME = '<Grid Name="step '
_END = "</Grid>\n</Domain>"


class XdmfWriter:
    """Writes states of a problem as XDMF; see the module.  All of it is collective.

    Args:
        problem: The problem that is solved.
        path: The `.xdmf` file; the arrays go into a folder beside it.
        fields: Names from `FIELDS`; None: displacement and stresses, in motion also velocity.
        every: Steps between written states, see `StepInterval`; the last state is always written.
        frames: If given, so many states evenly over the run are written instead, and the last.
        saved: Its restart state: later steps are cut off.

    Raises:
        InputError: An unknown field.
        RestartError: Steps from before the checkpoint are missing.
        OutputError: The folder cannot be written to.
    """

    def __init__(
        self,
        problem: Problem,
        path: Path,
        *,
        fields: tuple[str, ...] | None = None,
        every: int = 1,
        frames: int | None = None,
        saved: Numbers | None = None,
    ) -> None:
        self.problem, self.path, self.fields = problem, path, fields
        self.every, self.frames = (
            StepInterval(every, -1 if saved is None else saved["taken"]),
            frames,
        )
        self.comm = problem.body.comm
        self.data = _data_folder(path)
        self._frames: list[str] = []
        self._synced = 0
        self._mesh_file = self._mesh_xml = ""
        self._last_state = LastState()
        self._pending = False
        with stage("output"):
            self._evaluate = Evaluator(problem, fields or DEFAULT)
            if saved is None:
                on_root(self.comm, self._clear)
            else:
                self._frames = on_root(self.comm, lambda: self._cut(saved["frames"]))
                self._synced = len(self._frames)

    def _clear(self) -> None:
        make_folder(self.data)
        clear(self.path)

    def _cut(self, count: int) -> list[str]:
        """Removes all frames but the first ones, and returns the XML of these. On rank 0."""
        make_folder(self.data)
        with writing(self.path):
            text = self.path.read_text(encoding="utf-8") if self.path.is_file() else ""
        frames = [_FRAME + part for part in text.partition(_END)[0].split(_FRAME)[1:]][:count]
        meshes = {mesh for frame in frames for mesh in _MESH.findall(frame)}
        needed = meshes | {f"{number:06d}.h5" for number in range(count)}
        if len(frames) < count or any(not (self.data / name).is_file() for name in needed):
            raise missing_results(self.path, "steps")
        if count:
            replace_text(self.path, _document(frames), durable=True)
        else:
            clear(self.path)
        with writing(self.data):
            for file in self.data.glob("*.h5"):
                if _OWN_FILES.fullmatch(file.name) and file.name not in needed:
                    file.unlink()
        return frames

    def restart_state(self) -> Numbers:
        """See `Writer`."""
        on_root(self.comm, self._sync)
        self._synced = len(self._frames)
        return {"frames": len(self._frames), "taken": self.every.taken}

    def _sync(self) -> None:
        for number in range(self._synced, len(self._frames)):
            sync(self.data / f"{number:06d}.h5")
        if self._frames:
            sync(self.data / _MESH.findall(self._frames[-1])[0])
            sync(self.path)

    def write(self, state: State) -> None:
        """Writes one step, if it is due: on return its file is complete."""
        with stage("output"):
            self._pending = not self._due(state)
            if self._pending:
                self._last_state.copy(state)
            else:
                self._write(state)

    def _due(self, state: State) -> bool:
        if self.frames is None:
            return self.every.takes(state.step)
        return state.done * self.frames >= len(self._frames)

    def _write(self, state: State) -> None:
        grid = self._evaluate.grid
        default_in_motion = self.fields is None and state.v is not None
        values = self._evaluate(state, more=IN_MOTION if default_in_motion else ())
        rows = {name: grid.rows(FIELDS[name].centre, v) for name, v in values.items()}
        moving = {name: r for name, r in rows.items() if not FIELDS[name].fixed}
        if not self._mesh_xml:
            fixed = {name: r for name, r in rows.items() if FIELDS[name].fixed}
            self._write_mesh(grid, {**mesh_rows(grid), **fixed})
        file = f"{len(self._frames):06d}.h5"
        hdf5.write(self.comm, self.data / file, moving)
        self._frames.append(self._frame(state, file, rows))
        on_root(self.comm, lambda: replace_text(self.path, _document(self._frames), durable=True))

    def _write_mesh(self, grid: Grid, arrays: Mapping[str, Rows]) -> None:
        """Writes arrays that are the same at all steps, unless the continued run has done so."""
        before = _MESH.findall(self._frames[-1])[0] if self._frames else ""
        self._mesh_file = before or "mesh.h5"
        if not before or not _same(self.comm, self.data / before, arrays):
            if before:
                self._mesh_file = f"mesh_{len(self._frames):06d}.h5"
            hdf5.write(self.comm, self.data / self._mesh_file, arrays)
        self._mesh_xml = mesh_xml(grid, f"{self.data.name}/{self._mesh_file}")

    def _frame(self, state: State, file: str, rows: Mapping[str, Rows]) -> str:
        files = {name: self._mesh_file if FIELDS[name].fixed else file for name in rows}
        attributes = "".join(
            _attribute(name, r, f"{self.data.name}/{files[name]}") for name, r in rows.items()
        )
        return (
            f'<Grid Name="step {state.step}" GridType="Uniform">\n{self._mesh_xml}'
            f'<Time Value="{plain(state.t)!r}"/>\n{attributes}</Grid>\n'
        )

    def close(self, status: str = "completed", error: object = None) -> None:
        """See `Writer`; writes the last step, if it was not due."""
        if self._pending and self._last_state.state:
            with stage("output"):
                self._write(self._last_state.state)
            self._pending = False


def _document(frames: Sequence[str]) -> str:
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n<Xdmf Version="3.0">\n<Domain>\n'
        '<Grid Name="results" GridType="Collection" CollectionType="Temporal">\n'
        f"{''.join(frames)}{_END}\n</Xdmf>\n"
    )


def _same(comm: MPI.Comm, path: Path, arrays: Mapping[str, Rows]) -> bool:
    """Whether a file has these arrays with the same values. Collective."""
    return not largest(comm, float(_differs(path, arrays)))


def _differs(path: Path, arrays: Mapping[str, Rows]) -> bool:
    try:
        if hdf5.shapes(path) != {name: rows.shape for name, rows in arrays.items()}:
            return True
        return any(
            not np.array_equal(hdf5.read(path, name, rows.first, len(rows.values)), rows.values)
            for name, rows in arrays.items()
        )
    except OSError:
        return True


def clear(path: Path) -> None:
    """Removes the results of an earlier run, first the `.xdmf`. Not collective.

    Files in the folder that this writer does not make stay.

    Args:
        path: The `.xdmf` file; it need not exist.

    Raises:
        OutputError: They cannot be removed.
    """
    with writing(path):
        path.unlink(missing_ok=True)
        for file in _data_folder(path).glob("*.h5"):
            if _OWN_FILES.fullmatch(file.name):
                file.unlink()


def remove(path: Path) -> None:
    """As `clear`; the folder of the arrays is removed, too, if it is empty. Not collective.

    Args:
        path: The `.xdmf` file; it need not exist.

    Raises:
        OutputError: They cannot be removed.
    """
    clear(path)
    data = _data_folder(path)
    with writing(data):
        if data.is_dir() and not any(data.iterdir()):
            data.rmdir()


def _data_folder(path: Path) -> Path:
    return path.with_name(f"{path.stem}_data")


def mesh_rows(grid: Grid) -> dict[str, Rows]:
    """This rank's rows of the arrays "points" and "cells"."""
    return {"points": grid.rows("node", grid.points()), "cells": grid.rows("cell", grid.cells())}


def mesh_xml(grid: Grid, file: str) -> str:
    """XML of a mesh.

    Args:
        grid: Points and cells.
        file: HDF5 file with the arrays of `mesh_rows`, relative to the `.xdmf`.
    """
    mesh = mesh_rows(grid)
    count, nodes = mesh["cells"].shape
    return (
        f'<Topology TopologyType="{grid.kind}" NumberOfElements="{count}" '
        f'NodesPerElement="{nodes}">{item(mesh["cells"], f"{file}:/cells")}</Topology>\n'
        f'<Geometry GeometryType="XYZ">{item(mesh["points"], f"{file}:/points")}'
        "</Geometry>\n"
    )


def _attribute(name: str, rows: Rows, file: str) -> str:
    field = FIELDS[name]
    return (
        f'<Attribute Name={quoteattr(name)} AttributeType="{field.shape.capitalize()}" '
        f'Center="{field.centre.capitalize()}">{item(rows, f"{file}:/{name}")}'
        "</Attribute>\n"
    )


def item(rows: Rows, place: str) -> str:
    """XML that refers to an array.

    Args:
        rows: This rank's part of it.
        place: "FILE:/NAME", relative to the `.xdmf`.
    """
    count, columns = rows.shape
    kind = "Float" if rows.values.dtype.kind == "f" else "Int"
    return (
        f'<DataItem Dimensions="{count} {columns}" NumberType="{kind}" '
        f'Precision="{rows.values.itemsize}" Format="HDF">{escape(place)}</DataItem>'
    )
