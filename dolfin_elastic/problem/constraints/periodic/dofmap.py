"""Faces of a body that are one: spaces whose nodes on paired faces are the same unknown.

A periodic field has one value at the two ends of a lattice vector.  So the nodes of paired faces
are merged in the map of unknowns itself: what is assembled, solved and exchanged between ranks
knows nothing of it.  Nodes on several faces, at edges and corners, are merged through the chain of
their pairs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from dolfinx import cpp, fem, la
from mpi4py import MPI

from dolfin_elastic.core.compat import adjacency, make_index_map, space_like
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.body import Body, connected_components, span

NEAR = 1e-6
"""Distance over the body's diagonal within which two nodes are the same."""


@dataclass(frozen=True)
class Field:
    """One field of a space: a vector or a scalar, whose nodes have places.

    Attributes:
        space: Lagrange space of the field alone.
        entries: Local indices of the whole space's map, one row a node of `space`; the fields of
            a row are merged with those of the other row.
        groups: Where the field jumps between groups of cells: the group of each of the entries of
            a node, of the shape of `entries`, both -1 where a node has fewer.  Then an entry is
            merged with that of the same group.
    """

    space: fem.FunctionSpace
    entries: IndexArray
    groups: IntArray | None = None


@dataclass(frozen=True)
class MergedDofmap:
    """A space whose nodes on paired faces are merged.

    Attributes:
        space: The space.
        new: Local index of the plain space's map to that of this one, owned and ghost.
    """

    space: fem.FunctionSpace
    new: IndexArray


@dataclass(frozen=True)
class _Points:
    """Nodes of a surface from all ranks: places, global indices and groups, one row a node."""

    x: FloatArray
    index: IntArray
    group: IntArray

    def joined(self, other: _Points, match: IntArray) -> IntArray:
        """Pairs of global indices that are one, shape (pairs, 2).

        Args:
            match: Which of its nodes each of these is one with.
        """
        index, group = other.index[match], other.group[match]
        same = (self.group[:, :, None] == group[:, None, :]) & (self.group[:, :, None] >= 0)
        node, here, there = np.nonzero(same)
        return np.column_stack([index[node, there], self.index[node, here]])


