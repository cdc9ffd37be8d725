"""Periodic unit cells: their dof map and their fluctuation field."""
