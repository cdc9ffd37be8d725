"""Named parts of a refined mesh: the cells, facets, edges and nodes in those of the coarse mesh.

They are found by barycentric coordinates in the parent cell: a finer facet lies in facet j of the
parent where coordinate j is zero at all its corners.  Names are sent with the cells, so that ranks
which share a part agree on it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import basix
import numpy as np
from dolfinx.mesh import Mesh

from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body, boundary_shape
from dolfin_elastic.mesh.faces import CadFaces
from dolfin_elastic.mesh.geometry.boundary_shape import KnownSurface, facet_ridges, facet_vertices
from dolfin_elastic.mesh.geometry.ridges import cell_ridges
from dolfin_elastic.mesh.geometry.simplices import boundary_facets, cells_beside_facets
from dolfin_elastic.mesh.refine.division import barycentric, lagrange

_SHAPES = {2: basix.CellType.triangle, 3: basix.CellType.tetrahedron}
Parts = Mapping[str, IndexArray]


def carry_parts(
    body: Body, mesh: Mesh, corners: FloatArray, of_parents: Callable[[AnyArray], AnyArray]
) -> dict[str, dict[str, IndexArray]]:
    """Named parts of the finer mesh: the fields of `Body` that hold such.  Collective.

    Args:
        corners: Barycentric coordinates of the corners of its local cells in their parents.
        of_parents: Rows of coarse cells to rows of the parents of finer cells.
    """
    coarse = body.mesh
    regions = of_parents(_marks(body.regions, len(coarse.geometry.dofmap)))
    result = {"regions": _named(body.regions, regions, np.arange(len(regions)))}
    d = coarse.topology.dim
    result["surfaces"] = _entities(body.surfaces, coarse, mesh, d - 1, corners, of_parents)
    result["edges"] = _entities(body.edges, coarse, mesh, 1, corners, of_parents)
    result["points"] = _points(body.points, coarse, mesh, corners, of_parents)
    return result


def _marks(parts: Parts, count: int) -> AnyArray:
    """Which of `count` cells, facets, edges or nodes belong to each part, shape (count, parts)."""
    marks = np.zeros((count, len(parts)), dtype=np.uint8)
    for column, members in enumerate(parts.values()):
        marks[members, column] = 1
    return marks


def _named(parts: Parts, marks: AnyArray, members: AnyArray) -> dict[str, IndexArray]:
    """Name to its members, by marks of shape (..., parts) for local numbers of shape (...)."""
    return {
        name: np.unique(members[marks[..., column] > 0]).astype(np.int32)
        for column, name in enumerate(parts)
    }


def _around(mesh: Mesh, dim: int) -> IndexArray:
    """Local facets or edges of each local cell, shape (cells, facets of a cell). Collective."""
    d = mesh.topology.dim
    mesh.topology.create_entities(dim)
    mesh.topology.create_connectivity(d, dim)
    mesh.topology.create_connectivity(dim, d)
    each = len(basix.topology(_SHAPES[d])[dim])
    return np.asarray(mesh.topology.connectivity(d, dim).array).reshape(-1, each)


def _entities(
    parts: Parts,
    coarse: Mesh,
    mesh: Mesh,
    dim: int,
    corners: FloatArray,
    of_parents: Callable[[AnyArray], AnyArray],
) -> dict[str, IndexArray]:
    """Facets or edges of the finer mesh that lie in named ones of the coarse mesh. Collective."""
    if not parts:
        return {}
    d = coarse.topology.dim
    members = _around(coarse, dim)
    index = coarse.topology.index_map(dim)
    marks = _marks(parts, index.size_local + index.num_ghosts)
    of_parent = of_parents(marks[members])  # (finer cells, entities of a cell, parts)
    within = _entities_within(d, dim, corners)  # (finer cells, own entity, parent's entity)
    own = np.einsum("cij,cjp->cip", within.astype(np.uint8), of_parent)
    return _named(parts, own, _around(mesh, dim))


def carry_faces(
    body: Body, mesh: Mesh, corners: FloatArray, of_parents: Callable[[AnyArray], AnyArray]
) -> CadFaces | None:
    """The CAD faces of the coarse body, with the facets of the finer mesh on them.  Collective.

    Args:
        body: See `carry_parts`, as the others.
    """
    if body.faces is None:
        return None
    d = body.dim
    members = _around(body.mesh, d - 1)
    numbers = body.faces.numbers_of(members.reshape(-1)).reshape(members.shape)
    within = _entities_within(d, d - 1, corners)
    own = np.einsum("cij,cj->ci", within.astype(np.int64), of_parents(numbers))
    facets, first = np.unique(_around(mesh, d - 1)[own > 0], return_index=True)
    return replace(body.faces, facets=facets.astype(np.int32), numbers=own[own > 0][first])


def carry_surface(
    body: Body, mesh: Mesh, corners: FloatArray, of_parents: Callable[[AnyArray], AnyArray]
) -> KnownSurface:
    """What is known of the surface of the coarse body, on the finer mesh.  Collective.

    Args:
        body: See `carry_parts`, as the others.
    """
    shape, d, count = boundary_shape(body), body.dim, len(body.mesh.geometry.dofmap)
    known, vertices = shape.known(), facet_vertices(body.dim)
    assert known.arcs is not None  # since it is of a shape
    _, of_facets = cells_beside_facets(body.mesh, shape.facets)
    facets = boundary_facets(mesh)
    cells, local = cells_beside_facets(mesh, facets)
    within = _entities_within(d, d - 1, corners)[cells, local]  # (facets, parent's facet)
    normals, gap = np.full((len(facets), d, d), np.nan), np.full(len(facets), np.nan)
    off = np.zeros(len(facets))
    own = corners[cells[:, None], vertices[local]]  # (facets, corner, parent's corner)
    for facet in range(d + 1):
        rows = np.full((count, d, d + 2), np.nan)
        there = of_facets == facet
        rows[shape.cells[there], :, :d] = known.normals[there]
        rows[shape.cells[there], 0, d] = known.gap[there]
        rows[shape.cells[there], 0, d + 1] = known.off[there]
        parents = of_parents(rows)[cells]
        here = within[:, facet]
        mean = np.einsum("fkv,fvj->fkj", own[here][:, :, vertices[facet]], parents[here][..., :d])
        normals[here] = mean / np.linalg.norm(mean, axis=2, keepdims=True)
        gap[here], off[here] = parents[here, 0, d], parents[here, 0, d + 1]
    ridges = np.zeros((count, len(cell_ridges(d))), dtype=np.uint8)
    np.maximum.at(ridges, (shape.cells[:, None], shape.numbers), known.arcs.astype(np.uint8))
    of_cells = _entities_within(d, d - 2, corners)
    arcs = np.einsum("cij,cj->ci", of_cells.astype(np.uint8), of_parents(ridges)) > 0
    _, numbers = facet_ridges(d, local)
    return KnownSurface(normals, arcs[cells[:, None], numbers], gap, off)


def _entities_within(d: int, dim: int, corners: FloatArray) -> AnyArray:
    """Whether each entity of a finer cell lies in each of its parent, (cells, own, parent's)."""
    entities: list[Any] = basix.topology(_SHAPES[d])[dim]
    zero = corners == 0.0
    result = np.zeros((len(corners), len(entities), len(entities)), dtype=bool)
    for i, own in enumerate(entities):
        for j, other in enumerate(entities):
            away = [k for k in range(d + 1) if k not in other]
            result[:, i, j] = zero[:, own][:, :, away].all(axis=(1, 2))
    return result


def _points(
    parts: Parts,
    coarse: Mesh,
    mesh: Mesh,
    corners: FloatArray,
    of_parents: Callable[[AnyArray], AnyArray],
) -> dict[str, IndexArray]:
    """Nodes of the finer mesh that are where named nodes of the coarse mesh are. Collective."""
    if not parts:
        return {}
    marks = _marks(parts, len(coarse.geometry.x))
    of_parent = of_parents(marks[coarse.geometry.dofmap])  # (finer cells, parent's node, parts)
    reference = barycentric(lagrange(coarse.topology.dim, int(coarse.geometry.cmap.degree)).points)
    coordinates = np.einsum("kv,cvj->ckj", reference, corners)
    # Coordinates are multiples of 1/4.
    same = (np.abs(coordinates[:, :, None] - reference) < 0.1).all(axis=3)
    own = np.einsum("ckn,cnp->ckp", same.astype(np.uint8), of_parent)
    return _named(parts, own, mesh.geometry.dofmap[:, : own.shape[1]])  # vertices first
