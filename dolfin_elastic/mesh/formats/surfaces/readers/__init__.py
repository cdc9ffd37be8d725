"""Triangles of files, as they are there."""
