"""The case file: its tables, its check, and the run that it describes."""

from __future__ import annotations

import dolfin_elastic.core.startup.started  # noqa: F401  # before anything starts MPI
