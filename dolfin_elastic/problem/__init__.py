"""A model on a mesh: function spaces, weak form, constraints and state."""
