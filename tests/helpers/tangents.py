"""Tangents against differences of the residual."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from dolfin_elastic import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler


@contextmanager
def against_differences(
    problem: Problem, prepare: Callable[[], object] = lambda: None, step: float = 1e-7
) -> Iterator[tuple[Assembler, float, float]]:
    """The tangent at a displacement of some percent times a motion, and central differences.

    Collective.

    Args:
        prepare: Is called where the problem has that displacement.

    Yields:
        The assembler with the tangent there, the norm of the difference, and that of the product.
    """
    assembler, dim, comm = Assembler(problem), problem.body.dim, problem.body.comm
    x, f, d = (assembler.create_vector() for _ in range(3))
    places = problem.V.tabulate_dof_coordinates()[: assembler.size // dim, :dim]
    x.array_w[:] = 0.01 * np.sin(3 * places + places[:, ::-1]).ravel()
    d.array_w[:] = np.cos(5 * places + 1 + places[:, ::-1]).ravel()
    assembler.put(x)
    prepare()
    found, start = [], x.array_r.copy()
    for sign in (1, -1):
        x.array_w[:] = start + sign * step * d.array_r
        assembler.residual.evaluate(x, f)
        found.append(f.array_r.copy())
    x.array_w[:] = start
    assembler.tangent.assemble(x)
    assembler.tangent.matrix.mult(d, f)
    difference = (found[0] - found[1]) / (2 * step) - f.array_r
    off, size = np.sqrt([comm.allreduce(float(v @ v)) for v in (difference, f.array_r)])
    yield assembler, float(off), float(size)
    for vector in (x, f, d):
        vector.destroy()
    assembler.destroy()
