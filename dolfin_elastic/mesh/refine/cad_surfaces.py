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
from dolfinx import fem, la
from dolfinx.common import IndexMap
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.ghosts import marked, with_ghosts
from dolfin_elastic.core.parallel import agree, total
from dolfin_elastic.core.types import AnyArray, BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.body import Body, CadSource, span
from dolfin_elastic.mesh.formats.cad.read import CadModel, open_model
from dolfin_elastic.mesh.geometry.boundary_shape import facet_vertices
from dolfin_elastic.mesh.geometry.curved import cell_gradients, facet_points, quadrature_rule
from dolfin_elastic.mesh.geometry.simplices import (
    boundary_facets,
    cells_beside_facets,
    facet_nodes,
    longest_edges,
    prepare_facets,
)
from dolfin_elastic.mesh.refine.division import Division, lagrange

T = TypeVar("T")
_NEAR = 1e-6
"""Share of the body's diagonal up to which a corner lies on a surface."""
_FAR = 0.6
"""Share of a finer facet's longest edge up to which its nodes are moved."""
_FLAT = 0.1
"""Smallest determinant of a cell's map, over its mean before, that moved nodes may leave."""
_STIFF = 4
"""Springs have stiffnesses of 1/length to this power: with 3 cells in a fillet still folded."""
_SWEEPS, _LAYERS = 40, 4
"""Sweeps of Jacobi's method, and layers of cells round those that fold, in which nodes move."""
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

_Folded = Callable[[FloatArray], BoolArray]
"""Local cells that are flat or fold with their nodes at these places."""


@dataclass(frozen=True)
class _OnSurface:
    """The boundary facets of this rank of the finer mesh.

    Attributes:
        cells, local: The cell of each, and its number in the cell.
        nodes: Local nodes, its corners first, shape (facets, nodes).
        surfaces: The surface of each in the CAD model, 0: none.
        faces: The face of the body that it is on, 0: none.
    """

    cells: IndexArray
    local: IndexArray
    nodes: IndexArray
    surfaces: IntArray
    faces: IntArray


@dataclass(frozen=True)
class Placed:
    """Where the nodes of a finer mesh are after they were moved.

    Attributes:
        x: Places of the local nodes [m].
        surfaces: Number in the CAD model of the surface of each facet of the local cells, 0: of
            none; shape (cells, d + 1).
        off: Largest distance of its nodes from that surface [m], shape (cells, d + 1).
        notes: What is doubtful.
    """

    x: FloatArray
    surfaces: IntArray
    off: FloatArray
    notes: tuple[str, ...]


class CadSurfaces:
    """The surfaces of a CAD file.

    Args:
        source: The file, and metres per unit of it.
    """

    def __init__(self, source: CadSource) -> None:
        self._source = source

    def place(
        self, body: Body, division: Division, space: fem.FunctionSpace, x: FloatArray
    ) -> Placed:
        """Moves the nodes on the boundary of the finer mesh to the surfaces. Collective.

        Args:
            body: The coarse body.  Its corners lie on the surfaces, or it was refined, and is known
                which surface each facet is to lie on.
            space: Scalar Lagrange space whose nodes are those of the finer mesh.
            x: Their places [m] in the shape of the coarse body, ghosts included.

        Raises:
            MeshError: The file cannot be read any more.
        """
        known = body.known_surface
        facets, near = boundary_facets(body.mesh), _NEAR * span(body)
        moved, nearest = x.copy(), x.copy()
        with ExitStack() as opened:

            def classified() -> tuple[_Model, IntArray]:
                source = open_model(self._source.path, self._source.permission)
                model = _Model(opened.enter_context(source), body.dim)
                if known is not None and known.surfaces is not None:
                    return model, known.surfaces
                return model, self._classify(model, body, facets, near)

            model, tags = _on_each_rank(body.comm, classified)
            table = np.zeros((len(division.parents), body.dim + 1))
            if not total(body.comm, int(np.count_nonzero(tags))):
                note = f"the mesh does not lie on the surfaces of {body.source}: it keeps its shape"
                return Placed(x, table.astype(np.int64), table, (note,))
            finer = _finer_facets(body, division, space, facets, tags)
            links = _shared(space, _links(x, finer))
            _on_each_rank(body.comm, lambda: self._project(model, links, moved, nearest))
            _from_owners(space, moved)
            _from_owners(space, nearest)
            folded = _folded(body, space, x)
            if total(body.comm, int(np.count_nonzero(folded(moved)))):
                kept = _kept_nodes(body, division, space, finer)
                _relax(body, space, folded, kept, x, moved)
                _restore_folded(body, space, x, moved)
            away = (moved != nearest).any(axis=1)
            off = _on_each_rank(body.comm, lambda: self._off(model, finer, moved, away))
        off[off <= near] = 0.0
        surfaces = table.astype(np.int64)
        surfaces[finer.cells, finer.local] = finer.surfaces
        table[finer.cells, finer.local] = off.max(axis=1, initial=0.0)
        return Placed(moved, surfaces, table, _notes(body, space, moved, finer, off))

    def _off(
        self, model: _Model, finer: _OnSurface, moved: FloatArray, away: BoolArray
    ) -> FloatArray:
        """Distances [m] of nodes from the surfaces of their facets, shape of `finer.nodes`. Local.

        Args:
            away: Local nodes that are not at the nearest points of their surfaces.
        """
        result = np.zeros(finer.nodes.shape)
        for tag in model.surfaces:
            which = away[finer.nodes] & (finer.surfaces == tag)[:, None]
            if which.any() and not model.is_straight(tag):
                x = _padded(moved[finer.nodes[which]] / self._source.scale)
                result[which] = model.distances(tag, x, np.inf) * self._source.scale
        return result

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

    def _project(
        self, model: _Model, links: _NodeSurfaces, moved: FloatArray, nearest: FloatArray
    ) -> None:
        """Moves nodes to the nearest points of their surfaces or curves. Local.

        Args:
            moved: Places [m] of the local nodes, changed where that point is not far.
            nearest: The same, changed everywhere.
        """
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
            nearest[nodes] = new[:, : moved.shape[1]] * self._source.scale
            chosen = np.array(nodes)[good]
            moved[chosen] = nearest[chosen]


