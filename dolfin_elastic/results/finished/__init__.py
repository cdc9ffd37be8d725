"""Reading the folder that a run has left: one process, without MPI and DOLFINx."""
