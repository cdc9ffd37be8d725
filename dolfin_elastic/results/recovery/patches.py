"""Superconvergent patch recovery: polynomials fitted to values at points inside the cells.

The patch of a vertex consists of the cells of one region that share it.  On it a polynomial of the
degree of the displacement is fitted by least squares to the values at the sampling points, where
the stress is most accurate: the barycentre of linear elements, and the points of the quadrature
rule of degree 2 of quadratic ones.  Points have the weight exp(-(r/h)^2), r the distance from the
vertex and h its root mean square over the patch: beside a surface, where patches lie on one side,
the polynomial follows a steep stress further than without.  The value at the vertex is that of its
polynomial, the one at the middle of an edge the mean of those of both ends.

A patch at a corner may have too few points for a polynomial, or so few, or so placed, that its
value at the vertex is an extrapolation that multiplies errors.  Then it is that of the vertices
beside it whose patches serve, averaged, as Zienkiewicz and Zhu take the values on the boundary from
the patches inside.  That is an extrapolation, too, and is done only as far as it does not multiply
errors: in a slender part one layer thick, in which few patches serve or none, a polynomial that
passed from vertex to vertex would grow with the square of the distance.  Where no patch that serves
is near enough, the degree is lowered until the vertex's own patch serves.

The value of a polynomial at a point is a sum of those of the sampling points, whose absolute
weights have by Cauchy and Schwarz at most the sum sqrt(p^T C p), p the monomials at the point and C
the inverse of the normal equations times the sum of the points' weights.  C is moved from vertex to
vertex as the polynomial is; that of a mean is at most the mean.

Sums over the cells of a patch are accumulated over the ranks, so that the result does not depend on
how the mesh is shared out, and nothing else is exchanged.

Source: O. C. Zienkiewicz and J. Z. Zhu, Int. J. Numer. Meth. Eng. 33 (1992) 1331, section 3;
weights: P. Lancaster and K. Salkauskas, Math. Comp. 37 (1981) 141; sampling points: J. Barlow, Int.
J. Numer. Meth. Eng. 10 (1976) 243.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations_with_replacement, permutations

import basix
import numpy as np
from dolfinx import fem, la
from dolfinx.mesh import Mesh

from dolfin_elastic.core.jit import JitOptions, compile_c, options
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import AnyArray, BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.geometry.curved import quadrature_rule, shape_functions

_CHUNK = 2048
"""Cells that are treated at once, which bounds the memory."""
_REGULAR = 1e5
"""Trace of the normal equations of a patch with enough points, times that of their inverse: at
least their condition."""
_GAIN = 10.0
"""Largest sum of the absolute weights of the points in the value at a vertex: its error is at most
so many times theirs.  Of one-sided patches of sound meshes it is 3 to 7, of four tetrahedra that
meet at a vertex of the surface it may be 100."""
_TAKEN = 2 * _GAIN
"""Limit of the bound of that sum for a value that is taken from the patches beside.  The bound is
about 1.7 times the sum, and 3 to 13 at corners of sound meshes."""
ROUNDS = 3
"""Most edges between a vertex and the patch whose polynomial it takes."""
_WIDEST = 64
"""Columns for which the loops in C have room."""


def sampling_points(dim: int, degree: int) -> FloatArray:
    """Points of the reference cell where stresses are most accurate, shape (points, dim).

    Args:
        dim: 2: triangle, 3: tetrahedron.
    """
    return quadrature_rule(dim, 1 if degree == 1 else 2)[0]


def cell_edges(dim: int) -> IntArray:
    """Corners at the ends of each edge of a cell, shape (edges, 2).

    Args:
        dim: 2: triangle, 3: tetrahedron.
    """
    kind = (basix.CellType.triangle, basix.CellType.tetrahedron)[dim - 2]
    return np.array(basix.topology(kind)[1], dtype=np.int64)


class Patches:
    """Patch recovery in one region of a mesh.  All of it is collective.

    Args:
        V: Vector-valued Lagrange space of degree 1 or 2, at whose nodes values are recovered.
        cells: Owned cells of the region on this rank, without repetition.
        jit_options: For loops in C; by default those of the program.

    Attributes:
        cells: As given.
    """

    def __init__(
        self, V: fem.FunctionSpace, cells: IndexArray, jit_options: JitOptions | None = None
    ) -> None:
        self.cells, self._mesh = np.ascontiguousarray(cells, dtype=np.int32), V.mesh
        self._dim, self._degree = V.mesh.topology.dim, V.element.basix_element.degree
        self._powers, self._edges = _powers(self._dim, self._degree), cell_edges(self._dim)
        samples = shape_functions(V.mesh, sampling_points(self._dim, self._degree))
        nodes = shape_functions(V.mesh, np.asarray(V.element.basix_element.points))
        self._loops = compile_c(
            V.mesh.comm,
            "patches.c",
            {
                "DIM": self._dim,
                "DEGREE": self._degree,
                "NG": nodes.shape[1],
                "ND": len(nodes),
                "NS": len(samples),
                "NM": len(self._powers),
                "WIDEST": _WIDEST,
            },
            jit_options or options(V.mesh.comm),
        )
        geometry, x = V.mesh.geometry.dofmap, V.mesh.geometry.x
        self._geometry = (len(geometry), geometry, len(x), x)
        self._samples, self._nodes = np.ascontiguousarray(samples), np.ascontiguousarray(nodes)
        self._map = V.mesh.topology.index_map(0)
        self._used, self._corners = self._numbered()
        self._centres = self._vertex_places()
        vertices = (len(self._used), self._centres)
        where = (self._samples, self._corners, *vertices)
        count, squares = self._summed(2, "add_spread", where).T
        self._size = np.sqrt(np.where(squares > 0, squares / np.maximum(count, 1), 1.0))
        self._frames = self._corners, *vertices, self._size
        self._solve, weights, serves = self._normal_equations()
        self._rounds = self._plan_extrapolation(weights, serves)

    def __call__(self, values: FloatArray) -> FloatArray:
        """Recovers fields from their values at the sampling points. Collective.

        Args:
            values: Shape (cells, sampling points, columns).

        Returns:
            Values at the nodes of the cells, shape (cells, nodes of a cell, columns); the same at
            a node in all cells of the region.
        """
        return self.at_nodes(self.fit(values), slice(0, len(self.cells)))

    def fit(self, values: FloatArray) -> FloatArray:
        """The polynomials of fields from their values at the sampling points. Collective.

        Args:
            values: Shape (cells, sampling points, columns).

        Returns:
            Coefficients at the vertices of the cells, shape (vertices, monomials, columns).
        """
        return self.fit_parts(values.shape[2], values.__getitem__)

    def fit_parts(self, width: int, values: Callable[[slice], FloatArray]) -> FloatArray:
        """As `fit`, of values that are made for some cells at a time. Collective.

        Args:
            values: Of one of `parts`, shape (cells, sampling points, columns). Not collective.
        """
        size = len(self._powers)
        sums = _Sums(self._mesh, self._used, size * width)
        for part in self.parts():
            result = np.ascontiguousarray(values(part))
            if result.any():  # else as of a body at rest
                cells, corners = self.cells[part], self._corners[part]
                where = (len(cells), cells, *self._geometry, self._samples, corners)
                others = (len(self._used), self._centres, self._size, width, result)
                self._loops.call("add_moments", *where, *others, sums.rows)
        right = sums.over_ranks().reshape(-1, size, width)
        if not total(self._mesh.comm, float(right.any())):
            return right
        for first in range(0, len(right), _CHUNK):  # in place: both would be large
            some = slice(first, first + _CHUNK)
            right[some] = self._solve[some] @ right[some]
        for extrapolation in self._rounds:
            self._extrapolate(right, extrapolation)
        return right

    def sums(self, values: FloatArray) -> Callable[[slice], FloatArray]:
        """Sums of values of cells over the patches of their corners. Collective.

        Args:
            values: Shape (cells, columns).

        Returns:
            Those of one of `parts`, shape (cells, corners, columns). Local.
        """
        table = _Sums(self._mesh, self._used, values.shape[1])
        for column, row in enumerate(values.T):
            for corners in self._corners.T:
                table.rows[:, column] += np.bincount(corners, row, len(self._used))
        summed = table.over_ranks()
        return lambda part: np.asarray(summed[self._corners[part]])

    def add_at_nodes(
        self, cells: slice, nodes: IndexArray, values: FloatArray, sums: FloatArray
    ) -> None:
        """Adds values at the nodes of some cells to sums at nodes. Not collective.

        Args:
            nodes: Of all local cells, shape (local cells, nodes of a cell).
            values: Shape (cells, nodes of a cell, columns).
            sums: Shape (local nodes, columns + 1); in the last column are the numbers of summands.
        """
        chosen = self.cells[cells]
        where = (len(chosen), chosen, len(nodes), nodes)
        self._loops.call("add_nodal", *where, values.shape[2], values, len(sums), sums)

    def errors(
        self, cells: slice, rule: ErrorRule, recovered: FloatArray, raw: RawValues
    ) -> tuple[FloatArray, FloatArray]:
        """Integrals of the difference of recovered and raw values. Not collective.

        Args:
            recovered: At the nodes, shape (cells, nodes of a cell, columns).

        Returns:
            Strain energy of the error, elastic energy, integral of the square of the von Mises
            stress of the error, and volume, shape (cells, 4); and the recovered stress at the nodes
            less that of the cell, shape (cells, nodes of a cell, 6).
        """
        chosen, width = self.cells[cells], recovered.shape[2]
        assert width <= _WIDEST
        result = np.zeros((len(chosen), 4))
        difference = np.empty((*recovered.shape[:2], 6))
        self._loops.call(
            "add_errors",
            len(chosen),
            chosen,
            *self._geometry,
            len(rule.weights),
            rule.gradients,
            rule.weights,
            rule.shape,
            rule.to_nodes,
            width,
            len(rule.shares),
            rule.shares,
            int(width > 6 + 2 * len(rule.shares)),
            recovered,
            raw.values.shape[1],
            raw.first,
            raw.step,
            raw.values,
            result,
            difference,
        )
        return result, difference

    # --- geometry ---

    def _numbered(self) -> tuple[IntArray, IndexArray]:
        """The vertices of the cells, and their numbers among them, shape (cells, corners)."""
        topology = self._mesh.topology
        corners = topology.connectivity(self._dim, 0).array.reshape(-1, self._dim + 1)
        in_order = np.array_equal(self.cells, np.arange(len(self.cells)))
        corners = corners[: len(self.cells)] if in_order else corners[self.cells]
        marks = np.zeros(self._map.size_local + self._map.num_ghosts, dtype=np.int32)
        marks[corners] = 1
        used = np.flatnonzero(marks)
        if len(used) == len(marks):  # as of a body of one region: the mesh has them already
            return used, corners
        marks[used] = np.arange(len(used), dtype=np.int32)
        return used, marks[corners]

    def _vertex_places(self) -> FloatArray:
        """Places of the used vertices, shape (vertices, dim)."""
        nodes = np.empty(len(self._used), dtype=np.int32)
        nodes[self._corners] = self._mesh.geometry.dofmap[self.cells, : self._dim + 1]
        return np.ascontiguousarray(self._mesh.geometry.x[nodes, : self._dim])

    # --- sums over patches ---

    def _summed(self, width: int, name: str, arguments: tuple[int | AnyArray, ...]) -> FloatArray:
        """Sums over the cells of each patch on all ranks, shape (vertices, columns).

        Args:
            name: Of the loop that adds them up.
            arguments: What it needs but cells, geometry and the table of sums.
        """
        table = _Sums(self._mesh, self._used, width)
        where = (len(self.cells), self.cells, *self._geometry)
        self._loops.call(name, *where, *arguments, table.rows)
        return table.over_ranks()

    def _normal_equations(self) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Inverse of the normal equations of each patch, its sum of weights, and where it serves.

        Where it does not, the inverse is that of the highest degree of which it does.
        """
        size, where = len(self._powers), (self._samples, *self._frames)
        products = self._summed(size * size, "add_products", where)
        solve = np.zeros((len(products), size, size))
        regular = np.zeros(len(products), dtype=np.int8)
        most = np.array([_REGULAR])
        self._loops.call("invert_products", len(products), most, products, solve, regular)
        gains = self._gains(solve, slice(None))
        serves = (regular > 0) & (gains < _GAIN)
        for kept in (1 + self._dim, 1)[2 - self._degree :]:
            weak = gains >= _GAIN
            if not total(self._mesh.comm, int(weak.sum())):
                break
            block = products[weak].reshape(-1, size, size)[:, :kept, :kept]
            lower = np.zeros((len(block), size, size))
            lower[:, :kept, :kept] = np.linalg.inv(block)
            solve[weak] = lower
            around = np.asarray(weak[self._corners].any(axis=1))
            gains = np.where(weak, self._gains(solve, around), gains)
        return solve, np.array(products[:, 0]), serves

    def _gains(self, solve: FloatArray, some: slice | BoolArray) -> FloatArray:
        """Sum of the absolute weights of the points in the value at each vertex. Collective.

        Args:
            some: Those of the cells that are summed over.
        """
        table, cells = _Sums(self._mesh, self._used, 1), self.cells[some]
        corners = self._corners[some]
        where = (len(cells), cells, *self._geometry, self._samples, corners, *self._frames[1:])
        self._loops.call("add_gains", *where, solve, table.rows)
        return table.over_ranks()[:, 0]

    # --- patches with too few points ---

    def _plan_extrapolation(self, weights: FloatArray, serves: BoolArray) -> list[_Extrapolation]:
        """Rounds in which vertices get the polynomials of those beside them. Collective.

        Args:
            weights: Sum of those of the points of each patch.
            serves: Vertices whose own patches serve, of all local ones.
        """
        rounds: list[_Extrapolation] = []
        known, comm = serves.copy(), self._mesh.comm
        bounds = np.zeros(self._solve.shape)  # which takes memory only where it is filled in
        near = np.unique(self._corners[~known[self._corners].all(axis=1)])
        near = near[known[near]]
        bounds[near] = weights[near, None, None] * self._solve[near]
        while len(rounds) < ROUNDS and total(comm, int(np.sum(~known))):
            corners = self._corners[~known[self._corners].all(axis=1)]
            has = known[corners]
            beside = np.where(has, 0, has.sum(axis=1, keepdims=True)).astype(np.float64)
            table = _Sums(self._mesh, self._used, 1)
            np.add.at(table.rows[:, 0], corners, beside)
            count = table.over_ranks()[:, 0]
            step = _Extrapolation(known.copy(), count > 0, count, corners)
            self._extrapolate(bounds, step, quadratic=True)
            new = (count > 0) & (bounds[:, 0, 0] < _TAKEN**2)
            if not total(comm, int(np.sum(new))):
                break
            touched = corners[new[corners].any(axis=1)]
            rounds.append(_Extrapolation(step.known, new, count, touched))
            known |= new
        return rounds

    def _extrapolate(
        self, fitted: FloatArray, step: _Extrapolation, *, quadratic: bool = False
    ) -> None:
        """Fills in the polynomials of one round.

        Args:
            quadratic: They are matrices of quadratic forms of the monomials, not coefficients.
        """
        rows, width = np.flatnonzero(step.new), fitted.shape[1] * fitted.shape[2]
        offset = np.empty(len(fitted), dtype=np.int32)
        offset[rows] = np.arange(len(rows), dtype=np.int32)
        sums = np.zeros((len(rows), *fitted.shape[1:]))
        for a, b in permutations(range(self._dim + 1), 2):
            to, of = step.corners[:, a], step.corners[:, b]
            both = step.new[to] & step.known[of]
            shift = self._shift(of[both], to[both])
            moved = shift @ fitted[of[both]]
            if quadratic:
                moved = moved @ shift.transpose(0, 2, 1)
            np.add.at(sums, offset[to[both]], moved)
        if self._mesh.comm.size > 1:
            table = _Sums(self._mesh, self._used, width)
            table.rows[rows] = sums.reshape(-1, width)
            sums = table.over_ranks()[rows].reshape(sums.shape)
        fitted[rows] = sums / step.count[rows, None, None]

    def _shift(self, of: IndexArray, to: IndexArray) -> FloatArray:
        """Matrices that make polynomials about some vertices polynomials about others."""
        offset = (self._centres[to] - self._centres[of]) / self._size[of][:, None]
        return _shift_matrices(offset, self._size[to] / self._size[of], self._powers)

    # --- evaluation ---

    def parts(self) -> list[slice]:
        """The cells in parts whose values need little memory."""
        return [slice(i, i + _CHUNK) for i in range(0, len(self.cells), _CHUNK)]

    def at_nodes(self, fitted: FloatArray, cells: slice) -> FloatArray:
        """Values at the nodes of some cells, shape (cells, nodes of a cell, columns).

        Not collective.

        Args:
            fitted: From `fit`.
        """
        chosen, width = self.cells[cells], fitted.shape[2]
        result = np.empty((len(chosen), len(self._nodes), width))
        edges = self._edges.astype(np.int32)
        vertices = (len(self._used), self._centres, self._size)
        where = (self._nodes, self._corners[cells], *vertices, edges)
        self._loops.call(
            "take_nodal", len(chosen), chosen, *self._geometry, *where, width, fitted, result
        )
        return result


