"""Refining a case until one of its results is accurate enough."""
