"""Integrals along edges and sums over nodes as integrals over the cells beside them.

DOLFINx 0.9 has integrals over cells and facets only.  An integral along an edge of a cell is one
over the cell with quadrature points on the edge: the integrand is divided by the determinant of
the map that the integral over the cell contains, and multiplied by the edge's length element.  A
node is an edge with one point and length element 1.  Edges of equal number in their cells share a
kernel.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.geometry.curved import (
    PointsInCells,
    edge_points,
    edge_rule,
    node_points,
    reference_nodes,
)
from dolfin_elastic.mesh.geometry.simplices import cells_beside_edges, node_cells
from dolfin_elastic.model.kinematics import WeightedMeasure
from dolfin_elastic.problem.terms.at_points import IntegralPoints


@dataclass(frozen=True)
class SummedMeasure:
    """A sum of measures, each with a factor of the integrand.

    Attributes:
        terms: Factors and UFL measures.
    """

    terms: tuple[tuple[Expr, ufl.Measure], ...]

    def __rmul__(self, integrand: Expr) -> ufl.Form:
        """The integral's form."""
        return sum((integrand * factor) * measure for factor, measure in self.terms)


@dataclass(frozen=True)
class HeldPart:
    """The surfaces, edges or points that a spring or dashpot acts on.

    Attributes:
        kind: "surface", "edge" or "point".
        measure: Measure of the reference area of surfaces, the length of edges, or nodes.
        size: Gives that area, length or number as a constant [m^2, m, 1]; collective.
    """

    kind: str
    measure: WeightedMeasure | SummedMeasure
    size: Callable[[], fem.Constant]


class PointIntegrals:
    """Edges or nodes of one spring as cells with quadrature points. Collective to make.

    Args:
        kind: "edge" or "point".
        first: Lowest number of a set of cells that is free.

    Attributes:
        cells: Number of a set of cells to the cells, in each of which one of the edges or nodes has
            the same number; the same numbers on all ranks.
    """

    def __init__(self, body: Body, kind: str, names: Sequence[str], first: int) -> None:
        self._mesh, self._edges = body.mesh, kind == "edge"
        entities = owned(body, kind, names)
        beside, local = (cells_beside_edges if self._edges else node_cells)(body.mesh, entities)
        count = 6 if self._edges else body.mesh.geometry.dofmap.shape[1]
        used = np.bincount(local, minlength=count)
        body.comm.Allreduce(MPI.IN_PLACE, used, op=MPI.SUM)
        self._numbers = {first + i: int(k) for i, k in enumerate(np.flatnonzero(used))}
        self.cells: dict[int, IndexArray] = {
            number: np.sort(beside[local == k]).astype(np.int32)
            for number, k in self._numbers.items()
        }

    def measure(self, dx: ufl.Measure, degree: int) -> SummedMeasure:
        """The sum of integrals over all sets of cells.

        Args:
            dx: Measure of the mesh's volume with the sets under their numbers.
        """
        return SummedMeasure(
            tuple(
                (self._factor(k, degree), dx(number, metadata=self._rule(k, degree)))
                for number, k in self._numbers.items()
            )
        )

    def points(self, degree: int) -> IntegralPoints:
        """Where all these integrals take their integrand."""
        cells = list(self.cells.values())
        return IntegralPoints(
            np.array([self._points(k, degree)[0] for k in self._numbers.values()]),
            np.concatenate(cells),
            np.repeat(np.arange(len(cells), dtype=np.int32), [len(one) for one in cells]),
        )

    def _factor(self, local: int, degree: int) -> Expr:
        """Length element of the edge, or 1, over that of the cell's volume."""
        volume = abs(ufl.JacobianDeterminant(self._mesh))
        if not self._edges:
            return 1 / volume
        along = edge_rule(self._mesh, degree)[2][local]
        slope = ufl.dot(ufl.Jacobian(self._mesh), ufl.as_vector([float(a) for a in along]))
        return ufl.sqrt(ufl.dot(slope, slope)) / volume

    def _rule(self, local: int, degree: int) -> dict[str, object]:
        """The points as UFL's metadata, in tuples, which have a signature."""
        coordinates, weights = self._points(local, degree)
        return {
            "quadrature_rule": "custom",
            "quadrature_degree": degree,
            "quadrature_points": _rows(coordinates),
            "quadrature_weights": tuple(map(float, weights)),
        }

    def _points(self, local: int, degree: int) -> tuple[FloatArray, FloatArray]:
        """Points in the reference cell, shape (n, dim), and weights, shape (n,)."""
        if not self._edges:
            return reference_nodes(self._mesh)[local][None], np.ones(1)
        points, weights, _ = edge_rule(self._mesh, degree)
        return points[local], weights


def _rows(points: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(map(float, row)) for row in points)


def owned(body: Body, kind: str, names: Sequence[str]) -> IndexArray:
    """Owned mesh edges or nodes of parts, each once.

    Args:
        kind: "edge" or "point".

    Raises:
        MeshError: A name is none of such a part.
    """
    pick = body.owned_edges if kind == "edge" else body.owned_points
    return np.unique(np.concatenate([pick(name) for name in names]))


def extent(body: Body, kind: str, names: Sequence[str]) -> float:
    """Length of edges [m], or number of nodes. Collective.

    Args:
        kind: "edge" or "point".
    """
    return float(total(body.comm, float(points_of(body, kind, names, 0).weights.sum())))


def points_of(body: Body, kind: str, names: Sequence[str], degree: int) -> PointsInCells:
    """Quadrature points on the owned edges, or the owned nodes, of parts. Local.

    Args:
        kind: "edge" or "point".

    Raises:
        MeshError: A name is none of such a part.
    """
    entities = owned(body, kind, names)
    if kind == "edge":
        return edge_points(body.mesh, entities, degree)
    return node_points(body.mesh, entities)