class _Sums:
    """Sums over the cells around vertices on all ranks. Collective to make.

    Nothing collective may stand between that and `over_ranks`: which of the two makes the vector
    of DOLFINx differs between ranks.

    Attributes:
        rows: To be added to; shape (used vertices, columns).
    """

    def __init__(self, mesh: Mesh, used: IntArray, width: int) -> None:
        self._vertices, self._used, self._width = mesh.topology.index_map(0), used, width
        self._comm = mesh.comm
        self._work: la.Vector | None = None
        if (
            mesh.comm.size > 1
            and len(used) == self._vertices.size_local + self._vertices.num_ghosts
        ):
            self._work, self.rows = self._shared()  # no copies
        else:
            self.rows = np.zeros((len(used), width))

    def _shared(self) -> tuple[la.Vector, FloatArray]:
        work = la.vector(self._vertices, self._width)
        return work, work.array.reshape(-1, self._width)

    def over_ranks(self) -> FloatArray:
        """The sums. Collective; called once.

        Returns:
            Of the shape of `rows`, which it may overwrite.
        """
        if self._comm.size == 1:
            return self.rows
        work, rows = self._shared() if self._work is None else (self._work, self.rows)
        if self._work is None:
            rows[self._used] = self.rows
        work.scatter_reverse(la.InsertMode.add)
        work.scatter_forward()
        return np.asarray(rows[self._used]) if self._work is None else rows


