"""`Soup`: triangles as a file holds them, before anything is asked of them."""

from __future__ import annotations

import errno
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.files.memory import free_memory, in_words
from dolfin_elastic.core.files.regular import read_regular
from dolfin_elastic.core.types import FloatArray, IntArray

MOST = 20_000_000
"""Triangles that a surface may have."""

_MOST_BYTES = 4 << 30
"""Size of a file that is read."""

_BYTES = 800
"""Memory that a triangle takes until the surface has been checked."""


@dataclass(frozen=True)
class Soup:
    """Triangles of a file.

    Attributes:
        points: Corners in the file's unit, shape (n, 3).
        triangles: Rows of these, shape (m, 3).
        groups: Row of `names` for each triangle, shape (m,).
        names: Of groups; empty where a file has none.
        solids: Number of the solid that each triangle belongs to; corners of different solids are
            different ones, shape (m,).
        solid_names: Of solids; empty where a file has none.
        notes: What is left out.
    """

    points: FloatArray
    triangles: IntArray
    groups: IntArray
    names: Sequence[str]
    solids: IntArray
    solid_names: Sequence[str] = ("",)
    notes: Sequence[str] = ()

    @staticmethod
    def of(
        points: FloatArray,
        triangles: IntArray,
        groups: IntArray | None = None,
        names: Sequence[str] = ("",),
        notes: Sequence[str] = (),
    ) -> Soup:
        """Triangles of one solid."""
        zero = np.zeros(len(triangles), dtype=np.int64)
        return Soup(points, triangles, zero if groups is None else groups, names, zero, notes=notes)


def content(path: Path) -> bytes:
    """The bytes of a file. Local.

    Raises:
        MeshError: It is too large, or no regular file.
    """
    try:
        # Whoever names a file may name a link to it, as for all others.
        return read_regular(path.resolve(), _MOST_BYTES)
    except OSError as error:
        too_large = error.errno == errno.EFBIG
        raise MeshError(
            f"it cannot be read: {error.strerror or error}",
            where=path.name,
            expected="a surface of fewer triangles" if too_large else "",
        ) from None


def check_count(count: int, name: str) -> None:
    """Refuses a number of triangles before memory is taken for them. Local.

    Raises:
        MeshError: There are too many, or none.
    """
    if not count:
        raise MeshError("it has no triangles", where=name, expected="a surface of triangles")
    if count > MOST:
        raise MeshError(
            f"it has {count} triangles, more than {MOST}",
            where=name,
            expected="fewer: programs for meshes and scans can decimate them",
        )
    if count * _BYTES > (free := free_memory()):
        raise MeshError(
            f"its {count} triangles need about {in_words(count * _BYTES)} of memory, "
            f"{in_words(free)} are free",
            where=name,
            expected="fewer triangles, or a machine with more memory",
        )
