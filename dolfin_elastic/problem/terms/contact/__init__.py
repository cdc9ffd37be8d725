"""Contact with rigid obstacles: what all contacts have, their pressures and friction."""
