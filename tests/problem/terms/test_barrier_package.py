"""Contact of a surface with itself without its package, and on a processor that it was not compiled
for."""

from __future__ import annotations

import sys
from types import ModuleType

import pytest

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.problem.terms.bodies import barrier


def test_without_its_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "ipctk", None)
    with pytest.raises(InputError, match="needs the Python package ipctk") as error:
        barrier.library()
    assert "python-packages.txt" in error.value.expected


def test_on_another_processor(monkeypatch):
    """An unknown instruction ends the process that tries: this one goes on, and says why."""
    illegal = "import os, signal\nos.kill(os.getpid(), signal.SIGILL)\n# {path}"
    monkeypatch.setitem(sys.modules, "ipctk", ModuleType("ipctk"))
    monkeypatch.setattr(barrier, "_TRIAL", illegal)
    barrier.runs_here.cache_clear()
    try:
        with pytest.raises(InputError, match="compiled for another processor") as error:
            barrier.library()
    finally:
        barrier.runs_here.cache_clear()
    assert "--no-binary ipctk" in error.value.expected
