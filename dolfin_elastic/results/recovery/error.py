"""An estimate of the discretisation error, from the recovered and the raw stress.

The recovered stress is more accurate than the finite element solution's own, so their difference
estimates the error of the latter.  It is measured in the energy norm,

    eta^2 = 1/2 int (S* - S) : (E* - E) dV,

the strain energy of the error in J, where S* and E* are recovered from the stress S and the strain
E.  With Hooke's law S and E are the stress and strain of small strains, and since E* - E is the
compliance times S* - S wherever the law's constants do not vary in space, this is the estimate of
Zienkiewicz and Zhu.  With other laws S is the second Piola-Kirchhoff stress and E the Green strain:
to the order of the error S* - S is the material tangent at the state times E* - E, so this is the
energy norm with the present tangent, without its geometric part, the same in a turned body.  Where
it is negative at a point, as in a law that has lost its stability, its absolute value counts.
Growth and heat are taken out first: S and E are those of the elastic part.

Where a pressure p carries the volumetric part, S : E is that of the rest of the law and
p^2/k is added, k the modulus that belongs to p: the norm in which the perturbed Lagrangian is well
posed, which remains a norm where nu = 1/2 and 1/k = 0.

The estimate holds for the raw stress.  What is judged, such as the largest von Mises stress, is a
recovered value, but on the surface, where peaks are, its error has the order of the raw stress: its
estimate is sqrt(3) times the root mean square, over the cells around it, of the change of the value
between the recovered and the raw tensor, which is the largest value of a linear function of that
mean square whose mean is zero.  Where a fillet or hole has cells as large as its radius that mean
is too smooth.  There the tensor of the cells, extrapolated to the nodes from the points of
integration and averaged, is another value of the same tensor, of no lower order at the surface; its
change from the recovered one, the largest at the nodes of the cells around, is the estimate where
it is larger.

So it is for every criterion, each with its own tensor, see `_RegionError`.  The change of the von
Mises stress is that of the difference of the tensors, which bounds the difference of the values; it
is relative to the stress, and that of the safety factor by an allowable stress the same.  That of a
`Strength` is the difference of the utilisations, of which those of opposite signs have different
limits: an error of a pressure is none of a weak tension.

Source: O. C. Zienkiewicz and J. Z. Zhu, Int. J. Numer. Meth. Eng. 24 (1987) 337, (13) to (17), and
33 (1992) 1365; extrapolation: E. Hinton and J. S. Campbell, Int. J. Numer. Meth. Eng. 8 (1974) 461;
mixed elements: F. Brezzi and M. Fortin, Mixed and Hybrid Finite Element Methods
(1991), section VI.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfin_elastic.core.ghosts import with_ghosts
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import boundary_shape
from dolfin_elastic.mesh.geometry.curved import (
    cell_volumes,
    facet_areas,
    quadrature_rule,
    shape_gradients,
)
from dolfin_elastic.model.kinematics import green_strain, infinitesimal_strain
from dolfin_elastic.model.materials.growth import GrownLaw, grown_volume
from dolfin_elastic.model.materials.law import Law, ModifiedLaw
from dolfin_elastic.model.materials.mixed import Mixed
from dolfin_elastic.model.strength import Strength
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.cell_fields import unknowns_of_outputs
from dolfin_elastic.results.recovery.patches import ErrorRule, cell_edges
from dolfin_elastic.results.recovery.resolution import largest_at_nodes
from dolfin_elastic.results.recovery.strength import used_of
from dolfin_elastic.results.recovery.stress import (
    COMPONENTS,
    STRESS,
    NodalMeans,
    NodalStress,
    RegionStress,
    von_mises,
)

if TYPE_CHECKING:
    from dolfin_elastic.problem.material_regions import MaterialRegion
    from dolfin_elastic.problem.problem import Problem

ERROR = "estimated error"
"""Name of an `ErrorEstimate` in `State.derived`."""
_LARGEST = 3.0
"""Square of the largest value of x over its mean square for x from -1 to 1."""
_SHARES = (1.0, 1.0, 1.0, 2.0, 2.0, 2.0)
"""How often each of six components stands in a symmetric tensor."""


@dataclass(frozen=True)
class ErrorEstimate:
    """The estimated discretisation error of one state.

    Attributes:
        cells: Strain energy of the error in each owned cell [J], shape (owned cells,).
        energy: Its sum over all cells of all ranks, and `geometry` [J].
        geometry: About the strain energy between straight facets and the curved faces for which
            they stand [J].
        stored: Strain energy of the state in the same norm [J].
        relative: Relative error in the energy norm, sqrt(energy/(energy + elastic energy)).
        stress_in_cells: Root mean square over each owned cell of the von Mises stress of the
            difference between recovered and raw stress [Pa].
        stress: Recovered stress at the owned nodes.
        stress_error: Estimated error of its von Mises stress at the owned nodes, relative.
        safety_error: That of the utilisation of a `Strength`; elsewhere `stress_error`.
    """

    cells: FloatArray
    energy: float
    geometry: float
    stored: float
    relative: float
    stress_in_cells: FloatArray
    stress: NodalStress
    stress_error: FloatArray
    safety_error: FloatArray

    @property
    def cut_off(self) -> float:
        """Share of the strain energy that straight cells miss or add at curved faces."""
        return self.geometry / self.stored if self.stored > 0 else 0.0


class ErrorEstimator:
    """Estimates the discretisation error of a problem's states.  All of it is collective.

    The error of a state is estimated once for all outputs: it stays in `State.derived`, and so does
    the recovered stress.  The patches are made, and a kernel a material is compiled, for the first
    state whose error is not known.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem, self._w = problem, unknowns_of_outputs(problem)

    @cached_property
    def _regions(self) -> list[_RegionError]:
        return [_RegionError(self._problem, part, self._w) for part in self._problem.regions]

    def __call__(self, state: State) -> ErrorEstimate:
        """The estimate for one state."""
        known = state.derived.get(ERROR)
        if isinstance(known, ErrorEstimate):
            return known
        estimate = self._estimated(state)
        state.derived.update({ERROR: estimate, STRESS: estimate.stress})
        return estimate

    def _estimated(self, state: State) -> ErrorEstimate:
        self._w.x.array[:] = (state.w or state.u).x.array
        problem, V = self._problem, self._problem.V
        own = len(problem.body.owned_cells())
        cells, elastic, in_cells = np.zeros((3, own))
        result, nodes = [], np.arange(V.dofmap.index_map.size_local)
        errors = np.zeros((2, len(self._regions), len(nodes)))
        for number, region in enumerate(self._regions):
            of = region()
            chosen = region.part.cells
            cells[chosen], elastic[chosen], in_cells[chosen] = of.energy, of.elastic, of.stress
            result.append((region.part, of.recovered))
            errors[:, number] = of.at_nodes
        stress = NodalStress.of(V, result)
        sums = np.array([cells.sum(), elastic.sum(), _cut_off(problem, elastic)])
        within, stored, geometry = total(problem.body.comm, sums)
        energy = within + geometry
        return ErrorEstimate(
            cells,
            float(energy),
            float(geometry),
            float(stored),
            float(np.sqrt(energy / (energy + stored))) if energy != 0 else 0.0,
            in_cells,
            stress,
            errors[0, stress.region, nodes],
            errors[1, stress.safety_region, nodes],
        )


