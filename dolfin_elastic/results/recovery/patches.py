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
the patches inside; where a part of a region has no such patch at all, as one of a single cell, the
degree is lowered until the fit is unique.

Sums over the cells of a patch are accumulated over the ranks, so that the result does not depend on
how the mesh is shared out, and nothing else is exchanged.

Source: O. C. Zienkiewicz and J. Z. Zhu, Int. J. Numer. Meth. Eng. 33 (1992) 1331, section 3;
weights: P. Lancaster and K. Salkauskas, Math. Comp. 37 (1981) 141; sampling points: J. Barlow, Int.
J. Numer. Meth. Eng. 10 (1976) 243.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations_with_replacement

import basix
import numpy as np
from dolfinx import fem, la

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.geometry.curved import quadrature_rule, shape_functions

_CHUNK = 8192
"""Cells that are treated at once, which bounds the memory."""
_FEW = 20000
"""Values of so few rows are summed before scipy is imported."""
_REGULAR = 1e-5
"""Least over largest eigenvalue of the normal equations of a patch with enough points."""
_GAIN = 10.0
"""Largest sum of the absolute weights of the points in the value at a vertex: its error is at most
so many times theirs.  Of one-sided patches of sound meshes it is 3 to 7, of four tetrahedra that
meet at a vertex of the surface it may be 100."""


def sampling_points(dim: int, degree: int) -> FloatArray:
    """Points of the reference cell where stresses are most accurate, shape (points, dim).

    Args:
        dim: 2: triangle, 3: tetrahedron.
        degree: Of the displacement.
    """
    return quadrature_rule(dim, 1 if degree == 1 else 2)[0]


def cell_edges(dim: int) -> IntArray:
    """Corners at the ends of each edge of a cell, shape (edges, 2).

    Args:
        dim: 2: triangle, 3: tetrahedron.
    """
    kind = (basix.CellType.triangle, basix.CellType.tetrahedron)[dim - 2]
    return np.array(basix.topology(kind)[1], dtype=np.int64)


def sums_by_row(rows: IndexArray, values: FloatArray, count: int) -> FloatArray:
    """Sums of the values that belong to each row of a table, shape (count, columns).

    Args:
        rows: Row of each value, any shape.
        values: The same shape and (columns,).
        count: Number of rows.
    """
    flat, table = rows.reshape(-1), values.reshape(rows.size, values.shape[-1])
    if rows.size < _FEW:
        found = np.zeros((count, table.shape[1]))
        np.add.at(found, flat, table)
        return found
    from scipy.sparse import csc_array

    # Columns of one entry each: the product is one pass over the values, 15 to 30 times as fast as
    # numpy's ways.
    columns = np.arange(rows.size + 1, dtype=np.int32)
    matrix = csc_array((np.ones(rows.size), flat, columns), shape=(count, rows.size))
    return np.asarray(matrix @ table)


