"""`CadSurfaces` moves boundary nodes of a refined mesh to the surfaces of its CAD file.

Each rank opens the file itself and moves its own nodes.  A boundary facet belongs to the surface on
which all its corners lie; if there are several (where a plane ends a cylinder), to the one nearest
to the middle of the facet.  Nodes between facets of two surfaces are moved to the curve in which
these intersect, so that edges stay sharp.  In a plane body curves take the place of surfaces.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TypeVar, cast

import numpy as np
from dolfinx import fem
from dolfinx.common import IndexMap
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.ghosts import marked, with_ghosts
from dolfin_elastic.core.parallel import agree, total
from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.body import Body, CadSource, span
from dolfin_elastic.mesh.formats.cad.read import CadModel, open_model
from dolfin_elastic.mesh.geometry.curved import cell_gradients, facet_points, quadrature_rule
from dolfin_elastic.mesh.geometry.simplices import (
    boundary_facets,
    cells_beside_facets,
    facet_nodes,
    longest_edges,
)
from dolfin_elastic.mesh.refine.division import Division, lagrange

T = TypeVar("T")
_NEAR = 1e-6
"""Share of the body's diagonal up to which a corner lies on a surface."""
_FAR = 0.6
"""Share of a finer facet's longest edge up to which its nodes are moved."""
_FLAT = 0.1
"""Smallest determinant of a cell's map, over its mean before, that moved nodes may leave."""
_STRAIGHT = ("Plane", "Line")


@dataclass(frozen=True)
class _NodeSurface:
    """A surface on which a node lies.

    Attributes:
        surface: Its number in the CAD model.
        size: Longest edge of the finest facet there [m].
    """

    surface: int
    size: float


_NodeSurfaces = dict[int, list[_NodeSurface]]
"""Local node of the finer mesh to its surfaces."""


class CadSurfaces:
    """The surfaces of a CAD file.

    Args:
        source: The file, and metres per unit of it.
    """

    def __init__(self, source: CadSource) -> None:
        self._source = source

    def place(
        self, body: Body, division: Division, space: fem.FunctionSpace, x: FloatArray
    ) -> tuple[FloatArray, tuple[str, ...]]:
        """Moves the nodes on the boundary of the finer mesh to the surfaces. Collective.

        Args:
            body: The coarse body, whose corners lie on the surfaces.
            space: Scalar Lagrange space whose nodes are those of the finer mesh.
            x: Their places [m] in the shape of the coarse body, ghosts included.

        Returns:
            Their new places, and notes.

        Raises:
            MeshError: The file cannot be read any more.
        """
        facets, near, moved = boundary_facets(body.mesh), _NEAR * span(body), x.copy()
        with ExitStack() as opened:

            def classified() -> tuple[_Model, IntArray]:
                source = open_model(self._source.path, self._source.permission)
                model = _Model(opened.enter_context(source), body.dim)
                return model, self._classify(model, body, facets, near)

            model, tags = _on_each_rank(body.comm, classified)
            if not total(body.comm, int(np.count_nonzero(tags))):
                note = f"the mesh does not lie on the surfaces of {body.source}: it keeps its shape"
                return x, (note,)
            links = _shared(space, _links(body, division, space, x, facets, tags))
            _on_each_rank(body.comm, lambda: self._project(model, links, moved))
        _from_owners(space, moved)
        stay = _restore_folded(body, space, x, moved)
        note = f"{stay} nodes are not on the surfaces of {body.source}: elements would fold"
        return moved, (note,) if stay else ()

    def _classify(self, model: _Model, body: Body, facets: IndexArray, near: float) -> IntArray:
        """Number of the surface of each boundary facet of the coarse mesh, 0: none. Local."""
        nodes = facet_nodes(body.mesh, facets)
        used, rows = np.unique(nodes, return_inverse=True)
        rows = rows.reshape(nodes.shape)
        coordinates = _padded(body.mesh.geometry.x[used, : body.dim] / self._source.scale)
        near = near / self._source.scale
        middle = np.full((1, body.dim - 1), 1.0 / body.dim)
        middles = _padded(facet_points(body.mesh, facets, middle)[0][:, 0] / self._source.scale)
        tags = np.zeros(len(facets), dtype=np.int64)
        best = np.full(len(facets), np.inf)
        for tag in model.surfaces:
            on = model.distances(tag, coordinates, near) <= near
            candidates = np.flatnonzero(on[rows].all(axis=1))
            away = model.distances(tag, middles[candidates], np.inf)
            closer = away < best[candidates]
            tags[candidates[closer]], best[candidates[closer]] = tag, away[closer]
        return tags

    def _project(self, model: _Model, links: _NodeSurfaces, moved: FloatArray) -> None:
        """Moves nodes to the nearest points of their surfaces or curves. Local."""
        groups = dict[tuple[int, ...], list[int]]()
        for node, result in links.items():
            groups.setdefault(tuple(sorted({t.surface for t in result})), []).append(node)
        for surfaces, nodes in groups.items():
            old = _padded(moved[nodes] / self._source.scale)
            new = model.closest(surfaces, old)
            if new is None:
                continue
            step = np.linalg.norm(new - old, axis=1) * self._source.scale
            size = np.array([min(t.size for t in links[node]) for node in nodes])
            good = step <= _FAR * size
            chosen = np.array(nodes)[good]
            moved[chosen] = new[good, : moved.shape[1]] * self._source.scale


