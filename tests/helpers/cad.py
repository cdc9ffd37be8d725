"""Small CAD files, drawn with Gmsh."""

from __future__ import annotations

from collections.abc import Callable
from math import dist
from pathlib import Path
from typing import Any

from helpers.bodies import drawing
from mpi4py import MPI

from dolfin_elastic.core.parallel import on_root


def write(path: Path, draw: Callable[[Any], object], change: Callable[[str], str] | None = None):
    """Writes what `draw(occ)` draws, with the text of the file changed. Collective."""

    def action() -> None:
        with drawing() as gmsh:
            draw(gmsh.model.occ)
            gmsh.model.occ.synchronize()
            gmsh.write(str(path))
        if change is not None:
            path.write_text(change(path.read_text()))

    on_root(MPI.COMM_WORLD, action)


def block(occ: Any) -> None:
    """A part of 12 x 4 x 3."""
    occ.addBox(0, 0, 0, 12, 4, 3)


def angle(occ: Any, width: float = 6.0) -> None:
    """An angle of legs 20 and 16, 3 thick, with a fillet of radius 4 and a hole of radius 1.5."""
    occ.addBox(0, 0, 0, 20, width, 3, 1)
    occ.addBox(0, 0, 0, 3, width, 16, 2)
    occ.addCylinder(14, width / 2, -1, 0, 0, 5, 1.5, 3)
    (body,), _ = occ.fuse([(3, 1)], [(3, 2)], tag=4)
    occ.cut([body], [(3, 3)], tag=5)
    occ.synchronize()
    inner = (3.0, width / 2, 3.0)
    edges = [tag for _, tag in occ.getEntities(1)]
    (edge,) = [e for e in edges if dist(occ.getCenterOfMass(1, e), inner) < 1e-6]
    occ.fillet([5], [edge], [4.0])


def round_things(occ: Any) -> None:
    """A ball, a truncated cone, a torus and a shaft, apart from each other."""
    occ.addSphere(0, 0, 0, 2)
    occ.addCone(10, 0, 0, 0, 0, 3, 2, 1)
    occ.addTorus(20, 0, 0, 3, 1)
    occ.addCylinder(30, 0, 0, 0, 2, 0, 1)


def stack(occ: Any) -> None:
    """A block on another one, which is wider: faces that touch in part."""
    occ.addBox(0, 0, 0, 12, 4, 3)
    occ.addBox(2, 0, 3, 4, 4, 2)
