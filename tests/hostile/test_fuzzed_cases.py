"""Cases drawn at random from the schema, valid and nearly valid: codes 0, 2 or 3, never 1."""

from __future__ import annotations

import tempfile
import tomllib
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from helpers.hostile import BASES, ODD, Hostile, changed, places
from hostile.test_generated import read
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.mesh_table import MeshTable
from dolfin_elastic.case.tables import Output
from dolfin_elastic.core.files import memory
from dolfin_elastic.solvers.dynamics.settings import DynamicsSettings
from dolfin_elastic.solvers.eigen.settings import ModalSettings
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.solvers.statics.settings import StaticsSettings

pytestmark = pytest.mark.usefixtures("serial_only")

TABLES = {
    "": Case,
    "mesh": MeshTable,
    "output": Output,
    "dynamics": DynamicsSettings,
    "modal": ModalSettings,
    "solver": LinearSettings,
    "statics": StaticsSettings,
}
KEYS = [(table, key) for table, record in TABLES.items() for key in record.model_fields]
NUMBERS = st.one_of(
    st.integers(-3, 12),
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from([0.3, 1e-8, 1e6, 0.5, 1.0]),
)
WORDS = st.one_of(
    st.sampled_from(
        ["left", "right", "foot", "core", "steel", "auto", "direct", "iterative", "newmark", "t"]
    ),
    st.sampled_from(["1 mm", "2 GPa", "3 s", "10 %", "0.1*t", "sin(x)*t", "x/y", "sqrt(t - 1)"]),
    st.text(max_size=12),
)
LEAVES = st.one_of(NUMBERS, WORDS, st.booleans())
VALUES = st.one_of(
    LEAVES,
    st.lists(LEAVES, max_size=4),
    st.dictionaries(st.sampled_from(["on", "kind", "every", "value"]), LEAVES, max_size=3),
    st.sampled_from(ODD[1:]),
)


@st.composite
def cases(draw: st.DrawFn) -> bytes:
    """A base with up to three values changed or left out, and up to two keys added."""
    tables: dict[str, Any] = tomllib.loads(draw(st.sampled_from(BASES)))
    for _ in range(draw(st.integers(0, 3))):
        place = draw(st.sampled_from(list(places(tables))))
        tables = changed(tables, place, draw(st.one_of(st.none(), VALUES)))
    for _ in range(draw(st.integers(0, 2))):
        table, key = draw(st.sampled_from(KEYS))
        inner = tables.setdefault(table, {}) if table else tables
        if isinstance(inner, dict):
            inner[key] = deepcopy(draw(VALUES))
    return Hostile.of_tables(tables)


def _fuzz(count: int, monkeypatch: pytest.MonkeyPatch, command: str = "check") -> None:
    @settings(
        max_examples=count,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(cases())
    def holds(text: bytes) -> None:
        with tempfile.TemporaryDirectory() as folder:
            told = read(Hostile("", text), Path(folder), monkeypatch, command)
            monkeypatch.chdir("/")
        assert told == "", text.decode("utf-8", "replace")

    # As on a small machine: what takes no more is read in a few seconds, all else is refused.
    monkeypatch.setattr(memory, "free_memory", lambda: 2e8)
    holds()


@pytest.mark.long
def test_fuzzed_cases(monkeypatch: pytest.MonkeyPatch) -> None:
    _fuzz(150, monkeypatch)


@pytest.mark.long
def test_many_fuzzed_cases(monkeypatch: pytest.MonkeyPatch) -> None:
    _fuzz(2000, monkeypatch)


@pytest.mark.long
def test_fuzzed_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Computed, too, on two cells; a run that takes long is asked to stop."""
    _fuzz(1000, monkeypatch, "run")
