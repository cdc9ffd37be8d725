"""Normals of named surfaces at the nodes of a space, and directions of springs there."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass

import basix
import numpy as np
from dolfinx import fem
from dolfinx.mesh import exterior_facet_indices

from dolfin_elastic.core.compat import integration_entities, interpolation_points
from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.ghosts import summed
from dolfin_elastic.core.parallel import largest, smallest, total
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body, span
from dolfin_elastic.model.supports.springs import Spring
from dolfin_elastic.model.values import sized
from dolfin_elastic.problem.spaces import part_nodes

log = logging.getLogger("dolfin_elastic")

FLAT = 1e-6
"""Deviation of unit normals, and of places over the body's size, up to which a surface is flat."""

ROUND_OFF = 1e-10
"""Deviation from an axis up to which a normal is that axis."""

KINK = 0.8
"""Length of a mean of unit normals below which a surface has an edge: two faces at 74 degrees."""


Projections = tuple[IndexArray, FloatArray]
"""Owned nodes, and projections on the directions of springs, of shape (nodes, dim, dim)."""


@dataclass(frozen=True)
class SurfaceNormals:
    """A named surface as the nodes of a space see it.

    Attributes:
        nodes: Its nodes, owned and ghost, sorted.
        normals: Outward unit normals of the reference configuration there, of shape (nodes, dim).
        flat: All its facets have one normal.
        unevenness: Distance between its lowest and highest node along the mean normal [m]; not a
            number where the normals have no mean.
    """

    nodes: IndexArray
    normals: FloatArray
    flat: bool
    unevenness: float


def surface_normals(body: Body, V: fem.FunctionSpace, name: str) -> SurfaceNormals:
    """The nodes of a surface and the normals there, by the areas of the facets around. Collective.

    A facet's share in the normal at its node is the Jacobian's cofactor times the reference
    facet's normal: its area times its normal, where the node is.  Source: Nanson's formula,
    Holzapfel, Nonlinear Solid Mechanics (2000), section 2.4.

    Raises:
        MeshError: The surface lies inside the body, where it has two normals.
    """
    facets = body.owned_facets(name)
    check_outside(body, name, "support")
    shares, nodes = _shares(body, V, facets)
    dim, index_map = body.dim, V.dofmap.index_map
    areas = np.linalg.norm(shares, axis=1, keepdims=True)
    rows = summed(index_map, nodes, np.hstack([shares, areas]))
    mean = total(body.comm, shares.sum(axis=0))
    length = float(np.linalg.norm(mean))
    whole = total(body.comm, float(areas.sum()))
    mean = unit_normals(mean[None] / length)[0] if length > FLAT * whole else np.zeros(dim)
    result = np.flatnonzero(rows[:, dim] > 0.0).astype(np.int32)
    off = np.linalg.norm(areas * mean - shares, axis=1) / np.maximum(areas[:, 0], 1e-300)
    flat = largest(body.comm, float(np.max(off, initial=0.0))) < FLAT
    heights = V.tabulate_dof_coordinates()[result, :dim] @ mean
    low = smallest(body.comm, float(np.min(heights, initial=np.inf)))
    high = largest(body.comm, float(np.max(heights, initial=-np.inf)))
    flat = flat and high - low < FLAT * span(body)
    sharp = np.linalg.norm(rows[result, :dim], axis=1) / rows[result, dim]
    normals = unit_normals(
        rows[result, :dim] / np.linalg.norm(rows[result, :dim], axis=1, keepdims=True)
    )
    if smallest(body.comm, float(np.min(sharp, initial=1.0))) < KINK:
        log.warning(
            "the surface '%s' has an edge, where its nodes have a mean normal only: name its sides "
            "apart",
            name,
        )
    return SurfaceNormals(
        nodes=result,
        normals=np.broadcast_to(mean, normals.shape) if flat else normals,
        flat=flat,
        unevenness=high - low if np.any(mean) else np.nan,
    )


def check_outside(body: Body, name: str, where: str) -> None:
    """A surface has an outward normal only where it is a part of the body's boundary. Collective.

    Args:
        where: Key that names it, for the message.

    Raises:
        MeshError: A facet of it lies between two cells; on all ranks.
    """
    tdim = body.mesh.topology.dim
    body.mesh.topology.create_connectivity(tdim - 1, tdim)
    body.mesh.topology.create_connectivity(tdim, tdim - 1)
    inside = ~np.isin(body.owned_facets(name), exterior_facet_indices(body.mesh.topology))
    if total(body.comm, int(inside.sum())):
        raise MeshError(
            f"the surface '{name}' lies inside the body, where it has no outward normal",
            where=where,
            expected="a part of the body's boundary",
        )


def spring_directions(spring: Spring, body: Body, V: fem.FunctionSpace) -> Iterator[Projections]:
    """The nodes at which a spring resists, surface by surface. Collective."""
    dim, size = body.dim, V.dofmap.index_map.size_local
    given = sized(spring.coefficients, dim)
    stiff = np.array([isinstance(k, Formula) or k != 0.0 for k in given], float)
    kind = body.common_kind(spring.surfaces)
    for name in spring.surfaces:
        if kind != "surface":
            nodes = part_nodes(body, V, name)
            nodes = nodes[nodes < size]
            yield nodes, np.tile(np.diag(stiff), (len(nodes), 1, 1))
            continue
        normals = surface_normals(body, V, name)
        own = normals.nodes < size
        n = normals.normals[own]
        if spring.by_normal:
            along = n[:, :, None] * n[:, None, :]
            P = stiff[0] * along + stiff[1] * (np.eye(dim) - along)
        else:
            P = np.tile(np.diag(stiff), (len(n), 1, 1))
        yield normals.nodes[own], P


def unit_normals(normals: FloatArray) -> FloatArray:
    """Unit vectors, exactly along an axis where they are so but for round-off."""
    nearest = np.round(normals)
    close = np.linalg.norm(normals - nearest, axis=1) < ROUND_OFF
    return np.where(close[:, None], nearest + 0.0, normals)


def _shares(body: Body, V: fem.FunctionSpace, facets: IndexArray) -> tuple[FloatArray, IndexArray]:
    """Each facet's area times its normal at each of its nodes, and the nodes. Not collective."""
    mesh, dim = body.mesh, body.dim
    cell = getattr(basix.CellType, mesh.topology.cell_name())
    degree = int(mesh.geometry.cmap.degree)
    element = basix.create_element(
        basix.ElementFamily.P, cell, degree, basix.LagrangeVariant.equispaced
    )
    slopes = element.tabulate(1, interpolation_points(V.element))[1:, :, :, 0]
    normals = basix.cell.facet_outward_normals(cell)
    areas = basix.cell.facet_reference_volumes(cell)
    pairs = integration_entities(mesh, facets).reshape(-1, 2)
    result, where = [np.empty((0, dim))], [np.empty(0, dtype=np.int32)]
    for side in range(dim + 1):
        cells = pairs[pairs[:, 1] == side, 0]
        closure = V.dofmap.dof_layout.entity_closure_dofs(dim - 1, side)
        x = mesh.geometry.x[mesh.geometry.dofmap[cells]][:, :, :dim]
        J = np.einsum("tpb,cbi->cpit", slopes[:, closure], x)
        volume = np.abs(np.linalg.det(J))[..., None]
        turned = np.einsum("cpti,t->cpi", np.linalg.inv(J), normals[side])
        result.append((areas[side] * volume * turned).reshape(-1, dim))
        where.append(V.dofmap.list[cells][:, closure].reshape(-1))
    return np.concatenate(result), np.concatenate(where)