@dataclass(frozen=True)
class ErrorRule:
    """How differences of values at nodes and at points are integrated.

    Attributes:
        gradients: Those of the geometry's shape functions, shape (points, geometry nodes, dim).
        weights: Of the points, shape (points,).
        shape: Shape functions at the points, shape (points, nodes of a cell).
        to_nodes: Values at nodes of values at points, shape (nodes of a cell, points).
        shares: How often each product of a stress and a strain counts.
    """

    gradients: FloatArray
    weights: FloatArray
    shape: FloatArray
    to_nodes: FloatArray
    shares: FloatArray


@dataclass(frozen=True)
class RawValues:
    """Values of the finite element solution at the points of an `ErrorRule`.

    Attributes:
        values: Shape (cells, rows, columns).
        first: Row of the first point.
        step: Rows between points; 0: all points have those of the first.
    """

    values: FloatArray
    first: int
    step: int


@dataclass(frozen=True)
class _Extrapolation:
    """One round of extrapolation.

    Attributes:
        known: Vertices whose polynomials are known before.
        new: Vertices that get theirs.
        count: Number of summands of each vertex.
        corners: Of the cells that have new vertices, shape (cells, corners).
    """

    known: BoolArray
    new: BoolArray
    count: FloatArray
    corners: IndexArray


