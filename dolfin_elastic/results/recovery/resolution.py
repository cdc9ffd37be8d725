"""Whether the mesh resolves a peak of stress on a curved face.

Where a face turns by more than 45 degrees along one cell, the recovered stress and its estimated
error say nothing of the peak: in a fillet of a flange with one cell on its quarter circle it was
2.2 times the recovered stress, with three it was within the estimated error.  A re-entrant face of
radius r with cells of edge h looks from outside like an edge, where the stress grows like
(h/r)^0.4555 (the exponent of a right angle, see `singular`) until the cells resolve r.

Straight cells bend the surface at their edges.  A bar in torsion whose section is a regular polygon
in place of a circle has a largest stress that differs by 0.36 and 0.33 of the angle between its
sides, for six and eight of these: a third of it counts as a relative error.

Source: W. C. Young and R. G. Budynas, Roark's Formulas for Stress and Strain (2002), table 10.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.parallel import RankExchange
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray
from dolfin_elastic.mesh.body import boundary_shape
from dolfin_elastic.mesh.geometry.simplices import (
    dofs_on_facets,
    facet_corners,
    longest_edges,
)

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem

MOST = np.deg2rad(45.0)
"""Largest angle by which a face may turn along a cell."""
RESOLVED = np.deg2rad(30.0)
"""Angle that is advised: twelve cells round a circle."""
_LEAST, _SHARP, _EXPONENT = 3.0, 1.5, 0.4555
"""An unresolved stress may be so many times the recovered one: at least, and times (h/r)^0.4555."""
_POLYGON = 1 / 3
"""Relative error of a stress at straight cells, per angle between them."""


@dataclass(frozen=True)
class Resolution:
    """How well the cells at the owned nodes follow the faces there.

    Attributes:
        turn: Largest angle [rad] by which a face turns along a cell there, shape (nodes,); 0 inside
            the body and on flat faces.
        factor: How many times the recovered stress the exact one may be; 1 where it is resolved.
        bend: Largest curvature of these faces [1/m].
        polygon: Relative error of stresses because cells are straight.
        off: Largest distance [m] of nodes of an unresolved cell there from a face of a CAD file.
        face: Number of such a face; 0 where there is none.
    """

    turn: FloatArray
    factor: FloatArray
    bend: FloatArray
    polygon: FloatArray
    off: FloatArray
    face: FloatArray

    @property
    def unresolved(self) -> BoolArray:
        """Nodes where a peak is not resolved, shape (nodes,)."""
        return np.asarray(self.turn > MOST * (1 + 1e-6))


def resolution(problem: Problem) -> Resolution:
    """Of the mesh of a problem. Collective."""
    shape, V = boundary_shape(problem.body), problem.V
    turn, bend = shape.turn, shape.bend
    length = longest_edges(facet_corners(problem.body.mesh, shape.facets))
    sharp = np.maximum(_LEAST, _SHARP * np.maximum(-bend * length, 0.0) ** _EXPONENT)
    unresolved = (turn > MOST * (1 + 1e-6)) & (bend < 0)
    off, faces = np.where(turn > MOST, shape.off, 0.0), problem.body.faces
    numbers = np.zeros(len(off)) if faces is None else faces.numbers_of(shape.facets)
    nodes = dofs_on_facets(V, shape.facets)
    straight = problem.body.mesh.geometry.cmap.degree == 1
    result = largest_at_nodes(
        V,
        nodes,
        np.column_stack(
            [
                turn,
                np.where(unresolved, sharp, 1.0),
                np.abs(bend),
                turn * _POLYGON if straight else np.zeros_like(turn),
                off,
                np.where(off > 0, numbers, 0),
            ]
        ),
    )
    turn, factor, bend, polygon, off, face = result.T
    return Resolution(turn, np.maximum(factor, 1.0), bend, polygon, off, face)


def largest_at_nodes(V: fem.FunctionSpace, nodes: IndexArray, values: FloatArray) -> FloatArray:
    """Largest values of the cells or facets around each owned node, on any ranks. Collective.

    Args:
        nodes: Local nodes of each, shape (n, nodes of one).
        values: Not negative, shape (n, columns).

    Returns:
        Shape (owned nodes, columns); 0 at nodes of none.
    """
    index = V.dofmap.index_map
    own, first = index.size_local, index.local_range[0]
    result = np.zeros((own + index.num_ghosts, values.shape[1]))
    for column in range(nodes.shape[1]):
        np.maximum.at(result, nodes[:, column], values)
    exchange = RankExchange(V.mesh.comm, np.asarray(index.owners, dtype=np.int64))
    there = exchange.send(np.asarray(index.ghosts, dtype=np.int64)[:, None])[:, 0] - first
    np.maximum.at(result, there, exchange.send(result[own:]))
    return result[:own]
