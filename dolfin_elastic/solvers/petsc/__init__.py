"""PETSc's options, and what petsc4py does not wrap."""
