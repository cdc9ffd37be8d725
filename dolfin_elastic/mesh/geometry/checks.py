"""Checks of a distributed mesh: flat, folded, thin and inverted cells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.ghosts import summed
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import BoolArray, FloatArray, IntArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.formats.raw import format_points
from dolfin_elastic.mesh.geometry.curved import smallest_jacobians
from dolfin_elastic.mesh.geometry.simplices import cell_corners, qualities, signed_volumes

FLAT = 1e-12  # quality below which a cell has no volume
SLIVER = 1e-3  # quality below which a cell is worth a remark
OVERLAP = 1e-3  # share of the body's volume that inside-out cells may have


def check_cells(body: Body) -> Body:
    """The body with the findings on shapes and orientations of its cells that are no errors.

    Collective.

    Raises:
        MeshError: Cells without volume, cells inside out beyond tolerance, or cells so curved
            that they fold over themselves.
    """
    mesh, where = body.mesh, body.source
    corners = cell_corners(mesh)
    middle = corners.mean(axis=1) / body.unit.metres
    count, near = _places(body, ~np.isfinite(middle).all(axis=1), middle)
    if count:
        raise MeshError(
            f"{count} elements have points whose coordinates are not numbers",
            where=where,
            expected="save the mesh anew",
        )
    shape = qualities(corners)
    count, near = _places(body, shape < FLAT, middle)
    if count:
        raise MeshError(
            f"{count} of {body.num_cells} elements have no volume, {near}",
            where=where,
            expected="remesh there, or collapse their shortest edges",
        )
    notes, information = _orientation(body, signed_volumes(corners), middle)
    if mesh.geometry.cmap.degree > 1:
        _curved(body, middle)
    count, near = _places(body, shape < SLIVER, middle)
    if count:
        notes.append(
            f"{count} of {body.num_cells} elements are very thin (quality below "
            f"{SLIVER:g}; 1 is regular), {near}"
        )
    return replace(body, notes=(*body.notes, *notes), information=(*body.information, *information))


def _places(body: Body, bad: BoolArray, middle: FloatArray) -> tuple[int, str]:
    """Number of marked cells on all ranks, and midpoints of the first in the file. Collective."""
    mesh = body.mesh
    number = np.asarray(mesh.topology.original_cell_index)
    local = np.flatnonzero(bad)
    local = local[np.argsort(number[local])]
    result = mesh.comm.allgather((number[local[:5]], middle[local[:5]]))
    order = np.argsort(np.concatenate([numbers for numbers, _ in result]))
    first = np.concatenate([rows for _, rows in result])[order]
    count = int(total(mesh.comm, len(local)))
    return count, format_points(first, count, body.unit.name)


def _curved(body: Body, middle: FloatArray) -> None:
    count, near = _places(body, smallest_jacobians(body.mesh) <= 0, middle)
    if count:
        raise MeshError(
            f"{count} of {body.num_cells} quadratic elements fold over themselves, {near}",
            where=body.source,
            expected="optimise the high-order mesh (in Gmsh: Mesh.HighOrderOptimize = 2), use "
            "smaller elements there, or read the elements as straight ones: mesh.curved = false",
        )


def _orientation(
    body: Body, volumes: FloatArray, middle: FloatArray
) -> tuple[list[str], list[str]]:
    """Notes on inverted cells, which overlap others; information on a reversed node order."""
    comm = body.comm
    folded = folded_facets(body.mesh)
    main = 1.0 if total(comm, float(np.sign(volumes).sum())) >= 0 else -1.0
    against = np.sign(volumes) != main
    inside_out = against & (folded > 0)
    if total(comm, int(folded.sum())) and not total(comm, int(inside_out.sum())):
        most = comm.allreduce(int(folded.max(initial=0)), op=MPI.MAX)
        inside_out = folded == most
    notes, information = [], []
    count, near = _places(body, against & ~inside_out, middle)
    if count:
        information.append(
            f"{count} of {body.num_cells} elements list their points the other way round "
            f"(harmless: they are reordered), {near}"
        )
    count, near = _places(body, inside_out, middle)
    if count:
        notes.append(
            _inside_out(
                body,
                np.abs(volumes),
                inside_out,
                f"{count} of {body.num_cells} "
                f"elements are inside out (they overlap their neighbours), {near}",
            )
        )
    return notes, information


def _inside_out(body: Body, volumes: FloatArray, bad: BoolArray, finding: str) -> str:
    part = total(body.comm, float(volumes[bad].sum())) / total(body.comm, float(volumes.sum()))
    if part > OVERLAP:
        raise MeshError(
            f"{finding}, with {part:.2g} of the volume",
            where=body.source,
            expected="remesh, or untangle the mesh, there",
        )
    return f"warning: {finding}; their volume, {part:.2g} of the body's, counts twice"


def folded_facets(mesh: Mesh) -> IntArray:
    """For each local cell the number of facets whose other cell lies on the same side.

    Collective.  Seen from a facet, whose vertices are taken in their global order, the opposite
    vertices of its two cells lie on different sides of it in a valid mesh.
    """
    d = mesh.topology.dim
    sides = _sides(mesh)
    around = mesh.topology.connectivity(d, d - 1).array.reshape(-1, d + 1)
    sums = summed(mesh.topology.index_map(d - 1), around, sides[..., None])[:, 0]
    return np.asarray((np.abs(sums[around]) > 1.5).sum(axis=1))


def _sides(mesh: Mesh) -> FloatArray:
    """Side (+1 or -1) of each of its facets on which a local cell lies, shape (n, d + 1)."""
    d = mesh.topology.dim
    nodes = mesh.geometry.dofmap[:, : d + 1]
    number = mesh.geometry.index_map().local_to_global(nodes.ravel().astype(np.int32))
    number = number.reshape(nodes.shape)
    sign = np.sign(signed_volumes(cell_corners(mesh)))
    sides = np.empty(nodes.shape)
    for i in range(d + 1):
        others = number[:, [k for k in range(d + 1) if k != i]]
        parity = np.ones(len(others))
        for a in range(d):
            for b in range(a + 1, d):
                parity *= np.where(others[:, a] > others[:, b], -1, 1)
        sides[:, i] = sign * parity * (-1) ** (d - i)
    return sides
