"""Least squares of measured numbers: search, intervals, what cannot be told apart."""
