"""Whether a state is in equilibrium and whether its energy follows the path."""
