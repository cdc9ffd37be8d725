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
from dolfin_elastic.mesh.formats.surfaces.nesting import containing
from dolfin_elastic.mesh.formats.surfaces.options import is_surface
from dolfin_elastic.mesh.formats.surfaces.readers.read import read_soup
from dolfin_elastic.mesh.formats.surfaces.surface import DIGITS, crowded
from dolfin_elastic.mesh.formats.surfaces.topology import (
    CrowdedError,
    Edges,
    OneSidedError,
    heights,
    oriented,
    volumes,
    weld,
)
from dolfin_elastic.mesh.read import check_file, reader, stated_unit_of

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
    if size is not None and is_surface(path):
        raise MeshError(
            "size is given, but the facets of this file are as they are",
            where=path.name,
            expected="size is for .step, .stp, .brep, .iges and .igs",
        )
    stated = stated_unit_of(path)
    used = unit or stated or otherwise
    if is_surface(path):
        soup = read_soup(path)
        return soup.points, soup.triangles, used
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
    points[:, : file.points.shape[1]] = file.points
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
            expected="the surface of the obstacle: .stl, .obj, .ply, .3mf, or a CAD file",
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
    if not np.isfinite(points[np.unique(find_all(np.arange(len(points)), triangles))]).all():
        raise MeshError("it has coordinates that are no finite numbers", where=name)
    try:
        points, triangles = weld(points, triangles, DIGITS * np.abs(points[triangles]).max())
    except CrowdedError:
        raise crowded(name) from None
    sound = heights(points[triangles]) > _FLAT
    flat = int((~sound).sum())
    triangles = triangles[sound]
    _, first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    doubled = len(triangles) - len(first)
    triangles = triangles[np.sort(first)]
    if not len(triangles):
        raise MeshError("none of its triangles has an area", where=name, expected="a surface")
    closed, turned = _turned(points, triangles, name, unit)
    count = int(turned.sum())
    triangles = np.where(turned[:, None], triangles[:, ::-1], triangles)
    said = [f"{len(triangles)} triangles", "closed" if closed else "open"]
    said += [f"{flat} without area left out"] * (flat > 0)
    said += [f"{doubled} that were there twice left out"] * (doubled > 0)
    said += [f"{count} turned round"] * (count > 0)
    used_points, rows = np.unique(triangles, return_inverse=True)
    return FacetsOfFile(Facets(points[used_points], rows.reshape(-1, 3)), ", ".join(said))


def _turned(
    points: FloatArray, triangles: IntArray, name: str, unit: LengthUnit
) -> tuple[bool, BoolArray]:
    """Whether all shells are closed, and which triangles are to be turned round."""

    def wrong(what: str, nodes: IntArray) -> MeshError:
        place = unit.point(points[nodes].mean(axis=0))
        return MeshError(
            f"{what}, at {place}", where=name, expected="the surface of one or more bodies"
        )

    edges = Edges.of(triangles)
    if len(many := edges.crowded):
        ends = np.array([edges.starts[many[0]], edges.ends[many[0]]])
        raise wrong(f"{edges.count[edges.count > 2][0]} triangles meet in an edge", ends)
    try:
        shell, turned = oriented(edges)
    except OneSidedError as error:
        raise wrong("its surface has one side only", triangles[error.triangle]) from None
    count = int(shell.max()) + 1
    opened = np.zeros(count, dtype=bool)
    opened[shell[edges.open // 3]] = True
    # Fewest of an open shell are turned round.
    other = 2 * np.bincount(shell, turned, minlength=count) > np.bincount(shell)
    corners = points[triangles]
    corners[turned] = corners[turned, ::-1]
    inward = volumes(corners, shell, count) < 0
    depth = np.array([len(around) for around in containing(corners, shell, ~opened)])
    flip = np.where(opened, other, inward ^ (depth % 2 == 1))
    return not opened.any(), turned ^ flip[shell]
