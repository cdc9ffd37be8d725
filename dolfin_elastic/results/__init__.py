"""Files, tables, pictures and checkpoints of the states of a solver."""
