"""From plain arrays on one rank to a distributed `Body`."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import basix.ufl
import numpy as np
from dolfinx import cpp
from dolfinx.mesh import CellType, GhostMode, Mesh, create_mesh
from mpi4py import MPI

from dolfin_elastic.core.compat import cell_partitioner
from dolfin_elastic.core.errors import InputError, MeshError
from dolfin_elastic.core.files.memory import check_memory
from dolfin_elastic.core.parallel import agree, first_row, total
from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.faces import CadFaces
from dolfin_elastic.mesh.fields import distribute_fields
from dolfin_elastic.mesh.formats.surfaces.options import SURFACES
from dolfin_elastic.mesh.geometry.boundary_shape import KnownSurface
from dolfin_elastic.mesh.geometry.simplices import (
    boundary_facets,
    edge_nodes,
    facet_nodes,
    outward_normals,
    prepare_edges,
    prepare_facets,
)

if TYPE_CHECKING:
    from dolfin_elastic.mesh.formats.raw import RawMesh

LARGE = 1_000_000
"""Cells of a mesh from which on a hint is worth while though there is one process only."""

CAD = (".geo", ".geo_unrolled", ".step", ".stp", ".brep", ".iges", ".igs")
"""Suffixes of files that Gmsh meshes on the fly."""

Permutation = Callable[[CellType, int], IndexArray]
Numbers = TypeVar("Numbers", IntArray, FloatArray)


def is_cad(path: str | os.PathLike[str]) -> bool:
    """Whether Gmsh meshes a file on the fly, by its suffix."""
    return Path(path).suffix.lower() in CAD


def build_body(
    read: Callable[[], RawMesh],
    *,
    comm: MPI.Comm,
    unit: LengthUnit,
    source: str,
    permutation: Permutation = cpp.io.perm_vtk,
) -> Body:
    """Reads a mesh on rank 0, cleans it, and distributes it over all ranks.

    Collective.

    Args:
        read: Called on rank 0 only.
        unit: Unit of length of the file.
        permutation: The node order of quadratic cells: `cpp.io.perm_vtk` or `perm_gmsh`.

    Raises:
        MeshError: The mesh is not fit for use.
    """
    from dolfin_elastic.mesh.formats.cleaning import clean  # a box needs none

    raw = _on_root_only(comm, lambda: clean(replace(read(), unit=unit.name)), source)
    mesh = _distribute(comm, raw, unit.metres, permutation)
    uncovered, incomplete = comm.bcast((raw.uncovered, raw.incomplete) if raw else None)
    notes, information = comm.bcast((raw.notes, raw.information) if raw else None)
    surfaces, edges, points, lost = local_parts(mesh, raw)
    incomplete = {**lost, **incomplete}

    def whole(parts: dict[str, IndexArray]) -> dict[str, IndexArray]:
        return {name: rows for name, rows in parts.items() if name not in incomplete}

    return Body(
        mesh,
        whole(_regions(mesh, raw)),
        whole(surfaces),
        source,
        (*notes, *left_out(incomplete)),
        distribute_fields(mesh, raw),
        edges=whole(edges),
        points=whole(points),
        uncovered=uncovered,
        incomplete=incomplete,
        unit=unit,
        information=(*information, *_one_reader(mesh, source)),
        faces=_faces(mesh, raw, unit),
        known_surface=_known_surface(mesh, raw),
    )


def _one_reader(mesh: Mesh, source: str) -> list[str]:
    """A hint where one rank has read what all could read."""
    cells, ranks = mesh.topology.index_map(mesh.topology.dim).size_global, mesh.comm.size
    if Path(source).suffix.lower() in (*CAD, *SURFACES) or (ranks == 1 and cells < LARGE):
        return []
    readers = f"one of {ranks} ranks" if ranks > 1 else "one process, with its memory"
    new = Path(source).stem + (".xdmf" if Path(source).suffix != ".xdmf" else "_shared.xdmf")
    return [f"read by {readers}; 'dolfin-elastic convert {source} {new}' makes one that all share"]


def local_parts(
    mesh: Mesh, raw: RawMesh | None
) -> tuple[dict[str, IndexArray], dict[str, IndexArray], dict[str, IndexArray], dict[str, str]]:
    """Local facets, edges and nodes of named parts, shared ones included. Collective.

    Args:
        mesh: The mesh; it knows the points of the file by their rows.
        raw: The content of the file, on rank 0 only.

    Returns:
        Surfaces, edges, points; and name to reason of those of which members are missing.
    """
    surfaces, lost = _entities(mesh, raw.surfaces if raw else None, mesh.topology.dim - 1)
    edges, lost_edges = _entities(mesh, raw.edges if raw else None, 1)
    return surfaces, edges, _points(mesh, raw.nodes if raw else None), {**lost, **lost_edges}


def left_out(incomplete: Mapping[str, str]) -> list[str]:
    """A note on the parts that are not whole, if there are any."""
    reasons = "; ".join(f"'{name}' ({reason})" for name, reason in incomplete.items())
    return [f"incomplete named parts (left out): {reasons}"] if reasons else []


def _with_advice(error: InputError) -> InputError:
    """The error of a reader; one that says nothing else is about a damaged file."""
    anew = "save the mesh anew, or in another format"
    return error if error.expected else MeshError(error.what, where=error.where, expected=anew)


def _on_root_only(comm: MPI.Comm, action: Callable[[], RawMesh], source: str) -> RawMesh | None:
    """Result of rank 0, which is not broadcast since it may be large; errors raise on all."""
    raw: RawMesh | None = None
    error: Exception | None = None
    if comm.rank == 0:
        try:
            raw = action()
        except MeshError as caught:
            error = _with_advice(caught if caught.where else caught.at(source))
        except MemoryError:
            error = MeshError(
                "the mesh does not fit into the memory of one process",
                where=source,
                expected="convert it to XDMF, which is read in parts",
            )
        except OSError as caught:
            error = MeshError(
                f"cannot be read: {caught.strerror or caught}",
                where=source,
                expected="a file that you may read",
            )
        except Exception as caught:  # raised again on all ranks just below
            error = caught
    agree(comm, error)
    return raw


def _distribute(
    comm: MPI.Comm, raw: RawMesh | None, scale: float, permutation: Permutation
) -> Mesh:
    dim, order, width = comm.bcast((raw.dim, raw.order, raw.cells.shape[1]) if raw else None)
    nodes = permutation(CellType.tetrahedron if dim == 3 else CellType.triangle, width)

    def cells_of(rows: slice) -> IntArray:
        assert raw is not None
        return np.ascontiguousarray(raw.cells[rows][:, nodes], dtype=np.int64)

    def points_of(rows: slice) -> FloatArray:
        assert raw is not None
        return np.ascontiguousarray(raw.points[rows] * scale, dtype=np.float64)

    cells = _spread(comm, len(raw.cells) if raw else None, cells_of)
    x = _spread(comm, len(raw.points) if raw else None, points_of)
    return make_mesh(comm, cells, x, order)


def _spread(comm: MPI.Comm, rows: int | None, part: Callable[[slice], Numbers]) -> Numbers:
    """This rank's part of rows that rank 0 has, and sends to one rank after the other. Collective.

    Args:
        rows: Their number; None on other ranks than 0.
        part: Gives some of them; called on rank 0 only.
    """
    if rows is None:
        return comm.recv(source=0)
    ends = [first_row(comm, rows, rank) for rank in range(comm.size + 1)]
    for rank in range(1, comm.size):
        comm.send(part(slice(ends[rank], ends[rank + 1])), dest=rank)
    return part(slice(0, ends[1]))


BYTES = {2: 300, 3: 460}
"""Memory per element of a straight mesh with its facets [byte], by dimension.

