"""The package that contact of a surface with itself needs."""

from __future__ import annotations

from types import ModuleType

import pytest

from dolfin_elastic.problem.terms.bodies.barrier import runs_here


def usable_ipctk() -> ModuleType:
    """ipctk; skips tests where it is not installed, or was compiled for another processor."""
    ipctk = pytest.importorskip("ipctk")
    if not runs_here():
        pytest.skip("ipctk was compiled for another processor", allow_module_level=True)
    return ipctk