def _cut_off(problem: Problem, elastic: FloatArray) -> float:
    """Energy [J] between this rank's straight facets and the curved surface. Collective.

    The density in the cell, times the volume between them: to first order the strain energy changes
    by the density at the boundary times the volume by which the body grows or shrinks.

    Source: J. Sokolowski and J.-P. Zolesio, Introduction to Shape Optimization (1992), section 3.2.

    Args:
        elastic: Strain energy in the owned cells [J].
    """
    mesh, shape = problem.body.mesh, boundary_shape(problem.body)
    if mesh.geometry.cmap.degree > 1:
        return 0.0
    density = elastic / cell_volumes(mesh)[: len(elastic)]
    heights = np.abs(shape.gap) * facet_areas(mesh, shape.facets)
    return float(np.sum(density[shape.cells] * heights))


@dataclass(frozen=True)
class _Found:
    """The error in one region, by cell.

    Attributes:
        energy: Strain energy of the error [J], shape (cells,).
        elastic: Strain energy in the same norm [J].
        stress: See `ErrorEstimate.stress_in_cells`.
        at_nodes: Estimated errors of the von Mises stress and of the utilisation at the owned
            nodes, relative, shape (2, nodes); 0 at those of other regions.
        recovered: Recovered values there, see `RegionStress.at_owned_nodes`.
    """

    energy: FloatArray
    elastic: FloatArray
    stress: FloatArray
    at_nodes: FloatArray
    recovered: FloatArray


