"""Formulas of loads and springs at the points of their integrals: evaluated, not compiled.

A form that contains a formula would be compiled anew for each.  Here it contains a function with a
value at each point of the integral's quadrature rule, so that the integral is the same to round-off
and another formula compiles nothing.  DOLFINx has such functions on cells only ("quadrature
elements").  Those here have any sets of points of the reference cell: one for each of its facets,
edges or nodes; and entries only where the integral is taken.

What stands in stresses is evaluated at many sets of points.  It becomes a polynomial in each cell,
of the degree of the displacement, one more than its strain has.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import cpp, fem
from dolfinx.fem import Constant
from dolfinx.mesh import Mesh, create_unit_cube, create_unit_square
from mpi4py import MPI

from dolfin_elastic.core.compat import adjacency, make_index_map, space_like
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.parallel import largest
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.fields import MeshField
from dolfin_elastic.mesh.geometry.curved import shape_functions
from dolfin_elastic.model.values import PLACE, Component, Parts, depends_on_time, number_at

_NEAR = 1e-12
"""Distance of points of the reference cell that are the same."""
_INNER = 0.7
"""Distance of points of a cell from its barycentre, over that of the nodes of its element."""
_CHUNK = 16384
"""Entities that are treated at once, which bounds the memory."""


@dataclass(frozen=True)
class IntegralPoints:
    """Quadrature points of an integral over cells, or over entities beside one cell each.

    Attributes:
        sets: Points in the reference cell, shape (sets, points, dim).
        cells: Local cell of each owned entity, shape (n,).
        which: The set of each entity, shape (n,).
    """

    sets: FloatArray
    cells: IndexArray
    which: IndexArray


def facet_sets(dim: int, points: FloatArray) -> FloatArray:
    """Points of the reference facet on each facet of the reference cell.

    Args:
        points: Shape (points, dim - 1).

    Returns:
        Shape (facets, points, dim).
    """
    cell = _cell(dim)
    corners = np.asarray(basix.geometry(cell), dtype=np.float64)
    facets = [corners[facet] for facet in basix.topology(cell)[-2]]
    return np.array([first + points @ (others - first) for first, *others in facets])


def _cell(dim: int) -> basix.CellType:
    return basix.CellType.tetrahedron if dim == 3 else basix.CellType.triangle


class _PointsElement(basix.ufl._QuadratureElement):
    """Values at sets of points; at the points of each set, those of that set.

    Args:
        sets: Shape (sets, points, dim).
        shared: The sets have the same entries: a cell needs one of them at most.
    """

    def __init__(self, sets: FloatArray, *, shared: bool) -> None:
        points = sets[0] if shared else sets.reshape(-1, sets.shape[2])
        super().__init__(
            _cell(sets.shape[2]), points, np.ones(len(points)), ufl.identity_pullback, degree=1
        )
        self._sets, self._shared = sets, shared
        self._repr = f"Points({sets.round(12).tolist()}, {shared})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _PointsElement) and repr(self) == repr(other)

    def __hash__(self) -> int:
        return hash(repr(self))

    @property
    def has_custom_quadrature(self) -> bool:
        """FFCx takes the rule that the integral's measure names, not one of this element."""
        return False

    def tabulate(self, nderivs: int, points: FloatArray) -> FloatArray:
        """1 for the entry of each point."""
        count = self._sets.shape[1]
        for i, own in enumerate(self._sets):
            if nderivs == 0 and points.shape == own.shape and np.allclose(points, own, atol=_NEAR):
                table = np.zeros((1, count, self.dim))
                first = 0 if self._shared else i * count
                table[0, :, first : first + count] = np.eye(count)
                return table
        raise ValueError("these are no points of the integral that a formula stands in")


