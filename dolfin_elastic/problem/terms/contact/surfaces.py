"""Sizes, areas and penalties of the surface of a contact, from the elements beside it."""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.ghosts import summed
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.geometry.curved import facet_quadrature
from dolfin_elastic.mesh.geometry.simplices import (
    cell_corners,
    cells_beside_facets,
    dofs_on_facets,
    facet_corners,
    signed_volumes,
)
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.material_regions import MaterialRegion, shear_modulus, volume_modulus

FACTOR = 10.0
"""Penalty over the stiffness of the cell beside: enough for a few augmentations."""

ROUND = 10.0
"""Largest bulk modulus over shear modulus in the penalty: nearly incompressible cells give way
sideways."""


def penalties(context: FormContext, cells: IndexArray, heights: FloatArray) -> fem.Function:
    """Penalty [Pa/m] of cells of these heights [m], 0 in all others. Collective."""
    result = fem.Function(fem.functionspace(context.body.mesh, ("DG", 0)))
    eps = np.zeros(len(cells))
    for region in context.regions:
        local = np.isin(cells, region.cells)
        eps[local] = FACTOR * uniaxial_modulus(region) / heights[local]
    result.x.array[result.function_space.dofmap.list[cells, 0]] = eps
    # Material regions list owned cells only: ghosts beside the surface get theirs from owners.
    result.x.scatter_forward()
    return result


def uniaxial_modulus(region: MaterialRegion) -> float:
    """K + 4 mu/3 of a material [Pa], K bounded."""
    mu = shear_modulus(region.typical)
    known = region.typical.small_strain()
    K = volume_modulus(region.typical) if known is None else known.K
    return min(K, ROUND * mu) + 4 / 3 * mu


def nodal(
    context: FormContext, facets: IndexArray, degree: int
) -> tuple[fem.Function, IndexArray, IndexArray]:
    """A scalar field, its owned nodes on a surface, and these of the displacement. Collective.

    Two spaces need not number their nodes alike, but order those of a cell alike, vertices first.
    """
    mesh, V = context.body.mesh, context.unknowns.V
    S = fem.functionspace(mesh, ("Lagrange", degree))
    nodes = fem.locate_dofs_topological(S, mesh.topology.dim - 1, facets)
    owned = np.sort(nodes[nodes < S.dofmap.index_map.size_local]).astype(np.int32)
    number = np.zeros(S.dofmap.index_map.size_local + S.dofmap.index_map.num_ghosts, np.int32)
    number[S.dofmap.list] = V.dofmap.list[:, : S.dofmap.list.shape[1]]
    return fem.Function(S), owned, number[owned]


def heights_over(body: Body, facets: IndexArray) -> tuple[IndexArray, FloatArray]:
    """Local cells beside facets, and their smallest height over one of them [m]."""
    mesh, d = body.mesh, body.dim
    beside, _ = cells_beside_facets(mesh, facets)
    corners = facet_corners(mesh, facets)
    edges = corners[:, 1:] - corners[:, :1]
    gram = np.linalg.det(np.einsum("nik,njk->nij", edges, edges))
    area = np.sqrt(np.maximum(gram, np.finfo(float).tiny)) / (d - 1)
    height = d * np.abs(signed_volumes(cell_corners(mesh, beside))) / area
    cells, offset = np.unique(beside, return_inverse=True)
    smallest = np.full(len(cells), np.inf)
    np.minimum.at(smallest, offset, height)
    return cells.astype(np.int32), smallest


def mean_height(body: Body, facets: IndexArray, heights: tuple[IndexArray, FloatArray]) -> float:
    """Mean height over the facets that ranks own [m]. Collective."""
    own = facets[facets < body.mesh.topology.index_map(body.dim - 1).size_local]
    beside, _ = cells_beside_facets(body.mesh, own)
    result = heights[1][np.searchsorted(heights[0], beside)]
    sums = total(body.comm, np.array([result.sum(), len(result)]))
    return float(sums[0] / max(sums[1], 1.0))


def owned_areas(
    body: Body, facets: IndexArray, thickness: float | None
) -> tuple[IndexArray, FloatArray]:
    """Owned facets among some, and their reference areas [m^2]. Not collective.

    Args:
        thickness: Of a plane body [m]; None: it is axisymmetric.
    """
    own = facets[facets < body.mesh.topology.index_map(body.dim - 1).size_local]
    rule = facet_quadrature(body.mesh, own, 2, raised=False)
    around = 2 * np.pi * rule.X[:, :, 0] if thickness is None else thickness
    return own, np.asarray((rule.weights * around).sum(axis=1))


def at_nodes(
    body: Body, facets: IndexArray, penalty: fem.Function, S: fem.FunctionSpace
) -> FloatArray:
    """Harmonic mean at each owned node of the penalties around it [Pa/m]. Collective.

    The softest counts most: a step of the multiplier that is too long would not converge.
    """
    own = facets[facets < body.mesh.topology.index_map(body.dim - 1).size_local]
    beside, _ = cells_beside_facets(body.mesh, own)
    eps = penalty.x.array[penalty.function_space.dofmap.list[beside, 0]]
    rows = np.column_stack([np.ones(len(own)), 1 / eps])[:, None]
    count, inverse = summed(S.dofmap.index_map, dofs_on_facets(S, own), rows).T
    return np.asarray(np.divide(count, inverse, out=np.ones_like(count), where=inverse > 0))
