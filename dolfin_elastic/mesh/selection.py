"""`name_parts`: names for surfaces and regions that the mesh file does not name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from dolfinx.mesh import Mesh

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.parallel import first_of, total
from dolfin_elastic.core.schema import quoted
from dolfin_elastic.core.shapes.directions import vector_of
from dolfin_elastic.core.types import IndexArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.criteria import (
    BoundingBox,
    Criterion,
    fulfilled,
    not_found,
    place_criteria,
)
from dolfin_elastic.mesh.edge_selection import pick_edges
from dolfin_elastic.mesh.faces import chosen_faces
from dolfin_elastic.mesh.geometry.simplices import (
    boundary_facets,
    cell_corners,
    cells_beside_facets,
    facet_corners,
    outward_normals,
    prepare_facets,
)
from dolfin_elastic.mesh.inner_surfaces import (
    CellFacets,
    facets_between,
    interface,
    sides_of_plane,
)
from dolfin_elastic.mesh.point_selection import pick_points
from dolfin_elastic.mesh.selectors import EdgeSelector, Place, PointSelector, Selector

Choice = Selector | Sequence[Selector]
EdgeChoice = EdgeSelector | Sequence[EdgeSelector]
PointChoice = PointSelector | Sequence[PointSelector]
_ANGLE = 20.0  # degrees


def name_parts(
    body: Body,
    *,
    surfaces: Mapping[str, Choice] | None = None,
    regions: Mapping[str, Choice] | None = None,
    edges: Mapping[str, EdgeChoice] | None = None,
    points: Mapping[str, PointChoice] | None = None,
    scale: float = 1.0,
) -> Body:
    """The body with further named parts, selected by geometry.

    Collective.  Later selectors may refer (`of`, `between`) to the names of earlier ones, in the
    order regions, surfaces, edges, points.

    Args:
        surfaces: Name to a selector, or to several whose facets are joined.
        regions: Name to a selector, or to several whose cells are joined.
        edges: Name to a selector, or to several whose mesh edges are joined; in 3D only.
        points: Name to a selector, or to several whose nodes are joined.
        scale: Metres per unit of length of the mesh, for bare numbers in selectors.

    Raises:
        MeshError: A name exists already, or a selector finds nothing.
    """
    space = BoundingBox.of(body, scale)
    choices: dict[str, Mapping[str, Place | Sequence[Place]]] = {
        "region": regions or {},
        "surface": surfaces or {},
        "edge": edges or {},
        "point": points or {},
    }
    for kind, named in choices.items():
        for name, choice in named.items():
            result = _named(body, space, kind, name, choice)
            body = body.named(**{f"{kind}s": {name: result}})
    return body


def _named(
    body: Body, space: BoundingBox, kind: str, name: str, choice: Place | Sequence[Place]
) -> IndexArray:
    _check_free(body, kind, name)
    choices = [choice] if isinstance(choice, Place) else list(choice)
    result: list[IndexArray] = []
    for i, selector in enumerate(choices):
        where = f"{kind}s.{name}" + (f"[{i}]" if len(choices) > 1 else "")
        try:
            if isinstance(selector, EdgeSelector):
                result.append(pick_edges(body, space, selector))
            elif isinstance(selector, PointSelector):
                result.append(pick_points(body, space, selector))
            else:
                assert isinstance(selector, Selector)
                result.append(_pick(body, space, kind, selector))
        except MeshError as error:
            raise error.at(where) from None
    if not result:
        raise MeshError(
            "an empty list of selectors",
            where=f"{kind}s.{name}",
            expected='for example {plane = "x", at = "min"}',
        )
    return np.unique(np.concatenate(result)).astype(np.int32)


def _check_free(body: Body, kind: str, name: str) -> None:
    """Refuses a name that is taken; but a region may have the name of a surface."""
    # Names that differ by case only stay apart: the parts are not asked whether they know it.
    taken = tuple(other for other, parts in body.parts.items() if name in list(parts))
    if kind in ("surface", "region"):
        taken = tuple(other for other in taken if other == kind)
    if taken:
        raise MeshError(
            f"the mesh has a {taken[0]} '{name}' already".replace("a edge", "an edge"),
            where=f"{kind}s.{name}",
            expected="choose another name",
        )


def _pick(body: Body, space: BoundingBox, kind: str, selector: Selector) -> IndexArray:
    mesh = body.mesh
    if kind == "surface":
        prepare_facets(mesh)
        parts, selector = _searched(body, space, selector)
        if selector.by_face:
            on = chosen_faces(body.faces, selector, space.scale)
            assert body.faces is not None  # see `chosen_faces`
            facets = body.faces.facets_of(on)
            # Faces between joined bodies only by their numbers: they have no outward normal.
            numbered = selector.faces is not None and selector.normal is None
            parts = facets if numbered and not selector.of else np.intersect1d(parts, facets)
        tests = _surface_criteria(mesh, parts, selector, space)
        size = mesh.topology.index_map(mesh.topology.dim - 1).size_local
    else:
        size = mesh.topology.index_map(mesh.topology.dim).size_local
        parts = body.region(selector.of) if selector.of else np.arange(size, dtype=np.int32)
        tests = _region_criteria(mesh, parts, selector, space)
    inside = fulfilled(tests, len(parts))
    if total(body.comm, int(np.count_nonzero(inside))) == 0:
        things = "facets of the boundary" if kind == "surface" else "cells"
        if kind == "surface" and selector.between:
            things = "facets between " + " and ".join(f"'{name}'" for name in selector.between)
        elif selector.of:
            things = f"{things.split(maxsplit=1)[0]} of '{selector.of}'"
        raise _with_nearest_face(
            body, parts, tests, not_found(body.comm, space, tests, parts < size, things)
        )
    return np.asarray(parts[inside])


def _with_nearest_face(
    body: Body, facets: IndexArray, tests: Sequence[Criterion], error: MeshError
) -> MeshError:
    """The error with the CAD face that comes nearest to the first criterion. Collective."""
    if body.faces is None or not tests:
        return error
    numbers, distance = body.faces.numbers_of(facets), tests[0].distance
    local = [(float(distance[i]), int(numbers[i])) for i in np.argsort(distance)[:1] if numbers[i]]
    best = first_of(body.comm, local)
    if best is None:
        return error
    near = f"; the nearest CAD face is {body.faces.text(best[1])}"
    return MeshError(error.what, where=error.where, expected=error.expected + near)


def _searched(body: Body, space: BoundingBox, selector: Selector) -> tuple[IndexArray, Selector]:
    """Facets among which a selector picks, and what is left of its keys. Collective."""
    if selector.between is not None:
        try:
            return interface(body, *selector.between), selector
        except MeshError as error:
            raise error if error.where else error.at("between") from None
    if selector.cut:
        assert selector.plane is not None
        assert selector.at is not None
        sides = sides_of_plane(body, space, selector.plane, selector.at, selector.of)
        left = selector.model_copy(update={"plane": None, "at": None})
        return facets_between(CellFacets(body), sides), left
    facets = _searched_facets(body, selector.of) if selector.of else boundary_facets(body.mesh)
    return facets, selector


def _searched_facets(body: Body, name: str) -> IndexArray:
    """Facets of a surface, or of the boundary of a region where no surface has that name."""
    if name in body.surfaces or name not in body.regions:
        return body.surface(name)
    facets = boundary_facets(body.mesh)
    cells, _ = cells_beside_facets(body.mesh, facets)
    return np.asarray(facets[np.isin(cells, body.region(name))])


def _surface_criteria(
    mesh: Mesh, facets: IndexArray, selector: Selector, space: BoundingBox
) -> list[Criterion]:
    tests = place_criteria(selector, space, facet_corners(mesh, facets))
    if selector.normal is not None:
        tests.append(_normal_test(mesh, facets, selector, space))
    return tests


def _region_criteria(
    mesh: Mesh, cells: IndexArray, selector: Selector, space: BoundingBox
) -> list[Criterion]:
    wrong = [key for key in ("plane", "normal", "between") if getattr(selector, key) is not None]
    wrong += [key for key in selector.by_face if key not in selector.shapes]
    if wrong:
        raise MeshError(
            f"a {wrong[0]} picks surfaces, not regions",
            expected="regions are picked by box, sphere, cylinder, of, or all",
        )
    selector.check_placed()
    middle = cell_corners(mesh, cells).mean(axis=1, keepdims=True)
    return place_criteria(selector, space, middle, filled=True)


def _normal_test(
    mesh: Mesh, facets: IndexArray, selector: Selector, space: BoundingBox
) -> Criterion:
    assert selector.normal is not None
    dim = len(space.low)
    wanted = np.array(vector_of(selector.normal)[:dim])
    if len(wanted) < dim or not wanted.any():
        raise MeshError(
            f"a direction in {dim}D is needed, not {quoted(selector.normal)}",
            where="normal",
            expected=f"for example {[1, 0, 0][:dim]}",
        )
    cosine = outward_normals(mesh, facets) @ (wanted / np.linalg.norm(wanted))
    angles = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    text = ", ".join(f"{n:g}" for n in wanted)
    return Criterion(f"facing ({text})", angles, selector.angle or _ANGLE, key="angle")
