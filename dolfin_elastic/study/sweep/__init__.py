"""Runs of one case with other values: one table, one plot, and what the values' spread does."""
