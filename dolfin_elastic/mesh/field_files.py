"""Fields of other files on the mesh of a body, such as the temperatures of a thermal analysis.

The other mesh is distributed on its own.  Every rank asks for the values at its own nodes, or at
the midpoints of its own cells, and the ranks that own the cells there answer.  On the same mesh
these are the values of the file, to round-off; on another one they are interpolated by its shape
functions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Literal

import numpy as np
from dolfinx import cpp, la
from dolfinx.geometry import compute_distance_gjk
from dolfinx.mesh import Mesh

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.parallel import RankExchange, first_of, largest, on_root, total
from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.body import Body, extent, span
from dolfin_elastic.mesh.distribute import is_cad
from dolfin_elastic.mesh.fields import MeshField
from dolfin_elastic.mesh.formats.surfaces.options import is_surface
from dolfin_elastic.mesh.geometry.curved import shape_functions
from dolfin_elastic.mesh.geometry.locate import OUTSIDE_TOLERANCE, ROUND_OFF, in_reference_cells
from dolfin_elastic.mesh.read import check_file, read_body, stated_unit_of

Centre = Literal["cell", "point"]
Outside = Literal["error", "nearest"]
"""What becomes of places outside of the other mesh: an error, or the nearest place in it."""
_INWARD = 1e-6
"""Way from a node to the middle of a cell at which a cell of the other mesh is looked for.

