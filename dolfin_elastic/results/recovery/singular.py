"""Where the exact stress is unbounded, so that its largest value grows with every refinement.

At a re-entrant edge, where a held part of the boundary ends, where materials meet, and under a
force at a point or along a line the stress of linear elasticity grows without bound: r^(lambda - 1)
at an edge, lambda < 1.  Edges of the boundary are found by the interior angle beta between the two
boundary facets there (in the plane at a vertex):

    both free or both held alike     beta > 180 degrees
    held in all directions and free  sin(beta)^2 > 1 - nu, or beta > 90 degrees
    held in some directions beside   2 beta > 180 degrees: the body and its mirror image, as at the
    free or held in all              end of a plane of symmetry

Held are surfaces whose displacement is prescribed, those on springs that are stiffer than a layer
of cells, which act as supports do on this mesh, and along the normal those that press an obstacle.
The edge of a contact is not singular where the surface is smooth and might touch further on, as
with Hertz: the pressure ends at zero.  Softer springs make a traction that jumps at their edge;
that leaves the stress bounded, or lets it grow like a logarithm.  Materials: see
`material_corners`.

Whether an edge of a facet is one of the body at all, or lies within a round face, is told by
`BoundaryShape`: exactly where the mesh was made of a CAD file.  Elsewhere angles that exceed a
limit by less than a margin are not counted, for facets of a round surface meet at angles, too.

Source: M. L. Williams, J. Appl. Mech. 19 (1952) 526: lambda = 1 in sin(lambda beta)^2 =
((kappa + 1)^2 - 4 lambda^2 sin(beta)^2)/(4 kappa) for a wedge with one clamped side, and kappa =
3 - 4 nu in plane strain, (3 - nu)/(1 + nu) in plane stress.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem, la

from dolfin_elastic.core.ghosts import summed, with_ghosts
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray
from dolfin_elastic.mesh.body import boundary_shape, cell_size
from dolfin_elastic.mesh.geometry.boundary_shape import EDGE
from dolfin_elastic.mesh.geometry.curved import facet_areas
from dolfin_elastic.mesh.geometry.ridges import Ridges
from dolfin_elastic.mesh.geometry.simplices import cells_beside_facets, dofs_on_facets
from dolfin_elastic.model.supports.displacement import PrescribingSupport, Restraint
from dolfin_elastic.model.supports.rigid_surface import Rigid
from dolfin_elastic.model.supports.springs import Spring
from dolfin_elastic.problem.material_regions import poisson, young
from dolfin_elastic.problem.terms.contact.pair import ContactPair
from dolfin_elastic.results.recovery.interfaces import angles_at_interfaces, material_corners

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem

_MARGIN = np.deg2rad(30.0)
"""Angle above 90 degrees up to which an edge with a mirror image counts as smooth."""
_MARGIN_HELD = np.deg2rad(5.0)
"""The same margin for an edge between a clamped and a free facet."""
RE_ENTRANT = "a re-entrant edge"
FORCE = "a force at a point or along a line"
INTERFACE = "an edge where materials meet"
_NORMAL_BIT = 8
_ROUND_OFF = 1e-9
"""Force at a node over the largest one up to which it is none: a point at a vertex loads that."""


@dataclass(frozen=True)
class SingularPlaces:
    """Owned nodes at singular places, and in the cells that touch them.

    Attributes:
        reasons: Causes of a singular stress.
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
        anywhere = with_ghosts(V.dofmap.index_map, self.anywhere[:, None])
        return np.asarray(_with_neighbours(V, anywhere)[:, 0])

    def reason(self, node: int) -> str:
        """Why the stress is singular near an owned node; empty if it is not."""
        near = np.flatnonzero(self.near[node])
        return self.reasons[near[0]] if len(near) else ""


