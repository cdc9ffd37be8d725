"""Abaqus input files (.inp), as CalculiX, Cubit, Salome and others write them too."""

from dolfin_elastic.mesh.formats.abaqus.reader import read_abaqus

__all__ = ["read_abaqus"]
