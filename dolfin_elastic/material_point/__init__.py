"""Materials at a point, before any mesh exists: checks and curves.  UFL and numpy only."""
