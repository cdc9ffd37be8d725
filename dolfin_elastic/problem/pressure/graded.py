"""By how much a stiffness that varies in space changes from one cell to the next."""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.ghosts import summed
from dolfin_elastic.core.parallel import largest
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.geometry.simplices import prepare_facets
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.spatial import units_of


def stiffness_step(body: Body, law: Law, cells: IndexArray) -> float:
    """Largest ratio of the stiffness of two cells that share a facet, at least 1. Collective.

    Of the constants with the unit of a stress that vary in space the one that changes most counts.
    The pressure inside a material is continuous.  Where its stiffness jumps by the ratio r the
    pressure of the body jumps, too: that of a two-layer sphere with nu = 0.4999, written as one
    material whose mu depends on the place, is off by half of its jump, and the von Mises stress
    there is 2.3, 8.5, 18, 29 and 63 % too low for r = 1.05, 1.2, 1.5, 2 and 10, at cells of both
    0.1 and 0.05.

    Args:
        law: Of a material region, bound to it.
        cells: Of the region, owned.
    """
    stresses = {name for name, unit in units_of(type(law)).items() if unit == "Pa"}
    # Volume moduli have no part in the jump: the traction is continuous.
    stresses -= {"allowable", "lmbda", getattr(law, "volume_modulus", "")}
    result = 1.0
    for name in type(law).model_fields:
        constant = getattr(law, name)
        if name in stresses and isinstance(constant, fem.Function):
            rows = constant.function_space.dofmap.list[cells]
            result = max(result, _step(body, np.abs(constant.x.array[rows]).mean(axis=1), cells))
    return result


def _step(body: Body, values: FloatArray, cells: IndexArray) -> float:
    """Largest ratio of values of two of the cells that share a facet. Collective.

    With n cells of the sum s and the sum of squares q at a facet, two differ by
    sqrt(2 q - s^2): sums are what ranks can exchange.
    """
    mesh, dim = body.mesh, body.dim
    prepare_facets(mesh)
    facets = mesh.topology.connectivity(dim, dim - 1).array.reshape(-1, dim + 1)[cells]
    logs = np.log(np.maximum(values, np.finfo(np.float64).tiny))
    rows = np.stack([np.ones_like(logs), logs, logs**2], axis=1)[:, None]
    table = summed(mesh.topology.index_map(dim - 1), facets, rows)
    count, s, q = table[: mesh.topology.index_map(dim - 1).size_local].T
    square = np.where(count == 2, 2 * q - s**2, 0.0).max(initial=0.0)
    return float(np.exp(np.sqrt(max(largest(body.comm, float(square)), 0.0))))