def singular_places(problem: Problem) -> SingularPlaces:
    """Finds them by the mesh, the supports, the present forces and contacts. Collective."""
    held = [s for s in problem.supports if isinstance(s, PrescribingSupport | Rigid | Spring)]
    labels = list(dict.fromkeys(s.label for s in held))
    pairs = problem.contact_pairs
    reasons = [
        FORCE,
        INTERFACE,
        RE_ENTRANT,
        *(f"the edge of the support '{label}'" for label in labels),
        *(f"the edge of the contact '{pair.label}'" for pair in pairs),
    ]
    cells, numbers, values = zip(
        _at_surface(problem, held, labels), *angles_at_interfaces(problem), strict=True
    )
    ridges = Ridges(problem.body.mesh, np.concatenate(cells), np.concatenate(numbers))
    ends = np.cumsum([0, *(len(rows) for rows in values)])
    sums, *angles = (
        ridges.sums(slice(ends[i], ends[i + 1]), rows) for i, rows in enumerate(values)
    )
    (count, whole, some) = sums[:, 3:6].T
    singular = np.zeros((ridges.count, 2 + len(labels) + len(pairs)), dtype=bool)
    singular[:, 0] = material_corners(problem, np.column_stack(angles), count, whole, some)
    outside = np.flatnonzero(count > 0)
    singular[outside, 1:] = _classify(sums[outside], problem, (len(labels), len(pairs)))
    V = problem.V
    marks = la.vector(V.dofmap.index_map, len(reasons))
    table = marks.array.reshape(-1, len(reasons))
    nodes = ridges.nodes(V)
    for column in range(singular.shape[1]):
        table[nodes[singular[:, column]], 1 + column] = 1.0
    for column, label in enumerate(labels):
        names = [n for s in held if s.label == label for n in s.surfaces]
        table[_nodes_of_edges_and_points(problem, names), 3 + column] = 1.0
    if problem.nodal_loads is not None:
        forces = problem.nodal_loads.nodal_forces().reshape(len(table), problem.body.dim)
        sizes = np.abs(forces).max(axis=1, initial=0.0)
        most = largest(problem.body.comm, float(sizes.max(initial=0.0)))
        table[:, 0] = sizes > _ROUND_OFF * most
    marks.scatter_reverse(la.InsertMode.add)
    marks.scatter_forward()
    return SingularPlaces(tuple(reasons), _with_neighbours(V, table))


def _with_neighbours(V: fem.FunctionSpace, table: FloatArray) -> BoolArray:
    """Owned nodes in cells that have a marked node, shape of the table. Collective."""
    cells = V.mesh.topology.index_map(V.mesh.topology.dim).size_local
    nodes = V.dofmap.list[:cells]
    marked = np.any(table > 0, axis=1)
    nodes = nodes[np.any(np.asarray(marked)[nodes], axis=1)]  # few cells have any
    touched = (table[nodes] > 0).any(axis=1)
    near = summed(V.dofmap.index_map, nodes, touched[:, None].astype(np.float64))
    return np.asarray(near[: V.dofmap.index_map.size_local] > 0)


def _nodes_of_edges_and_points(problem: Problem, names: Sequence[str]) -> IndexArray:
    """Nodes of the parts of some names that are edges or points. Collective."""
    body, V = problem.body, problem.V
    result: list[IndexArray] = [np.empty(0, dtype=np.int32)]
    for name in names:
        kinds = body.kinds(name)
        if "surface" in kinds:
            continue
        if "edge" in kinds:
            result.append(fem.locate_dofs_topological(V, 1, body.edges[name]))
        if "point" in kinds:
            result.append(_nearest_nodes(problem, body.points[name]))
    return np.unique(np.concatenate(result)).astype(np.int32)


def _nearest_nodes(problem: Problem, points: IndexArray) -> IndexArray:
    """Local nodes of the space at nodes of the geometry. Not collective."""
    if not len(points):
        return np.empty(0, dtype=np.int32)
    x, coordinates = problem.places, problem.body.mesh.geometry.x[points]
    result = [int(np.argmin(np.sum((x - place) ** 2, axis=1))) for place in coordinates]
    return np.array(result, dtype=np.int32)


# --- edges of the boundary ---


def _at_surface(
    problem: Problem, held: Sequence[Restraint], labels: Sequence[str]
) -> tuple[IndexArray, IndexArray, FloatArray]:
    """What boundary facets tell about their edges (vertices in the plane). Collective.

    Returns:
        A row for each facet and edge of it: cell; local edge of that cell; and the interior angle
        [rad], whether the face is smooth there, whether the angle is exact, 1, whether the facet is
        held in all and in some directions, by each support, whether it presses each obstacle and
        might, Poisson's ratio.
    """
    shape = boundary_shape(problem.body)
    facts = np.column_stack(
        [
            np.ones(len(shape.facets)),
            *_held(problem, held, labels, shape.facets),
            _nu(problem, shape.cells),
        ]
    )
    edges = shape.numbers.shape[1]
    smooth = np.where(shape.smooth, 1.0, 0.0)
    own = np.stack([shape.angles, smooth, shape.exact.astype(float)], axis=-1).reshape(-1, 3)
    return (
        np.repeat(shape.cells, edges),
        shape.numbers.reshape(-1),
        np.concatenate([own, np.repeat(facts, edges, axis=0)], axis=1),
    )


