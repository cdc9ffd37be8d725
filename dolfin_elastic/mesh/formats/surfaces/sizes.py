"""The size of a body whose file has no unit."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.mesh.formats.surfaces.readers.read import read_soup

ASKED = ("mm", "inch", "m")
"""Units in which the size of a body is said where its file has none."""

_METRES = {"mm": 1e-3, "inch": 0.0254, "m": 1.0}


def sizes_in_units(path: Path) -> str:
    """The size that the body of a file would have in each of some units. Local.

    Raises:
        MeshError: The file is damaged.
    """
    soup = read_soup(path)
    extent = np.ptp(soup.points[np.unique(soup.triangles)], axis=0)
    texts = []
    for name in ASKED:
        mm = extent * _METRES[name] / 1e-3
        factor, shown = (1.0, "mm") if mm.max() < 1e3 else (1e-3, "m")
        texts.append(f"{name}: " + " x ".join(f"{x * factor:.4g}" for x in mm) + f" {shown}")
    return "; ".join(texts)


def unit_is_missing(path: Path) -> MeshError:
    """The error of a file whose lengths have no unit. Local."""
    return MeshError(
        f"the lengths of a {path.suffix.lower()} file have no unit, and the body would have this "
        f"size with unit = {sizes_in_units(path)}",
        where=path.name,
        expected='write which, for example unit = "mm"',
    )