class PeriodicPairing:
    """Pairs of surfaces that are one another's images. Collective.

    Args:
        pairs: Two surfaces each: from the first to the second is a lattice vector.

    Attributes:
        vectors: Lattice vectors [m], one row a pair.
        volume: Of the parallelepiped they span, holes included [m^dim].
        corner: The vertex whose displacement is fixed [m].
        face_nodes: How many vertices a face has, on average.

    Raises:
        MeshError: A surface does not exist.
        InputError: The faces are no images of one another, or do not span the space.
    """

    def __init__(self, body: Body, pairs: Sequence[Sequence[str]]) -> None:
        self.body, self.pairs = body, tuple(tuple(pair) for pair in pairs)
        self._near = NEAR * span(body)
        self._facets = [[body.surface(name) for name in pair] for pair in self.pairs]
        vertices = fem.functionspace(body.mesh, ("Lagrange", 1))
        ends = [self._ends(plain(vertices), k) for k in range(len(self.pairs))]
        self._check_not_empty(ends)
        self.vectors = np.array([_middle(b.x) - _middle(a.x) for a, b in ends])[:, : body.dim]
        self._check_count()
        self.volume = float(abs(np.linalg.det(self.vectors)))
        self.corner = _first_corner(np.concatenate([a.x for a, _ in ends]))
        self.face_nodes = float(np.mean([len(a.x) for a, _ in ends]))
        # Faces of which one is no image of the other are named before what they make of the cell.
        self._edges(vertices, [plain(vertices)])
        self._check_span()

    def _check_not_empty(self, ends: Sequence[tuple[_Points, _Points]]) -> None:
        for k, pair in enumerate(ends):
            for i, points in enumerate(pair):
                if not len(points.x):
                    raise InputError(
                        f"the surface '{self.pairs[k][i]}' is empty",
                        where=f"periodic.pairs[{k}]",
                        expected="a surface with facets",
                    )

    def _check_count(self) -> None:
        dim = self.body.dim
        if len(self.pairs) != dim:
            raise InputError(
                f"{len(self.pairs)} pairs of surfaces given",
                where="periodic.pairs",
                expected=f"{dim} pairs: a cell is repeated along each of its {dim} directions",
            )

    def _check_span(self) -> None:
        scale = np.linalg.norm(self.vectors, axis=1)
        if abs(np.linalg.det(self.vectors)) <= 1e-6 * np.prod(scale):
            shown = "; ".join(_shown(vector) for vector in self.vectors)
            raise InputError(
                f"the vectors from face to face do not span the space: {shown} m",
                where="periodic.pairs",
                expected="opposite faces of the cell in each pair, each pair once",
            )

    # --- spaces ---

    def merged(self, V: fem.FunctionSpace, fields: Sequence[Field] | None = None) -> MergedDofmap:
        """The space with the nodes of paired faces merged. Collective.

        Args:
            V: A Lagrange space, or a mixed one.
            fields: What a mixed space consists of; fields that are not named have no nodes on
                faces.

        Raises:
            InputError: A node of one face has no image on the other.
        """
        fields = [plain(V)] if fields is None else list(fields)
        comm = self.body.comm
        ids, root = _classes(self._edges(V, fields))
        owner, number, (offset, count) = _renumbered(comm, V.dofmap.index_map, ids, root)
        local = owner == comm.rank
        ghosts, first, back = np.unique(number[~local], return_index=True, return_inverse=True)
        new = np.empty(len(number), dtype=np.int32)
        new[local] = number[local] - offset
        new[~local] = count + back
        index_map = make_index_map(comm, count, ghosts, owner[~local][first])
        return MergedDofmap(_space(V, index_map, new), new)

    def _edges(self, V: fem.FunctionSpace, fields: Sequence[Field]) -> IntArray:
        """Pairs of global indices that are one, shape (pairs, 2), the same on all ranks."""
        result = []
        for field in fields:
            for k, vector in enumerate(self.vectors):
                a, b = self._ends(field, k, V)
                match = self._match(a.x, b.x, vector, k)
                result.append(b.joined(a, match))
        return np.concatenate(result)

    def _ends(
        self, field: Field, k: int, V: fem.FunctionSpace | None = None
    ) -> tuple[_Points, _Points]:
        """Nodes of the two faces of a pair, from all ranks. Collective."""
        first, second = (
            self._points(field, V or field.space, facets) for facets in self._facets[k]
        )
        return first, second

    def _points(self, field: Field, V: fem.FunctionSpace, facets: IndexArray) -> _Points:
        tdim, imap, comm = self.body.mesh.topology.dim, V.dofmap.index_map, self.body.comm
        nodes = fem.locate_dofs_topological(field.space, tdim - 1, facets)
        nodes = nodes[field.entries[nodes].max(axis=1, initial=-1) < imap.size_local]
        x, entries = field.space.tabulate_dof_coordinates()[nodes], field.entries[nodes]
        index = imap.local_to_global(np.maximum(entries, 0).reshape(-1)).reshape(entries.shape)
        group = np.broadcast_to(np.arange(entries.shape[1]), entries.shape)
        if field.groups is not None:
            group = field.groups[nodes]
        return _Points(*(_gathered(comm, table) for table in (x, index, group)))

    def _match(self, a: FloatArray, b: FloatArray, vector: FloatArray, k: int) -> IntArray:
        """Index in a of the image of each point of b."""
        from scipy.spatial import cKDTree

        shift = np.zeros(3)
        shift[: len(vector)] = vector
        for here, there, way, side in ((a, b, shift, 0), (b, a, -shift, 1)):
            distance, match = cKDTree(there).query(here + way)
            bad = np.flatnonzero(distance > self._near)
            if len(bad):
                first = bad[np.lexsort(here[bad].T[::-1])[0]]
                place = np.where(np.abs(here[first]) < self._near, 0.0, here[first])
                raise InputError(
                    f"the node of '{self.pairs[k][side]}' at {_shown(place[: len(vector)])} m has "
                    f"no image on '{self.pairs[k][1 - side]}': the nearest node is "
                    f"{distance[first]:.3g} m from where it should be ({len(bad)} of {len(here)} "
                    "nodes have none)",
                    where=f"periodic.pairs[{k}]",
                    expected="two faces with the same mesh, shifted by one vector (in Gmsh: "
                    "Periodic Surface)",
                )
        return np.asarray(match, dtype=np.int64)

    def places(self, V: fem.FunctionSpace, merged: MergedDofmap) -> FloatArray:
        """Places [m] of the nodes of a merged space, ghosts too, shape (n, 3). Collective.

        Of a node with several places it is that nearest to the origin, and of equally near ones the
        first along x, then y, then z: the same on any number of ranks.

        Args:
            merged: The same with merged nodes.
        """
        imap, x = merged.space.dofmap.index_map, V.tabulate_dof_coordinates()
        result = np.empty((imap.size_local + imap.num_ghosts, 3))
        result[merged.new] = x
        ids, coordinates = self._images(x, V, merged)
        nodes, group = np.unique(ids, return_inverse=True)
        kept = np.ones(len(ids), dtype=bool)
        for key in (np.linalg.norm(coordinates, axis=1), *coordinates.T):
            least = np.full(len(nodes), np.inf)
            np.minimum.at(least, group[kept], key[kept])
            kept &= key <= least[group] + self._near
        first = np.empty((len(nodes), 3))
        first[group[kept]] = coordinates[kept]
        numbers = imap.local_to_global(np.arange(len(result), dtype=np.int32))
        on_faces = np.isin(numbers, nodes)
        result[on_faces] = first[np.searchsorted(nodes, numbers[on_faces])]
        return result

    def _images(
        self, x: FloatArray, V: fem.FunctionSpace, merged: MergedDofmap
    ) -> tuple[IntArray, FloatArray]:
        """Merged global index and place [m] of each node of the faces, from all ranks."""
        imap, comm, low = merged.space.dofmap.index_map, self.body.comm, self.body.dim - 1
        faces = [facets for pair in self._facets for facets in pair]
        nodes = np.unique(
            np.concatenate([fem.locate_dofs_topological(V, low, facets) for facets in faces])
        )
        nodes = nodes[nodes < V.dofmap.index_map.size_local]
        ids = imap.local_to_global(merged.new[nodes])
        return np.concatenate(comm.allgather(ids)), np.concatenate(comm.allgather(x[nodes]))

    # --- the fixed vertex ---

    def corner_nodes(self, V: fem.FunctionSpace, merged: MergedDofmap) -> IndexArray:
        """Local nodes that are the fixed vertex or its images. Collective.

        Args:
            merged: The same with merged nodes.
        """
        x = V.tabulate_dof_coordinates()
        here = np.flatnonzero(np.linalg.norm(x - self.corner, axis=1) <= self._near)
        local = merged.space.dofmap.index_map.local_to_global(merged.new[here])
        pinned = np.unique(np.concatenate(self.body.comm.allgather(local)))
        nodes = merged.space.dofmap.index_map.local_to_global(merged.new)
        return np.flatnonzero(np.isin(nodes, pinned)).astype(np.int32)


