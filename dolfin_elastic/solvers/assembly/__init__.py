"""From forms to PETSc vectors and matrices."""
