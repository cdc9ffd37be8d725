"""Essential boundary conditions, skew supports and rigid surfaces on a mesh."""
