"""dolfin_elastic: an MPI-parallel solver for deformable elastic bodies on DOLFINx and PETSc."""

__version__ = "0.1.0"
