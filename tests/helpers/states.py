"""A problem and a state of it with given displacements, to be written to files; solved problems."""

from __future__ import annotations

from typing import Any

import numpy as np
from dolfinx.mesh import create_box, create_rectangle
from mpi4py import MPI

from dolfin_elastic import NeoHookean, Statics
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import State

COMM = MPI.COMM_WORLD


def make_problem(dim: int = 3, degree: int = 1, *, cells: int = 3) -> Problem:
    """A beam or a strip of rubber."""
    mesh = (
        create_box(COMM, [[0, 0, 0], [2, 1, 1]], [2 * cells, cells, cells])
        if dim == 3
        else create_rectangle(COMM, [[0, 0], [2, 1]], [2 * cells, cells])
    )
    return Problem(Body(mesh), NeoHookean(E=1e6, nu=0.3, density=1e3), degree=degree)


def displacement(x: AnyArray, t: float = 1.0) -> AnyArray:
    """A bent and stretched shape, quadratic in x; x of shape (3, n)."""
    return t * np.stack([0.1 * x[0] - 0.05 * x[0] * x[1], 0.2 * x[0] ** 2, 0.03 * x[0] * x[1]])


def make_state(problem: Problem, step: int = 1, t: float = 1.0, **more: Any) -> State:
    """The state with the displacement above."""
    problem.u.interpolate(lambda x: displacement(x, t)[: problem.body.dim])
    return State(step, t, problem.u, **more)


def bend(problem: Problem) -> None:
    """A smooth displacement of a tenth of the body and a pressure, without symmetry."""
    dim = problem.body.dim

    def u(x: np.ndarray) -> np.ndarray:
        return 0.05 * np.array([x[0] * x[1], np.sin(x[1] + x[0]), x[0] ** 2 + x[1]])[:dim]

    if problem.mixed:
        problem.w.sub(1).interpolate(lambda x: 0.1 + 0.2 * x[0] - 0.3 * x[1])
    problem.u.interpolate(u)
    problem.unknowns.u_to_w()
    problem.w.x.scatter_forward()


def last(problem: Problem, **settings: Any) -> Any:
    """The state at the end of statics."""
    *_, state = Statics(problem, **settings).steps()
    return state
