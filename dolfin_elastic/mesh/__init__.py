"""Meshes: reading, generating, naming of parts, checks of cells.

Each name is imported when it is first used: the process of Gmsh (`formats/cad/`) has no use for
DOLFINx, which takes ten times as long to import, and starts no MPI (`stay_without`).
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import dolfin_elastic.core.startup.started  # noqa: F401  # before anything starts MPI

if TYPE_CHECKING:
    from dolfin_elastic.core.shapes.shapes import Cylinder as Cylinder
    from dolfin_elastic.core.shapes.shapes import Sphere as Sphere
    from dolfin_elastic.mesh.assembly.of_parts import parts_body as parts_body
    from dolfin_elastic.mesh.assembly.placement import Placed as Placed
    from dolfin_elastic.mesh.body import Body as Body
    from dolfin_elastic.mesh.field_files import FieldFile as FieldFile
    from dolfin_elastic.mesh.generate import box_body as box_body
    from dolfin_elastic.mesh.generate import mesh_body as mesh_body
    from dolfin_elastic.mesh.generate import rectangle_body as rectangle_body
    from dolfin_elastic.mesh.geometry.quality import MeshStatistics as MeshStatistics
    from dolfin_elastic.mesh.geometry.quality import mesh_statistics as mesh_statistics
    from dolfin_elastic.mesh.read import read_body as read_body
    from dolfin_elastic.mesh.selection import name_parts as name_parts
    from dolfin_elastic.mesh.selectors import EdgeSelector as EdgeSelector
    from dolfin_elastic.mesh.selectors import PointSelector as PointSelector
    from dolfin_elastic.mesh.selectors import Selector as Selector

_WHERE = {
    "Body": "body",
    "Cylinder": "selectors",
    "EdgeSelector": "selectors",
    "FieldFile": "field_files",
    "MeshStatistics": "geometry.quality",
    "Placed": "assembly.placement",
    "PointSelector": "selectors",
    "Selector": "selectors",
    "Sphere": "selectors",
    "box_body": "generate",
    "mesh_body": "generate",
    "mesh_statistics": "geometry.quality",
    "name_parts": "selection",
    "parts_body": "assembly.of_parts",
    "read_body": "read",
    "rectangle_body": "generate",
}
__all__ = sorted(_WHERE)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module 'dolfin_elastic.mesh' has no attribute '{name}'")
    attribute = getattr(import_module(f"dolfin_elastic.mesh.{_WHERE[name]}"), name)
    globals()[name] = attribute
    return attribute
