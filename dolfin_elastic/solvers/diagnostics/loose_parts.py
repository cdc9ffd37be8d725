"""Connected parts of a body, and the rigid motions that nothing resists."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from dolfinx import la
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.types import BoolArray, IntArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.diagnostics.rigid_body import rigid_motions
from dolfin_elastic.solvers.diagnostics.rigid_body_names import motions_in_words
from dolfin_elastic.solvers.linear.nullspace import null_combinations

FREE = 1e-10
"""Stiffness against a rigid motion, over that of the diagonal, which counts as none."""


@dataclass(frozen=True)
class LoosePart:
    """A piece that can move as a rigid body.

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


def connected_parts(problem: Problem) -> IntArray:
    """Number of the piece each local node (ghosts included) belongs to. Collective.

    A rank finds the pieces of its own cells; the nodes it shares with others say which of them
    are one.  Only these links go from rank to rank.
    """
    nodes, V = problem.V.dofmap.list[problem.body.owned_cells()], problem.V
    own, count = V.dofmap.index_map.size_local, len(problem.u.x.array) // problem.body.dim
    first = np.repeat(nodes[:, :1], nodes.shape[1], axis=1).ravel()
    graph = coo_array((np.ones(nodes.size), (first, nodes.ravel())), shape=(count, count))
    _, mine = connected_components(graph, directed=False)
    comm = problem.body.comm
    counts = comm.allgather(int(mine.max(initial=-1)) + 1)
    label = la.vector(V.dofmap.index_map, 1, np.int64)
    label.array[:] = mine + sum(counts[: comm.rank])
    before = label.array.copy()
    label.scatter_forward()
    pairs = np.unique(np.stack([before[own:], label.array[own:]], axis=1), axis=0)
    links = np.concatenate(comm.allgather(pairs))
    size = sum(counts)
    table = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(size, size))
    _, joined = connected_components(table, directed=False)
    _, joined = np.unique(joined, return_inverse=True)
    return np.asarray(joined[before], dtype=np.int64)


def find_loose_part(assembler: Assembler) -> LoosePart | None:
    """A piece that the tangent, as it is assembled, does not hold. Collective."""
    problem = assembler.problem
    if problem.cell is not None:  # its neighbours hold it
        return None
    number = connected_parts(problem)
    count = int(largest(problem.body.comm, float(number.max(initial=-1)))) + 1
    if count > 50:  # dust of a broken mesh; each costs six products
        return None
    for piece in range(count):
        if (found := _motions(assembler, number == piece)) is not None:
            words, place = found
            name = _name(problem, number == piece)
            return LoosePart(tuple(words), place, name, count == 1)
    return None


def _motions(assembler: Assembler, inside: BoolArray) -> tuple[list[str], tuple[float, ...]] | None:
    """Rigid motions of some nodes against which the tangent has no stiffness. Collective."""
    problem, comm = assembler.problem, assembler.comm
    dim, own = problem.body.dim, problem.V.dofmap.index_map.size_local
    inside = inside[:own]
    x = problem.V.tabulate_dof_coordinates()[:own, :dim]
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