class FormulaSpace(ABC):
    """Functions given by formulas at points.

    Args:
        points: Where formulas are evaluated.
        width: Components of a function; 0: it is a scalar.

    Attributes:
        fields: Of the mesh, by name.
    """

    _space: fem.FunctionSpace
    fields: Mapping[str, MeshField] = MappingProxyType({})

    def __init__(self, mesh: Mesh, points: IntegralPoints, width: int) -> None:
        self._mesh, self._points, self._width = mesh, points, width

    def function(self) -> fem.Function:
        """A function that is 0."""
        return fem.Function(self._space)

    def fill(self, function: fem.Function, values: tuple[Component, ...], t: float) -> None:
        """Gives a function its values. Not collective.

        Args:
            t: Time [s], or load parameter.
        """
        rows = function.x.array.reshape(-1, max(self._width, 1))
        for start in range(0, len(self._points.cells), _CHUNK):
            coordinates, fields = self._places_for(start, values), partial(self._field, start)
            table = [number_at(v, coordinates, t, fields) for v in values]
            self._store(rows, start, np.stack(table, axis=2))

    @abstractmethod
    def _store(self, rows: FloatArray, start: int, table: FloatArray) -> None:
        """Gives entries of a function their values.

        Args:
            rows: Entries, shape (entries, components).
            table: Values at the points of its entities, shape (entities, points, components).
        """

    def _places_for(self, start: int, values: tuple[Component, ...]) -> FloatArray:
        """Points [m] of the entities of a chunk, shape (entities, points, 3)."""
        return self._places(start)

    def places(self) -> FloatArray:
        """All points of this rank [m], shape (n, 3). Not collective."""
        starts = range(0, len(self._points.cells), _CHUNK)
        result = [np.zeros((0, 3)), *(self._places(start).reshape(-1, 3) for start in starts)]
        return np.concatenate(result)

    def _field(self, start: int, name: str) -> FloatArray:
        """A field at the points of the entities of a chunk, shape (entities, points, columns)."""
        field, sets = self.fields[name], self._points.sets
        cells, which = (a[start : start + _CHUNK] for a in (self._points.cells, self._points.which))
        result = np.empty((len(cells), sets.shape[1], field.columns))
        for i, own in enumerate(sets):
            result[which == i] = field.at(self._mesh, cells[which == i], own)
        return result

    def _places(self, start: int) -> FloatArray:
        sets, geometry = self._points.sets, self._mesh.geometry
        cells, which = (a[start : start + _CHUNK] for a in (self._points.cells, self._points.which))
        result = np.empty((len(cells), sets.shape[1], 3))
        for i, own in enumerate(sets):
            here = which == i
            nodes = geometry.x[geometry.dofmap[cells[here]]]
            result[here] = np.einsum("kn,cnj->ckj", shape_functions(self._mesh, own), nodes)
        return result


class CellwiseSpace(FormulaSpace):
    """Functions that are polynomials in each cell, for integrals and fields anywhere.

    They have the values of formulas at points inside the cells: a jump along facets stays where it
    is.  Collective to make.

    Args:
        width: Components of a function; 0: it is a scalar.
    """

    def __init__(self, mesh: Mesh, degree: int, width: int) -> None:
        dim, shape = mesh.topology.dim, (width,) if width else ()
        element = basix.ufl.element("DG", _cell(dim).name, degree)
        middle = 1 / (dim + 1)
        inside = middle + _INNER * (element.basix_element.points - middle)
        self._to_nodes = np.linalg.inv(element.tabulate(0, inside)[0])
        cells = np.arange(len(mesh.geometry.dofmap), dtype=np.int32)
        super().__init__(mesh, IntegralPoints(inside[None], cells, np.zeros_like(cells)), width)
        self._space = fem.functionspace(mesh, ("DG", degree, shape) if shape else ("DG", degree))

    def _store(self, rows: FloatArray, start: int, table: FloatArray) -> None:
        dofs = self._space.dofmap.list[start : start + len(table)]
        rows[dofs] = np.einsum("nk,cki->cni", self._to_nodes, table)


