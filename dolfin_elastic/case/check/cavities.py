"""Whether cavities are closed, found from the mesh and the supports alone.

A virtual displacement v of the rim (the edges that bound a cavity's surfaces) changes the volume
by 1/d times the integral along the rim of v . (dx x (x - o)), o the cavity's origin, d the
dimension; in a plane the rim consists of two end points of a curve.  A cavity is closed if this
vanishes for every v that the supports admit: it has no rim, or its rim lies in planes of symmetry
through the origin.

Source: Stokes' theorem on the volume of `model.loads.cavity`.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray
from dolfin_elastic.model.loads import Cavity
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.terms.pressure_symmetry import boundary_edges

_ROUND_OFF = 1e-6
"""Volume per displacement that is none, over that of an edge across the cavity."""


def cavity_notes(problem: Problem) -> Iterator[str]:
    """Open cavities whose pressure is prescribed: they have no volume to report. Collective.

    Raises:
        InputError: An open cavity whose volume is prescribed.
    """
    for index, load in enumerate(problem.loads):
        if not isinstance(load, Cavity) or not _open(load, problem):
            continue
        reason = (
            f"the cavity '{load.label}' is open: a part of its edge is not constrained to a plane "
            "through its origin"
        )
        if load.volume_controlled:
            raise InputError(
                reason,
                where=f"load[{index}].on",
                expected="all surfaces around it, supports in planes of symmetry, and an origin "
                "in all of them",
            )
        yield f"load[{index}].on: {reason}, so its volume is not reported"


def _open(load: Cavity, problem: Problem) -> bool:
    """Whether an admissible displacement of the rim changes the volume. Collective.

    Never true of skew supports and periodic cells, whose constraints couple components: their
    rims are not judged.
    """
    body, dim = problem.body, problem.body.dim
    if problem.constraints.skewed or problem.cell is not None:
        return False
    origin = np.array(load.origin or (0.0,) * dim)
    held = np.zeros(len(problem.constraints.values.x.array), dtype=bool)
    held[problem.constraints.dofs] = True
    axisymmetric, open_edges = problem.geometry == "axisymmetric", 0
    for edge in boundary_edges(body, load.parts):
        points, nodes = _edge_nodes(problem, int(edge))
        free = ~held.reshape(-1, dim)[points].all(axis=0)
        flux = _changes_volume(body.mesh.geometry.x[nodes, :dim], origin, axisymmetric)
        open_edges += bool(flux[free].any())
    return bool(total(body.comm, open_edges))


def _edge_nodes(problem: Problem, edge: int) -> tuple[IndexArray, IndexArray]:
    """Dofs of the displacement on an edge (in a plane: a point), and mesh nodes at its ends."""
    mesh, dim = problem.body.mesh, problem.body.dim
    mesh.topology.create_connectivity(dim - 2, dim)
    mesh.topology.create_connectivity(dim, dim - 2)
    cell = mesh.topology.connectivity(dim - 2, dim).links(edge)[0]
    local = int(np.flatnonzero(mesh.topology.connectivity(dim, dim - 2).links(cell) == edge)[0])
    V, layout = problem.V.dofmap, mesh.geometry.cmap.create_dof_layout()
    points = V.cell_dofs(cell)[V.dof_layout.entity_closure_dofs(dim - 2, local)]
    corners = layout.entity_closure_dofs(dim - 2, local)[: dim - 1]
    return points, mesh.geometry.dofmap[cell][corners]


def _changes_volume(x: FloatArray, origin: FloatArray, axisymmetric: bool) -> BoolArray:
    """Components in which a virtual displacement of an edge changes the volume, shape (dim,).

    Args:
        x: Undeformed ends of the edge, shape (dim - 1, dim) [m].
        origin: Of the cavity, shape (dim,) [m].
        axisymmetric: The body is swept round the axis x = 0.
    """
    arm, size = x[0] - origin, float(np.abs(x - origin).max())
    if len(origin) == 2:
        flux = np.array([-arm[1], arm[0]]) * (x[0, 0] if axisymmetric else 1.0)
        size *= abs(x[0, 0]) if axisymmetric else 1.0
    else:
        flux = np.cross(x[1] - x[0], arm)
        size *= float(np.linalg.norm(x[1] - x[0]))
    return np.asarray(np.abs(flux) > _ROUND_OFF * size)
