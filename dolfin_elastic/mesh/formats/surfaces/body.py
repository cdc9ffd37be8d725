"""`mesh_surface`: tetrahedra within the closed surface of a file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.formats.cad.process import Permission
from dolfin_elastic.mesh.formats.raw import MeshFile
from dolfin_elastic.mesh.formats.surfaces.complex import read_complex
from dolfin_elastic.mesh.formats.surfaces.options import SurfaceOptions


def mesh_surface(
    path: Path,
    *,
    size: float | None,
    curved: bool | None,
    options: SurfaceOptions,
    unit: LengthUnit,
    permission: Permission,
) -> MeshFile:
    """Fills the closed surface of a file with tetrahedra. Local: one rank meshes.

    Args:
        size: Of the elements, in the file's unit; see `fill`.
        curved: Quadratic cells that follow curved surfaces; None: where there are any.
        unit: Of the file's lengths, for messages.

    Raises:
        MeshError: The file is damaged, the surface has a fault, or Gmsh cannot fill it.
    """
    from dolfin_elastic.mesh.formats.surfaces.filling.fill import fill

    made = read_complex(path, unit=unit, repair=bool(options.repair), angle=options.angle)
    filled = fill(
        made.plc,
        source=path.name,
        size=size,
        deviation=options.deviation,
        curved=curved,
        permission=Permission(seconds=permission.seconds),  # a surface needs no trust
    )
    return replace(
        filled,
        notes=[*made.notes, *filled.notes],
        information=[*made.information, *filled.information],
    )
