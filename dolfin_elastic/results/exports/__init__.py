"""Finished results as files for other programs: surfaces that move, and nodes with their fields."""
