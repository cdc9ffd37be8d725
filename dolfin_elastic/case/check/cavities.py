"""Whether cavities are closed, told from the mesh and the supports alone.

With the origin o the change of the enclosed volume along the rim of its surfaces is 1/d times the
integral of v . (dx x (x - o)), in a plane the same of its end points.  A cavity is closed where
this vanishes for all free v: no rim, or one in planes of symmetry through the origin.

Source: Stokes' theorem on the volume of `model.loads.cavity`.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dolfin_elastic.case.case import Case
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray
from dolfin_elastic.model.loads import Cavity
from dolfin_elastic.problem.loads.pressure_symmetry import rim
from dolfin_elastic.problem.problem import Problem

_ROUND_OFF = 1e-6


def cavity_notes(case: Case, problem: Problem) -> Iterator[str]:
    """Cavities whose pressure is given although they have no volume. Collective.

    Raises:
        InputError: One is open though its volume is prescribed.
    """
    for index, load in enumerate(case.load):
        if not isinstance(load, Cavity) or not _open(load, problem):
            continue
        said = (
            f"the cavity '{load.label}' is open: a part of its rim is not held in a plane through "
            "its origin"
        )
        if load.controlled:
            raise InputError(
                said,
                where=f"load[{index}].on",
                expected="all surfaces around it, supports in planes of symmetry, and an origin "
                "in all of them",
            )
        yield f"load[{index}].on: {said}, so its volume is not told"


def _open(load: Cavity, problem: Problem) -> bool:
    """Whether its rim can carry volume away; not told of oblique supports. Collective."""
    body, dim = problem.body, problem.body.dim
    if problem.dirichlet.tilted is not None or problem.cell is not None:
        return False
    origin = np.zeros(dim)
    origin[: len(load.middle)] = [float(x or 0.0) for x in load.middle]  # type: ignore[arg-type]
    held = np.zeros(len(problem.dirichlet.values.x.array), dtype=bool)
    held[problem.dirichlet.dofs] = True
    turned, lost = problem.geometry == "axisymmetric", 0
    for edge in rim(body, load.parts):
        points, nodes = _ends(problem, int(edge))
        free = ~held.reshape(-1, dim)[points].all(axis=0)
        lost += bool(_flux(body.mesh.geometry.x[nodes, :dim], origin, turned)[free].any())
    return bool(total(body.comm, lost))


def _ends(problem: Problem, edge: int) -> tuple[IndexArray, IndexArray]:
    """Nodes of the displacement on an edge (in a plane: a point), and of the mesh at its ends."""
    mesh, dim = problem.body.mesh, problem.body.dim
    mesh.topology.create_connectivity(dim - 2, dim)
    mesh.topology.create_connectivity(dim, dim - 2)
    cell = mesh.topology.connectivity(dim - 2, dim).links(edge)[0]
    local = int(np.flatnonzero(mesh.topology.connectivity(dim, dim - 2).links(cell) == edge)[0])
    V, layout = problem.V.dofmap, mesh.geometry.cmap.create_dof_layout()
    points = V.cell_dofs(cell)[V.dof_layout.entity_closure_dofs(dim - 2, local)]
    corners = layout.entity_closure_dofs(dim - 2, local)[: dim - 1]
    return points, mesh.geometry.dofmap[cell][corners]


def _flux(x: FloatArray, origin: FloatArray, turned: bool) -> BoolArray:
    """Components in which a virtual displacement of an edge changes the volume."""
    arm, size = x[0] - origin, float(np.abs(x - origin).max())
    if len(origin) == 2:
        flux = np.array([-arm[1], arm[0]]) * (x[0, 0] if turned else 1.0)
        size *= abs(x[0, 0]) if turned else 1.0
    else:
        flux = np.cross(x[1] - x[0], arm)
        size *= float(np.linalg.norm(x[1] - x[0]))
    return np.asarray(np.abs(flux) > _ROUND_OFF * size)
