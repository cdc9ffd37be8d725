"""Files, tables, pictures and checkpoints of the states of a solver."""

from __future__ import annotations

import dolfin_elastic.core.startup.started  # noqa: F401  # before anything starts MPI
