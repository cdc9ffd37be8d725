"""A model on a mesh: function spaces, weak form, constraints and state."""

from __future__ import annotations

import dolfin_elastic.core.startup.started  # noqa: F401  # before anything starts MPI
