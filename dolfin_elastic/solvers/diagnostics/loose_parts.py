"""Connected parts of a body, and the rigid motions that nothing resists."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.types import BoolArray
from dolfin_elastic.problem.connectivity import ConnectedBodies
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.diagnostics.rigid_body import rigid_motions
from dolfin_elastic.solvers.diagnostics.rigid_body_names import motions_in_words
from dolfin_elastic.solvers.linear.nullspace import null_combinations

FREE = 1e-10
"""Stiffness against a rigid motion, over that of the diagonal, which counts as none."""

MANY = 50
"""Number of parts above which none is checked: so many are fragments of a broken mesh, and each
costs six products with the tangent."""


@dataclass(frozen=True)
class LoosePart:
    """A part that can move as a rigid body.

    Attributes:
        motions: In words, for example "move along x".
        place: Its middle in the reference configuration [m].
        name: Materials or regions it is made of.
        whole: It is the whole body.
    """

    motions: tuple[str, ...]
    place: tuple[float, ...]
    name: str
    whole: bool


def find_loose_part(assembler: Assembler) -> LoosePart | None:
    """A part that can move rigidly without stiffness of the assembled tangent. Collective."""
    problem = assembler.problem
    if problem.cell is not None:  # its neighbours hold it
        return None
    bodies = ConnectedBodies(problem)
    if bodies.count > MANY:
        return None
    for k in range(bodies.count):
        inside = bodies.of_node == k
        if (found := _motions(assembler, inside)) is not None:
            words, place = found
            return LoosePart(tuple(words), place, _name(problem, inside), bodies.count == 1)
    return None


def _motions(assembler: Assembler, inside: BoolArray) -> tuple[list[str], tuple[float, ...]] | None:
    """Rigid motions of a part against which the tangent has no stiffness. Collective.

    Args:
        inside: Local nodes of the part, ghosts included.

    Returns:
        The motions in words, and the middle of the part [m]; None if there are none.
    """
    problem, comm = assembler.problem, assembler.comm
    dim, own = problem.body.dim, problem.V.dofmap.index_map.size_local
    inside = inside[:own]
    x = problem.places[:own, :dim]
    now = x + problem.u.x.array[: own * dim].reshape(-1, dim)
    mine = total(comm, np.array([inside.sum(), *x[inside].sum(axis=0), *now[inside].sum(axis=0)]))
    centre = mine[1 + dim :] / mine[0]
    radius = largest(comm, float(np.max(np.linalg.norm(now[inside] - centre, axis=1), initial=0.0)))
    modes = rigid_motions((now - centre) / (radius or 1.0)) * inside[:, None, None]
    if problem.geometry == "axisymmetric":
        modes = modes[:, :, 1:2]
    columns = np.zeros((assembler.size, modes.shape[-1]))
    columns[assembler.displacement_dofs] = modes.reshape(own * dim, modes.shape[-1])
    columns /= np.sqrt(total(comm, (columns**2).sum(axis=0)))
    null = null_combinations(assembler, columns, FREE)
    if not null.shape[1]:
        return None
    place = tuple(float(c) for c in mine[1 : 1 + dim] / mine[0])
    if problem.geometry == "axisymmetric":
        return ["move along y"], place
    return motions_in_words(null, centre, radius), place


def _name(problem: Problem, inside: BoolArray) -> str:
    """The named regions, or else the materials, of cells inside. Collective."""
    nodes, body = problem.V.dofmap.list, problem.body
    regions = {name: body.owned_cells(name) for name in sorted(body.regions)}
    materials = {part.name: part.cells for part in problem.regions}
    for groups, kind in ((regions, "region"), (materials, "material")):
        hit = []
        for name, cells in groups.items():
            within = inside[nodes[cells]].all(axis=1)
            some, all_ = total(body.comm, np.array([within.sum(), len(within)]))
            if some and some == all_:
                hit.append(name)
        if hit:
            return f"{kind}{'s' if len(hit) > 1 else ''} '{', '.join(hit)}'"
    return ""