class Patches:
    """Patch recovery in one region of a mesh.  All of it is collective.

    Args:
        V: Vector-valued Lagrange space of degree 1 or 2, at whose nodes values are recovered.
        cells: Owned cells of the region on this rank, without repetition.

    Attributes:
        cells: As given.
    """

    def __init__(self, V: fem.FunctionSpace, cells: IndexArray) -> None:
        self.cells, self._mesh = cells, V.mesh
        self._dim, self._degree = V.mesh.topology.dim, V.element.basix_element.degree
        self._vertices = fem.functionspace(V.mesh, ("Lagrange", 1)).dofmap
        self._powers = _powers(self._dim, self._degree)
        self._samples = shape_functions(V.mesh, sampling_points(self._dim, self._degree))
        self._nodes = shape_functions(V.mesh, np.asarray(V.element.basix_element.points))
        corners = self._vertices.list[cells]
        self._used, numbers = np.unique(corners, return_inverse=True)
        self._corners = numbers.reshape(corners.shape).astype(np.int64)
        self._parts = [_Chunk.of(self._corners, begin) for begin in range(0, len(cells), _CHUNK)]
        self._centres = self._vertex_places()
        count, squares = self._sum(2, self._spread).T
        self._size = np.sqrt(np.where(squares > 0, squares / np.maximum(count, 1), 1.0))
        # Of linear cells it takes 128 bytes a cell and saves half of the time of every further
        # state; of quadratic ones ten times that, a third of the tangent.
        self._kept: dict[int, FloatArray] = {}
        if self._degree == 1:
            self._kept = {part.cells.start: self._weighted(part) for part in self._parts}
        self._solve, self._regular = self._normal_equations()
        self._rounds = self._plan_extrapolation()

    def __call__(self, values: FloatArray) -> FloatArray:
        """Recovers fields from their values at the sampling points. Collective.

        Args:
            values: Shape (cells, sampling points, columns).

        Returns:
            Values at the nodes of the cells, shape (cells, nodes of a cell, columns); the same at
            a node in all cells of the region.
        """
        fitted = self.fit(values)
        parts = [self.at_nodes(fitted, part.cells) for part in self._parts]
        return np.concatenate([*parts, np.zeros((0, len(self._nodes), values.shape[2]))])

    def fit(self, values: FloatArray) -> FloatArray:
        """The polynomials of fields from their values at the sampling points. Collective.

        Args:
            values: Shape (cells, sampling points, columns).

        Returns:
            Coefficients at the vertices of the cells, shape (vertices, monomials, columns).
        """
        width, size = values.shape[2], len(self._powers)

        def moments(part: _Chunk) -> FloatArray:
            found = self._weighted(part).swapaxes(2, 3) @ values[part.cells][:, None]
            return np.asarray(found.reshape(*found.shape[:2], size * width))

        if not total(self._mesh.comm, float(np.any(values != 0.0))):  # as of a body at rest
            return np.zeros((len(self._used), size, width))
        right = self._sum(size * width, moments).reshape(-1, size, width)
        fitted = np.asarray(self._solve @ right)
        for extrapolation in self._rounds:
            self._extrapolate(fitted, extrapolation)
        return fitted

    def sums(self, values: FloatArray) -> FloatArray:
        """Sums of values of cells over the patches of their corners. Collective.

        Args:
            values: Shape (cells, columns).

        Returns:
            Shape (cells, corners, columns).
        """

        def summand(part: _Chunk) -> FloatArray:
            return np.repeat(values[part.cells][:, None], part.corners.shape[1], axis=1)

        return self._sum(values.shape[1], summand)[self._corners]

    # --- geometry ---

    def _vertex_places(self) -> FloatArray:
        """Places of the used vertices, shape (vertices, dim)."""
        places = np.zeros((len(self._used), self._dim))
        nodes = self._mesh.geometry.dofmap[self.cells][:, : self._dim + 1]
        places[self._corners.reshape(-1)] = self._mesh.geometry.x[nodes.reshape(-1), : self._dim]
        return places

    def _places(self, cells: slice, shape: FloatArray) -> FloatArray:
        """Places of points of the reference cell, shape (cells, points, dim)."""
        nodes = self._mesh.geometry.x[self._mesh.geometry.dofmap[self.cells[cells]]]
        return np.einsum("sn,cnj->csj", shape, nodes[:, :, : self._dim])

    def _spread(self, part: _Chunk) -> FloatArray:
        """Number of sampling points of a cell, and the sum of their squared distances."""
        offsets = (
            self._places(part.cells, self._samples)[:, None]
            - self._centres[part.corners][:, :, None]
        )
        squares = np.einsum("cvsj,cvsj->cv", offsets, offsets)
        return np.stack([np.full(squares.shape, float(len(self._samples))), squares], axis=2)

    def _monomials(self, cells: slice, shape: FloatArray) -> FloatArray:
        """Monomials about each corner of a cell, shape (cells, corners, points, monomials)."""
        places, corners = self._places(cells, shape), self._corners[cells]
        offsets = places[:, None] - self._centres[corners][:, :, None]
        return _monomials(offsets / self._size[corners][:, :, None, None], self._powers)

    def _weighted(self, part: _Chunk) -> FloatArray:
        """Monomials at the sampling points times weights, shape (cells, corners, points, -)."""
        kept = self._kept.get(part.cells.start)
        if kept is not None:
            return kept
        p = self._monomials(part.cells, self._samples)
        return p * self._weights(p)

    def _weights(self, p: FloatArray) -> FloatArray:
        """Weight of each sampling point in a patch, shape (cells, corners, points, 1).

        Args:
            p: Monomials at the points, of which the first after 1 are the coordinates.
        """
        return np.exp(-np.sum(p[..., 1 : 1 + self._dim] ** 2, axis=3, keepdims=True))

    # --- sums over patches ---

    def _sum(self, width: int, summand: Callable[[_Chunk], FloatArray]) -> FloatArray:
        """Sums over the cells of each patch on all ranks.

        Args:
            width: Number of columns.
            summand: Gives the summands of some cells, shape (cells, corners, columns).

        Returns:
            Shape (vertices, columns).
        """
        work = la.vector(self._vertices.index_map, width)
        table = work.array.reshape(-1, width)
        for part in self._parts:
            table[self._used[part.vertices]] += part.sum(summand(part))
        work.scatter_reverse(la.InsertMode.add)
        work.scatter_forward()
        return np.asarray(table[self._used])

    def _normal_equations(self) -> tuple[FloatArray, BoolArray]:
        """Inverse of the normal equations of each patch, and where it serves.

        Where there is none, it is that of the highest degree for which there is one.
        """
        size = len(self._powers)

        def products(part: _Chunk) -> FloatArray:
            p = self._monomials(part.cells, self._samples)
            found = (p * self._weights(p)).swapaxes(2, 3) @ p
            return np.asarray(found.reshape(*found.shape[:2], size * size))

        matrices = self._sum(size * size, products).reshape(-1, size, size)
        solve = np.zeros_like(matrices)
        open_ = np.ones(len(matrices), dtype=bool)
        for degree in range(self._degree, -1, -1):
            kept = sum(sum(power) <= degree for power in self._powers)
            block = matrices[open_, :kept, :kept]
            values = np.linalg.eigvalsh(block)
            enough = values[:, 0] > _REGULAR * values[:, -1]
            rows = np.flatnonzero(open_)[enough]
            solve[rows, :kept, :kept] = np.linalg.inv(block[enough])
            open_[rows] = False
            if degree == self._degree:
                regular = ~open_
        return solve, regular & (self._gains(solve) < _GAIN)

    def _gains(self, solve: FloatArray) -> FloatArray:
        """Sum of the absolute weights of the points in the value at each vertex.

        Args:
            solve: Inverse of the normal equations of each patch.
        """

        def summand(part: _Chunk) -> FloatArray:
            shares = self._weighted(part) @ solve[part.corners, 0][..., None]
            return np.asarray(np.abs(shares).sum(axis=2))

        return self._sum(1, summand)[:, 0]

    # --- patches with too few points ---

    def _plan_extrapolation(self) -> list[_Extrapolation]:
        """Rounds in which vertices get the polynomials of those beside them. Collective."""
        rounds, known = [], self._regular.copy()
        comm = self._mesh.comm
        while total(comm, int(np.sum(~known))):

            def pairs(part: _Chunk, known: BoolArray = known) -> FloatArray:
                has = known[part.corners]
                beside = np.where(has, 0, has.sum(axis=1, keepdims=True))
                return beside[:, :, None].astype(np.float64)

            count = self._sum(1, pairs)[:, 0]
            new = count > 0
            if not total(comm, int(np.sum(new))):
                break
            rounds.append(_Extrapolation(known.copy(), new, count))
            known |= new
        return rounds

    def _extrapolate(self, fitted: FloatArray, step: _Extrapolation) -> None:
        """Fills in the polynomials of one round."""
        size, width = fitted.shape[1:]

        def shifted(part: _Chunk) -> FloatArray:
            corners = part.corners
            found = np.zeros((*corners.shape, size, width))
            for a in range(corners.shape[1]):
                rows = np.flatnonzero(step.new[corners[:, a]])
                for b in range(corners.shape[1]):
                    both = rows[step.known[corners[rows, b]]]
                    to, of = corners[both, a], corners[both, b]
                    found[both, a] += self._shift(fitted[of], of, to)
            return found.reshape(*corners.shape, size * width)

        sums = self._sum(size * width, shifted).reshape(-1, size, width)
        fitted[step.new] = sums[step.new] / step.count[step.new, None, None]

    def _shift(self, polynomials: FloatArray, of: IntArray, to: IntArray) -> FloatArray:
        """Polynomials about some vertices as polynomials about others.

        Args:
            polynomials: Coefficients, shape (n, monomials, columns).
            of: Vertices about which they are.
            to: Vertices about which they are to be.
        """
        offset = (self._centres[to] - self._centres[of]) / self._size[of][:, None]
        ratio = self._size[to] / self._size[of]
        matrix = _shift_matrices(offset, ratio, self._powers)
        return np.asarray(matrix @ polynomials)

    # --- evaluation ---

    def at_nodes(self, fitted: FloatArray, cells: slice) -> FloatArray:
        """Values at the nodes of some cells, shape (cells, nodes of a cell, columns).

        Not collective.

        Args:
            fitted: From `fit`.
            cells: Which of the region's.
        """
        edges, count, numbers = cell_edges(self._dim), self._dim + 1, self._corners[cells]
        found = np.zeros((len(numbers), len(self._nodes), fitted.shape[2]))
        found[:, :count] = np.ascontiguousarray(fitted[:, 0])[numbers]
        if self._degree > 1:
            p = self._monomials(cells, self._nodes[count:])
            for node, (a, b) in enumerate(edges):
                for end in (a, b):
                    value = p[:, end, node, None] @ fitted[numbers[:, end]]
                    found[:, count + node] += 0.5 * value[:, 0]
        return found


