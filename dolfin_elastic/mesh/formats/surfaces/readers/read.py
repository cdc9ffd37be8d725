"""Surfaces of triangles by the suffix of their file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.mesh.formats.surfaces.readers.soup import Soup


def read_soup(path: Path) -> Soup:
    """Reads the triangles of a file. Local: one rank reads.

    Raises:
        MeshError: It is damaged, has no triangles, or coordinates that are no finite numbers.
    """
    suffix = path.suffix.lower()
    if suffix == ".stl":
        from dolfin_elastic.mesh.formats.surfaces.readers.stl import read_stl as read
    elif suffix == ".obj":
        from dolfin_elastic.mesh.formats.surfaces.readers.obj import read_obj as read
    elif suffix == ".ply":
        from dolfin_elastic.mesh.formats.surfaces.readers.ply import read_ply as read
    else:
        from dolfin_elastic.mesh.formats.surfaces.readers.threemf import read_3mf as read
    soup = read(path)
    finite = np.asarray(np.isfinite(soup.points).all(axis=1))
    bad = np.flatnonzero(~np.all(finite[soup.triangles], axis=1))
    if len(bad):
        raise MeshError(
            f"a corner of triangle {bad[0] + 1} has coordinates that are no finite numbers",
            where=path.name,
            expected="save it anew",
        )
    return soup
