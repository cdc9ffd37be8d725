"""Where the exact stress is unbounded, so that its largest value grows with every refinement.

At a re-entrant edge, where a held part of the boundary ends, and under a force at a point or along
a line the stress of linear elasticity grows without bound: r^(lambda - 1) at an edge, lambda < 1.
Such edges are found by the interior angle beta between the two boundary facets at an edge (in the
plane at a vertex):

    both free or both held alike     beta > 180 degrees
    held in all directions and free  sin(beta)^2 > 1 - nu, or beta > 90 degrees
    held in some directions beside   2 beta > 180 degrees: the body and its mirror image, as at the
    free or held in all              end of a plane of symmetry

Angles that exceed the limit by less than a margin are not counted: facets of a round surface meet
at angles, too, and the stress there hardly grows.

Source: M. L. Williams, J. Appl. Mech. 19 (1952) 526: lambda = 1 in sin(lambda beta)^2 =
((kappa + 1)^2 - 4 lambda^2 sin(beta)^2)/(4 kappa) for a wedge with one clamped side, and kappa =
3 - 4 nu in plane strain, (3 - nu)/(1 + nu) in plane stress.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem, la

from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray
from dolfin_elastic.mesh.body import cell_size
from dolfin_elastic.mesh.geometry.curved import cell_gradients
from dolfin_elastic.mesh.geometry.simplices import boundary_facets, cells_beside_facets
from dolfin_elastic.model.supports.displacement import PrescribingSupport, Restraint
from dolfin_elastic.model.supports.rigid_surface import Rigid
from dolfin_elastic.problem.material_regions import poisson
from dolfin_elastic.results.recovery.patches import cell_edges

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem

_MARGIN = np.deg2rad(30.0)
"""Angle above 180 degrees, or 90 with a mirror image, up to which an edge counts as smooth."""
_MARGIN_HELD = np.deg2rad(5.0)
"""The same of the limit between clamped and free."""
RE_ENTRANT = "a re-entrant edge"
FORCE = "a force at a point or along a line"
_NORMAL_BIT = 8


@dataclass(frozen=True)
class SingularPlaces:
    """Owned nodes at singular places, and in the cells that touch them.

    Attributes:
        reasons: What is singular.
        near: Whether a node is in a cell that touches such a place, shape (nodes, reasons).
    """

    reasons: tuple[str, ...]
    near: BoolArray

    @property
    def anywhere(self) -> BoolArray:
        """Nodes near any of them, shape (nodes,)."""
        return np.asarray(self.near.any(axis=1))

    def widened(self, V: fem.FunctionSpace) -> BoolArray:
        """Nodes in cells that have a node near any of them, shape (nodes,). Collective."""
        work = la.vector(V.dofmap.index_map, 1)
        work.array[: len(self.near)] = self.anywhere
        work.scatter_forward()
        return np.asarray(_with_neighbours(V, work.array[:, None])[:, 0])

    def reason(self, node: int) -> str:
        """What is singular near an owned node; empty if nothing is."""
        found = np.flatnonzero(self.near[node])
        return self.reasons[found[0]] if len(found) else ""


def singular_places(problem: Problem) -> SingularPlaces:
    """Finds them by the mesh, the supports and the present point and line forces. Collective."""
    held = [s for s in problem.supports if isinstance(s, PrescribingSupport | Rigid)]
    labels = list(dict.fromkeys(s.label for s in held))
    reasons = [FORCE, RE_ENTRANT, *(f"the rim of the support '{label}'" for label in labels)]
    sums, ridge_dim = _sums_at_ridges(problem, held, labels)
    singular = _classify(sums, problem, len(labels))
    V = problem.V
    marks = la.vector(V.dofmap.index_map, len(reasons))
    table = marks.array.reshape(-1, len(reasons))
    for column in range(singular.shape[1]):
        found = np.flatnonzero(singular[:, column]).astype(np.int32)
        nodes = fem.locate_dofs_topological(V, ridge_dim, found)
        table[nodes, 1 + column] = 1.0
    for column, label in enumerate(labels):
        names = [n for s in held if s.label == label for n in s.surfaces]
        table[_nodes_of_edges_and_points(problem, names), 2 + column] = 1.0
    if problem.nodal_loads is not None:
        forces = problem.nodal_loads.nodal().reshape(len(table), -1)
        table[:, 0] = np.abs(forces).max(axis=1, initial=0.0) > 0
    marks.scatter_reverse(la.InsertMode.add)
    marks.scatter_forward()
    return SingularPlaces(tuple(reasons), _with_neighbours(V, table))


def _with_neighbours(V: fem.FunctionSpace, table: FloatArray) -> BoolArray:
    """Owned nodes in cells that have a marked node, shape of the table. Collective."""
    cells = V.mesh.topology.index_map(V.mesh.topology.dim).size_local
    nodes = V.dofmap.list[:cells]
    touched = (table[nodes] > 0).any(axis=1)
    work = la.vector(V.dofmap.index_map, table.shape[1])
    near = work.array.reshape(table.shape)
    for column in range(table.shape[1]):
        near[nodes[touched[:, column]].reshape(-1), column] = 1.0
    work.scatter_reverse(la.InsertMode.add)
    return np.asarray(near[: V.dofmap.index_map.size_local] > 0)


def _nodes_of_edges_and_points(problem: Problem, names: Sequence[str]) -> IndexArray:
    """Nodes of the parts of some names that are edges or points. Collective."""
    body, V = problem.body, problem.V
    found: list[IndexArray] = [np.empty(0, dtype=np.int32)]
    for name in names:
        kinds = body.kinds(name)
        if "surface" in kinds:
            continue
        if "edge" in kinds:
            found.append(fem.locate_dofs_topological(V, 1, body.edges[name]))
        if "point" in kinds:
            found.append(_nearest_nodes(problem, body.points[name]))
    return np.unique(np.concatenate(found)).astype(np.int32)


def _nearest_nodes(problem: Problem, points: IndexArray) -> IndexArray:
    """Local nodes of the space at nodes of the geometry. Not collective."""
    if not len(points):
        return np.empty(0, dtype=np.int32)
    x, places = problem.V.tabulate_dof_coordinates(), problem.body.mesh.geometry.x[points]
    found = [int(np.argmin(np.sum((x - place) ** 2, axis=1))) for place in places]
    return np.array(found, dtype=np.int32)


# --- edges of the boundary ---


def _sums_at_ridges(
    problem: Problem, held: Sequence[Restraint], labels: Sequence[str]
) -> tuple[FloatArray, int]:
    """Sums over the boundary facets at each edge (vertex in the plane). Collective.

    Returns:
        Of each local edge the sums of outward normals (3), of directions into the facets (3), of 1,
        of facets that are held in all and in some directions, of Poisson's ratio, and of facets of
        each support; and the dimension of the edges.
    """
    body, mesh = problem.body, problem.body.mesh
    dim = mesh.topology.dim
    facets = boundary_facets(mesh)
    mesh.topology.create_entities(dim - 2)
    for pair in ((dim, dim - 2), (dim - 2, dim)):
        mesh.topology.create_connectivity(*pair)
    cells, local = cells_beside_facets(mesh, facets)
    facts = np.column_stack(
        [np.ones(len(facets)), *_held(problem, held, labels, facets), _nu(problem, cells)]
    )
    index_map = mesh.topology.index_map(dim - 2)
    work = la.vector(index_map, 6 + facts.shape[1])
    table = work.array.reshape(-1, 6 + facts.shape[1])
    around = mesh.topology.connectivity(dim, dim - 2).array.reshape(len(mesh.geometry.dofmap), -1)
    numbers = {(int(a), int(b)): i for i, (a, b) in enumerate(cell_edges(dim))}
    for facet in range(dim + 1):
        rows = np.flatnonzero(local == facet)
        nodes = mesh.geometry.x[mesh.geometry.dofmap[cells[rows]], :dim]
        corners = [k for k in range(dim + 1) if k != facet]
        for ridge in combinations(corners, dim - 1):
            other = next(k for k in corners if k not in ridge)
            frames = _frames(nodes, mesh.geometry.cmap.degree, facet, ridge, other)
            number = numbers[ridge[0], ridge[-1]] if dim == 3 else ridge[0]
            np.add.at(
                table, around[cells[rows], number], np.concatenate([frames, facts[rows]], axis=1)
            )
    work.scatter_reverse(la.InsertMode.add)
    work.scatter_forward()
    assert body.dim == dim
    return np.asarray(table), dim - 2


def _frames(
    nodes: FloatArray, degree: int, facet: int, ridge: tuple[int, ...], other: int
) -> FloatArray:
    """Outward normal and direction into the facet at the middle of an edge of cells.

    Args:
        nodes: Geometry nodes of the cells, shape (cells, nodes, dim).
        degree: Of the geometry.
        facet: Local facet.
        ridge: Corners of one of its edges; in the plane one corner.
        other: Its other corner.

    Returns:
        Shape (cells, 6).
    """
    dim = nodes.shape[2]
    corners = np.concatenate([np.zeros((1, dim)), np.eye(dim)])
    middle = corners[list(ridge)].mean(axis=0)
    J = cell_gradients(nodes, degree, middle[None])[:, 0]
    outward = np.ones(dim) if facet == 0 else -np.eye(dim)[facet - 1]
    n = np.einsum("cji,j->ci", np.linalg.inv(J), outward)
    inward = J @ (corners[other] - middle)
    if dim == 3:
        along = J @ (corners[ridge[1]] - corners[ridge[0]])
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        inward -= np.sum(inward * along, axis=1, keepdims=True) * along
    found = np.zeros((len(nodes), 6))
    found[:, :dim] = n / np.linalg.norm(n, axis=1, keepdims=True)
    found[:, 3 : 3 + dim] = inward / np.linalg.norm(inward, axis=1, keepdims=True)
    return found


def _held(
    problem: Problem, held: Sequence[Restraint], labels: Sequence[str], facets: IndexArray
) -> list[FloatArray]:
    """For boundary facets: held in all directions, in some, and by each support; 0 or 1."""
    body, dim = problem.body, problem.body.dim
    bits = np.zeros(len(facets), dtype=np.int64)
    by = np.zeros((len(labels), len(facets)))
    for support in held:
        which = range(dim)
        if isinstance(support, PrescribingSupport):
            which = support.prescribed_components(dim)  # type: ignore[assignment]
        mask = sum(_NORMAL_BIT if i < 0 else 1 << i for i in set(which))
        for name in support.surfaces:
            if name in body.surfaces:
                chosen = np.isin(facets, body.surfaces[name])
                bits[chosen] |= mask
                by[labels.index(support.label), chosen] = 1.0
    if problem.geometry == "axisymmetric":
        mesh = body.mesh
        mesh.topology.create_connectivity(dim - 1, 0)
        corners = fem.functionspace(mesh, ("Lagrange", 1)).tabulate_dof_coordinates()
        off = 1e-9 * cell_size(body)
        on_axis = np.flatnonzero(corners[:, 0] < off)
        cells, local = cells_beside_facets(mesh, facets)
        nodes = fem.functionspace(mesh, ("Lagrange", 1)).dofmap.list[cells]
        opposite = np.arange(dim + 1)[None] == local[:, None]
        bits[(np.isin(nodes, on_axis) | opposite).all(axis=1)] |= 1
    every = (1 << dim) - 1
    whole = (bits & every) == every
    return [whole.astype(float), ((bits > 0) & ~whole).astype(float), *by]


def _nu(problem: Problem, cells: IndexArray) -> FloatArray:
    """Poisson's ratio in cells."""
    found = np.zeros(len(problem.body.owned_cells()))
    for region in problem.regions:
        found[region.cells] = min(max(poisson(region.typical), 0.0), 0.5)
    # A boundary facet belongs to the rank of its cell.
    return np.asarray(found[np.minimum(cells, len(found) - 1)]) if len(found) else np.zeros(0)


