"""Faults of meshes that all ranks read, looked for in parts of the facets."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx.mesh import create_unit_cube
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import IntArray
from dolfin_elastic.mesh.formats import cleaning
from dolfin_elastic.mesh.formats.cleaning import check_distributed

COMM = MPI.COMM_WORLD


def check(cells: IntArray, points: int) -> None:
    """Each rank has some of the cells and points."""
    mine = np.array_split(cells, COMM.size)[COMM.rank]
    check_distributed(COMM, mine, len(np.array_split(np.arange(points), COMM.size)[COMM.rank]), 3)


@pytest.mark.parametrize("at_once", [5, 64, 1 << 18])
def test_faults_are_counted_in_any_number_of_parts(
    at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cleaning, "_AT_ONCE", at_once)
    mesh = create_unit_cube(MPI.COMM_SELF, 3, 3, 3)
    cells = np.asarray(mesh.geometry.dofmap, dtype=np.int64)
    points = len(mesh.geometry.x)
    check(cells, points)
    again = cells[[3, 17, 40]][:, [2, 0, 3, 1]]  # in another order of their corners
    with pytest.raises(MeshError, match="3 duplicate elements"):
        check(np.concatenate([cells, again]), points)
    mesh.topology.create_connectivity(2, 3)
    inner = np.flatnonzero(np.diff(mesh.topology.connectivity(2, 3).offsets) == 2)[:2]
    third = mesh.topology.connectivity(2, 0)
    vertices = np.array([third.links(facet) for facet in inner], dtype=np.int64)
    # On a serial mesh vertices and nodes of straight cells have the numbers of the cells' rows.
    corners = np.asarray(mesh.topology.connectivity(3, 0).array).reshape(-1, 4)
    to_node = np.empty(points, dtype=np.int64)
    to_node[corners] = cells
    more = np.column_stack([to_node[vertices], points + np.arange(2)])
    with pytest.raises(MeshError, match="2 facets lie between three or more elements"):
        check(np.concatenate([cells, more]), points + 2)
