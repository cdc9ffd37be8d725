"""Surfaces of triangles: readers, checks, mending, and filling with tetrahedra."""
