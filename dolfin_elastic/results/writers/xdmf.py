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
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.parallel import largest
from dolfin_elastic.mesh.formats.xdmf_arrays import UNIT
from dolfin_elastic.problem.state import State, plain
from dolfin_elastic.results import hdf5
from dolfin_elastic.results.field import Field
from dolfin_elastic.results.files import replace_text
from dolfin_elastic.results.grid import Grid
from dolfin_elastic.results.hdf5 import Rows
from dolfin_elastic.results.writers.series import IndexedSeries

if TYPE_CHECKING:
    from dolfin_elastic.mesh.fields import MeshField
    from dolfin_elastic.problem.problem import Problem

_MESH = re.compile(r"/([^/:<>]+\.h5):/points<")
_ARRAYS = re.compile(r"/([^/:<>]+\.h5):/")
_FRAME = '<Grid Name="step '
_END = "</Grid>\n</Domain>"
_ESCAPED = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;"})
"""What the name of a file may hold and XML not.  That of xml.sax imports urllib, http and ssl."""


class Hdf5Series(IndexedSeries):
    """Arrays of states in HDF5 files, one a step, and one of the mesh.  All of it is collective.

    See `SeriesWriter`.
    """

    own = re.compile(r"mesh\.h5|(?:mesh_)?(\d{6,})\.h5")
    mesh_file = ""
    """HDF5 file of the mesh and of fields that are the same at all steps; empty: none yet."""

    def _add(self, state: State, rows: Mapping[str, Rows]) -> str:
        if not self.mesh_file:
            fixed = {name: r for name, r in rows.items() if self._evaluate.table[name].fixed}
            self._write_mesh({**self._mesh_arrays(self._evaluate.grid), **fixed})
        file = f"{len(self._frames):06d}.h5"
        moving = {name: r for name, r in rows.items() if not self._evaluate.table[name].fixed}
        hdf5.write(self.comm, self.data / file, moving)
        return self._entry(state, file, rows)

    def _write_mesh(self, arrays: Mapping[str, Rows]) -> None:
        """Writes arrays that are the same at all steps, unless the continued run has done so."""
        before = self._mesh_of(self._frames[-1]) if self._frames else ""
        self.mesh_file = before or "mesh.h5"
        if not before or not _same(self.comm, self.data / before, arrays):
            if before:
                self.mesh_file = f"mesh_{len(self._frames):06d}.h5"
            hdf5.write(self.comm, self.data / self.mesh_file, arrays)

    @abstractmethod
    def _mesh_arrays(self, grid: Grid) -> dict[str, Rows]:
        """This rank's rows of the arrays of the mesh. Not collective."""

    @abstractmethod
    def _mesh_of(self, entry: str) -> str:
        """The file of the mesh that an entry refers to. Not collective."""

    @abstractmethod
    def _entry(self, state: State, file: str, rows: Mapping[str, Rows]) -> str:
        """The entry of a state in the index.

        Args:
            file: HDF5 file with its fields.
            rows: Name of a field to this rank's rows.
        """


class XdmfWriter(Hdf5Series):
    """Writes states of a problem as XDMF; see the module.  All of it is collective.

    See `SeriesWriter`.
    """

    folder = "_data"
    _mesh_text = ""

    def _mesh_arrays(self, grid: Grid) -> dict[str, Rows]:
        return mesh_rows(grid)

    def _mesh_of(self, entry: str) -> str:
        return str(_MESH.findall(entry)[0])

    def _entry(self, state: State, file: str, rows: Mapping[str, Rows]) -> str:
        fields = {name: self._evaluate.table[name] for name in rows}
        files = {name: self.mesh_file if row.fixed else file for name, row in fields.items()}
        if not self._mesh_text:
            place = f"{self.data.name}/{self.mesh_file}"
            self._mesh_text = mesh_xml(self._evaluate.grid, place)
        attributes = "".join(
            _attribute(name, fields[name], r, f"{self.data.name}/{files[name]}")
            for name, r in rows.items()
        )
        return (
            f'<Grid Name="step {state.step}" GridType="Uniform">\n{self._mesh_text}'
            f'<Time Value="{plain(state.t)!r}"/>\n{attributes}</Grid>\n'
        )

    def _named(self, entry: str) -> list[str]:
        return list(dict.fromkeys(_ARRAYS.findall(entry)))

    def _entries(self) -> list[str]:
        text = self.path.read_text(encoding="utf-8")
        return [_FRAME + part for part in text.partition(_END)[0].split(_FRAME)[1:]]

    def _replace_index(self, frames: Sequence[str]) -> None:
        replace_text(self.path, _document(frames), durable=True)


def _document(frames: Sequence[str]) -> str:
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n<Xdmf Version="3.0">\n<Domain>\n'
        f'<Information Name="{UNIT}" Value="1"/>\n'
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


def mesh_rows(grid: Grid) -> dict[str, Rows]:
    """This rank's rows of the arrays "points" and "cells"."""
    return {"points": grid.rows("node", grid.points()), "cells": grid.rows("cell", grid.cells())}


def mesh_xml(grid: Grid, file: str) -> str:
    """XML of a mesh.

    Args:
        file: HDF5 file with the arrays of `mesh_rows`, relative to the `.xdmf`.
    """
    # Only their shapes and types are needed.
    points = grid.rows("node", np.empty((0, 3)))
    cells = grid.rows("cell", np.empty((0, grid.nodes_per_cell), dtype=grid.number_type))
    count, nodes = cells.shape
    return (
        f'<Topology TopologyType="{grid.kind}" NumberOfElements="{count}" '
        f'NodesPerElement="{nodes}">{item(cells, f"{file}:/cells")}</Topology>\n'
        f'<Geometry GeometryType="XYZ">{item(points, f"{file}:/points")}'
        "</Geometry>\n"
    )


def _attribute(name: str, field: Field, rows: Rows, file: str) -> str:
    return (
        f'<Attribute Name="{name}" AttributeType="{field.shape.capitalize()}" '
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
        f'Precision="{rows.values.itemsize}" Format="HDF">{place.translate(_ESCAPED)}</DataItem>'
    )


def write_with_fields(
    problem: Problem, state: State, path: Path, fields: Mapping[str, MeshField]
) -> None:
    """Writes one state's displacement and further fields, which its body then has. Collective.

    Args:
        fields: Name to a field on the mesh of the problem.

    Raises:
        OutputError: It cannot be written.
    """
    for name, one in fields.items():
        problem.body.fields[name] = one
    writer = XdmfWriter(problem, path, fields=("displacement", *fields))
    writer.write(state)
    writer.close()
