"""The recovered stress of a state: the Cauchy stress, fitted on patches of each material.

The Cauchy stress is recovered as a function of the reference coordinates.  It is the stress that an
engineer compares with a strength: the von Mises stress, the pressure and the safety factor are
evaluated from the recovered tensor and not fitted themselves, so that they are consistent.  The
tensor is symmetric, so six components suffice, and it is as smooth as the deformation gradient, so
that patches of the reference mesh serve all states.  The von Mises stress is not fitted, because it
has a kink where it vanishes.

The stress jumps at interfaces of materials: it is recovered in each material region from the cells
of that region alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, cast
from weakref import WeakKeyDictionary

import numpy as np
import ufl
from dolfinx import fem, la
from dolfinx.fem import Constant
from ufl.checks import is_cellwise_constant
from ufl.classes import Grad
from ufl.core.expr import Expr

from dolfin_elastic.core.ghosts import marked
from dolfin_elastic.core.jit import compile_expression
from dolfin_elastic.core.jit.cell_integrals import CellExpression
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.geometry.locate import LocatedPoint
from dolfin_elastic.model.materials.plasticity import Plastic
from dolfin_elastic.model.strength import Strength
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.cell_fields import unknowns_of_outputs
from dolfin_elastic.results.fields import FIELDS, axis_of, cauchy_stress
from dolfin_elastic.results.recovery.patches import ROUNDS, Patches, RawValues, sampling_points
from dolfin_elastic.results.recovery.strength import constant_axis, judged_apart, used_of
from dolfin_elastic.results.recovery.yielding import YieldLimit, bounded
from dolfin_elastic.results.verdict import SAFEST

if TYPE_CHECKING:
    from dolfin_elastic.model.materials.law import Law
    from dolfin_elastic.problem.material_regions import MaterialRegion
    from dolfin_elastic.problem.problem import Problem


_RINGS = 1 + ROUNDS
"""Layers of cells around the cell of a point: those of the patches of its nodes, and those of the
patches from which a patch with too few sampling points takes its polynomial."""


@dataclass(frozen=True)
class PointStress:
    """Recovered stress at a point; zeros on all ranks but one, so that a sum gives the value.

    Attributes:
        stress: Cauchy stress [Pa], shape (1, 6).
        safety: Safety factor, shape (1,); NaN without an allowable stress.
    """

    stress: FloatArray
    safety: FloatArray

    def row(self, name: str) -> FloatArray:
        """Components of a field that follows from the recovered stress."""
        return np.asarray(field_rows(name, self.stress, self.safety)[0])


class StressAtPoints:
    """Recovered stress at points.  All of it is collective.

    The stress at the nodes of the point's cell is interpolated by the shape functions of the
    displacement, so that it is that of the nodes in the fields.

    Args:
        places: Name of the point to its cell and local coordinates.
    """

    def __init__(self, problem: Problem, places: Mapping[str, LocatedPoint]) -> None:
        self._w, self._places = unknowns_of_outputs(problem), places
        self._element = problem.V.element.basix_element
        comm = problem.body.comm
        self._parts: list[tuple[RegionStress, dict[str, int]]] = []
        for region in problem.regions:
            local = [n for n, p in places.items() if p.cell >= 0 and p.cell in region.cells]
            if total(comm, len(local)):
                cells = cells_around(problem, region, [places[name].cell for name in local], _RINGS)
                part = RegionStress(problem, region, self._w, cells)
                rows = {n: int(np.searchsorted(cells, places[n].cell)) for n in local}
                self._parts.append((part, rows))

    def __call__(self, state: State) -> dict[str, PointStress]:
        """Name of the point to the stress there."""
        self._w.x.array[:] = (state.w or state.u).x.array
        result = {n: PointStress(np.zeros((1, 6)), np.zeros(1)) for n in self._places}
        for part, rows in self._parts:
            stress, used = part(), part.judge()
            for name, row in rows.items():
                local = self._places[name].local
                shape = self._element.tabulate(0, local[None])[0, :, :, 0]
                sigma = shape @ stress[row]
                result[name] = PointStress(sigma, safety_factor(used(row, shape, sigma)))
        return result


def cells_around(
    problem: Problem, region: MaterialRegion, cells: list[int], rings: int
) -> IndexArray:
    """Owned cells of a region in some layers around cells of all ranks, sorted. Collective."""
    dofmap = fem.functionspace(problem.body.mesh, ("Lagrange", 1)).dofmap
    chosen = np.asarray(sorted(cells), dtype=np.int32)
    for _ in range(rings):
        nodes = marked(dofmap.index_map, dofmap.list[chosen])
        near = nodes[dofmap.list[region.cells]].any(axis=1)
        chosen = np.asarray(region.cells[near])
    return chosen


def is_recovered(names: tuple[str, ...]) -> bool:
    """Whether one of some fields follows from the recovered stress."""
    return any(name in FIELDS and FIELDS[name].recovered for name in names)


COMPONENTS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Order of the six components of a symmetric tensor: xx, yy, zz, xy, xz, yz."""
_WHOLE = (0, 3, 4, 3, 1, 5, 4, 5, 2)
_SHEAR = 3
"""Number of xy among the components."""


