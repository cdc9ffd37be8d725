"""Fields of mesh files: values at cells or points, distributed over the ranks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, cast

import numpy as np
import numpy.typing as npt
from dolfinx import la
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.parallel import agree, largest, smallest
from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.geometry.curved import QuadraturePoints, shape_functions

if TYPE_CHECKING:
    from dolfin_elastic.mesh.formats.raw import RawMesh

Read = Callable[[int, int], FloatArray]
"""Rows from `start` to `stop` of a field in a file, shape (stop - start, columns)."""
CHUNK = 1 << 20
"""Rows that are sent at a time."""


@dataclass(frozen=True)
class MeshField:
    """A field of a mesh file.

    Attributes:
        centre: Whether values are constant in cells or belong to the mesh's points.
        values: Rows of this rank's local cells, or of the points of `mesh.geometry` (ghosts
            included), shape (rows, columns); 1 column is a scalar, 2 or 3 a vector.
    """

    centre: Literal["cell", "point"]
    values: FloatArray

    def describe(self, comm: MPI.Comm) -> str:
        """Entity and range of values in words. Collective."""
        if self.columns > 1:
            return f"{self.centre}s, {self.columns} components"
        finite = self.values[np.isfinite(self.values)]
        low = smallest(comm, float(finite.min(initial=np.inf)))
        high = largest(comm, float(finite.max(initial=-np.inf)))
        return f"{self.centre}s, {low:.4g} to {high:.4g}"

    @property
    def columns(self) -> int:
        """Numbers per cell or point."""
        return int(self.values.shape[1])

    def at(self, mesh: Mesh, cells: IndexArray, points: FloatArray) -> FloatArray:
        """Values in cells; between points by the shape functions of the mesh. Local.

        Args:
            cells: Local cells.
            points: Points of the reference cell, shape (k, dim).

        Returns:
            Shape (cells, k, columns).
        """
        if self.centre == "cell":
            return np.repeat(self.values[cells][:, None, :], len(points), axis=1)
        nodes = self.values[mesh.geometry.dofmap[cells]]
        return np.asarray(np.einsum("kn,cnj->ckj", shape_functions(mesh, points), nodes))

    def at_each(self, mesh: Mesh, cells: IndexArray, points: FloatArray) -> FloatArray:
        """Values at one point in each of some cells. Local.

        Args:
            cells: Local cells, shape (n,); one may be there several times.
            points: A point of the reference cell for each, shape (n, dim).

        Returns:
            Shape (n, columns).
        """
        if self.centre == "cell":
            return self.values[cells]
        nodes = self.values[mesh.geometry.dofmap[cells]]
        return np.asarray(np.einsum("pn,pnj->pj", shape_functions(mesh, points), nodes))

    def over(self, points: QuadraturePoints) -> FloatArray:
        """Values at quadrature points of cells or facets, shape (entities, points, columns).

        Local.
        """
        if self.centre == "cell":
            return np.repeat(self.values[points.cells][:, None, :], points.X.shape[1], axis=1)
        return np.asarray(np.einsum("pn,enj->epj", points.shapes, self.values[points.nodes]))


def from_array(mesh: Mesh, values: npt.ArrayLike, name: str) -> MeshField:
    """An array as a field, see `body.MeshFields`. Collective.

    Raises:
        MeshError: It has another number of rows on some rank, or fits cells and points alike.
    """
    maps = {"cell": mesh.topology.index_map(mesh.topology.dim), "point": mesh.geometry.index_map()}
    owned = {kind: int(map_.size_local) for kind, map_ in maps.items()}
    sizes = {kind: (size, size + int(maps[kind].num_ghosts)) for kind, size in owned.items()}
    error, fits, table = None, [False, False], cast("FloatArray", np.empty((0, 1)))
    try:
        table = as_columns(values, np.shape(values)[0] if np.shape(values) else 0, name)
        fits = [len(table) in sizes[kind] for kind in maps]
    except MeshError as caught:
        error = caught
    agree(mesh.comm, error)
    everywhere = np.array([*fits, -table.shape[1], table.shape[1]], dtype=np.int64)
    mesh.comm.Allreduce(MPI.IN_PLACE, everywhere, op=MPI.MIN)
    cells, points = (bool(fit) for fit in everywhere[:2])
    if cells == points or -everywhere[2] != everywhere[3]:
        raise MeshError(
            f"the field '{name}' has {len(table)} rows on this rank",
            expected='give MeshField("cell", values) or MeshField("point", values)'
            if cells and points
            else f"a row for each of {owned['cell']} cells or {owned['point']} points of the rank",
        )
    centre: Literal["cell", "point"] = "cell" if cells else "point"
    vector = la.vector(maps[centre], table.shape[1])
    vector.array[: table.size] = table.ravel()
    vector.scatter_forward()
    return MeshField(centre, vector.array.reshape(-1, table.shape[1]).copy())


def as_columns(data: npt.ArrayLike, rows: int, name: str) -> FloatArray:
    """Data of a file as an array with one row for each cell or point.

    Returns:
        Shape (rows, columns).

    Raises:
        MeshError: The number of rows is another, or they are no numbers.
    """
    try:
        table = np.asarray(data, dtype=np.float64)
    except (TypeError, ValueError):
        raise MeshError(f"the field '{name}' holds something that is not a number") from None
    if table.ndim == 0 or len(table) != rows:
        count = 0 if table.ndim == 0 else len(table)
        raise MeshError(f"the field '{name}' has {count} rows for {rows} cells or points")
    return table.reshape(rows, -1) if rows else np.empty((0, 1))


def distribute_fields(mesh: Mesh, raw: RawMesh | None) -> dict[str, MeshField]:
    """Distributes the fields that rank 0 has read. Collective.

    Args:
        raw: The mesh as it was read, on rank 0; None on all others.
    """
    result: dict[str, MeshField] = {}
    for centre in ("cell", "point"):
        tables: Mapping[str, FloatArray] = getattr(raw, f"{centre}_data") if raw else {}
        shapes = mesh.comm.bcast({name: table.shape for name, table in tables.items()})
        for name, shape in shapes.items():
            table = tables.get(name)
            read = None if table is None else _rows_of(table)
            result[name] = distribute_rows(mesh, centre, shape, read)
    return result


def _rows_of(table: FloatArray) -> Read:
    return lambda start, stop: table[start:stop]


def distribute_rows(
    mesh: Mesh, centre: Literal["cell", "point"], shape: tuple[int, int], read: Read | None
) -> MeshField:
    """Distributes the rows of a field in chunks, so that no rank holds all of them.

    Collective.

    Args:
        mesh: The distributed mesh; it knows the rows of the file by their numbers.
        shape: Rows and columns of the whole field.
        read: Reads rows, on rank 0; None on all others.

    Raises:
        MeshError: The field has another number of rows than the mesh has cells or points.
    """
    if centre == "cell":
        rows = np.asarray(mesh.topology.original_cell_index, dtype=np.int64)
    else:
        rows = np.asarray(mesh.geometry.input_global_indices, dtype=np.int64)
    _check_rows(mesh, rows, shape[0], centre)
    order = np.argsort(rows, kind="stable")
    values = np.empty((len(rows), shape[1]))
    for start in range(0, shape[0], CHUNK):
        stop = min(start + CHUNK, shape[0])
        part = _sent(mesh.comm, (stop - start, shape[1]), start, read)
        low, high = np.searchsorted(rows[order], (start, stop))
        values[order[low:high]] = part[rows[order[low:high]] - start]
    return MeshField(centre, values)


def _check_rows(mesh: Mesh, rows: IntArray, count: int, centre: str) -> None:
    need = int(mesh.comm.allreduce(int(rows.max(initial=-1)), op=MPI.MAX)) + 1
    if need > count or (need < count and centre == "cell"):  # not all points need be in use
        raise MeshError(f"it has {count} rows, but there are {need} {centre}s")


def _sent(comm: MPI.Comm, shape: tuple[int, int], start: int, read: Read | None) -> FloatArray:
    part, error = np.empty(shape), None
    if read is not None:
        try:
            part[:] = read(start, start + shape[0])
        except Exception as caught:  # whatever h5py makes of a damaged file
            error = MeshError(f"it cannot be read: {caught}")
    agree(comm, error)
    comm.Bcast(part)
    return part
