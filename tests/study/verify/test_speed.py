"""`verify --speed`: what is timed, and what is counted for the bound."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic.cli.tools.verify import verify
from dolfin_elastic.study.verify import speed as module

COMM = MPI.COMM_WORLD


def test_all_kernels_are_timed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for name, value in {"_CELLS": {1: 3, 2: 2}, "_TIMES": 1, "_STEPS": 2, "_TRIAD": 1000}.items():
        monkeypatch.setattr(module, name, value)
    file = Path(COMM.bcast(str(tmp_path / "speed.json"), root=0))
    verify(speed=True, full=False, ranks="", case=None, json=file)
    memory, *rows = json.loads(file.read_text())
    operations = ["multigrid and CG", "tangent", "residual", "explicit motion"]
    assert [row["what"] for row in rows] == [*operations, *operations[:3]]
    assert all(row["nanoseconds"] > 0 and row["ranks"] == COMM.size for row in rows)
    assert (COMM.rank > 0) == (not capsys.readouterr().out)
    # What one cell's tangent and residual read at least: the numbers of its nodes.
    bytes_per_cell = [row["bound"] * memory["bytes_per_second"] / 1e9 for row in rows]
    for i, nodes in ((1, 4), (2, 4), (5, 10), (6, 10)):
        assert bytes_per_cell[i] > 4 * nodes


def test_half_of_the_blocks_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of n nodes and m pairs of neighbours n + m blocks of 9 numbers and of one place."""
    monkeypatch.setattr(module, "_CELLS", {1: 3})
    cubes = max(2, round(3 * COMM.size ** (1 / 3)))
    edges = np.array([2 * cubes, cubes, cubes])
    n = np.prod(edges + 1)
    # Edges, diagonals of faces and of cubes, each in one direction of three, three and one.
    pairs = sum(np.prod(edges + 1 - np.array(d)) for d in np.ndindex(2, 2, 2) if any(d))
    found = next(iter(module.speeds(COMM, 1.0)))
    least = 3 * (8 * 9 + 4) * (n + pairs) / (3 * n)
    # On several ranks those of pairs that two ranks have are with both.
    assert least < found.bound / 1e9 < (1.1 if COMM.size == 1 else 1.5) * least
