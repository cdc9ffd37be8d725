"""FEBio model files (.feb) of the specifications 2.0 to 4.0."""

from dolfin_elastic.mesh.formats.febio.reader import read_febio

__all__ = ["read_febio"]
