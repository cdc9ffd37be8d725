"""Refining a case until one of its results is known to a given share."""
