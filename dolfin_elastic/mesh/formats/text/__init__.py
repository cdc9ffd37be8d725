"""Meshes as plain text: TetGen and MFEM."""
