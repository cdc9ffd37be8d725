"""The surface of a body, gathered on rank 0 for pictures; the mesh is not gathered.

VTK interpolates linearly in the triangles that it draws.  Every face of a cell is therefore divided
into many, whose corners get the values of the shape functions: between its few nodes a von Mises
stress that falls to zero, as on the neutral axis of a beam, would not be seen.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from dolfinx.common import IndexMap
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.geometry.simplices import boundary_facets, cells_beside_facets
from dolfin_elastic.results.grid import Grid

_CORNERS = 3
_MOST_TRIANGLES = 30_000
"""Faces are divided into up to 64 triangles each while these are no more together, for drawing them
takes about 30 microseconds each."""
_SIDES = ((1, 2), (0, 2), (0, 1))
"""Corners of the sides of a face, whose middles are the nodes after the corners."""

_AT_NODE = 1e-9
"""What a shape function lacks of 1 at its node."""

_Share = tuple[AnyArray, AnyArray, AnyArray, dict[str, AnyArray], AnyArray | None]
"""Faces, global numbers of nodes, their places, values and values of cells of one rank."""


@dataclass(frozen=True)
class Surface:
    """Triangles and values at their corners.

    Attributes:
        triangles: Numbers of `points`, shape (n, 3), counter-clockwise seen from outside.
        points: Reference configuration [m], shape (m, 3).
        values: Name to values at the points, shape (m, columns).
        of_cells: Values of the cells behind the triangles, shape (n, ...), or None.
        nodes: Which points are nodes, shape (m,), or None: all of them.
        edges: Lines between pairs of points, shape (k, 2).
        skin: Which triangles are no sections, shape (n,), or None: all of them.
    """

    triangles: AnyArray
    points: AnyArray
    values: dict[str, AnyArray]
    of_cells: AnyArray | None = None
    nodes: AnyArray | None = None
    edges: AnyArray = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    skin: AnyArray | None = None


def gather_surface(
    grid: Grid | Mesh,
    values: dict[str, AnyArray],
    of_cells: AnyArray | None = None,
    *,
    linear: Collection[str] = (),
    of_faces: Callable[[IndexArray], AnyArray] | None = None,
) -> Surface | None:
    """The body's surface on rank 0, None on the others. Collective.

    The surface of a plane body are all its cells.

    Args:
        grid: Or a mesh, whose nodes are those of its geometry.
        values: Name to values at the local points (ghosts included), shape (points, columns);
            between them they follow the shape functions of the displacement.
        of_cells: Values of the local cells (ghosts included), shape (cells,), or None.
        linear: Names of values that are linear between neighbouring nodes instead.
        of_faces: Local facets, in a plane cells, to values in place of those of cells.
    """
    nodes = _nodes(grid)
    faces, cells, facets = _faces(nodes)
    used, local = np.unique(faces, return_inverse=True)
    numbers = nodes.index_map.local_to_global(used.astype(np.int32))
    points = nodes.x[used]
    local_rows = None if of_cells is None else of_cells[cells]
    if of_faces is not None:
        local_rows = of_faces(facets)
    own = (
        local.reshape(faces.shape),
        numbers,
        points,
        {k: v[used] for k, v in values.items()},
        local_rows,
    )
    parts = _to_root(nodes.mesh.comm, own)
    return divided(_joined(parts), linear) if nodes.mesh.comm.rank == 0 else None


def gather_cells(
    grid: Grid,
    values: dict[str, AnyArray],
    planes: Sequence[tuple[int, float]],
    of_cells: AnyArray | None = None,
) -> Surface | None:
    """The tetrahedra that planes cut, on rank 0, None on the others. Collective.

    Args:
        values: See `gather_surface`.
        planes: Number of the axis across each plane, and its coordinate [m].
        of_cells: See `gather_surface`.

    Returns:
        The nodes of the cells, in the order of VTK, as its triangles.
    """
    own, x = grid.local_cells(), grid.V.tabulate_dof_coordinates()
    cut = np.zeros(len(own), dtype=bool)
    for axis, at in planes:
        along = x[own, axis]
        cut |= (along.min(axis=1) <= at) & (along.max(axis=1) >= at)
    cells = own[cut]
    used, local = np.unique(cells, return_inverse=True)
    share = (
        local.reshape(cells.shape),
        grid.V.dofmap.index_map.local_to_global(used.astype(np.int32)),
        x[used],
        {k: v[used] for k, v in values.items()},
        None if of_cells is None else of_cells[: grid.own_cells][cut],
    )
    parts = _to_root(grid.mesh.comm, share)
    return _joined(parts) if grid.mesh.comm.rank == 0 else None


@dataclass(frozen=True)
class _Nodes:
    """Nodes of a space or of a mesh's geometry: local cells, their layout, numbers and places."""

    mesh: Mesh
    cells: AnyArray
    layout: Any
    index_map: IndexMap
    x: AnyArray


