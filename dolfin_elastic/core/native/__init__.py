"""Loops in C, in files of their own, and what reads them."""
