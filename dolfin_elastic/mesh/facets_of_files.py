"""Surfaces of rigid bodies, from files of triangles, volume meshes and CAD files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.shapes.rigid_mesh import Facets
from dolfin_elastic.core.types import BoolArray, FloatArray, IntArray
from dolfin_elastic.core.units import METRE, LengthUnit, metres
from dolfin_elastic.mesh.formats.cad.process import Permission
from dolfin_elastic.mesh.formats.raw import MeshFile, find_all
from dolfin_elastic.mesh.read import check_file, reader, stated_unit_of

_SAME = 1e-7
"""Distance of points that are one, over the largest coordinate: files have seven digits."""

_CROWD = 100
"""Points that are one with each, on average, at most."""

_FLAT = 1e-10
"""Height of a triangle without area over its longest edge."""

_PARTS = {
    "triangle": [[0, 1, 2]],
    "triangle6": [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]],
    "quad": [[0, 1, 2], [0, 2, 3]],
    "quad8": [[0, 1, 2], [0, 2, 3]],
    "quad9": [[0, 1, 2], [0, 2, 3]],
}
"""Triangles of the elements of a surface."""

_FACES = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
"""Outward faces of a tetrahedron."""


@dataclass(frozen=True)
class FacetsOfFile:
    """What has been read.

    Attributes:
        facets: The surface, in metres.
        remarks: What was corrected, and how large it is.
    """

    facets: Facets
    remarks: str


def read_facets(
    path: Path, unit: LengthUnit | None, otherwise: LengthUnit, size: float | str | None
) -> FacetsOfFile:
    """Reads the surface of a rigid body. Local: one rank reads.

    Args:
        unit: Unit of length of the file; None: the one that it states.
        otherwise: Where it states none.
        size: Size of the facets of a CAD file, in its unit.

    Raises:
        MeshError: The file cannot be read, or is no surface.
    """
    points, triangles, used = _read(path, unit, otherwise, size)
    return clean(points * used.metres, triangles, path.name, used)


def read_triangles(path: Path, metres: float) -> tuple[FloatArray, IntArray]:
    """Corners [m] and triangles of a surface as a file holds them, in its order. Local.

    Args:
        metres: Metres per unit of length of the file, where it states none.

    Raises:
        MeshError: The file cannot be read, or is no surface.
    """
    points, triangles, used = _read(path, None, LengthUnit.of(metres), None)
    return points * used.metres, triangles


def _read(
    path: Path, unit: LengthUnit | None, otherwise: LengthUnit, size: float | str | None
) -> tuple[FloatArray, IntArray, LengthUnit]:
    """See `read_facets`; points in the unit that comes with them."""
    check_file(path, size)
    stated = stated_unit_of(path)
    used = unit or stated or otherwise
    permission = Permission()

    def cad() -> MeshFile:
        from dolfin_elastic.mesh.formats.cad.read import mesh_cad

        edge = None if size is None else metres(size, used.metres) / used.metres
        return mesh_cad(
            path, size=edge, curved=False, dim=2, stated=stated, unit=used, permission=permission
        )

    file = reader(path, cad, permission)[0]()
    return *_triangles(file, path.name), used


def _triangles(file: MeshFile, name: str) -> tuple[FloatArray, IntArray]:
    """Points of three coordinates, and triangles as they stand in a file."""
    points = np.zeros((len(file.points), 3))
    given = file.points[:, :3]  # some programs write colours after them
    points[:, : given.shape[1]] = given
    blocks = [block for block in file.blocks if block.dim > 1 and len(block.nodes)]
    if any(block.dim == 3 for block in blocks):
        if other := [b.kind for b in blocks if b.dim == 3 and not b.kind.startswith("tetra")]:
            raise _no_format(other[0], name)
        cells = np.concatenate([b.nodes[:, :4] for b in blocks if b.dim == 3])
        faces = cells[:, _FACES].reshape(-1, 3)
        _, first, count = np.unique(
            np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
        )
        return points, faces[first[count == 1]]
    if other := [b.kind for b in blocks if b.kind not in _PARTS]:
        raise _no_format(other[0], name)
    found = [b.nodes[:, _PARTS[b.kind]].reshape(-1, 3) for b in blocks]
    if not found:
        raise MeshError(
            "it has no triangles",
            where=name,
            expected="the surface of the obstacle: .stl, .obj, .ply, or a CAD file",
        )
    return points, np.concatenate(found)


def _no_format(kind: str, name: str) -> MeshError:
    return MeshError(
        f"it has elements of the kind {kind}, whose surface is not supported",
        where=name,
        expected="triangles, quadrilaterals or tetrahedra",
    )


def clean(
    points: FloatArray, triangles: IntArray, name: str, unit: LengthUnit = METRE
) -> FacetsOfFile:
    """The surface of triangles that are written one by one. Local.

    Points that coincide are merged; triangles without area and doubled ones are left out; all that
    are joined are turned the same way round, outwards where they enclose a volume.

    Args:
        points: Corners [m].
        unit: By which messages give places.

    Raises:
        MeshError: There are no triangles, more than two meet in an edge, it has one side only, or
            corners that do not exist or are not finite.
    """
    used, rows = np.unique(triangles, return_inverse=True)
    points = points[find_all(np.arange(len(points)), used)]
    if not np.isfinite(points).all():
        raise MeshError("it has coordinates that are no finite numbers", where=name)
    points, triangles = _merged(points, rows.reshape(-1, 3), name)
    sound = _has_area(points[triangles])
    flat = int((~sound).sum())
    triangles = triangles[sound]
    _, first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    doubled = len(triangles) - len(first)
    triangles = triangles[np.sort(first)]
    if not len(triangles):
        raise MeshError("none of its triangles has an area", where=name, expected="a surface")
    shells, turned = _Shells(points, triangles, name, unit).oriented()
    count = int(turned.sum())
    triangles = np.where(turned[:, None], triangles[:, ::-1], triangles)
    said = [f"{len(triangles)} triangles", "closed" if shells else "open"]
    said += [f"{flat} without area left out"] * (flat > 0)
    said += [f"{doubled} that were there twice left out"] * (doubled > 0)
    said += [f"{count} turned round"] * (count > 0)
    used_points, rows = np.unique(triangles, return_inverse=True)
    return FacetsOfFile(Facets(points[used_points], rows.reshape(-1, 3)), ", ".join(said))


def _merged(points: FloatArray, triangles: IntArray, name: str) -> tuple[FloatArray, IntArray]:
    """Points of which no two coincide.

    Raises:
        MeshError: So many do that it has no shape.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    points, rows = np.unique(points, axis=0, return_inverse=True)
    near = _SAME * np.abs(points).max(initial=0.0)
    tree, n = cKDTree(points), len(points)
    if tree.count_neighbors(tree, near) > _CROWD * n:
        raise MeshError(
            "its corners coincide to the seven digits of their coordinates",
            where=name,
            expected="the origin near the surface",
        )
    pairs = tree.query_pairs(near, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    count, label = connected_components(graph, directed=False)
    first = np.full(count, n)
    np.minimum.at(first, label, np.arange(n))
    return points[first], label[rows.reshape(-1)][triangles]


def _has_area(corners: FloatArray) -> BoolArray:
    edges = np.roll(corners, -1, axis=1) - corners
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    longest = (edges**2).sum(axis=2).max(axis=1)
    return np.asarray(area > _FLAT * longest)


class _Shells:
    """Triangles that are joined by edges."""

    def __init__(
        self, points: FloatArray, triangles: IntArray, name: str, unit: LengthUnit
    ) -> None:
        self._points, self._triangles, self._name, self._unit = points, triangles, name, unit
        ends = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)
        low, high = ends.min(axis=1), ends.max(axis=1)
        keys = low * len(points) + high
        order = np.argsort(keys, kind="stable")
        first, count = np.unique(keys[order], return_index=True, return_counts=True)[1:]
        if len(many := np.flatnonzero(count > 2)):
            raise self._wrong(
                f"{count[many[0]]} triangles meet in an edge", ends[order[first[many[0]]]]
            )
        self._pairs = np.stack([order[first[count == 2]], order[first[count == 2] + 1]], axis=1)
        self._opposed: BoolArray = ends[self._pairs[:, 0], 0] != ends[self._pairs[:, 1], 0]
        self._ends, self._open_edges = ends, order[first[count == 1]]

    def _wrong(self, what: str, edge: IntArray) -> MeshError:
        place = self._unit.point(self._points[edge].mean(axis=0))
        return MeshError(
            f"{what}, at {place}", where=self._name, expected="the surface of one or more bodies"
        )

    def oriented(self) -> tuple[bool, BoolArray]:
        """Whether all shells are closed, and which triangles are to be turned round.

        A triangle and the same one turned round are two nodes of a graph, of which those are joined
        that go the same way round: a surface that has two sides falls into two parts.
        """
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        m = len(self._triangles)
        a, b = (self._pairs // 3).T
        turn = np.where(self._opposed, 0, m)
        i, j = np.concatenate([a, a + m]), np.concatenate([b + turn, (b + m + turn) % (2 * m)])
        graph = coo_array((np.ones(len(i)), (i, j)), shape=(2 * m, 2 * m))
        label = connected_components(graph, directed=False)[1]
        if len(bad := np.flatnonzero(label[:m] == label[m:])):
            raise self._wrong("its surface has one side only", self._triangles[bad[0]])
        pair = np.stack([label[:m], label[m:]])
        shell = np.unique(pair.min(axis=0), return_inverse=True)[1].reshape(-1)
        turned: BoolArray = pair[0] > pair[1]
        count = int(shell.max()) + 1
        opened = np.zeros(count, dtype=bool)
        opened[shell[self._open_edges // 3]] = True
        # Fewest of an open shell are turned round.
        size = np.bincount(shell, minlength=count)
        other = 2 * np.bincount(shell, turned, minlength=count) > size
        corners = self._points[self._triangles]
        corners[turned] = corners[turned, ::-1]
        volume = np.linalg.det(corners - corners.mean(axis=(0, 1)))
        inward = np.bincount(shell, volume, minlength=count) < 0
        flip = np.where(opened, other, inward ^ _within_others(corners, shell, opened))
        return not opened.any(), turned ^ flip[shell]


def _within_others(corners: FloatArray, shell: IntArray, opened: BoolArray) -> BoolArray:
    """Which closed shells lie inside an odd number of others: these bound a cavity."""
    count = len(opened)
    inside = np.zeros(count, dtype=np.int64)
    starts = np.array([corners[np.argmax(shell == k)].mean(axis=0) for k in range(count)])
    for k in np.flatnonzero(~opened):
        solid = _solid_angle(corners[shell == k], starts)
        inside += (solid > 2 * np.pi) & (np.arange(count) != k)
    return np.asarray((inside % 2 == 1) & ~opened)


def _solid_angle(corners: FloatArray, x: FloatArray) -> FloatArray:
    """Size of the solid angle under which triangles are seen from points.

    Source: A. Van Oosterom & J. Strackee, IEEE Trans. Biomed. Eng. 30 (1983) 125.
    """
    result = np.empty(len(x))
    for row, place in enumerate(x):
        a, b, c = np.moveaxis(corners - place, 1, 0)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        top = np.einsum("ni,ni->n", a, np.cross(b, c))
        below = la * lb * lc + sum(
            np.einsum("ni,ni->n", p, q) * r for p, q, r in ((a, b, lc), (b, c, la), (c, a, lb))
        )
        result[row] = abs(np.sum(2 * np.arctan2(top, below)))
    return result
