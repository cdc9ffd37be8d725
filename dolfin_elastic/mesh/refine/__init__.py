"""Refining a body where it is asked for, with all that belongs to its mesh."""
