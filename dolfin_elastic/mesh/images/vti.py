"""VTK's XML images (.vti)."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.formats.vtk_xml import TYPES, VtkXml, count_of
from dolfin_elastic.mesh.images.image import Image, check_shape, scaled
from dolfin_elastic.mesh.images.stream import RATIO


def read_vti(path: Path) -> Image:
    """Reads the scalars of an image; values at points or in cells are those of voxels. Local.

    Raises:
        MeshError: It is damaged, in several pieces, or has no scalar of its own.
    """
    content = path.read_bytes()
    xml = VtkXml(content, "ImageData")
    grid = xml.root.find("ImageData")
    pieces = [] if grid is None else grid.findall("Piece")
    if grid is None or len(pieces) != 1:
        raise MeshError(f"the image is in {len(pieces)} pieces", expected="one piece")
    extent = _extent(grid, "WholeExtent")
    if _extent(pieces[0], "Extent") != extent:
        raise MeshError("its piece is not the whole image", expected="one piece")
    origin, spacing = (_numbers(grid, key, 3, other) for key, other in _PLACES)
    direction = _numbers(grid, "Direction", 9, "1 0 0 0 1 0 0 0 1").reshape(3, 3)
    first, last = np.array(extent[::2]), np.array(extent[1::2])
    array, at_points = _scalars(pieces[0])
    shape = tuple(int(n) for n in last - first + at_points)
    if not at_points:  # of a plane image cells have no thickness
        shape = tuple(max(n, 1) for n in shape)
    dtype = np.dtype(TYPES[array.get("type", "")])
    check_shape(shape, dtype, RATIO * len(content))
    values = xml.array(array, int(np.prod(shape)), 1).reshape(shape, order="F")
    affine = np.eye(4)
    affine[:3, :3] = direction * spacing
    affine[:3, 3] = origin + affine[:3, :3] @ (first + (0.0 if at_points else 0.5))
    return Image(scaled(values, 1.0, 0.0), affine, None)


_PLACES = (("Origin", "0 0 0"), ("Spacing", "1 1 1"))
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d{1,3})?", re.ASCII)


def _numbers(element: ElementTree.Element, key: str, count: int, other: str) -> FloatArray:
    words = element.get(key, other).split()
    if len(words) != count or not all(len(w) < 40 and _NUMBER.fullmatch(w) for w in words):
        raise MeshError(
            f"{element.tag} has {key} = '{' '.join(words)}'", expected=f"{count} numbers"
        )
    return np.array(words, dtype=np.float64)


def _extent(element: ElementTree.Element, key: str) -> list[int]:
    numbers = _numbers(element, key, 6, "")
    if not all(abs(n) < 1 << 40 and float(n).is_integer() for n in numbers):
        raise MeshError(
            f"{element.tag} has {key} = '{element.get(key, '')[:80]}'", expected="whole numbers"
        )
    return [int(n) for n in numbers]


def _scalars(piece: ElementTree.Element) -> tuple[ElementTree.Element, bool]:
    """The array that is marked as scalars, or the only one; whether it is at points."""
    found = []
    for part in ("PointData", "CellData"):
        for data in piece.findall(part):
            for array in data.findall("DataArray"):
                one = count_of(array, "NumberOfComponents", 1) == 1
                if one and array.get("type") in TYPES and array.get("Name") != "vtkGhostType":
                    if array.get("Name") == data.get("Scalars"):
                        return array, part == "PointData"
                    found.append((array, part == "PointData"))
    if len(found) != 1:
        names = ", ".join(f"'{array.get('Name', '')}'" for array, _ in found[:8])
        raise MeshError(
            f"it has {len(found) or 'no'} arrays of one number a voxel",
            expected="one, or one that is marked as Scalars" + (f", of {names}" if names else ""),
        )
    return found[0]