class _Model:
    """The model, as surfaces.

    Args:
        dim: 3, or 2: then its curves are the surfaces.
    """

    def __init__(self, model: CadModel, dim: int) -> None:
        self._model, self._dim = model, dim - 1
        self.surfaces = model.entities(self._dim)

    def is_straight(self, tag: int) -> bool:
        """Whether a surface is a plane, or a curve a line."""
        return self._model.kind(self._dim, tag) in _STRAIGHT

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
        if all(map(self.is_straight, surfaces)) or len(surfaces) > self._dim:
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


def _finer_facets(
    body: Body, division: Division, space: fem.FunctionSpace, facets: IndexArray, tags: IntArray
) -> _OnSurface:
    """The facets of the finer mesh's boundary on this rank, on the surfaces of the coarse ones.

    Args:
        tags: The surface of each of the coarse mesh's `facets`.
    """
    d = body.dim
    of_cells = np.zeros((len(body.mesh.geometry.dofmap), d + 1, 2), dtype=np.int64)
    numbers = np.zeros_like(tags) if body.faces is None else body.faces.numbers_of(facets)
    of_cells[cells_beside_facets(body.mesh, facets)] = np.column_stack([tags, numbers])
    cells, local = cells_beside_facets(division.mesh, boundary_facets(division.mesh))
    closure = lagrange(d, int(body.mesh.geometry.cmap.degree)).entity_closure_dofs[d - 1]
    corners = division.corners[cells[:, None], facet_vertices(d)[local]]
    within = (corners == 0.0).all(axis=1)  # in which facet of the parent
    surfaces, faces = (of_cells[division.parents[cells]] * within[..., None]).sum(axis=1).T
    nodes = np.take_along_axis(space.dofmap.list[cells], np.array(closure)[local], axis=1)
    return _OnSurface(cells, local, nodes, surfaces, faces)


def _links(x: FloatArray, finer: _OnSurface) -> _NodeSurfaces:
    """Surfaces of the nodes on this rank's boundary facets of the finer mesh."""
    links: _NodeSurfaces = {}
    # The first d nodes of a facet are its corners.
    size = longest_edges(x[finer.nodes[:, : x.shape[1]]])
    for row, tag, edge in zip(finer.nodes, finer.surfaces, size, strict=True):
        for node in row if tag else ():
            links.setdefault(int(node), []).append(_NodeSurface(int(tag), float(edge)))
    return links


