"""Which files are surfaces of triangles, and the options of these."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from dolfin_elastic.core.errors import MeshError

SURFACES = (".stl", ".obj", ".ply", ".3mf")
"""Suffixes of files of triangles that bound a body."""


def is_surface(path: str | os.PathLike[str]) -> bool:
    """Whether a file is a surface of triangles, by its suffix."""
    return Path(path).suffix.lower() in SURFACES


@dataclass(frozen=True)
class SurfaceOptions:
    """How a surface of triangles becomes a body.

    Attributes:
        deviation: Distance between elements and surface that does no harm, in the file's unit.
        repair: Mends what is wrong with the surface.
        angle: Between the normals of triangles, from which on their edge divides patches
            [degrees]; None: 40.
    """

    deviation: float | None = None
    repair: bool | None = None
    angle: float | None = None

    def check(self, path: Path, dim: int | None, *, known_unit: bool) -> None:
        """Refuses what makes no sense, or no sense for a file. Local.

        Args:
            dim: Of the elements; None: that of the file.
            known_unit: The unit of its lengths is stated, in the file or by the user.

        Raises:
            MeshError: With what would be right.
        """
        if is_surface(path) and dim == 2:
            raise MeshError(
                "a surface of triangles encloses a solid", where=path.name, expected="dim = 3"
            )
        if is_surface(path) and not known_unit:
            from dolfin_elastic.mesh.formats.surfaces.sizes import unit_is_missing

            raise unit_is_missing(path)
        given = [key for key, value in vars(self).items() if value is not None]
        if given and not is_surface(path):
            raise MeshError(
                f"mesh.{given[0]} is given, but this file is no surface of triangles",
                where=path.name,
                expected=f"{given[0]} is for {', '.join(SURFACES)}",
            )
        if self.angle is not None and not 0 < self.angle <= 180:
            raise MeshError(
                f"the angle of sharp edges must be more than 0 and at most 180 degrees, not "
                f"{self.angle:g}",
                where="mesh.angle",
            )
        if self.deviation is not None and not self.deviation > 0:
            raise MeshError(
                f"the deviation from the surface must be positive, not {self.deviation:g}",
                where="mesh.deviation",
                expected='for example "0.1 mm"',
            )
