"""Materials at a point, before any mesh exists: checks and curves.  UFL and numpy only."""

from __future__ import annotations

import dolfin_elastic.core.startup.started  # noqa: F401  # before anything starts MPI
