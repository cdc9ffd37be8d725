"""Convergence rates with manufactured solutions, for every element and law.

The slope of the error is fitted over the meshes; see `helpers/manufactured.py`.

Expected: u in L2 with order p + 1, in H1 with order p (Ciarlet 1978, theorem 3.2.2; Nitsche).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
import ufl
from helpers.manufactured import NU, E, exact, held_and_loaded
from mpi4py import MPI

from dolfin_elastic import (
    LinearElastic,
    NeoHookean,
    Statics,
    box_body,
)
from dolfin_elastic.core.jit import compile_forms
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.solvers.assembly.assembler import integral


def errors(law: Law, dim: int, degree: int, n: int) -> np.ndarray:
    """Error of u in L2 and of grad u in L2 on n cells along each edge."""
    body = box_body(size=(1.0,) * dim, cells=(n,) * dim)
    problem = held_and_loaded(body, law, law, degree)
    *_, state = Statics(problem, steps=1 if law.linear else 2, rtol=1e-10).steps()
    assert state.load_factor == 1.0
    e = problem.u - exact(dim, ufl.SpatialCoordinate(body.mesh))
    dx = ufl.dx(domain=body.mesh, metadata={"quadrature_degree": 2 * degree + 2})
    forms = compile_forms(
        body.comm, [ufl.inner(e, e) * dx, ufl.inner(ufl.grad(e), ufl.grad(e)) * dx], problem.jit
    )
    return np.sqrt([integral(problem, form) for form in forms])


def slopes(law: Law, dim: int, degree: int, cells: Sequence[int]) -> np.ndarray:
    table = np.array([errors(law, dim, degree, n) for n in cells])
    print(law.name(), dim, degree, table.tolist())
    return np.polyfit(np.log(1 / np.array(cells)), np.log(table), 1)[0]


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    ("dim", "degree", "cells"),
    [(2, 1, (12, 24, 48)), (2, 2, (6, 12, 24)), (3, 1, (5, 10, 15)), (3, 2, (3, 5, 7))],
)
@pytest.mark.parametrize("kind", [LinearElastic, NeoHookean], ids=lambda k: k.__name__)
def test_rates(kind, dim, degree, cells):
    in_l2, in_h1 = slopes(kind(E=E, nu=NU), dim, degree, cells)
    print(in_l2, in_h1)
    assert in_l2 >= {1: 1.95, 2: 2.9}[degree]
    assert in_h1 >= {1: 0.95, 2: 1.9}[degree]
    # Much faster than theory would mean that the error is measured wrongly.
    assert in_l2 <= degree + 1.25
    assert in_h1 <= degree + 0.25


def test_a_wrong_force_would_be_seen():
    """The error stops falling when the law of the forces is not that of the body."""
    body = box_body(size=(1.0, 1.0), cells=(24, 24))
    law, wrong = LinearElastic(E=E, nu=NU), LinearElastic(E=E, nu=NU * 1.05)
    problem = held_and_loaded(body, law, wrong, 1)
    _ = [*Statics(problem).steps()]
    nodal = problem.V.tabulate_dof_coordinates()
    x, y = nodal[:, 0], nodal[:, 1]
    u = problem.u.x.array.reshape(-1, 2)
    off = np.abs(u[:, 0] - 0.1 * np.sin(np.pi * x) * np.cos(np.pi * y / 2)).max(initial=0.0)
    assert body.comm.allreduce(float(off), op=MPI.MAX) > 1e-3
