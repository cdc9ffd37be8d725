"""Boxes and rectangles, made in parallel."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import CellType, GhostMode, create_box, create_rectangle
from mpi4py import MPI

from dolfin_elastic.core.compat import adjacency
from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.files.memory import check_memory
from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.distribute import BYTES, before_partitioning
from dolfin_elastic.mesh.geometry.simplices import boundary_facets, facet_corners

if TYPE_CHECKING:
    from dolfin_elastic.mesh.formats.raw import RawMesh

_MOST_CELLS = 2**31 - 1
_SHORTEST = 1e-14
"""Length of an edge [m]: DOLFINx takes twice the round-off of 1 for zero."""
_THINNEST = 1e-7
"""Shortest edge over the longest; `_sides` tells nodes apart that are 1e-9 of it away."""

_FEW = 1000
"""Little cubes of a rank below which a box is shared as other meshes are."""
_UNEVEN = 0.03
"""Most by which a share of a box may be larger than the mean."""

_SIDES = {
    2: ("left", "right", "bottom", "top"),
    3: ("left", "right", "front", "back", "bottom", "top"),
}


def box_body(
    *,
    size: Sequence[float],
    cells: Sequence[int],
    origin: Sequence[float] = (0, 0, 0),
    comm: MPI.Comm = MPI.COMM_WORLD,
    scale: float = 1.0,
) -> Body:
    """A box of tetrahedra, six in each little cube; with two sizes a rectangle of triangles.

    Collective.  The surfaces are called left and right (x), front and back (y), bottom and top
    (z); of a rectangle left and right (x), bottom and top (y).

    Args:
        size: Lengths of the edges, in units of `scale` metres.
        cells: Number of little cubes (squares) along each edge.
        origin: The corner with the smallest coordinates; a missing third number is 0.
        scale: Metres per unit of length.

    Raises:
        MeshError: The numbers make no box.
    """
    dim = _check(size, cells, origin)
    number = number_of_cells(cells)
    _check_extremes(size, scale)
    check_memory(comm, number, BYTES[dim], where="cells", expected="fewer elements")
    low = np.array([*origin, 0.0][:dim], dtype=float) * scale
    high = low + np.asarray(size, dtype=float) * scale
    count = [int(n) for n in cells]
    before_partitioning(comm)
    sharing = {"ghost_mode": GhostMode.none, "partitioner": _partitioner(comm, count)}
    if dim == 3:
        mesh = create_box(comm, [low, high], count, CellType.tetrahedron, **sharing)
    else:
        mesh = create_rectangle(comm, [low, high], count, CellType.triangle, **sharing)
    facets = boundary_facets(mesh)
    text = " x ".join(f"{s:g}" for s in size)
    return Body(
        mesh,
        {},
        _sides(facets, facet_corners(mesh, facets), low, high),
        f"{'box' if dim == 3 else 'rectangle'} {text}",
        unit=LengthUnit.of(scale),
    )


def rectangle_body(
    *,
    size: Sequence[float],
    cells: Sequence[int],
    origin: Sequence[float] = (0, 0),
    comm: MPI.Comm = MPI.COMM_WORLD,
    scale: float = 1.0,
) -> Body:
    """A rectangle of triangles for plane strain: `box_body` with two sizes. Collective.

    Args:
        size: Lengths of both edges, in units of `scale` metres.
        cells: Number of squares along each edge, of two triangles each.
        scale: Metres per unit of length.

    Raises:
        MeshError: The numbers make no rectangle.
    """
    if len(size) != 2:
        raise MeshError(
            f"a rectangle has two sizes, not {len(size)}",
            where="size",
            expected="for example [0.2, 0.1]",
        )
    return box_body(size=size, cells=cells, origin=origin, comm=comm, scale=scale)


def mesh_body(
    points: npt.ArrayLike,
    cells: npt.ArrayLike,
    *,
    regions: Mapping[str, npt.ArrayLike] | None = None,
    nodes: Mapping[str, npt.ArrayLike] | None = None,
    fields: Mapping[str, npt.ArrayLike] | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    scale: float = 1.0,
) -> Body:
    """A body of arrays, distributed over the ranks. Collective.

    The arrays are those of rank 0; what other ranks give is not looked at.  They are checked and
    cleaned as those of a mesh file are.

    Args:
        points: Coordinates in units of `scale` metres, shape (N, 2) or (N, 3).
        cells: Rows of `points`: triangles, shape (M, 3) or, with the nodes of VTK's quadratic
            ones, (M, 6); tetrahedra, (M, 4) or (M, 10).
        regions: Name to rows of `cells`.
        nodes: Name to rows of `points`: a set of nodes, and the surface of the boundary's facets
            all of whose corners are in it.
        fields: Name to values, shape (M,), (N,) or (..., columns).
        scale: Metres per unit of length.

    Raises:
        MeshError: The arrays are no mesh.

    Example:
        mesh_body([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]], nodes={"foot": [0, 1]})
    """
    from dolfin_elastic.mesh.distribute import build_body
    from dolfin_elastic.mesh.formats.arrays import raw_mesh
    from dolfin_elastic.mesh.geometry.checks import check_cells

    def read() -> RawMesh:
        return raw_mesh(points, cells, regions or {}, nodes or {}, fields or {})

    return check_cells(build_body(read, comm=comm, unit=LengthUnit.of(scale), source="the arrays"))


def _check(size: Sequence[float], cells: Sequence[int], origin: Sequence[float]) -> int:
    dim = len(size)
    if dim not in (2, 3):
        raise MeshError(
            f"a box has three sizes, a rectangle two, not {dim}",
            where="size",
            expected="for example [0.2, 0.1, 0.1]",
        )
    if len(cells) != dim:
        raise MeshError(
            f"{len(cells)} numbers of elements for {dim} sizes",
            where="cells",
            expected="one number for each edge",
        )
    if not (np.isfinite(size).all() and min(size) > 0):
        raise MeshError(
            f"sizes must be positive, not {list(size)}",
            where="size",
            expected="for example [0.2, 0.1, 0.1]",
        )
    if min(cells) < 1 or any(int(n) != n for n in cells):
        raise MeshError(
            f"numbers of elements must be whole and positive, not {list(cells)}",
            where="cells",
            expected="for example [8, 4, 4]",
        )
    if len(origin) not in (2, 3) or not np.isfinite(origin).all():
        raise MeshError(
            f"the origin needs {dim} coordinates, not {list(origin)}",
            where="origin",
            expected="for example [0, 0, 0]",
        )
    return dim


def _check_extremes(size: Sequence[float], scale: float) -> None:
    """Refuses boxes at which DOLFINx fails, or whose sides cannot be told apart."""
    if min(size) * scale < _SHORTEST or min(size) < _THINNEST * max(size):
        raise MeshError(
            f"an edge of {min(size) * scale:.3g} m is too short",
            where="size",
            expected=f"at least {_SHORTEST:g} m, and {_THINNEST:g} of the longest edge",
        )


def number_of_cells(cells: Sequence[int]) -> int:
    """Number of tetrahedra of a box, or of triangles of a rectangle.

    Args:
        cells: Number of little cubes or squares along each edge.

    Raises:
        MeshError: There are more than 32-bit numbers count.
    """
    number = math.prod(int(n) for n in cells) * math.factorial(len(cells))
    if number > _MOST_CELLS:
        raise MeshError(
            f"{number:.3g} elements are too many",
            where="cells",
            expected=f"at most {_MOST_CELLS:.3g}: PETSc's numbers have 32 bits",
        )
    return number


def _partitioner(comm: MPI.Comm, count: Sequence[int]) -> Callable[..., object] | None:
    """How ranks share a box: by recursive coordinate bisection of its little cubes.

    No graph of its cells is made: that takes two fifths of the time of the whole mesh.

    Args:
        count: Number of little cubes (squares) along each edge.

    Returns:
        None where DOLFINx's own way is better: where a graph takes no time, and where layers of
        cubes make uneven shares.
    """
    total = math.prod(count)
    if comm.size == 1 or total < _FEW * comm.size:
        return None
    if _largest_share(np.array(count), comm.size) * comm.size > (1 + _UNEVEN) * total:
        return None

    def ranks_of(_: MPI.Comm, parts: int, kinds: object, cells: Sequence[IntArray]) -> object:
        """Rank of each cell.

        DOLFINx numbers the vertices of a box along x first, and every cell has the lowest vertex
        of its little cube.
        """
        corner = np.asarray(cells[0]).reshape(-1, len(count) + 1).min(axis=1)
        cubes = np.empty((len(corner), len(count)), dtype=np.int64)
        for axis, number in enumerate(count):
            corner, cubes[:, axis] = np.divmod(corner, number + 1)
        return adjacency(_bisected(cubes, np.array(count), parts)[:, None])

    return ranks_of


def _cut(count: IntArray, parts: int) -> tuple[IntArray, IntArray, int]:
    """Where a box of cubes is cut, across its longest edge.

    Args:
        count: Number of cubes along each edge, shape (dim,).
        parts: Number of parts, at least 2; both sides get cubes in proportion to theirs.

    Returns:
        First cube of the upper side, shape (dim,); number of cubes along each edge of the lower
        one; and the parts of the lower one.
    """
    axis, below = int(np.argmax(count)), parts // 2
    first, lower = np.zeros_like(count), count.copy()
    first[axis] = lower[axis] = round(int(count[axis]) * below / parts)
    return first, lower, below


def _largest_share(count: IntArray, parts: int) -> int:
    """Most cubes of a part; see `_bisected`."""
    if parts == 1:
        return int(np.prod(count))
    first, lower, below = _cut(count, parts)
    return max(_largest_share(lower, below), _largest_share(count - first, parts - below))


def _bisected(cubes: IntArray, count: IntArray, parts: int) -> IndexArray:
    """Part of each cube, given by its place along each edge, of a box that is bisected."""
    result = np.zeros(len(cubes), dtype=np.int32)
    if parts == 1:
        return result
    first, lower, below = _cut(count, parts)
    here = (cubes < lower).all(axis=1)
    result[here] = _bisected(cubes[here], lower, below)
    result[~here] = below + _bisected(cubes[~here] - first, count - first, parts - below)
    return result


def _sides(
    facets: IndexArray, corners: FloatArray, low: FloatArray, high: FloatArray
) -> dict[str, IndexArray]:
    # Half a cell's width would do; this is far above round-off and far below it.
    near = 1e-9 * np.linalg.norm(high - low)
    names, sides = _SIDES[len(low)], {}
    for axis in range(len(low)):
        for name, value in zip(names[2 * axis : 2 * axis + 2], (low, high), strict=True):
            on = (np.abs(corners[:, :, axis] - value[axis]) <= near).all(axis=1)
            sides[name] = facets[on]
    return sides