def plain(V: fem.FunctionSpace) -> Field:
    """A Lagrange space as the one field that it consists of."""
    imap = V.dofmap.index_map
    return Field(V, np.arange(imap.size_local + imap.num_ghosts, dtype=np.int32)[:, None])


def _gathered(comm: MPI.Comm, rows: AnyArray) -> AnyArray:
    """Rows of all ranks, of which some may have fewer columns: filled up with -1. Collective."""
    width = max(comm.allgather(rows.shape[1]))
    filled = np.pad(rows, ((0, 0), (0, width - rows.shape[1])), constant_values=-1)
    return np.concatenate(comm.allgather(filled))


def _middle(x: FloatArray) -> FloatArray:
    return np.asarray((x.max(axis=0) + x.min(axis=0)) / 2)


def _first_corner(x: FloatArray) -> FloatArray:
    """The point that comes first along a direction in which no two corners are alike."""
    return np.asarray(x[np.argmin((x - x.min(axis=0)) @ np.array([1.0, 1.0831, 1.1937]))])


def _shown(vector: FloatArray) -> str:
    return "(" + ", ".join(f"{x:.6g}" for x in vector) + ")"


def _classes(edges: IntArray) -> tuple[IntArray, IntArray]:
    """Global indices in pairs, sorted, and the smallest index of the class of each."""
    ids, flat = np.unique(edges, return_inverse=True)
    _, label = connected_components(len(ids), flat.reshape(edges.shape))
    _, first = np.unique(label, return_index=True)  # the first of a class is its smallest
    return ids, ids[first[label]]


def _renumbered(
    comm: MPI.Comm, imap: cpp.common.IndexMap, ids: IntArray, root: IntArray
) -> tuple[IndexArray, IntArray, tuple[int, int]]:
    """Owner and new global index of each local index; first and number of this rank's. Collective.

    Args:
        comm: The ranks that share the space.
        ids: Global indices that are in pairs, sorted.
        root: What each of them becomes one with.
    """
    size, (start, end) = imap.size_local, imap.local_range
    first = np.ones(size, dtype=bool)
    first[ids[(root != ids) & (ids >= start) & (ids < end)] - start] = False
    count = int(first.sum())
    offset = sum(comm.allgather(count)[: comm.rank])
    numbers = la.vector(imap, 1, dtype=np.int64)
    numbers.array[:size] = np.where(first, offset + np.cumsum(first) - 1, -1)
    numbers.scatter_forward()
    new = numbers.array.copy()
    owner = np.concatenate([np.full(size, comm.rank, dtype=np.int32), imap.owners])
    # What is in pairs takes number and owner of its root, which may live on any rank.
    here = (root >= start) & (root < end)
    about = np.full((2, len(ids)), -1, dtype=np.int64)
    about[0, here], about[1, here] = new[root[here] - start], comm.rank
    comm.Allreduce(MPI.IN_PLACE, about, op=MPI.MAX)
    old = imap.local_to_global(np.arange(size + imap.num_ghosts, dtype=np.int32))
    paired = np.isin(old, ids)
    offsets = np.searchsorted(ids, old[paired])
    new[paired], owner[paired] = about[:, offsets]
    return owner, new, (offset, count)


def _space(
    V: fem.FunctionSpace, index_map: cpp.common.IndexMap, new: IndexArray
) -> fem.FunctionSpace:
    dofmap = V.dofmap
    cells = adjacency(np.ascontiguousarray(new[dofmap.list], dtype=np.int32))
    merged = cpp.fem.DofMap(dofmap.dof_layout, index_map, dofmap.index_map_bs, cells, dofmap.bs)
    made = space_like(V, merged)
    return fem.FunctionSpace(V.mesh, V.ufl_element(), made)
