"""Penalties on the jumps of a field between neighbouring cells."""

from __future__ import annotations

from typing import Literal

import numpy as np

from dolfin_elastic.core.errors import CaseError, nearest
from dolfin_elastic.core.ghosts import summed
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.geometry.curved import cell_volumes

Penalty = Literal["tv", "tikhonov"]
PENALTIES: tuple[Penalty, ...] = ("tv", "tikhonov")
_ROUND = 1e-2
"""Jump of a logarithm below which total variation is smooth."""


def penalty_of(name: str) -> Penalty:
    """The penalty of a name.

    Raises:
        InputError: There is none.
    """
    for one in PENALTIES:
        if one == name:
            return one
    raise CaseError(
        f"there is no penalty '{name}'", where="--penalty", expected=nearest(name, PENALTIES)
    )


class Jumps:
    """A penalty of the jumps of a field m of cells, of no unit.  Collective, all of it.

    "tv" is the total variation, which allows edges: sum A ((j^2 + e^2)^(1/2) - e) over the facets
    with the area A and the jump j, over V^((d - 1)/d).  "tikhonov" stands for the integral of
    |grad m|^2, which smooths: sum A j^2/h over V^((d - 2)/d), h the distance of the midpoints.
    V is the volume of all cells, d the dimension.

    Source: L. I. Rudin, S. Osher and E. Fatemi, Physica D 60 (1992) 259; C. R. Vogel, Computational
    Methods for Inverse Problems (2002), section 8.

    Args:
        chosen: Owned cells between which jumps count, shape (cells,).
    """

    def __init__(self, body: Body, chosen: BoolArray, kind: Penalty) -> None:
        mesh, d = body.mesh, body.dim
        mesh.topology.create_connectivity(d, d - 1)
        self._comm, self._map, count = body.comm, mesh.topology.index_map(d - 1), len(chosen)
        facets = mesh.topology.connectivity(d, d - 1).array.reshape(-1, d + 1)[:count]
        self._facets, self._chosen, self._kind = facets, chosen, kind
        nodes = mesh.geometry.x[mesh.geometry.dofmap[:count, : d + 1], :d]
        ones = np.where(chosen, 1.0, 0.0)[:, None, None]
        middles = ones * nodes.mean(axis=1)[:, None]
        around = summed(self._map, facets, np.concatenate([middles, ones], axis=2))[facets]
        self._inner = (around[:, :, -1] > 1.5) & chosen[:, None]
        apart = np.linalg.norm(2 * middles - around[:, :, :-1], axis=2)
        volumes = cell_volumes(mesh)[:count]
        whole = float(total(body.comm, float(volumes[chosen].sum())))
        areas = _areas(nodes)
        self.volumes = volumes
        if kind == "tv":
            weights = areas / whole ** ((d - 1) / d)
        else:
            weights = areas / np.where(self._inner, apart, 1.0) / whole ** ((d - 2) / d)
        self._weights = np.where(self._inner, weights, 0.0)

    def value(self, field: FloatArray) -> tuple[float, FloatArray]:
        """The penalty and its derivatives by the values of owned cells.

        Args:
            field: m of owned cells, shape (cells,).
        """
        own = np.where(self._chosen, field, 0.0)
        both = summed(self._map, self._facets, own[:, None, None])[self._facets][:, :, 0]
        jump = np.where(self._inner, 2 * own[:, None] - both, 0.0)
        if self._kind == "tv":
            root = np.sqrt(jump**2 + _ROUND**2)
            each, slope = root - _ROUND, jump / root
        else:
            each, slope = jump**2, 2 * jump
        # Each facet is seen from both of its cells.
        result = total(self._comm, float(np.sum(self._weights * each))) / 2
        return float(result), np.asarray((self._weights * slope).sum(axis=1))


def _areas(nodes: FloatArray) -> FloatArray:
    """Of the facets opposite to the corners of simplices, shape (cells, d + 1).

    Args:
        nodes: Corners, shape (cells, d + 1, d).
    """
    d = nodes.shape[2]
    result = []
    for i in range(d + 1):
        corners = np.delete(nodes, i, axis=1)
        sides = corners[:, 1:] - corners[:, :1]
        if d == 2:
            result.append(np.linalg.norm(sides[:, 0], axis=1))
        else:
            result.append(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 2)
    return np.stack(result, axis=1)
