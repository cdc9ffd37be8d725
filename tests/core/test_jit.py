"""Compiled forms and expressions: one compilation serves every problem of the same kind."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic import box_body
from dolfin_elastic.core import jit
from dolfin_elastic.core.parallel import on_root


def test_an_expression_is_compiled_once(comm: MPI.Comm, folder, monkeypatch: pytest.MonkeyPatch):
    """Also where the variables it is differentiated by are the process's second ones."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    body = box_body(size=(1, 1, 1), cells=(1, 1, 1), comm=comm)
    points = np.array([[0.25, 0.25, 0.25]])
    values = []
    for factor in (1.0, 2.0):
        u = fem.Function(fem.functionspace(body.mesh, ("Lagrange", 1, (3,))))
        u.interpolate(lambda x, factor=factor: factor * x)
        F = ufl.variable(ufl.grad(u))
        stress = ufl.diff(ufl.inner(F, F) / 2, F)
        expression = jit.compile_expression(comm, stress[0, 0], points, jit.options(comm))
        values.append(expression.eval(body.mesh, np.array([0], dtype=np.int32)).flat[0])
    assert values == pytest.approx([1.0, 2.0])
    assert on_root(comm, lambda: len([*folder.rglob("*.c")])) == 1