def _nodes(grid: Grid | Mesh) -> _Nodes:
    if isinstance(grid, Mesh):
        g = grid.geometry
        return _Nodes(grid, g.dofmap, g.cmap.create_dof_layout(), g.index_map(), g.x)
    of, x = grid.V.dofmap, grid.V.tabulate_dof_coordinates()
    return _Nodes(grid.mesh, of.list, of.dof_layout, of.index_map, x)


def _to_root(comm: MPI.Comm, own: _Share) -> list[_Share]:
    return comm.gather(own) or []


def _joined(parts: list[_Share]) -> Surface:
    """The faces of all ranks, with 3 or 6 nodes; nodes that several ranks have are merged."""
    numbers = np.concatenate([part[1] for part in parts])
    _, first, new = np.unique(numbers, return_index=True, return_inverse=True)
    starts = np.cumsum([0, *(len(part[1]) for part in parts)])
    faces = np.concatenate(
        [new[part[0] + start] for part, start in zip(parts, starts, strict=False)]
    )
    points = np.concatenate([part[2] for part in parts])[first]
    names = parts[0][3]
    values = {k: np.concatenate([part[3][k] for part in parts])[first] for k in names}
    shares = [part[4] for part in parts if part[4] is not None]
    of_cells = np.concatenate(shares) if shares else None
    return Surface(faces, points, values, of_cells)


# --- division of faces ---


def divided(faces: Surface, linear: Collection[str]) -> Surface:
    """Faces divided into triangles.

    Args:
        faces: With faces of 3 or 6 nodes as its triangles.
        linear: See `gather_surface`.
    """
    nodes = faces.triangles
    least = 1 if nodes.shape[1] == _CORNERS else 2
    n = least
    while n < 8 and (least > 1 or faces.values) and len(nodes) * (2 * n) ** 2 <= _MOST_TRIANGLES:
        n *= 2
    lattice = _lattice(n)
    numbers = _numbered(nodes[:, :_CORNERS], lattice, n)
    _, first, new = np.unique(numbers, return_index=True, return_inverse=True)
    smooth = _shape_functions(lattice / n, nodes.shape[1])
    kinked = _hat_functions(lattice / n, nodes.shape[1])
    face, offset = np.divmod(first, len(lattice))

    def between(values: AnyArray, shape: AnyArray) -> AnyArray:
        # A node without a value (NaN) matters where its shape function is not zero only.
        unknown = np.isnan(values)
        known, weights = np.where(unknown, 0.0, values)[nodes[face]], shape[offset]
        result = np.einsum("pn,pnj->pj", weights, known)
        gaps = np.einsum("pn,pnj->pj", (weights != 0).astype(float), unknown[nodes[face]])
        return np.asarray(np.where(gaps > 0, np.nan, result))

    pieces = _pieces(n)
    return Surface(
        new.reshape(numbers.shape)[:, pieces].reshape(-1, _CORNERS),
        between(faces.points, smooth),
        {k: between(v, kinked if k in linear else smooth) for k, v in faces.values.items()},
        None if faces.of_cells is None else np.repeat(faces.of_cells, len(pieces), axis=0),
        smooth.max(axis=1)[offset] > 1 - _AT_NODE,
    )


def _lattice(n: int) -> AnyArray:
    """Points of a divided triangle: n times their barycentric coordinates, shape (points, 3)."""
    return np.array([(n - p - q, p, q) for q in range(n + 1) for p in range(n + 1 - q)])


def _pieces(n: int) -> AnyArray:
    """Triangles between the points of `_lattice`, oriented as the whole one, shape (n^2, 3)."""
    number = {(b, c): i for i, (_, b, c) in enumerate(_lattice(n).tolist())}
    result = []
    for (p, q), here in number.items():
        if p + q < n:
            result.append((here, number[p + 1, q], number[p, q + 1]))
        if p + q < n - 1:
            result.append((number[p + 1, q], number[p + 1, q + 1], number[p, q + 1]))
    return np.array(result)


def _numbered(corners: AnyArray, lattice: AnyArray, n: int) -> AnyArray:
    """Numbers of the points of divided faces, the same in all faces that share a side or corner.

    Args:
        corners: Nodes at the corners of the faces, shape (faces, 3).
        lattice: See `_lattice`.
    """
    count = int(corners.max(initial=-1)) + 1
    result = np.empty((len(corners), len(lattice)), dtype=np.int64)
    ends = corners[:, _SIDES]
    low, high = ends.min(axis=2).astype(np.int64), ends.max(axis=2)
    keys, sides = np.unique(low * count + high, return_inverse=True)
    sides = sides.reshape(low.shape)
    inside = count + len(keys) * (n - 1) + np.arange(len(corners)) * len(lattice)
    for i, weights in enumerate(lattice):
        touched = np.flatnonzero(weights)
        if len(touched) == 1:
            result[:, i] = corners[:, touched[0]]
        elif len(touched) == 2:
            side = _SIDES.index((int(touched[0]), int(touched[1])))
            a, b = ends[:, side, 0], ends[:, side, 1]
            along = np.where(a < b, weights[touched[1]], weights[touched[0]])
            result[:, i] = count + sides[:, side] * (n - 1) + along - 1
        else:
            result[:, i] = inside + i
    return result