def _held(
    problem: Problem, held: Sequence[Restraint], labels: Sequence[str], facets: IndexArray
) -> list[FloatArray]:
    """For boundary facets, 0 or 1: see `_at_surface`."""
    body, dim = problem.body, problem.body.dim
    bits = np.zeros(len(facets), dtype=np.int64)
    by = np.zeros((len(labels), len(facets)))
    for support in held:
        mask = _directions(problem, support)
        for name in support.surfaces if mask else ():
            if name in body.surfaces:
                chosen = np.isin(facets, body.surfaces[name])
                bits[chosen] |= mask
                by[labels.index(support.label), chosen] = 1.0
    pressing = np.zeros((2 * len(problem.contact_pairs), len(facets)))
    for i, pair in enumerate(problem.contact_pairs):
        touching, pressed = _pressed(problem, pair, facets)
        bits[pressed] |= _NORMAL_BIT
        pressing[2 * i, pressed], pressing[2 * i + 1, touching] = 1.0, 1.0
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
    return [whole.astype(float), ((bits > 0) & ~whole).astype(float), *by, *pressing]


def _directions(problem: Problem, support: Restraint) -> int:
    """Directions in which a support holds its surfaces, a bit each. Collective."""
    dim = problem.body.dim
    every = (1 << dim) - 1
    if isinstance(support, Rigid):
        return every
    if isinstance(support, PrescribingSupport):
        parts = set(support.prescribed_components(dim))
        return sum(_NORMAL_BIT if i < 0 else 1 << i for i in parts)
    assert isinstance(support, Spring)
    surfaces = [name for name in support.surfaces if name in problem.body.surfaces]
    if not surfaces:
        return 0
    body, area = problem.body, 1.0
    if support.total:
        own = np.unique(np.concatenate([body.owned_facets(name) for name in surfaces]))
        area = total(body.comm, float(facet_areas(body.mesh, own).sum()))
    layer = max(young(region.typical) for region in problem.regions) / cell_size(body)
    stiff = [isinstance(c, float) and c > layer * area for c in support.coefficients]
    if not support.by_normal:
        return sum(1 << i for i, one in enumerate(stiff) if one)
    return every if all(stiff) else _NORMAL_BIT if any(stiff) else 0


def _pressed(
    problem: Problem, pair: ContactPair, facets: IndexArray
) -> tuple[BoolArray, BoolArray]:
    """Which boundary facets may touch an obstacle, and which press it with all nodes. Collective.

    Args:
        facets: Local boundary facets.
    """
    V = problem.V
    work = la.vector(V.dofmap.index_map, 1)
    nodes, pressures = pair.nodal_pressures()
    work.array[nodes[pressures > 0]] = 1.0
    work.scatter_forward()
    touching = np.isin(facets, pair.facets)
    return touching, touching & (work.array[dofs_on_facets(V, facets)] > 0).all(axis=1)


def _nu(problem: Problem, cells: IndexArray) -> FloatArray:
    """Poisson's ratio in cells."""
    result = np.zeros(len(problem.body.owned_cells()))
    for region in problem.regions:
        result[region.cells] = min(max(poisson(region.typical), 0.0), 0.5)
    # A boundary facet belongs to the rank of its cell.
    return np.asarray(result[np.minimum(cells, len(result) - 1)]) if len(result) else np.zeros(0)


def _classify(sums: FloatArray, problem: Problem, sources: tuple[int, int]) -> BoolArray:
    """Which edges are re-entrant, and which are the rim of what holds the body; see the module.

    Args:
        sums: Sums of the values of `_at_surface`.

    Returns:
        Shape (edges, 1 + supports + contacts).
    """
    angle, (count, whole, some) = sums[:, 0] / 2, sums[:, 3:6].T
    smooth, exact = sums[:, 1] > 1.5, sums[:, 2] > 1.5
    supports, contacts = sources
    by, nu = sums[:, 6 : 6 + supports], sums[:, -1] / 2
    pressing, touching = np.split(sums[:, 6 + supports : -1].reshape(len(sums), contacts, 2), 2, 2)
    edge = np.abs(count - 2) < 0.5
    free = count - whole - some
    alike = (np.abs(whole - 2) < 0.5) | (np.abs(some - 2) < 0.5) | (np.abs(free - 2) < 0.5)
    clamped = ~alike & (np.abs(some) < 0.5)
    kappa = (3 - nu) / (1 + nu) if problem.geometry == "plane-stress" else 3 - 4 * nu
    limit = np.arcsin(np.sqrt(np.clip((kappa + 1) / 4, 0.0, 1.0)))
    corner = edge & alike & ~smooth & (angle > np.pi)
    margin = np.where(exact, EDGE, _MARGIN)
    rim = edge & np.where(
        clamped, angle > limit + _MARGIN_HELD, ~alike & (angle > np.pi / 2 + margin)
    )
    ends = (pressing[..., 0] > 0.5) & ~(smooth[:, None] & (touching[..., 0] > 1.5))
    return np.column_stack([corner, rim[:, None] & (by > 0.5), rim[:, None] & ends])
