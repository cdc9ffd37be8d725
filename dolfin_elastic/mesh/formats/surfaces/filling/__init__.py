"""Closed surfaces and the cells within."""