class _Model:
    """The model, as surfaces.

    Args:
        dim: 3, or 2: then its curves are the surfaces.
    """

    def __init__(self, model: CadModel, dim: int) -> None:
        self._model, self._dim = model, dim - 1
        self.surfaces = model.entities(self._dim)

    def distances(self, tag: int, coordinates: FloatArray, near: float) -> FloatArray:
        """Distances of places to a surface; infinite outside of its box by more than `near`.

        Args:
            coordinates: In the file's unit, shape (n, 3).
            near: In the file's unit.
        """
        box = self._model.box(self._dim, tag)
        inside = ((coordinates >= box[:3] - near) & (coordinates <= box[3:] + near)).all(axis=1)
        result = np.full(len(coordinates), np.inf)
        chosen = coordinates[inside]
        result[inside] = np.linalg.norm(
            self._model.nearest(self._dim, tag, chosen) - chosen, axis=1
        )
        return result

    def closest(self, surfaces: tuple[int, ...], coordinates: FloatArray) -> FloatArray | None:
        """Nearest places on one surface, or on the curves in which two meet; None: they stay.

        Args:
            coordinates: In the file's unit, shape (n, 3).
        """
        straight = [self._model.kind(self._dim, tag) in _STRAIGHT for tag in surfaces]
        if all(straight) or len(surfaces) > self._dim:
            return None
        if len(surfaces) == 1:
            return self._model.nearest(self._dim, surfaces[0], coordinates)
        around = [self._model.below(self._dim, s) for s in surfaces]
        curves = sorted(set.intersection(*around))
        result = [self._model.nearest(self._dim - 1, curve, coordinates) for curve in curves]
        if not result:
            return None
        away = np.array([np.linalg.norm(f - coordinates, axis=1) for f in result])
        return np.asarray(np.array(result)[np.argmin(away, axis=0), np.arange(len(coordinates))])


def _on_each_rank(comm: MPI.Comm, action: Callable[[], T]) -> T:
    """Runs a local action on each rank; an error of one rank is raised on all. Collective."""
    result: T | None = None
    error: MeshError | None = None
    try:
        result = action()
    except MeshError as caught:
        error = caught
    agree(comm, error)
    return cast(T, result)


def _padded(coordinates: AnyArray) -> FloatArray:
    """Places with three coordinates."""
    return np.asarray(
        np.pad(coordinates, ((0, 0), (0, 3 - coordinates.shape[1]))), dtype=np.float64
    )


