"""The surface of a body, gathered on rank 0 for pictures; the mesh is not gathered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh, exterior_facet_indices
from mpi4py import MPI

from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.results.grid import Grid

# A triangle whose nodes are corners a, b, c and the middles of bc, ac, ab, as four triangles.
_QUARTERS = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2], [5, 3, 4]])
_CORNERS = 3

_Share = tuple[AnyArray, AnyArray, AnyArray, dict[str, AnyArray], AnyArray | None]
"""Triangles, global numbers of points, points, values and values of cells of one rank."""


@dataclass(frozen=True)
class Surface:
    """Triangles and values at their corners.

    Attributes:
        triangles: Numbers of `points`, shape (n, 3), counter-clockwise seen from outside.
        points: Reference configuration [m], shape (m, 3).
        values: Name to values at the points, shape (m, columns).
        of_cells: Values of the cells behind the triangles, shape (n,), or None.
    """

    triangles: AnyArray
    points: AnyArray
    values: dict[str, AnyArray]
    of_cells: AnyArray | None = None


def gather_surface(
    grid: Grid, values: dict[str, AnyArray], of_cells: AnyArray | None = None
) -> Surface | None:
    """The body's surface on rank 0, None on the others. Collective.

    The surface of a plane body are all its cells.

    Args:
        grid: The body's points and cells.
        values: Name to values at the local points (ghosts included), shape (points, columns).
        of_cells: Values of the local cells (ghosts included), shape (cells,), or None.
    """
    triangles, cells = _triangles(grid)
    used, local = np.unique(triangles, return_inverse=True)
    numbers = grid.V.dofmap.index_map.local_to_global(used.astype(np.int32))
    points = grid.V.tabulate_dof_coordinates()[used]
    mine = None if of_cells is None else of_cells[cells]
    own = (local.reshape(-1, 3), numbers, points, {k: v[used] for k, v in values.items()}, mine)
    parts = _to_root(grid.mesh.comm, own)
    return _joined(parts) if grid.mesh.comm.rank == 0 else None


def _to_root(comm: MPI.Comm, own: _Share) -> list[_Share]:
    return comm.gather(own) or []


def _joined(parts: list[_Share]) -> Surface:
    """One surface from the parts of all ranks; points that several ranks have are merged."""
    numbers = np.concatenate([part[1] for part in parts])
    _, first, new = np.unique(numbers, return_index=True, return_inverse=True)
    starts = np.cumsum([0, *(len(part[1]) for part in parts)])
    triangles = np.concatenate(
        [new[part[0] + start] for part, start in zip(parts, starts, strict=False)]
    )
    points = np.concatenate([part[2] for part in parts])[first]
    names = parts[0][3]
    values = {k: np.concatenate([part[3][k] for part in parts])[first] for k in names}
    shares = [part[4] for part in parts if part[4] is not None]
    of_cells = np.concatenate(shares) if shares else None
    return Surface(triangles, points, values, of_cells)


def _triangles(grid: Grid) -> tuple[AnyArray, AnyArray]:
    """Local points of this rank's triangles, shape (n, 3), and the cell of each."""
    if grid.mesh.topology.dim == 2:
        own = np.arange(grid.own_cells)
        return _split(_upward(grid.V, grid.V.dofmap.list[own]), own)
    cells, sides = _outer_sides(grid.mesh)
    nodes = np.array([sorted(grid.V.dofmap.dof_layout.entity_closure_dofs(2, i)) for i in range(4)])
    faces = np.take_along_axis(grid.V.dofmap.list[cells], nodes[sides], axis=1)
    return _split(_outward(grid.V, faces, grid.V.dofmap.list[cells, sides]), cells)


def _split(faces: AnyArray, cells: AnyArray) -> tuple[AnyArray, AnyArray]:
    if faces.shape[1] == _CORNERS:
        return faces, cells
    return faces[:, _QUARTERS].reshape(-1, 3), np.repeat(cells, len(_QUARTERS))


def _outward(V: fem.FunctionSpace, faces: AnyArray, opposite: AnyArray) -> AnyArray:
    """Orients faces outward.

    Args:
        V: The space whose nodes the faces have.
        faces: Shape (n, 3 or 6).
        opposite: The corner of each face's cell that is not on the face, shape (n,).
    """
    x = V.tabulate_dof_coordinates()
    behind = x[faces[:, 0]] - x[opposite]
    return _turned(faces, np.einsum("ij,ij->i", _normals(x, faces), behind) < 0)


def _upward(V: fem.FunctionSpace, faces: AnyArray) -> AnyArray:
    """Orients the cells of a plane body so that their normals are +z."""
    return _turned(faces, _normals(V.tabulate_dof_coordinates(), faces)[:, 2] < 0)


def _normals(x: AnyArray, faces: AnyArray) -> AnyArray:
    a, b, c = (x[faces[:, i]] for i in range(3))
    return np.asarray(np.cross(b - a, c - a))


def _turned(faces: AnyArray, which: AnyArray) -> AnyArray:
    # Exchanging corners b and c exchanges the middles of ac and ab.
    order = [0, 2, 1] if faces.shape[1] == _CORNERS else [0, 2, 1, 3, 5, 4]
    faces = faces.copy()
    faces[which] = faces[which][:, order]
    return faces


def _outer_sides(mesh: Mesh) -> tuple[AnyArray, AnyArray]:
    """Cells of the owned boundary facets, and the facets' local numbers in them. Collective."""
    mesh.topology.create_connectivity(2, 3)
    mesh.topology.create_connectivity(3, 2)
    facets = exterior_facet_indices(mesh.topology)
    around = mesh.topology.connectivity(2, 3)
    cells = around.array[around.offsets[facets]]
    sides = mesh.topology.connectivity(3, 2).array.reshape(-1, 4)[cells]
    return cells, np.argmax(sides == facets[:, None], axis=1)
