"""Checkpoints: states on disk, readable on any number of ranks."""
