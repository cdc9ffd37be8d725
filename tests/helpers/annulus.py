"""A quarter of an annulus under pressure: its mesh, its solution and a radial displacement."""

from __future__ import annotations

from typing import Any

import numpy as np
from helpers.bodies import made
from mpi4py import MPI

from dolfin_elastic import (
    Problem,
    Selector,
    Statics,
    name_parts,
)
from dolfin_elastic.mesh import Body

FREE = "free"


def annulus(comm: MPI.Comm, n: int) -> Body:
    """Quarter of an annulus, radii 1 and 2, of quadratic triangles that follow the arcs."""
    side = np.arange(2 * n + 1)
    r, phi = np.meshgrid(1 + side / (2 * n), side / (2 * n) * np.pi / 2, indexing="ij")
    points = np.stack([r * np.cos(phi), r * np.sin(phi)], axis=-1).reshape(-1, 2)
    m = 2 * n + 1
    cells = []
    for i in range(0, 2 * n, 2):
        for j in range(0, 2 * n, 2):
            for corners in (
                ((i, j), (i + 2, j), (i + 2, j + 2)),
                ((i, j), (i + 2, j + 2), (i, j + 2)),
            ):
                a, b, c = (np.array(corner) for corner in corners)
                places = [a, b, c, (b + c) // 2, (a + c) // 2, (a + b) // 2]
                cells.append([p[0] * m + p[1] for p in places])
    body = made(comm, cells, points, 2)
    return name_parts(
        body,
        surfaces={
            "x0": Selector(plane="x", at=0),
            "y0": Selector(plane="y", at=0),
            "inside": Selector(sphere={"center": [0, 0], "radius": 1}),
        },
    )


def solved(problem: Problem, steps: int = 4) -> Any:
    *_, state = Statics(problem, steps=steps).steps()
    return state


def radial(problem: Problem, radius: float) -> float:
    """Displacement on the x axis at a radius."""
    x = problem.V.tabulate_dof_coordinates()
    near = np.flatnonzero(np.linalg.norm(x - [radius, 0, 0], axis=1) < 1e-9)
    mine = problem.u.x.array[problem.body.dim * near[0]] if len(near) else -np.inf
    return problem.body.comm.allreduce(float(mine), op=MPI.MAX)
