"""From plain arrays on one rank to a distributed `Body`."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import basix.ufl
import numpy as np
from dolfinx import cpp
from dolfinx.mesh import CellType, GhostMode, Mesh, create_mesh
from mpi4py import MPI

from dolfin_elastic.core.compat import cell_partitioner
from dolfin_elastic.core.errors import InputError, MeshError
from dolfin_elastic.core.files.memory import check_memory
from dolfin_elastic.core.parallel import agree, total
from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray
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
    facets, ends, nodes, uncovered, incomplete = comm.bcast(
        (raw.surfaces, raw.edges, raw.nodes, raw.uncovered, raw.incomplete) if raw else None
    )
    notes, information = comm.bcast((raw.notes, raw.information) if raw else None)
    surfaces, edges, points, lost = local_parts(mesh, facets, ends, nodes)
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
    mesh: Mesh,
    facets: Mapping[str, IntArray],
    ends: Mapping[str, IntArray],
    nodes: Mapping[str, IntArray],
) -> tuple[dict[str, IndexArray], dict[str, IndexArray], dict[str, IndexArray], dict[str, str]]:
    """Local facets, edges and nodes of named parts, shared ones included. Collective.

    Args:
        mesh: The mesh; it knows the points of the file by their rows.
        facets: Name of a surface to the vertices of its facets; all by their rows in the file, and
            the same on all ranks.
        ends: Name of an edge to the vertices of its mesh edges; in three dimensions only.
        nodes: Name of a point to its nodes.

    Returns:
        Surfaces, edges, points; and name to reason of those of which members are missing.
    """
    surfaces, lost = _entities(mesh, facets, mesh.topology.dim - 1)
    edges, lost_edges = _entities(mesh, ends, 1)
    return surfaces, edges, _points(mesh, nodes), {**lost, **lost_edges}


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
    kind = CellType.tetrahedron if dim == 3 else CellType.triangle
    if raw is not None:
        cells = np.ascontiguousarray(raw.cells[:, permutation(kind, width)])
        x = np.ascontiguousarray(raw.points * scale, dtype=np.float64)
    else:
        cells, x = np.empty((0, width), dtype=np.int64), np.empty((0, dim))
    return make_mesh(comm, cells, x, order)


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
    faces, of_faces = mesh.comm.bcast((raw.faces, raw.face_facets) if raw else None)
    if not faces:
        return None
    from dolfin_elastic.mesh.formats.raw import match_rows

    known = {face.number: face for face in faces}
    cad = CadFaces(known, mesh.topology.dim, unit)
    if not of_faces:
        return cad
    vertices = np.sort(np.concatenate(list(of_faces.values())), axis=1)
    numbers = np.repeat(list(of_faces), [len(rows) for rows in of_faces.values()])
    facets, keys = _candidates(mesh, np.unique(vertices), mesh.topology.dim - 1)
    at = match_rows(vertices, keys) if len(keys) else np.empty(0, dtype=np.int64)
    facets, numbers = facets[at >= 0], numbers[at[at >= 0]]
    own = facets < mesh.topology.index_map(mesh.topology.dim - 1).size_local
    inner = set(numbers[own & ~np.isin(facets, boundary_facets(mesh))].tolist())
    inside = frozenset[int]().union(*mesh.comm.allgather(inner))
    return replace(cad, facets=facets, numbers=numbers, inside=inside)


def _known_surface(mesh: Mesh, raw: RawMesh | None) -> KnownSurface | None:
    """The normals of CAD faces at the corners of the boundary's facets. Collective.

    The normals of a face may point to either side: here they point out of the body.
    """
    of_faces, of_each = mesh.comm.bcast((raw.face_facets, raw.face_normals) if raw else None)
    if not of_each:
        return None
    from dolfin_elastic.mesh.formats.raw import match_rows

    d = mesh.topology.dim
    vertices = np.concatenate([of_faces[n] for n in of_each])
    given = np.concatenate(list(of_each.values()))[..., :d]
    order = np.argsort(vertices, axis=1)
    vertices = np.take_along_axis(vertices, order, axis=1)
    given = np.take_along_axis(given, order[..., None], axis=1)
    facets = boundary_facets(mesh)
    result = np.full((len(facets), d, d), np.nan)
    if len(facets) and len(vertices):
        own = np.asarray(mesh.geometry.input_global_indices)[facet_nodes(mesh, facets)]
        order = np.argsort(own, axis=1)
        at = match_rows(vertices, np.take_along_axis(own, order, axis=1))
        sorted_ones = np.where((at >= 0)[:, None, None], given[at], np.nan)
        np.put_along_axis(result, order[..., None], sorted_ones, axis=1)
    outward = np.einsum("fkj,fj->f", result, outward_normals(mesh, facets)) >= 0
    return KnownSurface(
        np.where(outward[:, None, None], result, -result), None, np.full(len(facets), np.nan)
    )


def _entities(
    mesh: Mesh, named: Mapping[str, IntArray], dim: int
) -> tuple[dict[str, IndexArray], dict[str, str]]:
    """Local facets or edges of each name, shared ones included, and messages about missing ones.

    Collective.

    Args:
        named: Name to the vertices of each, by their rows in the file; the same on all ranks.
    """
    if not named:
        return {}, {}
    from dolfin_elastic.mesh.formats.raw import match_rows

    rows = np.unique(np.concatenate([f.ravel() for f in named.values()]))
    entities, keys = _candidates(mesh, rows, dim)
    things = "facets" if dim == mesh.topology.dim - 1 else "edges"
    parts, lost = {}, {}
    for name, ends in named.items():
        wanted = np.unique(np.sort(ends, axis=1), axis=0)
        at = match_rows(keys, wanted)
        hit = np.ascontiguousarray(at >= 0, dtype=np.int32)
        mesh.comm.Allreduce(MPI.IN_PLACE, hit, op=MPI.MAX)
        missed = int(np.count_nonzero(hit == 0))
        if missed < len(wanted):
            parts[name] = np.sort(entities[at[at >= 0]]).astype(np.int32)
        if missed:
            lost[name] = f"{missed} of its {len(wanted)} {things} are no {things} of an element"
    return parts, lost


def _candidates(mesh: Mesh, nodes: IntArray, dim: int) -> tuple[IndexArray, IntArray]:
    """Local facets or edges whose vertices are all in a set of rows of the file. Collective."""
    facets = dim == mesh.topology.dim - 1
    if not facets:
        prepare_edges(mesh)
    index = mesh.topology.index_map(dim)
    every = np.arange(index.size_local + index.num_ghosts, dtype=np.int32)
    if len(every) == 0:
        return every, np.empty((0, dim + 1), dtype=np.int64)
    vertices = (facet_nodes if facets else edge_nodes)(mesh, every)
    original = np.asarray(mesh.geometry.input_global_indices)[vertices]
    inside = np.isin(original, nodes).all(axis=1)
    return every[inside], np.sort(original[inside], axis=1)


def _points(mesh: Mesh, named: Mapping[str, IntArray]) -> dict[str, IndexArray]:
    """Local geometry nodes of each name, from the same rows of the file on all ranks. Local."""
    rows = np.asarray(mesh.geometry.input_global_indices)
    return {
        name: np.flatnonzero(np.isin(rows, nodes)).astype(np.int32)
        for name, nodes in named.items()
        if len(nodes)
    }
