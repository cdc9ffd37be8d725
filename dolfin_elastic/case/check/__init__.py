"""Checks and estimates of a case before anything is compiled or solved."""
