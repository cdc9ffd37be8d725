"""How it is solved: assembly, Newton, statics and dynamics."""

from __future__ import annotations

import dolfin_elastic.core.startup.started  # noqa: F401  # before anything starts MPI