def whole_tensor(components: FloatArray) -> FloatArray:
    """Nine components, row by row, of six; shape (..., 9)."""
    return np.asarray(components[..., _WHOLE])


def von_mises(components: FloatArray) -> FloatArray:
    """Von Mises stress of stresses of six components, shape (...)."""
    xx, yy, zz, xy, xz, yz = np.moveaxis(components, -1, 0)
    normal = (xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2
    return np.asarray(np.sqrt(normal / 2 + 3 * (xy**2 + xz**2 + yz**2)))


def safety_factor(used: FloatArray) -> FloatArray:
    """Inverse of the utilisation of the strength, bounded; NaN where it is."""
    return np.asarray(1 / np.maximum(used, 1 / SAFEST))


def field_rows(name: str, stress: FloatArray, safety: FloatArray) -> FloatArray:
    """Rows of a field that follows from the recovered stress, shape (n, 1, 3 or 9).

    Args:
        stress: Cauchy stress [Pa], shape (n, 6).
        safety: Safety factor, shape (n,).
    """
    if name == "cauchy_stress":
        return whole_tensor(stress)
    if (follows := FIELDS[name].of_tensor) is not None:
        return np.asarray(follows(whole_tensor(stress)))
    if name == "pressure":
        return -stress[:, :3].mean(axis=1)[:, None]
    return (safety if name == "safety_factor" else von_mises(stress))[:, None]


@dataclass(frozen=True)
class NodalStress:
    """Recovered stress at this rank's owned nodes.

    At a node on an interface it is that of the material with the largest von Mises stress; the
    safety factor is the smallest one there.

    Attributes:
        stress: Cauchy stress [Pa], shape (nodes, 6).
        region: Number of the material region that it belongs to, shape (nodes,).
        safety: Allowable over von Mises stress, or the factor at which the strength is used up,
            shape (nodes,); NaN without either.
        safety_region: Number of the region that the safety factor belongs to.
        utilisation: A tensor whose von Mises stress is the inverse of the factor, shape (nodes, 6):
            Cauchy stress of that region over its allowable stress, of a `Strength` a pure shear.
    """

    stress: FloatArray
    region: IntArray
    safety: FloatArray
    safety_region: IntArray
    utilisation: FloatArray

    @classmethod
    def of(
        cls, V: fem.FunctionSpace, parts: Sequence[tuple[RegionStress, FloatArray]]
    ) -> NodalStress:
        """Puts the stresses of all regions together. Collective.

        Args:
            parts: Each region with its recovered values at the owned nodes, the first six the
                stress, see `RegionStress.at_owned_nodes`.
        """
        count = V.dofmap.index_map.size_local
        stress, region = np.full((count, 6), np.nan), np.full(count, -1)
        safety, safety_region = np.full(count, np.nan), np.full(count, -1)
        highest, utilisation = np.full(count, -1.0), np.broadcast_to(np.nan, (count, 6))
        limited = any(part.region.law.allowable is not None for part, _ in parts)
        if limited:
            utilisation = utilisation.copy()
        for number, (part, values) in enumerate(parts):
            here, rows = values[:, -1] > 0, values[:, :6]
            value = von_mises(rows)
            # A comparison with NaN is false: so NaN counts as the largest stress.
            more = here & ~(value <= highest)
            stress[more], region[more], highest[more] = rows[more], number, value[more]
            if part.region.law.allowable is None:
                continue
            over = part.over_strength(rows)
            factor = safety_factor(von_mises(over))
            less = here & ~(factor >= safety)
            safety[less], safety_region[less] = factor[less], number
            utilisation[less] = over[less]
        return cls(stress, region, safety, safety_region, utilisation)

    def rows(self, name: str) -> FloatArray:
        """Rows of a field that follows from the recovered stress."""
        return field_rows(name, self.stress, self.safety)


_PATCHES: WeakKeyDictionary[Problem, dict[str, Patches]] = WeakKeyDictionary()
"""Those of each problem by region: they follow from the mesh alone, and outputs share them."""


def _patches(problem: Problem, region: MaterialRegion) -> Patches:
    """Patches of all cells of a material region. Collective."""
    known = _PATCHES.setdefault(problem, {})
    if region.name not in known:
        known[region.name] = Patches(problem.V, region.cells, problem.jit)
    return known[region.name]


class RegionStress:
    """Recovers the Cauchy stress in one material region.  All of it is collective.

    Args:
        w: All unknowns of the states that are looked at.
        cells: Owned cells of the region; by default all.
        tensor: Another symmetric tensor, 3x3, in place of the Cauchy stress.
        more: Further quantities, scalars in UFL, that are recovered beside it.
        points: Further points of the reference cell, for `at_points`.
    """

    def __init__(
        self,
        problem: Problem,
        region: MaterialRegion,
        w: fem.Function,
        cells: IndexArray | None = None,
        *,
        tensor: Expr | None = None,
        more: Sequence[Expr] = (),
        points: FloatArray | None = None,
    ) -> None:
        self.region, self.cells = region, region.cells if cells is None else cells
        self._problem, self._mesh, self._w, self._all = problem, problem.body.mesh, w, cells is None
        sigma = tensor
        if sigma is None:
            law = cast("Law", problem.weak_form.response(region, w))
            sigma = cauchy_stress(law, problem.weak_form.F(w))
        columns = [(sigma[i, j] + sigma[j, i]) / 2 for i, j in COMPONENTS] + list(more)
        samples = sampling_points(problem.body.dim, problem.degree)
        self._width, self._samples = len(columns), len(samples)
        self._points, self._further = 0 if points is None else len(points), points
        # One kernel for all points: compiling it takes longer than evaluating it.
        everywhere = samples if points is None else np.concatenate([samples, points])
        plain = problem.degree == 1 and problem.W is problem.V
        self._constant = plain and _constant_in_cells(columns, w)
        if self._constant:
            everywhere = samples[:1]
        self._kernel = CellExpression(ufl.as_vector(columns), everywhere, w, problem.jit)
        self.patches = (
            _patches(problem, region) if cells is None else Patches(problem.V, cells, problem.jit)
        )
        self._nodes = np.asarray(problem.V.element.basix_element.points)
        self._yields: YieldLimit | None = None
        if tensor is None and isinstance(region.law, Plastic) and problem.history is not None:
            self._yields = YieldLimit(problem, region, w, everywhere[: self._samples])

    def __call__(self) -> FloatArray:
        """Recovered values at the nodes of the cells; the first six are the Cauchy stress [Pa].

        Returns:
            Shape (cells, nodes of a cell, 6 and more).
        """
        samples = self.samples()
        return self._allowed(slice(0, len(self.cells)), self.patches(samples), samples)

    def at_owned_nodes(self, fitted: FloatArray | None = None) -> FloatArray:
        """Recovered values at this rank's nodes. Collective.

        Args:
            fitted: Polynomials, see `Patches.fit`; by default of the stress of the state.

        Returns:
            Shape (owned nodes, columns + 1); the last is 0 at nodes of none of the cells, whose
            other values are NaN.
        """
        if fitted is None:
            fitted = self.fitted()
        means = NodalMeans(self._problem.V, fitted.shape[2])
        for part in self.patches.parts():
            means.add(self.patches, part, self.at_nodes(fitted, part))
        return means.owned()

    def at_nodes(self, fitted: FloatArray, part: slice) -> FloatArray:
        """Recovered values at the nodes of some cells. Not collective.

        Where the material yields, the stress is not above what its law allows, see `yielding`.

        Args:
            fitted: Polynomials, see `Patches.fit`.
            part: One of `chunks`.

        Returns:
            Shape (cells, nodes of a cell, 6 and more).
        """
        values = self.patches.at_nodes(fitted, part)
        return values if self._yields is None else self._allowed(part, values, self._sampled(part))

    def _allowed(self, part: slice, values: FloatArray, samples: FloatArray) -> FloatArray:
        if self._yields is None:
            return values
        most = np.maximum(von_mises(samples[..., :6]), self._yields(self.cells[part])).max(axis=1)
        return bounded(values, von_mises(values[..., :6]), most)

    def fitted(self) -> FloatArray:
        """Polynomials of the stress of the state, see `Patches.fit`. Collective."""
        return self.patches.fit_parts(self._width, self._sampled)

    def samples(self) -> FloatArray:
        """Values of the finite element solution at the sampling points. Not collective."""
        values = np.empty((len(self.cells), self._samples, self._width))
        for part in self.chunks():
            values[part] = self._sampled(part)
        return values

    def _sampled(self, part: slice) -> FloatArray:
        return self._evaluated(part)[:, : self._samples]

    def chunks(self) -> list[slice]:
        """The cells in parts whose values need little memory."""
        return self.patches.parts()

    def at_points(self, part: slice) -> FloatArray:
        """Values of the finite element solution at the further points. Not collective.

        Args:
            part: One of `chunks`.

        Returns:
            Shape (cells, points, 6 and more).
        """
        raw = self.raw(part)
        rows = raw.first + raw.step * np.arange(self._points)
        return np.asarray(raw.values[:, rows])

    def raw(self, part: slice) -> RawValues:
        """As `at_points`; where they are the same at all points of a cell, once. Not collective.

        Args:
            part: One of `chunks`.
        """
        values = self._evaluated(part)
        return RawValues(values, 0, 0) if self._constant else RawValues(values, self._samples, 1)

    def _evaluated(self, part: slice) -> FloatArray:
        cells = self.cells[part]
        points = self._kernel.size // self._width
        return self._kernel.eval(cells).reshape(len(cells), points, self._width)

    # --- strength ---

    def over_strength(self, rows: FloatArray) -> FloatArray:
        """A tensor at the owned nodes whose von Mises stress is the utilisation. Collective.

        Args:
            rows: Recovered Cauchy stress there [Pa], shape (nodes, 6).

        Returns:
            Shape (nodes, 6), see `NodalStress.utilisation`; the region has an allowable stress.
        """
        limit, constant = self.limit
        strength = self.region.law.allowable
        if constant is None:
            constant = self._means(limit())
        if not isinstance(strength, Strength):
            return np.asarray(rows / constant.reshape(-1, 1))
        judged = rows if self.judged is self else self.judged.at_owned_nodes()[:, :6]
        result = np.zeros_like(rows)
        result[:, _SHEAR] = used_of(strength, judged, constant) / np.sqrt(3)
        return result

    def judge(self) -> Callable[[int, FloatArray, FloatArray], FloatArray]:
        """Utilisation of the strength at points in cells. Collective.

        Returns:
            Function, not collective, of the row of a cell, the shape functions at points in it,
            shape (points, nodes), and the Cauchy stress there [Pa], shape (points, 6), to the
            utilisation; NaN without an allowable stress.
        """
        if (strength := self.region.law.allowable) is None:
            return lambda row, shape, stress: np.full(len(stress), np.nan)
        (limit, constant), other = self.limit, self.judged
        values, judged = limit() if constant is None else None, None if other is self else other()

        def used(row: int, shape: FloatArray, stress: FloatArray) -> FloatArray:
            here = constant if values is None else shape @ values[row]
            assert here is not None
            if not isinstance(strength, Strength):
                return np.asarray(von_mises(stress) / here.ravel())
            return used_of(strength, stress if judged is None else shape @ judged[row], here)

        return used

    @cached_property
    def judged(self) -> RegionStress:
        """Recovery of the tensor that the criterion judges; itself: that is the Cauchy stress."""
        if not isinstance(self.region.law.allowable, Strength):
            return self
        tensor = judged_apart(self._problem, self.region, self._w)
        if tensor is None:
            return self
        return RegionStress(
            self._problem,
            self.region,
            self._w,
            None if self._all else self.cells,
            tensor=tensor,
            points=self._further,
        )

    @cached_property
    def limit(self) -> tuple[Callable[[], FloatArray], FloatArray | None]:
        """Allowable stress [Pa], or axis of the strength, of a region that has one.

        Returns:
            Function to its values at the nodes of the cells, shape (cells, nodes, 1 or 3), and
            itself where it is constant.
        """
        allowable = self.region.law.allowable
        if isinstance(allowable, Strength):
            constant, width = constant_axis(self.region), 3
            expression = axis_of(self.region.law) if constant is None else None
        else:
            number = isinstance(allowable, Constant | float | int)
            constant = np.array([getattr(allowable, "value", allowable)]) if number else None
            width, expression = 1, None if number else allowable
        kernel = None
        if expression is not None:
            nodes = np.asarray(self._problem.V.element.basix_element.points)
            comm, jit = self._problem.body.comm, self._problem.jit
            kernel = compile_expression(comm, expression, nodes, jit)

        def values() -> FloatArray:
            assert kernel is not None
            table = np.asarray(kernel.eval(self._mesh, self.cells))
            return np.ascontiguousarray(table.reshape(len(self.cells), -1, width))

        return values, constant

    def _means(self, values: FloatArray) -> FloatArray:
        """Means at the owned nodes of values at the nodes of the cells. Collective."""
        means = NodalMeans(self._problem.V, values.shape[2])
        means.add(self.patches, slice(0, len(self.cells)), values)
        return means.owned()[:, :-1]


STRESS = "recovered stress"
"""Name of a `NodalStress` in `State.derived`."""


class StressRecovery:
    """Recovers the stress of a problem's states at the nodes.  All of it is collective.

    The stress of a state is recovered once for all outputs: it stays in `State.derived`.  The
    patches are made, and kernels compiled, for the first state whose stress is not known.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem, self._w = problem, unknowns_of_outputs(problem)

    @cached_property
    def _regions(self) -> list[RegionStress]:
        return [RegionStress(self._problem, part, self._w) for part in self._problem.regions]

    def __call__(self, state: State) -> NodalStress:
        """The recovered stress of a state at the owned nodes."""
        known = state.derived.get(STRESS)
        if isinstance(known, NodalStress):
            return known
        self._w.x.array[:] = (state.w or state.u).x.array
        stress = NodalStress.of(self._problem.V, [(p, p.at_owned_nodes()) for p in self._regions])
        state.derived[STRESS] = stress
        return stress


class NodalMeans:
    """Means over cells of their values at nodes."""

    def __init__(self, V: fem.FunctionSpace, width: int) -> None:
        self._map, self._nodes = V.dofmap.index_map, V.dofmap.list
        self._work = la.vector(self._map, width + 1)
        self._table = self._work.array.reshape(-1, width + 1)

    def add(self, patches: Patches, cells: slice, values: FloatArray) -> None:
        """Takes in the values of some cells. Not collective.

        Args:
            values: Shape (cells, nodes of a cell, columns).
        """
        patches.add_at_nodes(cells, self._nodes, values, self._table)

    def owned(self) -> FloatArray:
        """Means at the owned nodes and the number of summands, shape (nodes, columns + 1).

        NaN at nodes of none of the cells.  Collective; called once.
        """
        self._work.scatter_reverse(la.InsertMode.add)
        own = np.array(self._table[: self._map.size_local])
        own[:, :-1] /= np.where(own[:, -1:] > 0, own[:, -1:], np.nan)
        return own


def _constant_in_cells(expressions: Sequence[Expr], w: fem.Function) -> bool:
    """Whether expressions of a linear displacement are the same at all points of a cell.

    Args:
        expressions: They may contain the gradient of the displacement.
        w: The displacement, linear in straight or curved cells.
    """
    mesh = w.function_space.mesh
    if w.function_space.element.basix_element.degree > 1 or mesh.geometry.cmap.degree > 1:
        return False
    waiting, seen = list(expressions), set()
    while waiting:
        one = waiting.pop()
        if one in seen:
            continue
        seen.add(one)
        if isinstance(one, Grad) and one.ufl_operands[0] is w:
            continue
        if not one.ufl_operands and not is_cellwise_constant(one):
            return False
        waiting.extend(one.ufl_operands)
    return True
