"""Several runs: on finer meshes until a result is known, and of cases with known results."""

from __future__ import annotations

import dolfin_elastic.core.startup.started  # noqa: F401  # before anything starts MPI
