"""How MPI, PETSc and the other libraries start: the current folder decides nothing."""