def _classify(sums: FloatArray, problem: Problem, labels: int) -> BoolArray:
    """Which edges are re-entrant, and which are the rim of each support; see the module.

    Args:
        sums: See `_sums_at_ridges`.
        problem: The problem that is solved.
        labels: Number of supports.

    Returns:
        Shape (edges, 1 + supports).
    """
    normal, inward, (count, whole, some) = sums[:, :3], sums[:, 3:6], sums[:, 6:9].T
    by, nu = sums[:, 9 : 9 + labels], sums[:, -1] / 2
    edge = np.abs(count - 2) < 0.5
    # Of unit vectors a, b: |a + b|^2 = 2 + 2 a.b; seen from outside, a re-entrant edge is a valley.
    cosine = np.clip(np.sum(inward**2, axis=1) / 2 - 1, -1.0, 1.0)
    angle = np.arccos(cosine)
    valley = np.sum(normal * inward, axis=1) > 0
    angle = np.where(valley, 2 * np.pi - angle, angle)
    free = count - whole - some
    alike = (np.abs(whole - 2) < 0.5) | (np.abs(some - 2) < 0.5) | (np.abs(free - 2) < 0.5)
    clamped = ~alike & (np.abs(some) < 0.5)
    kappa = (3 - nu) / (1 + nu) if problem.geometry == "plane-stress" else 3 - 4 * nu
    limit = np.arcsin(np.sqrt(np.clip((kappa + 1) / 4, 0.0, 1.0)))
    corner = edge & alike & (angle > np.pi + _MARGIN)
    rim = edge & np.where(
        clamped, angle > limit + _MARGIN_HELD, ~alike & (angle > np.pi / 2 + _MARGIN)
    )
    return np.column_stack([corner, *(rim & (by[:, i] > 0.5) for i in range(labels))])
