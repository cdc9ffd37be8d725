"""Regions of a label image as bodies of tetrahedra."""