def _notes(
    body: Body, space: fem.FunctionSpace, x: FloatArray, finer: _OnSurface, off: FloatArray
) -> tuple[str, ...]:
    """A note where nodes are off the surfaces. Collective.

    Args:
        off: Distance [m] of each node of `finer`.
    """
    nodes = np.unique(finer.nodes[off > 0])
    mine = {
        "nodes": space.dofmap.index_map.local_to_global(nodes.astype(np.int32)),
        "faces": np.unique(finer.faces[(off > 0).any(axis=1)]),
        "most": off.max(initial=0.0),
        "place": x[finer.nodes.reshape(-1)[off.argmax()]] if off.size else np.zeros(body.dim),
    }
    every = body.comm.allgather(mine)
    count = len(np.unique(np.concatenate([one["nodes"] for one in every])))
    if not count:
        return ()
    # Of equal distances the same place on any number of ranks.
    most = max(one["most"] for one in every)
    place = min(tuple(one["place"]) for one in every if one["most"] >= most * (1 - 1e-9))
    numbers = sorted({int(n) for one in every for n in one["faces"] if n})
    word = "face" if body.dim == 3 else "curve"
    which = f"{word} {body.faces.listed(numbers)}" if body.faces and numbers else "the surfaces"
    return (
        f"{count} nodes are off {which} of {body.source}, by up to "
        f"{body.unit.length(most)} at {body.unit.point(place)}: elements would fold; a peak of "
        "stress there is not known; a smaller mesh.size, which meshes the file anew, follows it",
    )


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
    cells, index, folded = space.dofmap.list, space.dofmap.index_map, _folded(body, space, x)
    stay = 0
    while True:
        bad = folded(moved)
        if not total(body.comm, int(np.count_nonzero(bad))):
            return int(stay)
        back = marked(index, cells[bad]) & (moved != x).any(axis=1)
        moved[back] = x[back]
        stay += total(body.comm, int(np.count_nonzero(back[: index.size_local])))


def _folded(body: Body, space: fem.FunctionSpace, x: FloatArray) -> _Folded:
    """Tells which local cells are flat or fold where nodes have moved from `x`. Local."""
    order, d, cells = int(body.mesh.geometry.cmap.degree), body.dim, space.dofmap.list
    points = np.concatenate([lagrange(d, order).points, quadrature_rule(d, 4)[0]])
    before = np.linalg.det(cell_gradients(x[cells], order, points))
    mean = before.mean(axis=1, keepdims=True)
    limit = np.minimum(_FLAT, 0.9 * (before / mean).min(axis=1, initial=np.inf))

    def folded(moved: FloatArray) -> BoolArray:
        after = np.linalg.det(cell_gradients(moved[cells], order, points))
        return np.asarray((after / mean).min(axis=1, initial=np.inf) < limit)

    return folded


def _kept_nodes(
    body: Body, division: Division, space: fem.FunctionSpace, finer: _OnSurface
) -> BoolArray:
    """Local nodes on the boundary, named surfaces and faces between bodies. Collective."""
    d, mesh = body.dim, body.mesh
    prepare_facets(mesh)
    of_cells = mesh.topology.connectivity(d, d - 1).array.reshape(-1, d + 1)
    parts = [*body.surfaces.values(), *([] if body.faces is None else [body.faces.facets])]
    named = np.isin(of_cells, np.concatenate([np.empty(0, dtype=np.int32), *parts]))
    closure = lagrange(d, int(mesh.geometry.cmap.degree)).entity_closure_dofs[d - 1]
    vertices, nodes = facet_vertices(d), [finer.nodes.reshape(-1)]
    for i in range(d + 1):
        within = (division.corners[:, vertices[i]] == 0.0).all(axis=1)
        there = (within & named[division.parents]).any(axis=1)
        nodes.append(space.dofmap.list[there][:, closure[i]].reshape(-1))
    return marked(space.dofmap.index_map, np.concatenate(nodes))


def _relax(
    body: Body,
    space: fem.FunctionSpace,
    folded: _Folded,
    kept: BoolArray,
    x: FloatArray,
    moved: FloatArray,
) -> None:
    """Lets nodes within the body follow those of its boundary near cells that fold. Collective.

    Nodes of a cell are joined by springs, the shorter the stiffer, so that a node moves with the
    nearest ones (J. T. Batina, AIAA Journal 28 (1990) 1381, doi:10.2514/3.25229); Jacobi's method.

    Args:
        kept: Local nodes that stay where they are in `moved`.
    """
    index, d, cells = space.dofmap.index_map, body.dim, space.dofmap.list
    free = marked(index, cells[folded(moved)])
    for _ in range(_LAYERS):
        free = marked(index, cells[free[cells].any(axis=1)])
    free &= ~kept
    owned = cells[: space.mesh.topology.index_map(d).size_local]
    owned = owned[free[owned].any(axis=1)]
    lengths = np.linalg.norm(x[owned][:, :, None] - x[owned][:, None], axis=3)
    springs = np.where(lengths > 0, lengths / span(body), np.inf) ** -_STIFF
    work = la.vector(index, d + 1)
    sums = work.array.reshape(-1, d + 1)
    for sweep in range(_SWEEPS):
        if sweep % 10 == 0 and not total(body.comm, int(np.count_nonzero(folded(moved)))):
            return
        steps = np.concatenate([(moved - x)[owned], np.ones((*owned.shape, 1))], axis=2)
        forces = (springs @ steps).reshape(-1, d + 1)
        sums[:] = 0.0
        np.add.at(sums, owned.reshape(-1), forces)
        work.scatter_reverse(la.InsertMode.add)
        work.scatter_forward()
        moved[free] = x[free] + sums[free, :d] / sums[free, d:]