def _links(
    body: Body,
    division: Division,
    space: fem.FunctionSpace,
    x: FloatArray,
    facets: IndexArray,
    tags: IntArray,
) -> _NodeSurfaces:
    """Surfaces of the nodes on this rank's boundary facets of the finer mesh."""
    d = body.dim
    of_cells = np.zeros((len(body.mesh.geometry.dofmap), d + 1), dtype=np.int64)
    of_cells[cells_beside_facets(body.mesh, facets)] = tags
    finer = boundary_facets(division.mesh)
    cells, local = cells_beside_facets(division.mesh, finer)
    closure = lagrange(d, int(body.mesh.geometry.cmap.degree)).entity_closure_dofs[d - 1]
    links: _NodeSurfaces = {}
    for i in range(d + 1):
        own = cells[local == i]
        corners = np.delete(division.corners[own], i, axis=1)
        within = (corners == 0.0).all(axis=1)  # in which facet of the parent
        surface = (of_cells[division.parents[own]] * within).sum(axis=1)
        nodes = space.dofmap.list[own][:, closure[i]]
        # The first d nodes of a facet are its corners.
        size = longest_edges(x[nodes[:, :d]])
        for row, tag, edge in zip(nodes, surface, size, strict=True):
            for node in row if tag else ():
                links.setdefault(int(node), []).append(_NodeSurface(int(tag), float(edge)))
    return links


def _shared(space: fem.FunctionSpace, links: _NodeSurfaces) -> _NodeSurfaces:
    """Adds the surfaces that other ranks have found for shared nodes. Collective."""
    index = space.dofmap.index_map
    ghosts = np.arange(index.num_ghosts) + index.size_local
    marks = marked(index, ghosts)
    shared = [node for node in links if marks[node]]
    numbers = index.local_to_global(np.array(shared, dtype=np.int32))
    sent = {int(n): links[node] for n, node in zip(numbers, shared, strict=True)}
    for rank, received in enumerate(space.mesh.comm.allgather(sent)):
        if rank != space.mesh.comm.rank:
            _merge(index, links, received)
    return links


def _merge(
    index: IndexMap, links: _NodeSurfaces, received: Mapping[int, list[_NodeSurface]]
) -> None:
    nodes = index.global_to_local(np.array([*received], dtype=np.int64))
    for node, result in zip(nodes, received.values(), strict=True):
        if node >= 0:
            links.setdefault(int(node), []).extend(result)


def _from_owners(space: fem.FunctionSpace, x: FloatArray) -> None:
    """Overwrites the rows of ghosts by those of their owners. Collective."""
    index = space.dofmap.index_map
    x[:] = with_ghosts(index, x[: index.size_local])


def _restore_folded(body: Body, space: fem.FunctionSpace, x: FloatArray, moved: FloatArray) -> int:
    """Puts nodes of cells back that would be flat or fold, in `moved`; how many. Collective."""
    order, d = int(body.mesh.geometry.cmap.degree), body.dim
    points = np.concatenate([lagrange(d, order).points, quadrature_rule(d, 4)[0]])
    cells, index = space.dofmap.list, space.dofmap.index_map
    before = np.linalg.det(cell_gradients(x[cells], order, points))
    mean = before.mean(axis=1, keepdims=True)
    limit = np.minimum(_FLAT, 0.9 * (before / mean).min(axis=1, initial=np.inf))
    stay = 0
    while True:
        after = np.linalg.det(cell_gradients(moved[cells], order, points))
        bad = (after / mean).min(axis=1, initial=np.inf) < limit
        if not total(body.comm, int(np.count_nonzero(bad))):
            return int(stay)
        back = marked(index, cells[bad]) & (moved != x).any(axis=1)
        moved[back] = x[back]
        stay += total(body.comm, int(np.count_nonzero(back[: index.size_local])))
