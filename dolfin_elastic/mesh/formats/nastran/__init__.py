"""Nastran bulk data (.bdf, .nas, .fem), as preprocessors, OptiStruct and Gmsh write them."""

from dolfin_elastic.mesh.formats.nastran.reader import read_nastran

__all__ = ["read_nastran"]
