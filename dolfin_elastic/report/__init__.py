"""The report of a finished run: one HTML page that needs nothing else, and its PDF."""

from __future__ import annotations

import dolfin_elastic.core.startup.started  # noqa: F401  # before anything starts MPI