Where two parts touch, nodes of both are at one place: each gets the values of its own side.
"""
_FARTHER = 4.0
"""Factor by which the search for the nearest place goes on."""


class FieldFile:
    """Fields of a file on the mesh of a body.  Collective to make.

    Args:
        body: At its nodes and midpoints of cells the values are taken.
        path: A finished mesh with fields, of any format of `read_body`.
        time: Of a file of several time steps, which one; None: the last.
        unit: Unit of length of the file; None: the one that it states, else that of the body.

    Raises:
        MeshError: The file cannot be read, or has no such step.
    """

    def __init__(
        self,
        body: Body,
        path: str | PathLike[str],
        *,
        time: float | None = None,
        unit: LengthUnit | None = None,
    ) -> None:
        path = Path(path)
        if is_cad(path) or is_surface(path):
            what = "CAD file" if is_cad(path) else "surface of triangles"
            raise MeshError(f"a {what} has no fields", expected="a mesh with fields on it")
        on_root(body.comm, lambda: check_file(path))
        if unit is None:
            unit = on_root(body.comm, lambda: stated_unit_of(path)) or body.unit
        self._body = body
        self._other = read_body(path, comm=body.comm, scale=unit.metres, time=time)
        self._found: dict[tuple[str, Outside], _Found] = {}
        if self._other.dim != body.dim:
            raise MeshError(
                f"its mesh is of {self._other.dim} dimensions, the body of {body.dim}",
                expected="fields on a mesh of the same dimension",
            )

    def field(self, name: str, outside: Outside = "error") -> MeshField:
        """A field at the nodes, or in the cells, of the body's mesh. Collective.

        Args:
            name: Of the field in the file.
            outside: See `Outside`.  Nodes up to a twentieth of a cell outside count as inside:
                meshes of round bodies differ by so much.

        Returns:
            Of a field at points the values at nodes, of one in cells those at midpoints of cells.

        Raises:
            MeshError: There is no such field, or places lie outside.
        """
        field, mesh = self._other.mesh_field(name), self._body.mesh
        key = field.centre, outside
        if key not in self._found:
            self._found[key] = self._find(*key)
        found = self._found[key]
        index = mesh.topology.index_map(mesh.topology.dim)
        if field.centre == "point":
            index = mesh.geometry.index_map()
        values = field.at_each(self._other.mesh, found.cells, found.local)
        vector = la.vector(index, field.columns)
        own = found.answer(values)
        vector.array[: own.size] = own.ravel()
        vector.scatter_forward()
        return MeshField(field.centre, vector.array.reshape(-1, field.columns).copy())

    def _find(self, centre: Centre, outside: Outside) -> _Found:
        """Finds the nodes, or the midpoints of cells, in the other mesh. Collective."""
        comm, other = self._body.comm, self._other.mesh
        places, search = self._places(centre)
        d, x = self._body.dim, other.geometry.x[other.geometry.dofmap]
        size = largest(comm, float(np.ptp(x, axis=1).max(initial=0.0)))
        owners, parts = np.full(len(places), -1, dtype=np.int32), list[_Part]()
        # Nearly all are inside; a search far around finds the others, with much more work.
        padding, near = ROUND_OFF * span(self._other), OUTSIDE_TOLERANCE * size
        while (padding <= near or outside == "nearest") and total(comm, int((owners < 0).sum())):
            rows = np.flatnonzero(owners < 0)
            there = np.ascontiguousarray(search[rows])
            data = cpp.geometry.determine_point_ownership(other._cpp_object, there, padding)
            owners[rows] = data.src_owner
            rows = rows[owners[rows] >= 0]
            exchange = RankExchange(comm, owners[rows])
            asked = exchange.send(places[rows])[:, :d]
            order = np.argsort(data.dest_owners, kind="stable")
            cells = np.asarray(data.dest_cells, dtype=np.int32)[order]
            local, off = in_reference_cells(other, x[cells][..., :d], asked)
            if outside == "nearest":
                _move_inside(other, cells, asked, local, off, within=padding)
            owners[rows[exchange.send_back(off[:, None] > OUTSIDE_TOLERANCE)[:, 0]]] = -1
            parts.append(_Part(rows, exchange, cells, local))
            padding = near if padding < near else _FARTHER * padding
        self._refuse(centre, places[owners < 0])
        return _Found(len(places), parts)

    def _places(self, centre: Centre) -> tuple[FloatArray, FloatArray]:
        """Own nodes or midpoints [m], and places beside them whose cells are taken, (n, 3)."""
        mesh, d = self._body.mesh, self._body.dim
        middle = shape_functions(mesh, np.full((1, d), 1 / (d + 1)))[0]
        rows = mesh.geometry.dofmap
        middles = np.asarray(np.einsum("n,cnj->cj", middle, mesh.geometry.x[rows]))
        if centre == "cell":
            own = middles[: mesh.topology.index_map(d).size_local]
            return own, own
        own = np.array(mesh.geometry.x[: mesh.geometry.index_map().size_local])
        cell_of = np.zeros(len(mesh.geometry.x), dtype=np.int64)
        cell_of[rows] = np.arange(len(rows))[:, None]
        return own, own + _INWARD * (middles[cell_of[: len(own)]] - own)

    def _refuse(self, centre: Centre, places: FloatArray) -> None:
        """Refuses places outside of the other mesh. Collective."""
        body, other = self._body, self._other
        count = int(total(body.comm, len(places)))
        first = first_of(body.comm, (tuple(map(float, x)) for x in places[:, : body.dim]))
        if first is None:
            return
        kind = "nodes" if centre == "point" else "midpoints of elements"
        sizes = [
            " x ".join(f"{x / body.unit.metres:.4g}" for x in extent(one)) for one in (body, other)
        ]
        raise MeshError(
            f"{count} {kind} of the body lie outside of its mesh, the first at "
            f"{body.unit.point(first)}; the body is {sizes[0]} {body.unit.name}, its mesh "
            f"{sizes[1]} {body.unit.name}",
            expected="a mesh around the body; mesh_unit, if it is in another unit; or outside = "
            '"nearest", for the value of the nearest place in it',
        )


@dataclass(frozen=True)
class _Part:
    """Places of all ranks that lie in cells of this rank.

    Attributes:
        rows: Own places that were asked for, shape (n,).
        exchange: Of these places with the ranks that have their cells.
        cells: Local cells of the other mesh with the places of all ranks, shape (k,).
        local: The places in the reference cells, shape (k, dim).
    """

    rows: IntArray
    exchange: RankExchange
    cells: IndexArray
    local: FloatArray


@dataclass(frozen=True)
class _Found:
    """Where the places of all ranks lie; of several parts the last one that has a place counts.

    Attributes:
        size: Number of own places.
        parts: See `_Part`.
    """

    size: int
    parts: Sequence[_Part]

    @cached_property
    def cells(self) -> IndexArray:
        """Of all parts."""
        return np.concatenate([np.empty(0, np.int32), *(part.cells for part in self.parts)])

    @cached_property
    def local(self) -> FloatArray:
        """Of all parts."""
        return np.concatenate([part.local for part in self.parts])

    def answer(self, values: FloatArray) -> FloatArray:
        """Sends values to the ranks that asked for them. Collective.

        Args:
            values: At the places in own cells, shape (k, columns).

        Returns:
            At own places, shape (size, columns).
        """
        result, start = np.empty((self.size, values.shape[1])), 0
        for part in self.parts:
            some = values[start : start + len(part.cells)]
            result[part.rows] = part.exchange.send_back(some)
            start += len(some)
        return result


def _move_inside(
    mesh: Mesh,
    cells: IndexArray,
    places: FloatArray,
    local: FloatArray,
    off: FloatArray,
    *,
    within: float,
) -> None:
    """Moves places far outside to the nearest ones in their cells, in `local` and `off`. Local.

    Args:
        within: Distance [m] in which all cells were looked at: farther away than the nearest place
            of the given cell may be one in another cell.
    """
    far = np.flatnonzero(off > OUTSIDE_TOLERANCE)
    x, d = mesh.geometry.x, mesh.topology.dim
    gaps = np.zeros((len(far), 3))
    for i, (cell, place) in enumerate(zip(cells[far], places[far], strict=True)):
        whole = np.append(place, [0.0] * (3 - d))
        gaps[i] = compute_distance_gjk(x[mesh.geometry.dofmap[cell]], whole)
    near = np.linalg.norm(gaps, axis=1) <= within
    far, gaps = far[near], gaps[near]
    nodes = x[mesh.geometry.dofmap[cells[far]]][..., :d]
    local[far], _ = in_reference_cells(mesh, nodes, places[far] + gaps[:, :d])
    off[far] = 0.0
