"""Meshes of tests: from Gmsh, from plain arrays, and rotated."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from dolfin_elastic import (
    Selector,
    name_parts,
)
from dolfin_elastic.mesh import (
    Body,
)
from dolfin_elastic.mesh.distribute import make_mesh


@contextmanager
def drawing() -> Iterator[Any]:
    """An initialised Gmsh, finalised also after an error."""
    import gmsh

    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    try:
        yield gmsh
    finally:
        gmsh.finalize()


def ball(path: Path) -> None:
    """An eighth of the unit ball with curved quadratic cells."""
    with drawing() as gmsh:
        gmsh.model.occ.addSphere(0, 0, 0, 1, angle1=0, angle2=np.pi / 2, angle3=np.pi / 2)
        gmsh.model.occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.35)
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(2)
        gmsh.write(str(path))
        gmsh.option.setNumber("Mesh.SaveAll", 1)
        gmsh.write(str(path.with_suffix(".inp")))


def soft_and_hard(body: Body, at: float) -> Body:
    """The same body with the regions "soft" and "hard": cells left and right of x = at."""
    middle = body.mesh.geometry.x[body.mesh.geometry.dofmap].mean(axis=1)[:, 0]
    sides = {"soft": middle < at, "hard": middle > at}
    return body.named(regions={n: np.flatnonzero(m).astype(np.int32) for n, m in sides.items()})


def turned(body: Any, axis: Any, angle: float) -> np.ndarray:
    """Turns a body's mesh about the origin; returns the rotation."""
    n = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    K = np.array([[0, -n[2], n[1]], [n[2], 0, -n[0]], [-n[1], n[0], 0]])
    R = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    body.mesh.geometry.x[:] = body.mesh.geometry.x @ R.T
    return R


def made(comm: MPI.Comm, cells: Any, points: Any, order: int = 1) -> Body:
    """A body of plain arrays; the surface `all` is its whole boundary."""
    cells, points = np.array(cells, dtype=np.int64), np.array(points, dtype=np.float64)
    if comm.rank:
        cells, points = cells[:0], points[:0]
    return name_parts(
        Body(make_mesh(comm, cells, points, order)), surfaces={"all": Selector(all=True)}
    )
