"""Surfaces of triangles as files hold them: each triangle with corners of its own."""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path

import numpy as np

from dolfin_elastic.core.types import FloatArray

_CORNERS = np.array([(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)], dtype=float)
_FACES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


def cube(low: float = 0.0, high: float = 1.0, shift: tuple[float, ...] = (0, 0, 0)) -> FloatArray:
    """Twelve triangles of a cube, outwards, shape (12, 3, 3)."""
    rows = [t for a, b, c, d in _FACES for t in ((a, b, c), (a, c, d))]
    return (low + (high - low) * _CORNERS + np.array(shift))[np.array(rows)]


def write_stl(path: Path, corners: FloatArray, count: int | None = None) -> Path:
    """A binary STL file, which may state another number of triangles."""
    rows = b"".join(struct.pack("<12fH", 0, 0, 0, *t.ravel(), 0) for t in corners)
    head = b"solid".ljust(80, b"\0")
    path.write_bytes(head + struct.pack("<I", len(corners) if count is None else count) + rows)
    return path


def write_3mf(path: Path, model: str) -> Path:
    """A 3MF file with a model alone."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("3D/3dmodel.model", model)
    return path


def model_3mf(corners: FloatArray, *, head: str = "", unit: str = "inch", items: str = "") -> str:
    """A model of one object with the name "block"."""
    points = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in corners.reshape(-1, 3))
    rows = "".join(
        f'<triangle v1="{3 * k}" v2="{3 * k + 1}" v3="{3 * k + 2}"/>' for k in range(len(corners))
    )
    return (
        f'<?xml version="1.0"?>{head}<model unit="{unit}"><resources><object id="1" name="block">'
        f"<mesh><vertices>{points}</vertices><triangles>{rows}</triangles></mesh></object>"
        f"</resources><build>{items}</build></model>"
    )
