"""Derivatives of numbers of an equilibrium: one adjoint solution for each number."""
