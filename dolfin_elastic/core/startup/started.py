"""Who imports this has MPI and PETSc started, see `libraries.start`. Collective."""

from __future__ import annotations

from dolfin_elastic.core.startup.libraries import start

start()
