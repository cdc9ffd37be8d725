"""Meshes: reading, generating, naming of parts, checks of cells."""

from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.generate import box_body, rectangle_body
from dolfin_elastic.mesh.geometry.quality import MeshStatistics, mesh_statistics
from dolfin_elastic.mesh.read import read_body
from dolfin_elastic.mesh.selection import name_parts
from dolfin_elastic.mesh.selectors import Cylinder, EdgeSelector, PointSelector, Selector, Sphere

__all__ = [
    "Body",
    "Cylinder",
    "EdgeSelector",
    "MeshStatistics",
    "PointSelector",
    "Selector",
    "Sphere",
    "box_body",
    "mesh_statistics",
    "name_parts",
    "read_body",
    "rectangle_body",
]
