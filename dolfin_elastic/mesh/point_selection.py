"""Vertices of a body, selected by geometry, in parallel."""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.ghosts import marked
from dolfin_elastic.core.parallel import first_of, total
from dolfin_elastic.core.types import BoolArray, IndexArray
from dolfin_elastic.mesh.body import Body, cell_size
from dolfin_elastic.mesh.criteria import BoundingBox, fulfilled, not_found, place_criteria
from dolfin_elastic.mesh.geometry.simplices import edge_nodes, facet_nodes, prepare_facets
from dolfin_elastic.mesh.selectors import PointSelector


def pick_points(body: Body, space: BoundingBox, selector: PointSelector) -> IndexArray:
    """Local geometry nodes, owned and ghost, that a selector means. Collective.

    Raises:
        MeshError: A name does not exist, or nothing is found.
    """
    chosen, things = _vertices(body), "vertices"
    names = [*([selector.of] if selector.of else []), *(selector.between or ())]
    for name in names:
        chosen &= vertices_of(body, name)
        things = "vertices that belong to " + " and ".join(f"'{n}'" for n in names)
    nodes = np.flatnonzero(chosen).astype(np.int32)
    x = body.mesh.geometry.x[:, : body.dim]
    tests = place_criteria(selector, space, x[nodes][:, None])
    inside = nodes[fulfilled(tests, len(nodes))]
    owned = body.mesh.geometry.index_map().size_local
    if not total(body.comm, int(np.count_nonzero(inside < owned))):
        raise not_found(body.comm, space, tests, nodes < owned, things)
    if selector.nearest is None:
        return inside
    return _nearest(body, space, selector, inside)


def _nearest(
    body: Body, space: BoundingBox, selector: PointSelector, nodes: IndexArray
) -> IndexArray:
    """The one nearest to a place; of several the one that comes first along x, then y, then z."""
    assert selector.nearest is not None
    place = space.point(selector.nearest, "nearest")
    x = body.mesh.geometry.x[:, : body.dim]
    numbers = body.mesh.geometry.index_map().local_to_global(nodes)
    far = np.linalg.norm(x[nodes] - place, axis=1)
    step = 1e-9 * space.diagonal  # distances closer than this are equal
    best = first_of(
        body.comm,
        [
            (float(np.round(d / step)), *map(float, np.round(x[n] / step)), int(number), float(d))
            for d, n, number in zip(far, nodes, numbers, strict=True)
            if d <= far.min() + step
        ],
    )
    assert best is not None
    number, distance = int(best[-2]), float(best[-1])
    wanted = selector.tolerance
    limit = cell_size(body) if wanted is None else space.metres(wanted)
    if distance > limit:
        shown = ", ".join(f"{c * step / space.scale:.6g}" for c in best[1:-2])
        raise MeshError(
            f"the nearest vertex ({shown}) is {distance / space.scale:.3g} away, allowed is "
            f"{limit / space.scale:.3g}",
            where="nearest",
            expected=f"a point at the body, or a tolerance above that; {space}",
        )
    return nodes[numbers == number]


def _vertices(body: Body) -> BoolArray:
    """Which local geometry nodes are vertices. Local."""
    chosen = np.zeros(len(body.mesh.geometry.x), dtype=bool)
    chosen[body.mesh.geometry.dofmap[:, : body.dim + 1]] = True
    return chosen


def vertices_of(body: Body, name: str) -> BoolArray:
    """Which local geometry nodes, owned and ghost, belong to parts of a name. Collective.

    Args:
        name: Of surface, edge or point, or several of them.

    Raises:
        MeshError: There is no such part.
    """
    vertices: list[IndexArray] = [np.empty(0, dtype=np.int32)]
    kinds = [kind for kind in body.kinds(name) if kind != "region"]
    if not kinds:
        body.surface(name)  # raises
    if "point" in kinds:
        vertices.append(body.points[name])
    if "edge" in kinds:
        vertices.append(edge_nodes(body.mesh, body.edges[name]).ravel())
    if "surface" in kinds:
        prepare_facets(body.mesh)
        vertices.append(facet_nodes(body.mesh, body.surfaces[name]).ravel())
    return marked(body.mesh.geometry.index_map(), np.concatenate(vertices))
