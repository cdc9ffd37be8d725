"""Newton's method with PETSc SNES, its scalar unknowns and contact updates."""