@dataclass(frozen=True)
class _Extrapolation:
    """One round of extrapolation.

    Attributes:
        known: Vertices whose polynomials are known before.
        new: Vertices that get theirs.
        count: Number of summands of each vertex.
    """

    known: BoolArray
    new: BoolArray
    count: FloatArray


@dataclass(frozen=True)
class _Chunk:
    """Some cells of a region, and how their summands are added up at the vertices.

    Attributes:
        cells: Their numbers in the region.
        corners: Numbers of their vertices among those of the region, shape (cells, corners).
        vertices: The vertices.
        rows: Number of each corner among these, shape (cells, corners).
    """

    cells: slice
    corners: IntArray
    vertices: IntArray
    rows: IndexArray

    @classmethod
    def of(cls, corners: IntArray, begin: int) -> _Chunk:
        """The chunk of a region that begins with one of its cells.

        Args:
            corners: Vertices of all cells, shape (cells, corners).
            begin: First cell.
        """
        cells = slice(begin, min(begin + _CHUNK, len(corners)))
        vertices, rows = np.unique(corners[cells], return_inverse=True)
        return cls(
            cells, corners[cells], vertices, rows.reshape(corners[cells].shape).astype(np.int32)
        )

    def sum(self, values: FloatArray) -> FloatArray:
        """Sums of values of corners at the vertices, shape (vertices, columns).

        Args:
            values: Shape (cells, corners, columns).
        """
        return sums_by_row(self.rows, values, len(self.vertices))