Measured as the growth of resident memory up to its peak, of generated meshes on one rank: 3.2e5
triangles of a square took 244 each; 3.8e5 tetrahedra of a cube 417, of a row of cubes 460.
"""


def before_partitioning(comm: MPI.Comm) -> None:
    """Makes the partitioning that follows reproducible. Collective."""
    # PT-Scotch's threads race: 10 of 1500 times the same body was partitioned in another way.
    os.environ.setdefault("SCOTCH_PTHREAD_NUMBER", "1")
    # DOLFINx 0.9 may mix up messages of two meshes made in a row (fixed in 0.10, #3512).
    comm.barrier()


def make_mesh(comm: MPI.Comm, cells: IntArray, x: FloatArray, order: int) -> Mesh:
    """Distributes cells without ghosts, and creates the facets. Collective.

    Args:
        cells: This rank's share of the cells, in DOLFINx's node order.
        x: This rank's share of the points, in metres, shape (n, 2) or (n, 3).
        order: Geometric degree, 1 or 2.
    """
    dim = x.shape[1]
    number = float(total(comm, len(cells)))
    check_memory(comm, number, BYTES[dim], where="", expected="a coarser mesh")
    kind = "tetrahedron" if dim == 3 else "triangle"
    element = basix.ufl.element("Lagrange", kind, order, shape=(dim,))
    before_partitioning(comm)
    mesh = create_mesh(
        comm, cells=cells, x=x, e=element, partitioner=cell_partitioner(GhostMode.none)
    )
    prepare_facets(mesh)
    return mesh


def _regions(mesh: Mesh, raw: RawMesh | None) -> dict[str, IndexArray]:
    """Local cells of each region; rank 0 broadcasts one bit per cell of the file."""
    comm, result = mesh.comm, dict[str, IndexArray]()
    original = np.asarray(mesh.topology.original_cell_index)
    for name in comm.bcast(list(raw.regions) if raw else None):
        bits = None
        if raw is not None:
            inside = np.zeros(len(raw.cells), dtype=bool)
            inside[raw.regions[name]] = True
            bits = np.packbits(inside)
        bits = np.asarray(comm.bcast(bits))
        inside = (bits[original >> 3] >> (7 - (original & 7)) & 1).astype(bool)
        result[name] = np.flatnonzero(inside).astype(np.int32)
    return result


def _faces(mesh: Mesh, raw: RawMesh | None, unit: LengthUnit) -> CadFaces | None:
    """The faces of the CAD model that was meshed, and the local facets on them. Collective."""
    faces = mesh.comm.bcast(raw.faces if raw else None)
    if not faces:
        return None
    d = mesh.topology.dim
    cad = CadFaces({face.number: face for face in faces}, d, unit)
    of_faces, _ = _entities(mesh, raw.face_facets if raw else None, d - 1)
    if not of_faces:
        return cad
    facets = np.concatenate(list(of_faces.values()))
    numbers = np.repeat(list(of_faces), [len(rows) for rows in of_faces.values()])
    order = np.argsort(facets, kind="stable")
    facets, numbers = facets[order], numbers[order]
    own = facets < mesh.topology.index_map(d - 1).size_local
    inner = set(numbers[own & ~np.isin(facets, boundary_facets(mesh))].tolist())
    inside = frozenset[int]().union(*mesh.comm.allgather(inner))
    return replace(cad, facets=facets, numbers=numbers, inside=inside)


def _known_surface(mesh: Mesh, raw: RawMesh | None) -> KnownSurface | None:
    """The normals of CAD faces at the corners of the boundary's facets. Collective.

    The normals of a face may point to either side: here they point out of the body.
    """
    comm, d = mesh.comm, mesh.topology.dim
    if not comm.bcast(len(raw.face_normals) if raw else None):
        return None
    facets = boundary_facets(mesh)
    rows = np.asarray(mesh.geometry.input_global_indices)[facet_nodes(mesh, facets)]
    rows = rows.reshape(-1, d)
    order = np.argsort(rows, axis=1)
    table = _Table(np.take_along_axis(rows, order, axis=1))
    sorted_ones = np.full((len(facets), d, d), np.nan)
    given: list[tuple[AnyArray, ...]] | None = None
    if raw is not None:
        given = [(raw.face_facets[n], one) for n, one in raw.face_normals.items()]
    for _, (vertices, normals) in _from_root(comm, given):
        turn = np.argsort(vertices, axis=1)
        at = table.find(np.take_along_axis(vertices, turn, axis=1))
        here = np.take_along_axis(normals[..., :d], turn[..., None], axis=1)
        sorted_ones[at[at >= 0]] = here[at >= 0]
    result = np.full_like(sorted_ones, np.nan)
    np.put_along_axis(result, order[..., None], sorted_ones, axis=1)
    outward = np.einsum("fkj,fj->f", result, outward_normals(mesh, facets)) >= 0
    return KnownSurface(
        np.where(outward[:, None, None], result, -result),
        None,
        np.full(len(facets), np.nan),
        np.zeros(len(facets)),
    )


AT_ONCE = 1 << 16
"""Rows that rank 0 sends to all at a time: no rank has the names of the whole surface."""

Key = TypeVar("Key", str, int)


def _from_root(
    comm: MPI.Comm, tables: Sequence[tuple[AnyArray, ...]] | None
) -> Iterator[tuple[IntArray, tuple[AnyArray, ...]]]:
    """The rows of tables of rank 0, some at a time, on all ranks. Collective.

    Args:
        comm: The ranks that share the mesh.
        tables: Arrays with as many rows each; on rank 0 only.

    Yields:
        The number of the table of each row, and the rows, of which those of small tables come
        together.
    """
    ends = np.cumsum(comm.bcast([0, *(len(t[0]) for t in tables)] if tables is not None else None))
    for first in range(0, int(ends[-1]), AT_ONCE):
        numbers = np.arange(first, min(first + AT_ONCE, int(ends[-1])))
        rows, of = None, np.searchsorted(ends, numbers, side="right") - 1
        if tables is not None:
            parts = [
                [one[max(0, first - ends[k]) : max(0, first + AT_ONCE - ends[k])] for one in table]
                for k, table in enumerate(tables)
                if of[0] <= k <= of[-1]
            ]
            rows = tuple(map(np.concatenate, zip(*parts, strict=True)))
        yield of, comm.bcast(rows)


class _Table:
    """Finds rows of numbers among some that are all different. Local.

    Column by column: what was found of a row so far has a number, which with that of the next
    column makes one number that is searched for among the sorted ones.

    Args:
        rows: Numbers that are not negative, shape (n, k).
    """

    def __init__(self, rows: IntArray) -> None:
        self._base, self._levels = int(rows.max(initial=0)) + 1, list[IntArray]()
        code: AnyArray = np.zeros(len(rows), dtype=np.int64)
        for column in rows.T:
            level, code = np.unique(code * self._base + column, return_inverse=True)
            self._levels.append(level)
        self._order = np.argsort(code.reshape(-1))

    def find(self, rows: IntArray) -> IntArray:
        """Index of each row, or -1, shape (m,).

        Args:
            rows: Shape (m, k).
        """
        from dolfin_elastic.mesh.formats.raw import find

        code: IntArray = np.zeros(len(rows), dtype=np.int64)
        for level, column in zip(self._levels, rows.T, strict=True):
            known = (code >= 0) & (column < self._base)
            code = find(level, np.where(known, code * self._base + column, -1))
        return np.where(code >= 0, self._order[code], -1) if len(self._order) else code


def _entities(
    mesh: Mesh, named: Mapping[Key, IntArray] | None, dim: int
) -> tuple[dict[Key, IndexArray], dict[Key, str]]:
    """Local facets or edges of each name, shared ones included, and messages about missing ones.

    Collective.

    Args:
        named: Name to the vertices of each, by their rows in the file; on rank 0 only.
    """
    comm = mesh.comm
    wanted: dict[Key, IntArray] = {}
    if named is not None:
        wanted = {n: np.unique(np.sort(e, axis=1), axis=0) for n, e in named.items()}
    sizes = comm.bcast({n: len(rows) for n, rows in wanted.items()})
    if not any(sizes.values()):
        return {}, {}
    entities, keys = _candidates(mesh, None if named is None else list(named.values()), dim)
    table, found = _Table(keys), list[tuple[IntArray, IntArray]]()
    missed: IntArray = np.zeros(len(sizes), dtype=np.int64)
    tables = None if named is None else [(rows,) for rows in wanted.values()]
    for of, (rows,) in _from_root(comm, tables):
        at = table.find(rows)
        hit = np.ascontiguousarray(at >= 0, dtype=np.int32)
        found.append((of[at >= 0], at[at >= 0]))
        comm.Allreduce(MPI.IN_PLACE, hit, op=MPI.MAX)
        missed += np.bincount(of[hit == 0], minlength=len(sizes))
    things = "facets" if dim == mesh.topology.dim - 1 else "edges"
    parts, lost = {}, {}
    of, at = map(np.concatenate, zip(*found, strict=True))
    here = np.split(at, np.searchsorted(of, np.arange(1, len(sizes))))
    for (name, size), count, rows in zip(sizes.items(), missed, here, strict=True):
        if count < size:
            parts[name] = np.sort(entities[rows]).astype(np.int32)
        if count:
            lost[name] = f"{count} of its {size} {things} are no {things} of an element"
    return parts, lost


def _candidates(
    mesh: Mesh, wanted: Sequence[IntArray] | None, dim: int
) -> tuple[IndexArray, IntArray]:
    """Local facets or edges whose vertices all are among those of some rows. Collective.

    Args:
        wanted: Rows of vertices, by their rows in the file; on rank 0 only, which sends one bit
            for each point of the file.
    """
    bits = None
    if wanted is not None:
        inside = np.zeros(max(int(rows.max(initial=0)) for rows in wanted) + 1, dtype=bool)
        for rows in wanted:
            inside[rows] = True
        bits = np.packbits(inside)
    bits = np.asarray(mesh.comm.bcast(bits))
    facets = dim == mesh.topology.dim - 1
    if not facets:
        prepare_edges(mesh)
    index = mesh.topology.index_map(dim)
    every = np.arange(index.size_local + index.num_ghosts, dtype=np.int32)
    if len(every) == 0:
        return every, np.empty((0, dim + 1), dtype=np.int64)
    vertices = (facet_nodes if facets else edge_nodes)(mesh, every)
    known = np.asarray(mesh.geometry.input_global_indices)
    marked = np.zeros(len(known), dtype=bool)
    within = known < 8 * len(bits)
    marked[within] = bits[known[within] >> 3] >> (7 - (known[within] & 7)) & 1
    chosen = marked[vertices].all(axis=1)
    return every[chosen], np.sort(known[vertices[chosen]], axis=1)


def _points(mesh: Mesh, named: Mapping[str, IntArray] | None) -> dict[str, IndexArray]:
    """Local geometry nodes of each name, by their rows in the file on rank 0. Collective."""
    rows, result = np.asarray(mesh.geometry.input_global_indices), dict[str, list[IntArray]]()
    names = mesh.comm.bcast(None if named is None else list(named))
    tables = None if named is None else [(nodes,) for nodes in named.values()]
    for of, (nodes,) in _from_root(mesh.comm, tables):
        for k in np.unique(of):
            here = np.flatnonzero(np.isin(rows, nodes[of == k]))
            result.setdefault(names[k], []).append(here)
    return {name: np.unique(np.concatenate(at)).astype(np.int32) for name, at in result.items()}