# --- polynomials ---


def _powers(dim: int, degree: int) -> list[tuple[int, ...]]:
    """Exponents of the monomials up to a degree, the lowest first."""
    result = []
    for order in range(degree + 1):
        for factors in combinations_with_replacement(range(dim), order):
            result.append(tuple(factors.count(axis) for axis in range(dim)))
    return result


def _shift_matrices(
    offset: FloatArray, ratio: FloatArray, powers: list[tuple[int, ...]]
) -> FloatArray:
    """Matrices that move polynomials f(x) of degree up to 2 to g(y) = f(offset + ratio y).

    Args:
        offset: Shape (n, dim).
        ratio: Shape (n,).
        powers: Exponents of each monomial.

    Returns:
        Shape (n, monomials, monomials).
    """
    number = {power: i for i, power in enumerate(powers)}
    result = np.zeros((len(offset), len(powers), len(powers)))
    for column, power in enumerate(powers):
        # The product of (offset_j + ratio y_j) over the factors j of the monomial.
        factors = [axis for axis, exponent in enumerate(power) for _ in range(exponent)]
        for taken in _subsets(len(factors)):
            row = [0] * len(power)
            value: FloatArray = np.ones(len(offset))
            for offsets, axis in enumerate(factors):
                if offsets in taken:
                    row[axis] += 1
                    value = value * ratio
                else:
                    value = value * offset[:, axis]
            result[:, number[tuple(row)], column] += value
    return result


def _subsets(size: int) -> Iterator[frozenset[int]]:
    """All subsets of 0 ... size - 1."""
    for mask in range(2**size):
        yield frozenset(i for i in range(size) if mask >> i & 1)
