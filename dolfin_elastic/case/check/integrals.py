"""Integrals over the undeformed body by quadrature in numpy, without compiling a form."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.geometry.curved import QuadraturePoints, cell_quadrature, facet_quadrature
from dolfin_elastic.mesh.geometry.simplices import prepare_facets
from dolfin_elastic.problem.problem import Problem


class Integrals:
    """Quadrature points of a problem's body, and its density there. Collective.

    The rules are those of the solver's loads: exact for products of two displacements.

    Args:
        problem: The problem whose body is integrated over.
        thickness: Of a plane body [m].
    """

    def __init__(self, problem: Problem, thickness: float = 1.0) -> None:
        self.problem, self.body = problem, problem.body
        self._thickness = thickness if problem.body.dim == 2 else 1.0
        self._degree = 2 * problem.context.order
        prepare_facets(self.body.mesh)

    def cells(self, names: Sequence[str] = ()) -> QuadraturePoints:
        """Points of the owned cells of regions, each cell once; without names of all. Local."""
        chosen = [self.body.owned_cells(name) for name in names] or [self.body.owned_cells()]
        return cell_quadrature(self.body.mesh, np.unique(np.concatenate(chosen)), self._degree)

    def facets(self, names: Sequence[str]) -> QuadraturePoints:
        """Points of the owned facets of surfaces, each facet once. Local."""
        chosen = np.concatenate([self.body.owned_facets(name) for name in names])
        return facet_quadrature(self.body.mesh, np.unique(chosen), self._degree)

    def mounted(self) -> list[tuple[QuadraturePoints, FloatArray]]:
        """Points of each mounted mass, and its density there [kg/m^2]. Collective."""
        result = []
        for one in self.problem.context.mounted:
            points = self.facets(one.surfaces)
            weights = self.full_weights(points)
            area = float(total(self.body.comm, float(weights.sum())))
            result.append((points, np.full(weights.shape, one.mass / area)))
        return result

    def full_weights(self, points: QuadraturePoints) -> FloatArray:
        """Weights times thickness, or times circumference of an axisymmetric body [m^2, m^3]."""
        if self.problem.geometry == "axisymmetric":
            return np.asarray(2 * np.pi * points.X[..., 0] * points.weights)
        return self._thickness * points.weights

    def density(self, points: QuadraturePoints) -> FloatArray:
        """Mass density at points of cells [kg/m^3]; nan where a material has none. Local."""
        result = np.full(points.weights.shape, np.nan)
        row = np.full(len(self.body.owned_cells()), -1)
        row[points.cells] = np.arange(len(points.cells))
        for part in self.problem.regions:
            cells = part.cells[row[part.cells] >= 0]
            if part.law.density is not None:
                result[row[cells]] = _at(part.law.density, cells, points.local)
        return result


def _at(
    density: fem.Constant | fem.Function, cells: IndexArray, local: FloatArray
) -> float | FloatArray:
    """Values of a bound density: of a constant, or of a discontinuous field in cells.

    Args:
        density: As the law was bound to it [kg/m^3].
        cells: Local cells.
        local: Points in the reference cell, shape (points, dim).

    Returns:
        A number, or shape (cells, points).
    """
    if isinstance(density, fem.Constant):
        return float(density.value)
    V = density.function_space
    table = np.asarray(V.element.basix_element.tabulate(0, local)[0, :, :, 0])
    return np.asarray(density.x.array[V.dofmap.list[cells]] @ table.T)