def _shape_functions(x: AnyArray, nodes: int) -> AnyArray:
    """Shape functions of a face, shape (points, nodes).

    Args:
        x: Barycentric coordinates, shape (points, 3).
        nodes: 3: linear, 6: quadratic.
    """
    if nodes == _CORNERS:
        return x
    middles = [4 * x[:, i] * x[:, j] for i, j in _SIDES]
    return np.column_stack([x * (2 * x - 1), *middles])


def _hat_functions(x: AnyArray, nodes: int) -> AnyArray:
    """Functions that are linear in each of the four triangles between the nodes of a face.

    Args:
        x: Barycentric coordinates, shape (points, 3).
        nodes: 3 or 6.
    """
    if nodes == _CORNERS:
        return x
    middles = [
        np.clip(np.minimum(np.minimum(2 * x[:, i], 2 * x[:, j]), 1 - 2 * x[:, 3 - i - j]), 0, None)
        for i, j in _SIDES
    ]
    return np.column_stack([np.clip(2 * x - 1, 0, None), *middles])


# --- faces ---


def _faces(nodes: _Nodes) -> tuple[AnyArray, AnyArray, IndexArray]:
    """Nodes of this rank's faces, shape (n, 3 or 6), the cell of each and its own local number."""
    x, mesh = nodes.x, nodes.mesh
    if mesh.topology.dim == 2:
        own = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
        faces = nodes.cells[own]  # seen from above
        return _turned(faces, _normals(x, faces)[:, 2] < 0), own, own
    facets = boundary_facets(mesh)
    cells, sides = cells_beside_facets(mesh, facets)
    closure = np.array([sorted(nodes.layout.entity_closure_dofs(2, i)) for i in range(4)])
    faces = np.take_along_axis(nodes.cells[cells], closure[sides], axis=1)
    behind = x[faces[:, 0]] - x[nodes.cells[cells, sides]]  # seen from outside
    inward = np.einsum("ij,ij->i", _normals(x, faces), behind) < 0
    return _turned(faces, inward), cells, facets


def _normals(x: AnyArray, faces: AnyArray) -> AnyArray:
    a, b, c = (x[faces[:, i]] for i in range(3))
    return np.asarray(np.cross(b - a, c - a))


def _turned(faces: AnyArray, which: AnyArray) -> AnyArray:
    # Exchanging corners b and c exchanges the middles of ac and ab.
    order = [0, 2, 1] if faces.shape[1] == _CORNERS else [0, 2, 1, 3, 5, 4]
    faces = faces.copy()
    faces[which] = faces[which][:, order]
    return faces


_FACES = {
    3: [[0, 1, 2]],
    4: [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
    6: [[0, 1, 2, 4, 5, 3]],
    10: [[0, 2, 1, 5, 4, 6], [0, 1, 3, 8, 7, 4], [1, 2, 3, 9, 8, 5], [0, 3, 2, 9, 6, 7]],
}
"""Number of nodes of a cell of VTK to those of its faces, which look outwards: three corners, then
the nodes in the middle of the sides opposite of them."""


def outer_faces(cells: IntArray, x: FloatArray) -> tuple[IntArray, IntArray]:
    """Faces that belong to one cell, seen from outside, and their cells. Not collective.

    Args:
        cells: Nodes of triangles or tetrahedra in VTK's order, shape (n, 3, 4, 6 or 10).
        x: Places of the nodes, shape (m, 3).

    Returns:
        Shapes (k, 3 or 6) and (k,).
    """
    parts = _FACES[cells.shape[1]]
    faces = np.concatenate([cells[:, face] for face in parts])
    of = np.tile(np.arange(len(cells)), len(parts))
    if len(parts) == 1:
        return _turned(faces, _normals(x, faces)[:, 2] < 0), of
    # Cells may run either way round.
    mirrored = np.linalg.det(x[cells[:, 1:4]] - x[cells[:, :1]]) < 0
    corners = np.sort(faces[:, :_CORNERS], axis=1)
    _, first, count = np.unique(corners, axis=0, return_index=True, return_counts=True)
    outer = np.sort(first[count == 1])
    return _turned(faces[outer], mirrored[of[outer]]), of[outer]
