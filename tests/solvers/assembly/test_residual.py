"""What the residual says of itself."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import LinearElastic, Problem, box_body
from dolfin_elastic.solvers.assembly.assembler import Assembler

COMM = MPI.COMM_WORLD


def test_the_largest_force_and_its_place():
    """Each node in turn is moved alone: the largest of all nodal forces, and its place."""
    body = box_body(size=(2, 1, 1), cells=(2, 1, 1))
    problem = Problem(body, LinearElastic(E=1e6, nu=0.3), degree=1)
    residual = Assembler(problem).residual
    x = problem.V.tabulate_dof_coordinates()
    own = problem.V.dofmap.index_map.size_local
    places = sorted({tuple(row) for rows in COMM.allgather(x[:own].tolist()) for row in rows})
    seen = set()
    for place in places:
        at = np.linalg.norm(x - place, axis=1) < 1e-9
        problem.u.x.array[:] = np.outer(at, [3e-4, -1e-4, 2e-4]).ravel()
        problem.unknowns.u_to_w()
        residual.assemble()
        rows = zip(residual.owned.reshape(-1, 3).tolist(), x[:own].tolist(), strict=True)
        sizes = [
            (float(np.linalg.norm(force)), tuple(where))
            for some in COMM.allgather(list(rows))
            for force, where in some
        ]
        size, where = residual.largest()
        assert size == pytest.approx(max(sizes)[0], rel=1e-12)
        assert min(abs(size - s) for s, w in sizes if np.allclose(w, where)) < 1e-9 * size
        seen.add(tuple(np.round(where, 9)))
    assert len(seen) == len(places)  # so the first node of each rank has had its turn
