"""Angles at which the facets of a body's boundary meet."""

from __future__ import annotations

import numpy as np
from dolfinx import la
from dolfinx.mesh import Mesh

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.geometry.simplices import boundary_facets, outward_normals


def ridge_angles(mesh: Mesh) -> FloatArray:
    """Angle [rad] between the normals of two facets of the boundary, at each ridge between them.

    A ridge is an edge, in a plane a point.  Collective; each ridge is on exactly one rank, and
    those of more than two facets are on none.
    """
    d = mesh.topology.dim
    facets = boundary_facets(mesh)
    mesh.topology.create_entities(d - 2)
    mesh.topology.create_connectivity(d - 1, d - 2)
    ridges = mesh.topology.connectivity(d - 1, d - 2).array.reshape(-1, d)[facets]
    index = mesh.topology.index_map(d - 2)
    sums = la.vector(index, d + 1)  # of the normals, and how many
    rows = np.column_stack([outward_normals(mesh, facets), np.ones(len(facets))])
    np.add.at(sums.array.reshape(-1, d + 1), ridges, rows[:, None, :])
    sums.scatter_reverse(la.InsertMode.add)
    owned = sums.array.reshape(-1, d + 1)[: index.size_local]
    between = owned[owned[:, d] == 2, :d]
    # Two unit normals at an angle a have a sum of length 2 cos(a/2).
    return np.asarray(2 * np.arccos(np.minimum(np.linalg.norm(between, axis=1) / 2, 1.0)))
