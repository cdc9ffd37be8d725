"""Memory that was freed goes back to the system."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from petsc4py import PETSc  # whose SuperLU_DIST keeps what is freed

from dolfin_elastic.solvers.petsc import c_api


def resident() -> float:
    """Resident memory of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096e-6


def test_gaps_between_arrays_are_given_back():
    """Of 400 arrays of 0.5 MB each tenth stays: about 180 MB in gaps between them go back."""
    assert PETSc.Sys.isInitialized()
    if c_api._trim() is None:
        pytest.skip("the C library has no malloc_trim")
    c_api.give_back()
    arrays = [np.ones(2**16) for _ in range(400)]
    before = resident()
    kept = arrays[::10]
    del arrays
    c_api.give_back()
    assert before - resident() > 150.0
    assert all(array.sum() == 2**16 for array in kept)


def test_another_c_library(monkeypatch):
    """Without `malloc_trim` nothing happens."""
    monkeypatch.setattr(c_api, "_trim", lambda: None)
    c_api.give_back()
