"""Bodies in motion whose frequencies and momenta are known, and their displacements in time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from mpi4py import MPI

from dolfin_elastic import (
    Dynamics,
    LinearElastic,
    NeoHookean,
    Problem,
    Selector,
    Support,
    box_body,
    name_parts,
)
from dolfin_elastic.mesh import Body
from dolfin_elastic.mesh.distribute import make_mesh

FREE = "free"
E, NU, RHO = 1e7, 0.3, 1000.0
STIFF = E * (1 - NU) / ((1 + NU) * (1 - 2 * NU))
"""lmbda + 2 mu."""


def oscillator(viscosity: float | None = None, **more: Any) -> Problem:
    """A triangle whose only free component is u_x at (1, 0).

    k = (lmbda + 2 mu)/2, consistent mass rho A/6 = rho/12.
    """
    comm = MPI.COMM_WORLD
    root = comm.rank == 0
    cells = np.array([[0, 1, 2]] if root else np.empty((0, 3)), dtype=np.int64)
    corners = np.array([[0.0, 0], [1, 0], [0, 1]]) if root else np.empty((0, 2))
    body = name_parts(
        Body(make_mesh(comm, cells, corners, 1)),
        surfaces={"left": Selector(plane="x", at=0), "bottom": Selector(plane="y", at=0)},
    )
    return Problem(
        body,
        LinearElastic(E=E, nu=NU, density=RHO, viscosity=viscosity),
        supports=[
            Support(on="bottom", displacement=[FREE, 0]),
            Support(on="left", displacement=[0, 0]),
        ],
        **{"degree": 1, **more},
    )


OMEGA = np.sqrt(6 * STIFF / RHO)
PERIOD = 2 * np.pi / OMEGA


def value_at(problem: Problem, array: np.ndarray, place: tuple[float, ...]) -> np.ndarray:
    dim, x = problem.body.dim, problem.V.tabulate_dof_coordinates()
    near = np.flatnonzero(np.linalg.norm(x[:, :dim] - np.array(place), axis=1) < 1e-9)
    found = array.reshape(-1, dim)[near[0]].copy() if len(near) else None
    return next(v for v in problem.body.comm.allgather(found) if v is not None)


def tip(problem: Problem, state: Any) -> tuple[float, float]:
    return (
        value_at(problem, state.u.x.array, (1.0, 0.0))[0],
        value_at(problem, state.v.x.array, (1.0, 0.0))[0],
    )


def swing(dt: float, end: float, **more: Any) -> np.ndarray:
    """Rows t, u, v of the oscillator, from u = 1e-3 and v = 0."""
    problem = oscillator()
    rows = []
    for state in Dynamics(
        problem, end=end, dt=dt, rtol=1e-12, initial_displacement=["1e-3*x", 0], **more
    ).steps():
        rows.append((state.t, *tip(problem, state)))
    return np.array(rows)


BRICK = {"size": (1.0, 0.6, 0.3), "cells": (3, 2, 1)}
CENTRE, SPIN, DRIFT = np.array([0.5, 0.3, 0.15]), np.array([3.0, -2, 5]), np.array([1.0, 2, -0.5])


def brick(**law: Any) -> tuple[Problem, dict[str, Any]]:
    """A neo-Hookean brick thrown with a spin."""
    problem = Problem(box_body(**BRICK), NeoHookean(E=1e5, nu=NU, density=RHO, **law), degree=1)
    x = ["x - 0.5", "y - 0.3", "z - 0.15"]
    velocity = [
        f"{DRIFT[i]} + ({SPIN[j]})*({x[k]}) - ({SPIN[k]})*({x[j]})"
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    ]
    return problem, {"initial_velocity": velocity}


def drift(values: Mapping[int, np.ndarray] | list[np.ndarray]) -> float:
    """Largest change of a vector against its first value."""
    rows = np.array(values)
    return float(np.abs(rows - rows[0]).max() / np.abs(rows[0]).max())
