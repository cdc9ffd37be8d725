"""Stress recovered at the nodes, and the discretisation error that is estimated from it."""
