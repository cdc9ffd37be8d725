"""Sizes and shapes of cells against triangles and tetrahedra known by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh import Body, mesh_statistics
from dolfin_elastic.mesh.distribute import make_mesh

COMM = MPI.COMM_WORLD


def body_of(points: FloatArray, cells: IndexArray) -> Body:
    """A body of a few cells, which rank 0 hands out."""
    root = COMM.rank == 0
    return Body(make_mesh(COMM, cells if root else cells[:0], points if root else points[:0], 1))


def test_quality_of_triangles():
    """An equilateral triangle (1), and a right one of legs h and 1/2 on its longest side 1.

    Quality is the area over that of the equilateral triangle on the longest side,
    (h/4)/(h/2) = 1/2; the mean of both is 3/4.
    """
    h = math.sqrt(3) / 2
    points = np.array([[0, 0], [1, 0], [0.5, h], [1, h]])
    found = mesh_statistics(body_of(3 * points, np.array([[0, 1, 2], [1, 3, 2]])), worst=1)
    assert found.quality_mean == pytest.approx(0.75, rel=1e-14)
    assert found.quality_min == pytest.approx(0.5, rel=1e-14)
    assert (found.shortest, found.longest) == pytest.approx((3, 3), rel=1e-14)
    assert found.volume == pytest.approx(9 * (h / 2 + h / 4), rel=1e-14)
    (worst,) = found.worst
    assert worst.quality == pytest.approx(0.5, rel=1e-14)
    assert worst.volume == pytest.approx(9 * h / 4, rel=1e-14)
    assert worst.middle == pytest.approx((2.5, 2 * h), rel=1e-14)


def test_quality_of_tetrahedra():
    """A regular tetrahedron (1) in a cube of edge 2, and the corner of the cube beyond a face.

    The volumes are 8/3 and 4/3 on longest edges of one length: qualities 1 and 1/2.
    """
    points = np.array([[0, 0, 0], [2, 2, 0], [2, 0, 2], [0, 2, 2], [2, 2, 2]], dtype=float)
    found = mesh_statistics(body_of(points, np.array([[0, 1, 2, 3], [1, 2, 3, 4]])))
    assert found.quality_mean == pytest.approx(0.75, rel=1e-14)
    assert [cell.quality for cell in found.worst] == pytest.approx([0.5, 1.0], rel=1e-14)
    assert found.longest == pytest.approx(math.sqrt(8), rel=1e-14)
    assert found.volume == pytest.approx(4, rel=1e-14)
