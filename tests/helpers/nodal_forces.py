"""Nodal forces of loads at a given displacement."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from dolfin_elastic import (
    Problem,
)
from dolfin_elastic.solvers.assembly.assembler import Assembler


def moved(problem: Problem, size: float, seed: int = 1) -> None:
    """A smooth displacement that is the same function of place on every rank."""
    x = problem.V.tabulate_dof_coordinates()[:, : problem.body.dim]
    k = np.random.default_rng(seed).uniform(1, 3, (problem.body.dim, problem.body.dim))
    problem.u.x.array[:] = size * np.sin(x @ k + seed).ravel()
    problem.unknowns.u_to_w()
    if problem.w is not problem.u:
        problem.w.sub(1).interpolate(lambda x: size * np.sin(seed * x[0] + x[1]))


def forces(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Places and applied forces of the nodes that this rank owns."""
    assembler = Assembler(problem)
    nodal = assembler.reactions.loads()[assembler.displacement_dofs].reshape(-1, problem.body.dim)
    assembler.destroy()
    return problem.V.tabulate_dof_coordinates()[: len(nodal), : problem.body.dim], nodal


def total(problem: Problem, values: np.ndarray) -> np.ndarray:
    return problem.body.comm.allreduce(values.sum(axis=0), op=MPI.SUM)
