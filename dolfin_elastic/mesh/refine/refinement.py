"""`refine_body`: a body with some of its cells divided, with names, fields and curved boundaries.

Everything follows from the barycentric coordinates of the finer cells in the coarse ones: the
quadratic geometry of curved cells, names of parts, and fields.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.distribute import make_mesh
from dolfin_elastic.mesh.fields import MeshField
from dolfin_elastic.mesh.geometry.simplices import boundary_facets, cells_beside_facets
from dolfin_elastic.mesh.refine.cad_surfaces import CadSurfaces
from dolfin_elastic.mesh.refine.division import (
    Division,
    barycentric,
    divide,
    interpolated,
    lagrange,
)
from dolfin_elastic.mesh.refine.parts import carry_faces, carry_parts, carry_surface


class CellLinks:
    """Sends data of cells to the ranks that they have moved to.  Collective to make.

    Only rows that a rank needs are sent to it.

    Args:
        count: Cells that this rank had.
        wanted: For each cell that it has now, the global number it had: those of rank 0 first, then
            those of rank 1 ...
    """

    def __init__(self, comm: MPI.Comm, count: int, wanted: IntArray) -> None:
        self._comm = comm
        ends = np.cumsum(comm.allgather(count))
        owner = np.searchsorted(ends, wanted, side="right")
        self._order = np.argsort(owner, kind="stable")
        self._asked = np.bincount(owner, minlength=comm.size)
        self._given = np.empty_like(self._asked)
        comm.Alltoall(self._asked, self._given)
        rows = np.ascontiguousarray(wanted[self._order], dtype=np.int64)
        self._rows = np.empty(int(self._given.sum()), dtype=np.int64)
        comm.Alltoallv([rows, self._asked], [self._rows, self._given])
        self._rows -= ends[comm.rank] - count

    def __call__(self, rows: AnyArray) -> AnyArray:
        """Rows of the cells that this rank has now.  Collective.

        Args:
            rows: A row for each cell that this rank had, shape (cells before, ...), of the same
                type and width on all ranks.

        Returns:
            Shape (cells now, ...).
        """
        width = int(np.prod(rows.shape[1:], dtype=int))
        out = np.ascontiguousarray(rows[self._rows]).reshape(len(self._rows), width)
        got = np.empty((len(self._order), width), dtype=rows.dtype)
        self._comm.Alltoallv(
            [out, self._given * width, MPI._typedict[rows.dtype.char]],
            [got, self._asked * width, MPI._typedict[rows.dtype.char]],
        )
        result = np.empty_like(got)
        result[self._order] = got
        return result.reshape(len(result), *rows.shape[1:])


@dataclass(frozen=True)
class Refinement:
    """A finer body, and where its cells lie in those of the coarse one.

    Attributes:
        coarse: The body that was refined.
        body: The finer body, distributed anew.
        corners: As `Division.corners`, for the local cells of the finer body.
        of_parents: Rows of the coarse body's local cells to rows of the parents of the finer body's
            local cells.  Collective.
    """

    coarse: Body
    body: Body
    corners: FloatArray
    of_parents: Callable[[AnyArray], AnyArray]

    def interpolated(self, degree: int, values: AnyArray) -> FloatArray:
        """A finite element function of the coarse body at the nodes of the finer one. Collective.

        Args:
            values: At the nodes of the local cells, shape (coarse cells, nodes, columns).

        Returns:
            At the nodes of the same element, shape (finer cells, nodes, columns).
        """
        d = self.body.dim
        nodes = barycentric(lagrange(d, degree).points)
        coordinates = np.einsum("kv,cvj->ckj", nodes, self.corners)
        return interpolated(d, degree, coordinates, self.of_parents(values))


def refine_body(body: Body, cells: IndexArray) -> Refinement:
    """Divides cells, and as many of their neighbours as it takes to leave no node hanging.

    Collective.  All edges of the cells are halved.  Cells, surfaces, edges and points keep their
    names, fields of the mesh are interpolated, and the shape of curved cells is exact: a part of a
    quadratic cell is a quadratic cell.  If the mesh was made from a CAD file, new nodes of the
    boundary are moved to the surfaces of that file.

    Args:
        cells: Local cells of this rank that are divided.

    Raises:
        MeshError: The CAD file cannot be read any more.
    """
    division = divide(body.mesh, cells)
    order = int(body.mesh.geometry.cmap.degree)
    space = fem.functionspace(division.mesh, ("Lagrange", order))
    x, notes, placed = _node_places(body, division, space), tuple[str, ...](), None
    if body.cad is not None:
        placed = CadSurfaces(body.cad).place(body, division, space, x)
        x, notes = placed.x, placed.notes
    index = space.dofmap.index_map
    nodes = index.local_to_global(space.dofmap.list.reshape(-1)).reshape(space.dofmap.list.shape)
    mesh = make_mesh(body.comm, nodes, x[: index.size_local], order)
    links = CellLinks(body.comm, len(nodes), np.asarray(mesh.topology.original_cell_index))

    def of_parents(rows: AnyArray) -> AnyArray:
        return links(rows[division.parents])

    corners = np.asarray(links(division.corners))
    parts = carry_parts(body, mesh, corners, of_parents)
    known = carry_surface(body, mesh, corners, of_parents)
    if placed is not None:
        beside = cells_beside_facets(mesh, boundary_facets(mesh))
        known = replace(
            known, off=links(placed.off)[beside], surfaces=links(placed.surfaces)[beside]
        )
    finer = replace(
        body,
        mesh=mesh,
        regions=parts["regions"],
        surfaces=parts["surfaces"],
        edges=parts["edges"],
        points=parts["points"],
        faces=carry_faces(body, mesh, corners, of_parents),
        known_surface=known,
        fields={},
        notes=notes,
        information=(),
    )
    bare = Refinement(body, finer, corners, of_parents)
    fields = {name: _carried_field(bare, field) for name, field in body.fields.items()}
    return replace(bare, body=replace(finer, fields=fields))


def _node_places(body: Body, division: Division, space: fem.FunctionSpace) -> FloatArray:
    """Coordinates [m] of all local nodes of the finer mesh, from the geometry of the coarse one."""
    mesh, d, order = body.mesh, body.dim, int(body.mesh.geometry.cmap.degree)
    nodes = mesh.geometry.x[mesh.geometry.dofmap[division.parents], :d]
    coordinates = division.places(lagrange(d, order).points)
    result = interpolated(d, order, coordinates, nodes)
    index = space.dofmap.index_map
    x = np.zeros((index.size_local + index.num_ghosts, d))
    x[space.dofmap.list] = result
    return x


def _carried_field(refinement: Refinement, field: MeshField) -> MeshField:
    """A field of the coarse body's mesh on the finer one. Collective."""
    if field.centre == "cell":
        return MeshField("cell", np.asarray(refinement.of_parents(field.values)))
    coarse, fine = refinement.coarse.mesh.geometry, refinement.body.mesh.geometry
    degree = int(coarse.cmap.degree)
    result = refinement.interpolated(degree, field.values[coarse.dofmap])
    values = np.zeros((len(fine.x), field.columns))
    values[fine.dofmap] = result
    return MeshField("point", values)
