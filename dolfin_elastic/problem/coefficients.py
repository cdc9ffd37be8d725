"""Laws bound to a body: with its constants in their places, also where these vary in space.

What varies becomes a function that is constant in linear elements, with the value at the
barycentre, and linear in quadratic ones, through the values at the points of the quadrature rule
of degree 2, where such elements integrate their laws.  Both keep the optimal rates of convergence
and cost nothing.  Values are only taken inside cells, so a jump along facets stays where it is; and
where the line through them would leave the possible values, a cell takes their mean.
Formulas are evaluated, not compiled: another formula compiles nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import basix
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError, MeshError, keyed
from dolfin_elastic.core.parallel import largest, smallest, total
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.core.units import SpatialValue
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.geometry.curved import shape_functions
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.spatial import (
    PLACE,
    Range,
    SpatialCells,
    SpatialDirection,
    SpatialField,
    SpatialFormula,
    SpatialFunction,
)

_SHORTEST = 1e-6
"""Length below which a direction is none; they have about 1."""


class CoefficientBinder:
    """Functions in place of what varies in laws on a body. All of it is collective.

    Args:
        order: Degree of the displacement or of the mesh, whichever is higher.
    """

    def __init__(self, body: Body, order: int) -> None:
        self.body, self.degree = body, min(order, 2) - 1

    @cached_property
    def points(self) -> FloatArray:
        """Points of the reference cell."""
        dim = self.body.dim
        if self.degree == 0:
            return np.full((1, dim), 1 / (dim + 1))
        kind = basix.CellType.triangle if dim == 2 else basix.CellType.tetrahedron
        return np.asarray(basix.make_quadrature(kind, 2)[0], dtype=np.float64)

    def _places(self, cells: IndexArray) -> FloatArray:
        """Where the points are [m], shape (cells, points, 3)."""
        mesh = self.body.mesh
        nodes = mesh.geometry.x[mesh.geometry.dofmap[cells]]
        return np.asarray(np.einsum("kn,cnj->ckj", shape_functions(mesh, self.points), nodes))

    def _at(self, item: SpatialValue, cells: IndexArray, directed: bool) -> FloatArray:
        """Values at the points of each cell: shape (cells, points), directions by 3.

        Args:
            cells: Owned local cells.
            directed: It is a direction, made to have length 1.

        Raises:
            InputError: A name that does not exist, or a direction without length.
        """
        values = self._values(item, cells, directed)
        return self._unit(values, cells) if directed else values

    def _values(self, item: SpatialValue, cells: IndexArray, directed: bool) -> FloatArray:
        match item:
            case SpatialFormula():
                return self._formula(item, cells)
            case SpatialField() if directed:
                return self._vector(item, cells)
            case SpatialField():
                with keyed("field"):
                    values = self._scalar(item.field, cells)
                    return item.factor * (values - float(item.table.reference))
            case SpatialFunction():
                return self._function(item, cells)
            case SpatialCells():
                return self._of_cells(item, cells)
            case SpatialDirection(components=parts):
                shape = (len(cells), len(self.points))
                return np.stack(
                    [
                        self._formula(part, cells)
                        if isinstance(part, SpatialFormula)
                        else np.full(shape, part)
                        for part in parts
                    ],
                    axis=2,
                )
        raise TypeError(f"{item!r} cannot be evaluated")

    def _formula(self, item: SpatialFormula, cells: IndexArray) -> FloatArray:
        formula = item.known(self.body.fields)
        values = dict(zip(PLACE, np.moveaxis(self._places(cells), 2, 0), strict=True))
        for name in sorted(formula.names - set(PLACE)):
            values[name] = self._scalar(name, cells)
        return np.asarray(formula.evaluate(**values))

    def _function(self, item: SpatialFunction, cells: IndexArray) -> FloatArray:
        # The C++ mesh, for a function may have been made on another Python object of it.
        mesh, own = self.body.mesh, getattr(item.function, "function_space", None)
        if own is None or own.mesh._cpp_object is not mesh._cpp_object:
            raise InputError(
                "the function is defined on another mesh",
                expected="a scalar DOLFINx function on body.mesh",
            )
        table = fem.Expression(item.function, self.points).eval(mesh, cells)
        return np.asarray(table, dtype=np.float64).reshape(len(cells), len(self.points))

    def _of_cells(self, item: SpatialCells, cells: IndexArray) -> FloatArray:
        owned, count = len(self.body.owned_cells()), len(item.values)
        ghosts = self.body.mesh.topology.index_map(self.body.dim).num_ghosts
        wrong = count not in (owned, owned + ghosts)
        if largest(self.body.comm, float(wrong)):
            raise InputError(
                f"an array of {count} values for the {owned} elements of this rank"
                if wrong
                else "an array that does not have a value for each element of another rank",
                expected="a value for each owned element of the rank, in the order of body.mesh",
            )
        return np.repeat(item.values[cells][:, None], len(self.points), axis=1)

    def _scalar(self, name: str, cells: IndexArray) -> FloatArray:
        table = self._field(name, cells)
        if table.shape[2] != 1:
            raise MeshError(
                f"the field '{name}' has {table.shape[2]} components", expected="expected a scalar"
            )
        return table[:, :, 0]

    def _vector(self, item: SpatialField, cells: IndexArray) -> FloatArray:
        with keyed("field"):
            table = self._field(item.field, cells)
            width = table.shape[2]
            if width not in (self.body.dim, 3):
                raise MeshError(
                    f"the field '{item.field}' has {width} components",
                    expected=f"expected a vector of {self.body.dim}",
                )
        return np.concatenate([table, np.zeros((*table.shape[:2], 3 - width))], axis=2)

    def _field(self, name: str, cells: IndexArray) -> FloatArray:
        table = self.body.mesh_field(name).at(self.body.mesh, cells, self.points)
        bad = ~np.isfinite(table).all(axis=2)
        if worst := self._worst(np.where(bad, np.inf, -1.0), table[:, :, 0], cells):
            count = int(total(self.body.comm, int(np.count_nonzero(np.any(bad, axis=1)))))
            raise MeshError(
                f"the field '{name}' of {self.body.source or 'the mesh'} has no finite value in "
                f"{count} elements, near {worst[1]}",
                expected="a field with a value wherever the material is",
            )
        return table

    def _unit(self, table: FloatArray, cells: IndexArray) -> FloatArray:
        length = np.linalg.norm(table, axis=2)
        bad = ~(np.isfinite(length) & (length > _SHORTEST))
        if worst := self._worst(np.where(bad, 1.0, -1.0), length, cells):
            raise InputError(
                f"the direction has the length {worst[0]:.3g} at {worst[1]}",
                expected="directions are made to have length 1, so they need one",
            )
        return np.asarray(table / length[:, :, None])

    def _worst(
        self, distance: FloatArray, values: FloatArray, cells: IndexArray
    ) -> tuple[float, str] | None:
        """Value and place where the distance is largest, of all ranks; None: none is above -1.

        Args:
            distance: From the possible values, shape (cells, points); -1 for what is possible.
            values: Shape (cells, points).
            cells: Owned local cells.
        """
        own: tuple[float, list[float], float] | None = None
        if (distance > -1).any():
            at = np.nonzero(distance == distance.max())
            coordinates = self._places(cells[at[0]])[np.arange(len(at[0])), at[1], : self.body.dim]
            last = int(np.lexsort(coordinates.T[::-1])[-1])  # of equals the same on any ranks
            i, j = at[0][last], at[1][last]
            own = float(distance[i, j]), [float(x) for x in coordinates[last]], float(values[i, j])
        result = [one for one in self.body.comm.allgather(own) if one is not None]
        if not result:
            return None
        _, place, value = max(result, key=lambda one: one[:2])
        return value, "(" + ", ".join(f"{x:.4g}" for x in place) + ")"

    def functions(
        self, law: Law, cells: IndexArray, where: str = ""
    ) -> tuple[dict[str, Expr], dict[str, Any], float | None]:
        """A function for each constant that varies, and numbers that stand for it.

        Args:
            law: The law as it was written.
            cells: Owned local cells that it fills.
            where: Dotted key of the material, for messages.

        Returns:
            Functions; means; the largest Poisson's ratio, if it varies or follows from what does.

        Raises:
            InputError: A name that does not exist, or a value that is impossible somewhere.
        """
        values, ranges = self.values(law, cells, where), law.ranges()
        functions = {
            name: self._expression(table, cells, ranges.get(name, Range()))
            for name, table in values.items()
        }
        comm, means = self.body.comm, dict[str, Any]()
        for name, table in values.items():
            if table.ndim == 2:
                sums = comm.allreduce(np.array([table.sum(), table.size]), op=MPI.SUM)
                means[name] = float(sums[0] / max(sums[1], 1))
        nu, largest_nu = getattr(law.with_values(values), "nu", None), None
        if isinstance(nu, np.ndarray):
            largest_nu = largest(comm, float(nu.max(initial=-1.0)))
        return functions, means | _across(law, values), largest_nu

    def values(self, law: Law, cells: IndexArray, where: str = "") -> dict[str, FloatArray]:
        """What varies, at the points of each cell: shape (cells, points), directions by 3.

        Args:
            law: The law as it was written.
            cells: Owned local cells that it fills.
            where: Dotted key of the material, for messages.

        Raises:
            InputError: See `functions`.
        """
        result: dict[str, FloatArray] = {}
        with keyed(where):
            for name, item in law.spatial_constants().items():
                with keyed(name):
                    result[name] = self._at(item, cells, name in law.directions)
            if result:
                self._check(law, result, cells)
        return result

    def _check(self, law: Law, result: dict[str, FloatArray], cells: IndexArray) -> None:
        with np.errstate(all="ignore"):
            bound = law.with_values(result)
        ranges = law.ranges()
        for name, values in (result | {n: getattr(bound, n) for n in law.derived}).items():
            if isinstance(values, np.ndarray) and values.ndim == 2:
                possible = ranges.get(name, Range())
                self._check_one(name, values, possible, cells, given=name in result)

    def _check_one(
        self, name: str, values: FloatArray, possible: Range, cells: IndexArray, *, given: bool
    ) -> None:
        worst = self._worst(possible.distance(values), values, cells)
        if worst is None:
            return
        finite = values[np.isfinite(values)]
        low = smallest(self.body.comm, finite.min(initial=np.inf))
        high = largest(self.body.comm, finite.max(initial=-np.inf))
        span = f"; the values run from {low:.6g} to {high:.6g}" if low <= high else ""
        what = f"{worst[0]:.6g} at {worst[1]} is not possible"
        if not given:
            what = f"no stable elastic solid: {name} is {worst[0]:.6g} at {worst[1]}"
        raise InputError(
            what + span,
            where=name if given else "",
            expected=f"{name} must be {possible}",
        )

    # --- as UFL ---

    @cached_property
    def _to_corners(self) -> FloatArray:
        """From values at the points to values at the corners of the line through them."""
        if self.degree == 0:
            return np.ones((1, 1))
        points = self.points
        return np.linalg.inv(np.column_stack([1 - points.sum(axis=1), points]))

    @cached_property
    def _space(self) -> fem.FunctionSpace:
        return fem.functionspace(self.body.mesh, ("DG", self.degree))

    @cached_property
    def _vector_space(self) -> fem.FunctionSpace:
        return fem.functionspace(self.body.mesh, ("DG", self.degree, (3,)))

    def _expression(self, table: FloatArray, cells: IndexArray, possible: Range) -> Expr:
        corners = np.einsum("nk,ck...->cn...", self._to_corners, table)
        if table.ndim == 2:
            beyond = (possible.distance(corners) > -1).any(axis=1)
            corners[beyond] = table[beyond].mean(axis=1, keepdims=True)
        V = self._space if table.ndim == 2 else self._vector_space
        function = fem.Function(V)
        width = V.dofmap.index_map_bs
        rows = function.x.array.reshape(-1, width)
        rows[V.dofmap.list[cells]] = corners.reshape(*corners.shape[:2], width)
        function.x.scatter_forward()
        if table.ndim == 2 or self.degree == 0:
            return function
        return function / ufl.sqrt(
            ufl.inner(function, function)
        )  # a line between unit vectors is shorter

    def joined(self, parts: Sequence[tuple[Expr | None, IndexArray]]) -> fem.Function:
        """One function of constants and functions, each in its cells; else 0."""
        varies = any(isinstance(part, fem.Function) for part, _ in parts)
        V = self._space if varies else fem.functionspace(self.body.mesh, ("DG", 0))
        function = fem.Function(V)
        for part, cells in parts:
            dofs = V.dofmap.list[cells]
            if isinstance(part, fem.Function):
                function.x.array[dofs] = part.x.array[dofs]
            elif part is not None:
                function.x.array[dofs] = float(part.value)
        function.x.scatter_forward()
        return function


def _across(law: Law, values: Mapping[str, FloatArray]) -> dict[str, tuple[float, ...]]:
    """Directions that stand for those that vary: across each other and those given."""
    given = [
        np.resize(np.append(np.asarray(known, dtype=float), 0.0), 3)
        for name in law.directions
        if (known := getattr(law, name)) is not None and not isinstance(known, SpatialValue)
    ]
    result: dict[str, tuple[float, ...]] = {}
    for name in law.directions:
        if name in values:
            axes = np.eye(3)
            best = min(axes, key=lambda axis: max((abs(axis @ g) for g in given), default=0.0))
            given.append(best)
            result[name] = tuple(float(x) for x in best)
    return result
