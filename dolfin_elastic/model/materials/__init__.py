"""Strain energies: the base classes of laws, their moduli, directions and table."""
