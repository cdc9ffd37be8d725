"""Prescribed displacements, springs, dashpots and rigid surfaces, as a user states them."""
