"""Where springs hold a body, and along which directions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.model.supports.springs import Spring
from dolfin_elastic.problem.constraints.normals import sheet

Projections = tuple[IndexArray, FloatArray]
"""Owned nodes, and projections on the directions held there, of shape (nodes, dim, dim)."""


def spring_directions(spring: Spring, body: Body, V: fem.FunctionSpace) -> Iterator[Projections]:
    """The nodes at which a spring resists, surface by surface. Collective."""
    dim, size = body.dim, V.dofmap.index_map.size_local
    stiff = np.array([isinstance(k, Formula) or k != 0.0 for k in spring.coefficients], float)
    for name in spring.surfaces:
        found = sheet(body, V, name)
        own = found.nodes < size
        n = found.normals[own]
        if spring.by_normal:
            along = n[:, :, None] * n[:, None, :]
            P = stiff[0] * along + stiff[1] * (np.eye(dim) - along)
        else:
            P = np.tile(np.diag(stiff), (len(n), 1, 1))
        yield found.nodes[own], P
