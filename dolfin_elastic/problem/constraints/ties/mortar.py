"""Mortar integrals of one tie: what the mean displacement opposite each node is.

With multipliers psi_i that are biorthogonal to the shape functions of the tied side,

    D_i u_i = sum_j M_ij u_j,    D_i = int phi_i,    M_ij = int psi_i phi_j,

so a tied node follows few nodes of the other side and no system has to be solved.  Both integrals
are taken over the same pieces, so that linear displacements are reproduced and, since the psi_i sum
up to one, a constant traction is passed on consistently.  Sources: B. I. Wohlmuth, SIAM J. Numer.
Anal. 38 (2000) 989; where a facet is covered in part, T. Cichosz & M. Bischoff, Comput. Methods
Appl. Mech. Engrg. 200 (2011) 1317; quadratic facets, whose vertices have no mean shape function,
A. Popp, B. I. Wohlmuth, M. W. Gee & W. A. Wall, SIAM J. Sci. Comput. 34 (2012) B421.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.sparse import csr_array

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.constraints.ties.exchange import Owners
from dolfin_elastic.problem.constraints.ties.facets import Facets, areas
from dolfin_elastic.problem.constraints.ties.segments import Segments
from dolfin_elastic.problem.constraints.ties.shapes import shape_functions

ALPHA = 0.2
"""Share of a midside function that each of its two vertices takes over (Popp et al., 4.1)."""

COVERED = 1e-3
"""Part of a node's surroundings from which it is tied."""
_SINGULAR = 1e-12
"""Eigenvalue of a facet's mass matrix over its largest below which it is round-off."""


@dataclass(frozen=True)
class Mortar:
    """Owned rows of the integrals of a tie, over the nodes of the displacement's space.

    Attributes:
        M: Integrals of psi_i phi_j [m^(d-1)].
        D: Integrals of phi_i over what is covered, shape (owned nodes,); 0 where too little is.
        beside: D_i / n of the facets that nodes share, n the nodes of a facet.
        ends: Ones at the two vertices of midside nodes; no entry in rows of others.
    """

    M: csr_array
    D: FloatArray
    beside: csr_array
    ends: csr_array


def integrate(
    owners: Owners, near: Facets, far: Facets, pieces: Segments, *, axisymmetric: bool
) -> Mortar:
    """The integrals over all pieces of a pair of surfaces. Collective.

    Args:
        near: This rank's facets of the tied side.
        far: Facets that may lie opposite.
        axisymmetric: Areas are those of rings about the axis, per radian.
    """
    d = near.x.shape[2]
    count, nodes = near.nodes.shape
    transform = _transform(d, nodes)
    weights = pieces.weights
    s = shape_functions(pieces.near_coordinates, nodes)
    if axisymmetric:
        x = np.einsum(
            "npk,nk->np",
            shape_functions(pieces.near_coordinates, near.x.shape[1]),
            near.x[pieces.near][:, :, 0],
        )
        weights = weights * x
    s = s @ transform
    m = shape_functions(pieces.far_coordinates, far.nodes.shape[1] if len(far.nodes) else nodes)
    masses, means = np.zeros((count, nodes, nodes)), np.zeros((count, nodes))
    np.add.at(masses, pieces.near, np.einsum("np,npi,npj->nij", weights, s, s))
    np.add.at(means, pieces.near, np.einsum("np,npi->ni", weights, s))
    dual = np.zeros_like(masses)
    some = np.unique(pieces.near)
    # A facet of which no more than a sliver lies opposite has a singular mass matrix.
    inverse = np.linalg.pinv(masses[some], rcond=_SINGULAR, hermitian=True)
    dual[some] = means[some, :, None] * inverse
    products = np.einsum("np,npi,npj->nij", weights, s, m)
    local = np.einsum("nij,njk->nik", dual[pieces.near], products)
    rows = np.repeat(near.nodes[pieces.near], m.shape[2], axis=1)
    columns = np.tile(far.nodes[pieces.far], (1, nodes))
    M = owners.summed(rows.ravel(), columns.ravel(), local.ravel())
    own = near.nodes[some]
    beside = owners.summed(
        np.repeat(own, nodes, axis=1).ravel(),
        np.tile(own, (1, nodes)).ravel(),
        np.repeat(means[some] / nodes, nodes, axis=1).ravel(),
    )
    pairs = list(combinations(range(d), 2))
    middle = [[v for v in range(d) if v not in pair] for pair in pairs]
    at = [d + (left[0] if left else 0) for left in middle][: nodes - d]
    rows = np.repeat(near.nodes[:, at], 2, axis=1)
    ends = owners.summed(
        rows.ravel(),
        near.nodes[:, [v for pair in pairs[: len(at)] for v in pair]].ravel(),
        np.ones(rows.size),
    )
    ends.data[:] = 1.0
    whole = _full(owners, near, transform, areas(near, axisymmetric=axisymmetric))
    D = np.asarray(beside.sum(axis=1))
    return Mortar(M, np.where(COVERED * whole < D, D, 0.0), beside, ends)


def _full(owners: Owners, near: Facets, transform: FloatArray, measures: FloatArray) -> FloatArray:
    """Integrals of the owned nodes' functions as if everything were covered. Collective."""
    d = near.x.shape[2]
    mean = np.zeros(near.nodes.shape[1])
    mean[:d] = 1 / d if len(mean) == d else (1 / 6 if d == 2 else 0.0)
    mean[d:] = 2 / 3 if d == 2 else 1 / 3
    values = measures[:, None] * (mean @ transform)
    result = owners.summed(
        near.nodes.ravel(), np.zeros(near.nodes.size, dtype=np.int64), values.ravel()
    )
    return np.asarray(result.sum(axis=1))


def _transform(d: int, nodes: int) -> FloatArray:
    """Functions with positive means as combinations of the shape functions, column by column."""
    result = np.eye(nodes)
    for i, j in combinations(range(d), 2):
        if nodes > d:
            middle = d + (3 - i - j if d == 3 else 0)
            result[middle, middle] = 1 - 2 * ALPHA
            result[middle, [i, j]] = ALPHA
    return result
