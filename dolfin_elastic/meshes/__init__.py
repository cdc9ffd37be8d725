"""Meshes: reading, generating, naming, judging."""

from dolfin_elastic.meshes.body import Body
from dolfin_elastic.meshes.generate import box_body, rectangle_body
from dolfin_elastic.meshes.naming import name_parts
from dolfin_elastic.meshes.quality import Measures, measures
from dolfin_elastic.meshes.reading import read_body
from dolfin_elastic.meshes.selectors import Cylinder, Selector, Sphere

__all__ = [
    "Body",
    "Cylinder",
    "Measures",
    "Selector",
    "Sphere",
    "box_body",
    "measures",
    "name_parts",
    "read_body",
    "rectangle_body",
]
