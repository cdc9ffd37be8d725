"""Small CAD files, drawn with Gmsh."""

from __future__ import annotations

from collections.abc import Callable
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


def stack(occ: Any) -> None:
    """A block on another one, which is wider: faces that touch in part."""
    occ.addBox(0, 0, 0, 12, 4, 3)
    occ.addBox(2, 0, 3, 4, 4, 2)
