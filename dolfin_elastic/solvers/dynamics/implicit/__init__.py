"""Implicit time integration with PETSc TS."""