# --- polynomials ---


def _powers(dim: int, degree: int) -> list[tuple[int, ...]]:
    """Exponents of the monomials up to a degree, the lowest first."""
    found = []
    for order in range(degree + 1):
        for factors in combinations_with_replacement(range(dim), order):
            found.append(tuple(factors.count(axis) for axis in range(dim)))
    return found


def _monomials(x: FloatArray, powers: list[tuple[int, ...]]) -> FloatArray:
    """Monomials at places, shape (..., monomials).

    Args:
        x: Places, shape (..., dim).
        powers: Exponents of each monomial.
    """
    found = np.ones((*x.shape[:-1], len(powers)))
    for number, power in enumerate(powers):
        for axis, exponent in enumerate(power):
            for _ in range(exponent):
                found[..., number] *= x[..., axis]
    return found


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
    found = np.zeros((len(offset), len(powers), len(powers)))
    for column, power in enumerate(powers):
        # The product of (offset_j + ratio y_j) over the factors j of the monomial.
        factors = [axis for axis, exponent in enumerate(power) for _ in range(exponent)]
        for taken in _subsets(len(factors)):
            row = [0] * len(power)
            value: FloatArray = np.ones(len(offset))
            for place, axis in enumerate(factors):
                if place in taken:
                    row[axis] += 1
                    value = value * ratio
                else:
                    value = value * offset[:, axis]
            found[:, number[tuple(row)], column] += value
    return found


def _subsets(size: int) -> Iterator[frozenset[int]]:
    """All subsets of 0 ... size - 1."""
    for mask in range(2**size):
        yield frozenset(i for i in range(size) if mask >> i & 1)