class _RegionError:
    """The error in one material region.  All of it is collective."""

    def __init__(self, problem: Problem, region: MaterialRegion, w: fem.Function) -> None:
        dim, degree = problem.body.dim, problem.degree
        pairs, shares = _work_pairs(problem, region, w)
        weight = problem.measures.filled(None, 0).weight
        self._V, mesh = problem.V, problem.body.mesh
        # The difference has the degree of the displacement on straight cells.
        points, weights = quadrature_rule(dim, 2 * degree)
        self.part = RegionStress(
            problem,
            region,
            w,
            more=[a for a, _ in pairs]
            + [b for _, b in pairs]
            + ([] if weight is None else [weight]),
            points=points,
        )
        # Values at nodes are coefficients.  The stress of curved cells has about the degree of the
        # displacement, too.
        shape = problem.V.element.basix_element.tabulate(0, points)[0, :, :, 0]
        self._rule = ErrorRule(
            shape_gradients(mesh, points),
            np.ascontiguousarray(weights),
            np.ascontiguousarray(shape),
            np.ascontiguousarray(np.linalg.pinv(shape)),
            np.array(shares),
        )
        self._edges = cell_edges(dim) if degree > 1 else np.zeros((0, 2), dtype=np.int64)

    def __call__(self) -> _Found:
        """The error of the state that is in the unknowns."""
        patches, fitted = self.part.patches, self.part.fitted()
        sums = np.empty((len(self.part.cells), 4))
        recovered, difference = (NodalMeans(self._V, 6) for _ in range(2))
        for part in self.part.chunks():
            at_nodes = self.part.at_nodes(fitted, part)
            raw = self.part.raw(part)
            sums[part], off = patches.errors(part, self._rule, at_nodes, raw)
            difference.add(patches, part, off)
            recovered.add(patches, part, np.ascontiguousarray(at_nodes[..., :6]))
        energy, elastic, squares, volume = sums.T
        rows, change = recovered.owned(), von_mises(difference.owned()[:, :6])
        error = self._at_nodes(von_mises(rows[:, :6]), change, sums[:, 2:])
        used = error
        if isinstance(strength := self.part.region.law.allowable, Strength):
            used = self._of_strength(strength, volume, fitted)
        return _Found(energy, elastic, np.sqrt(squares / volume), np.array([error, used]), rows)

    def _of_strength(
        self, strength: Strength, volume: FloatArray, fitted: FloatArray
    ) -> FloatArray:
        """Estimated error of a strength's utilisation. See `_at_nodes`.

        Args:
            volume: Of the cells of the region [m^3], shape (cells,).
            fitted: See `RegionStress.fitted`, of the Cauchy stress.
        """
        judged, rule, (axes, constant) = self.part.judged, self._rule, self.part.limit
        directions = axes() if constant is None else np.broadcast_to(constant, (len(volume), 1, 3))
        if judged is not self.part:
            fitted = judged.fitted()
        weights = rule.weights / rule.weights.sum()
        means, squares = NodalMeans(self._V, 15), np.empty_like(volume)
        for part in judged.chunks():
            nodal = judged.patches.at_nodes(fitted, part)[..., :6]
            raw = judged.at_points(part)[..., :6]
            axis = np.broadcast_to(directions[part], (*nodal.shape[:2], 3))
            recovered, here = rule.shape @ nodal, rule.shape @ axis
            change = used_of(strength, recovered, here) - used_of(strength, raw, here)
            squares[part] = volume[part] * (change**2 @ weights)
            columns = np.concatenate([nodal, rule.to_nodes @ raw, axis], axis=2)
            means.add(judged.patches, part, columns)
        recovered, averaged, axis, _ = np.split(means.owned(), (6, 12, 15), axis=1)
        values = used_of(strength, recovered, axis)
        change = np.abs(values - used_of(strength, averaged, axis))
        return self._at_nodes(values, change, np.column_stack([squares, volume]))

    def _at_nodes(self, values: FloatArray, change: FloatArray, squares: FloatArray) -> FloatArray:
        """Estimated error of what is judged at the owned nodes, relative; 0 in other regions.

        The mean square at the middle of an edge is that of one of its ends, whichever is larger.

        Args:
            values: What is judged, of the recovered tensor at the owned nodes, shape (nodes,).
            change: How it changes from there to the tensor of the cells, extrapolated and averaged.
            squares: Integral over each cell of the square of its change from the recovered to the
                raw tensor, and volume of the cell, shape (cells, 2).
        """
        V, of_patch, means = self._V, self.part.patches.sums(squares), NodalMeans(self._V, 1)
        for part in self.part.chunks():
            sums = of_patch(part)
            corners = np.sqrt(_LARGEST * sums[..., 0] / sums[..., 1])
            ends = np.concatenate([corners, corners[:, self._edges].max(axis=2)], axis=1)
            means.add(self.part.patches, part, ends[..., None])
        nodes = V.dofmap.list[self.part.cells]
        local = np.nan_to_num(with_ghosts(V.dofmap.index_map, change[:, None])[:, 0])
        around = largest_at_nodes(V, nodes, local[nodes].max(axis=1, initial=0.0)[:, None])
        error = np.fmax(means.owned()[:, 0], around[:, 0])
        return np.nan_to_num(error / np.where(values > 0, values, np.inf))


def _work_pairs(
    problem: Problem, region: MaterialRegion, w: fem.Function
) -> tuple[list[tuple[Expr, Expr]], list[float]]:
    """Stresses and strains whose products are twice the strain energy of an error.

    Args:
        w: All unknowns.

    Returns:
        Pairs of UFL scalars, and how often each counts; see the module.
    """
    response: Law | ModifiedLaw = problem.weak_form.response(region, w)
    F = problem.weak_form.F(w)
    volume = grown_volume(response)
    if isinstance(response, GrownLaw):
        F, response = response.elastic(F), response.law
    P = response.law.shape_stress(F) if isinstance(response, Mixed) else response.stress(F)
    if response.linear:
        S, E = P, infinitesimal_strain(F)
    else:
        S, E = ufl.inv(F) * P, green_strain(F)
    pairs = [(volume * (S[i, j] + S[j, i]) / 2, (E[i, j] + E[j, i]) / 2) for i, j in COMPONENTS]
    shares = list(_SHARES)
    if isinstance(response, Mixed):
        pairs.append((volume * response.p, response.p * response.compliance))
        shares.append(1.0)
    return pairs, shares
