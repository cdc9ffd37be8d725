"""Names that rank 0 has read: sent some at a time, and found on each rank."""

from __future__ import annotations

from itertools import pairwise
from math import comb

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.core.units import METRE
from dolfin_elastic.mesh import Body, distribute
from dolfin_elastic.mesh.distribute import _Table, build_body
from dolfin_elastic.mesh.formats.raw import RawMesh

COMM = MPI.COMM_WORLD


def grid(n: int) -> tuple[FloatArray, IntArray]:
    """Points and triangles of a square of n by n pieces."""
    at = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    low = [at[:-1, :-1], at[1:, :-1], at[1:, 1:]], [at[:-1, :-1], at[1:, 1:], at[:-1, 1:]]
    cells = np.concatenate([np.stack([c.ravel() for c in one], axis=1) for one in low])
    i, j = np.divmod(np.arange((n + 1) ** 2), n + 1)
    return np.stack([i, j], axis=1) / n, cells


def square(n: int) -> Body:
    """Its sides are named, and one name has edges that no element has."""
    points, cells = grid(n)
    at = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    sides = {"left": at[0], "right": at[-1], "top": at[:, -1]}
    surfaces = {name: np.array([*pairwise(row)]) for name, row in sides.items()}
    surfaces["broken"] = np.array([[0, n + 2], [0, 2 * n], [1, 3 * n]])
    nodes = {"ends": np.array([0, n, n * (n + 1)]), "side": at[:, 0]}
    raw = RawMesh(points, cells, 1, surfaces=surfaces, nodes=nodes)
    return build_body(lambda: raw, comm=COMM, unit=METRE, source="square.msh")


@pytest.mark.parametrize("at_once", [3, 1 << 16])
def test_names_come_some_at_a_time(at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
    n = 10
    monkeypatch.setattr(distribute, "AT_ONCE", at_once)
    body = square(n)
    x = body.mesh.geometry.x
    for name, axis, value in (("left", 0, 0.0), ("right", 0, 1.0), ("top", 1, 1.0)):
        assert total(COMM, len(body.owned_facets(name))) == n
        facets = distribute.facet_nodes(body.mesh, body.surfaces[name])
        assert np.abs(x[facets][..., axis] - value).max(initial=0.0) < 1e-12
    assert total(COMM, len(body.owned_points("ends"))) == 3
    assert total(COMM, len(body.owned_points("side"))) == n + 1
    assert "broken" not in body.surfaces
    assert body.incomplete["broken"] == "2 of its 3 facets are no facets of an element"


def test_rows_of_a_table() -> None:
    """All triples of some numbers, in any order; those of others are not found."""
    numbers = np.array([0, 3, 7, 2**40, 2**41])
    rows = np.array([[a, b, c] for a in numbers for b in numbers for c in numbers if a < b < c])
    rows = rows[np.random.default_rng(1).permutation(len(rows))]
    assert len(rows) == comb(5, 3)
    table = _Table(rows[:7])
    assert table.find(rows).tolist() == [0, 1, 2, 3, 4, 5, 6, -1, -1, -1]
    assert table.find(rows[:0]).tolist() == []
    assert table.find(np.array([[0, 3, 2**42], [3, 3, 7]])).tolist() == [-1, -1]
    assert _Table(rows[:0]).find(rows).tolist() == [-1] * len(rows)
