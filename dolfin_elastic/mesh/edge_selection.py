"""Edges of a solid, selected by geometry: sums over the facets beside them, found in parallel."""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.ghosts import summed
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.criteria import (
    BoundingBox,
    Criterion,
    allowed_distance,
    fulfilled,
    not_found,
    place_criteria,
)
from dolfin_elastic.mesh.geometry.simplices import (
    boundary_facets,
    edge_nodes,
    facet_corners,
    outward_normals,
    prepare_edges,
)
from dolfin_elastic.mesh.selectors import EdgeSelector, Line

_SHARP = 30.0
"""Degrees between the normals on both sides from which an edge is sharp."""


def pick_edges(body: Body, space: BoundingBox, selector: EdgeSelector) -> IndexArray:
    """Local mesh edges, owned and ghost, that a selector means. Collective.

    Raises:
        MeshError: The body is plane, a name does not exist, or nothing is found.
    """
    if body.dim == 2:
        raise MeshError(
            "the edges of a plane body are its surfaces",
            expected="select it in [surfaces], and use it as a surface",
        )
    prepare_edges(body.mesh)
    body.mesh.topology.create_connectivity(2, 1)
    beside = _FacetsBeside(body)
    chosen, things = _candidates(body, beside, selector)
    edges = np.flatnonzero(chosen).astype(np.int32)
    corners = body.mesh.geometry.x[edge_nodes(body.mesh, edges)]
    tests = place_criteria(selector, space, corners)
    if selector.line is not None:
        tests.append(_on_line(selector.line, selector, space, corners))
    inside = fulfilled(tests, len(edges))
    if selector.plane or selector.sphere or selector.cylinder:
        inside &= ~beside.inside_area(selector, space)[edges]
    owned = edges < body.mesh.topology.index_map(1).size_local
    if not total(body.comm, int(np.count_nonzero(inside & owned))):
        raise not_found(body.comm, space, tests, owned, things)
    return edges[inside]


def _candidates(body: Body, beside: _FacetsBeside, selector: EdgeSelector) -> tuple[BoolArray, str]:
    """Which local edges are searched, and what they are called in messages. Collective."""
    chosen, things = beside.count(beside.boundary) > 0, "edges of the boundary"
    border = np.zeros(len(chosen), dtype=bool)
    if selector.of is not None and "edge" in body.kinds(selector.of):
        chosen, things = np.zeros(len(chosen), dtype=bool), f"edges of '{selector.of}'"
        chosen[body.edge(selector.of)] = True
        border = chosen
    elif selector.of is not None:
        number = beside.count(body.owned_facets(selector.of))
        chosen, things = number > 0, f"edges of '{selector.of}'"
        border = number == 1
    for name in selector.between or ():
        chosen = chosen & (beside.count(body.owned_facets(name)) > 0)
        things = " and ".join(f"'{n}'" for n in selector.between or ())
        things = f"edges that belong to {things}"
    area = any((selector.plane, selector.sphere, selector.cylinder, selector.line))
    if selector.angle is not None or not (area or selector.between):
        angle = selector.angle or _SHARP
        sharp = beside.angles() > angle
        chosen = chosen & (sharp | border if selector.angle is None else sharp)
        things += f" where the normal turns by more than {angle:g} degrees"
    return chosen, things


def _on_line(
    line: Line, selector: EdgeSelector, space: BoundingBox, corners: FloatArray
) -> Criterion:
    start, end = space.point(line.start, "line.start"), space.point(line.end, "line.end")
    along = end - start
    length = float(np.linalg.norm(along))
    if not length > 0:
        raise MeshError("the line has no length", where="line.end", expected="another point")
    arm = corners - start
    s = np.clip(arm @ along / length**2, 0.0, 1.0)
    distance = np.linalg.norm(arm - s[..., None] * along, axis=-1).max(axis=1)
    return Criterion("on the line", distance, allowed_distance(selector, space), space.scale)


class _FacetsBeside:
    """The facets that meet at each mesh edge, also those on other ranks.

    The constructor is collective, and so is all else.

    Attributes:
        boundary: Facets of the boundary, each on exactly one rank.
    """

    def __init__(self, body: Body) -> None:
        self.boundary = boundary_facets(body.mesh)
        self._mesh = body.mesh
        self._edges = body.mesh.topology.connectivity(2, 1).array.reshape(-1, 3)

    def sums(self, facets: IndexArray, values: FloatArray) -> FloatArray:
        """Sums of values of facets at their edges, owned and ghost.

        Args:
            facets: Each on exactly one rank.
            values: Of each, shape (facets, columns).
        """
        return summed(self._mesh.topology.index_map(1), self._edges[facets], values[:, None, :])

    def count(self, facets: IndexArray) -> IndexArray:
        """Number of facets at each local edge."""
        return np.round(self.sums(facets, np.ones((len(facets), 1)))[:, 0]).astype(np.int32)

    def angles(self) -> FloatArray:
        """Angle by which the boundary's normal turns at each local edge [degrees].

        |n1 + n2| = 2 cos(angle/2); 180 where other than two facets meet.
        """
        normals = outward_normals(self._mesh, self.boundary)
        rows = self.sums(self.boundary, np.column_stack([normals, np.ones(len(normals))]))
        half = np.clip(np.linalg.norm(rows[:, :3], axis=1) / 2, 0.0, 1.0)
        return np.where(np.round(rows[:, 3]) == 2, 2 * np.degrees(np.arccos(half)), 180.0)

    def inside_area(self, selector: EdgeSelector, space: BoundingBox) -> BoolArray:
        """Local edges whose adjacent boundary facets all lie on the plane, sphere or cylinder."""
        surface = selector.model_copy(update={"box": None})
        corners = facet_corners(self._mesh, self.boundary)
        inside = fulfilled(place_criteria(surface, space, corners), len(corners))
        number = self.count(self.boundary[inside])
        return (number > 0) & (number == self.count(self.boundary))
