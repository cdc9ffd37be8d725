"""Connected bodies are the same however the ranks share them."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from dolfin_elastic import LinearElastic, Problem, Support
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh import Body
from dolfin_elastic.mesh.distribute import build_body
from dolfin_elastic.mesh.formats.raw import RawMesh
from dolfin_elastic.problem.connectivity import ConnectedBodies

COMM = MPI.COMM_WORLD
LENGTHS = 24, 8, 60
"""Squares of three strips, one above the other: the longest is on several ranks at any number."""


def strips() -> Body:
    """Strips of squares, a unit apart, whose left ends are the surface "left"."""

    def read() -> RawMesh:
        points, cells, left, first = [], [], [], 0
        for k, n in enumerate(LENGTHS):
            x, y = np.meshgrid(np.arange(n + 1.0), [2.0 * k, 2.0 * k + 1], indexing="ij")
            points.append(np.stack([x.ravel(), y.ravel()], axis=1))
            a = first + 2 * np.arange(n)
            cells += [np.stack([a, a + 2, a + 3], axis=1), np.stack([a, a + 3, a + 1], axis=1)]
            left.append([first, first + 1])
            first += 2 * (n + 1)
        every = np.concatenate(cells)
        return RawMesh(np.concatenate(points), every, 1, {}, {"left": np.array(left)})

    return build_body(read, comm=COMM, unit=LengthUnit(), source="strips")


def test_bodies_that_ranks_share():
    """Three, numbered by where they are: a link less parts one, a wrong one joins two.

    Ghosts that are not told the component of their owner would belong to the first one of all.
    """
    law = LinearElastic(E=1.0, nu=0.3)
    problem = Problem(strips(), law, supports=[Support(on="left")], degree=1)
    bodies = ConnectedBodies(problem)
    assert bodies.count == len(LENGTHS)
    strip = ((bodies.places[:, 1] + 0.25) // 2).astype(int)  # of nodes, ghosts included
    by_length = np.argsort(np.argsort(LENGTHS))  # the middles of longer ones lie farther along x
    np.testing.assert_array_equal(bodies.of_node, by_length[strip])
    shared = COMM.allgather(set(strip.tolist()))
    assert COMM.size == 1 or max(sum(k in on for on in shared) for k in range(3)) > 1