class PointsSpace(FormulaSpace):
    """Functions given at the points of an integral. Collective to make.

    Args:
        width: Components of a function; 0: it is a scalar.
    """

    def __init__(self, mesh: Mesh, points: IntegralPoints, width: int) -> None:
        super().__init__(mesh, points, width)
        self._kept: dict[int, FloatArray] = {}
        often = np.bincount(points.cells).max(initial=0)
        shared = largest(mesh.comm, float(often)) <= 1
        self._space = self._made(_PointsElement(points.sets, shared=shared), shared)

    def _made(self, scalar: _PointsElement, shared: bool) -> fem.FunctionSpace:
        """The space, with entries at the points of this rank and one that is 0 for all else."""
        element = basix.ufl.blocked_element(scalar, shape=(self._width,)) if self._width else scalar
        mesh, points, block = self._mesh, self._points, max(self._width, 1)
        size, count = len(points.cells), points.sets.shape[1]
        entries = np.full((len(mesh.geometry.dofmap), scalar.dim), size * count, dtype=np.int32)
        first = np.zeros(size, dtype=np.int32) if shared else points.which * count
        columns = first[:, None] + np.arange(count)
        entries[points.cells[:, None], columns] = np.arange(size * count).reshape(size, count)
        # The layout of a cell's entries, and DOLFINx's element, are taken from a tiny mesh.
        tiny = create_unit_cube if mesh.topology.dim == 3 else create_unit_square
        one = fem.functionspace(tiny(MPI.COMM_SELF, *[1] * mesh.topology.dim), element)
        nobody = np.empty(0, dtype=np.int32)
        index_map = make_index_map(mesh.comm, size * count + 1, nobody.astype(np.int64), nobody)
        rows = adjacency(entries)
        dofmap = cpp.fem.DofMap(one.dofmap.dof_layout, index_map, block, rows, block)
        return fem.FunctionSpace(mesh, element, space_like(one, dofmap, mesh))

    def _store(self, rows: FloatArray, start: int, table: FloatArray) -> None:
        first, size = start * table.shape[1], table.shape[0] * table.shape[1]
        rows[first : first + size] = table.reshape(size, -1)

    def _places_for(self, start: int, values: tuple[Component, ...]) -> FloatArray:
        coordinates = self._kept[start] if start in self._kept else self._places(start)
        if depends_on_time(values):
            self._kept[start] = coordinates
        return coordinates


class FormulaValues:
    """Values of formulas as constants and functions of forms.

    Args:
        points: Gives the points of an integral over parts; collective.
        degree: Of the displacement, and of what formulas are in a cell where they stand anywhere.
        t: Time [s], or load parameter.
        fields: Of the mesh, by name.

    Attributes:
        moving: Functions that change with time.
    """

    def __init__(
        self,
        mesh: Mesh,
        points: Callable[[Parts], IntegralPoints],
        degree: int,
        t: float,
        fields: Mapping[str, MeshField],
    ) -> None:
        self._mesh, self._points, self._degree, self._t = mesh, points, degree, t
        self._fields = fields
        self._spaces: dict[tuple[Parts | None, int], FormulaSpace] = {}
        self._timed: list[Callable[[float], None]] = []
        self.moving: list[fem.Function] = []

    def make(
        self, values: tuple[Component, ...], parts: Parts | None, *, scalar: bool
    ) -> Constant | fem.Function:
        """Components as one constant or function of its own.  Collective.

        Args:
            parts: Where the integral is taken that they stand in; None: anywhere.
            scalar: It is one number, else a vector.

        Returns:
            A constant where nothing varies in space, else a function with values at the points of
            the integral, or anywhere in cells.
        """
        width, timed = 0 if scalar else len(values), depends_on_time(values)
        function: Constant | fem.Function
        follow: Callable[[float], None]
        if not any(isinstance(value, Formula) and value.names & PLACE for value in values):
            function = Constant(self._mesh, np.zeros(width or ()))
            follow = partial(_set_constant, function, values)
        else:
            space = self._space(parts, width)
            function = space.function()
            follow = partial(space.fill, function, values)
            self.moving += [function] * timed
        follow(self._t)
        self._timed += [follow] * timed
        return function

    def places(self, parts: Parts) -> FloatArray:
        """Points of this rank at which formulas on parts are evaluated [m], (n, 3). Collective.

        Args:
            parts: Where the integral is taken.
        """
        known = (space for (there, _), space in self._spaces.items() if there == parts)
        space = next(known, None)
        return (self._space(parts, 0) if space is None else space).places()

    def _space(self, parts: Parts | None, width: int) -> FormulaSpace:
        if (parts, width) not in self._spaces:
            self._spaces[parts, width] = (
                CellwiseSpace(self._mesh, self._degree, width)
                if parts is None
                else PointsSpace(self._mesh, self._points(parts), width)
            )
            self._spaces[parts, width].fields = self._fields
        return self._spaces[parts, width]

    def set_time(self, t: float) -> None:
        """Evaluates what changes with time. Not collective.

        Args:
            t: Time [s], or load parameter.
        """
        if t != self._t:
            self._t = t
            for follow in self._timed:
                follow(t)


def _set_constant(constant: Constant, values: tuple[Component, ...], t: float) -> None:
    # At one point, as an array: whether a value is finite is the solver's to tell, as elsewhere.
    result = [number_at(value, np.zeros((1, 3)), t)[0] for value in values]
    constant.value = np.reshape(result, constant.value.shape)
