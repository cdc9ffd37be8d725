"""Block Jacobi, the smoother of multigrid in blocks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from dolfin_elastic.core.jit import CFunctions
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray, IntArray, SingleArray
from dolfin_elastic.solvers.assembly.symmetric.several import Vectors
from dolfin_elastic.solvers.linear.block_rows import (
    BlockRows,
    HalfRows,
    SymmetricRows,
    in_single_precision,
    into_single_precision,
    of_width,
    with_room,
)
from dolfin_elastic.solvers.linear.surface_means import SurfaceMeans

STEP = 0x9E3779B97F4A7C15
"""2^64 over the golden ratio."""


def random_vector(first: int, count: int) -> FloatArray:
    """Numbers evenly spread between -1 and 1, always the same for the same places. Not collective.

    The generator SplitMix64, whose k-th number is a function of k: G. L. Steele, D. Lea and C. H.
    Flood, Fast splittable pseudorandom number generators, OOPSLA (2014) 453, with the constants of
    D. Stafford's thirteenth variant.

    Args:
        first: Place of the first one, as in a vector of which each rank has a part.
    """
    z = np.arange(first + 1, first + 1 + count, dtype=np.uint64) * np.uint64(STEP)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        z = (z ^ (z >> np.uint64(shift))) * np.uint64(factor)
    z ^= z >> np.uint64(31)
    return np.asarray((z >> np.uint64(11)) * 2.0**-52 - 1.0)


Arrays: TypeAlias = tuple[IntArray, IndexArray, SingleArray]
"""Where rows begin, columns, and blocks."""

DAMPING = 1.7
"""Step of block Jacobi, over the largest eigenvalue of D^-1 A."""

SAFETY = 1.05
"""Factor of that eigenvalue after `POWERS` steps of the power method."""

POWERS = 12

MORE_POWERS = 4
"""The same from the vector of an earlier tangent."""


@dataclass(frozen=True)
class Diagonal:
    """Diagonal blocks D of a matrix A.

    Attributes:
        inverse: Their inverses.
        sizes: Their Frobenius norms.
        largest: Estimated eigenvalue of D^-1 A.
        vector: Of that eigenvalue, at owned nodes and ghosts, of any length.
    """

    inverse: FloatArray
    sizes: FloatArray
    largest: float
    vector: FloatArray


def diagonal_of(
    A: BlockRows,
    loops: CFunctions,
    vector: FloatArray | None = None,
    means: SurfaceMeans | None = None,
) -> Diagonal:
    """The diagonal of a matrix, which stays as it is. Collective.

    Args:
        vector: That of a similar matrix, which is overwritten.
        means: Take the place of nodes of a surface, where there are some.
    """
    blocks = A.diagonal(loops)
    sizes = np.sqrt(np.einsum("irc,irc->i", blocks, blocks))
    if means is not None:
        means.take(blocks, loops)
    loops.call("invert_blocks", A.R, A.rows, blocks)
    steps = MORE_POWERS
    if vector is None:
        steps, vector = POWERS, np.zeros((A.halo.size, A.R))
        own = vector[: A.rows]
        own[:] = random_vector(A.halo.first * A.R, own.size).reshape(own.shape)
    size = _largest(A, blocks, loops, vector, steps, means)
    return Diagonal(blocks, sizes, size, vector)


def _largest(
    A: BlockRows,
    inverse: FloatArray,
    loops: CFunctions,
    vector: FloatArray,
    steps: int,
    means: SurfaceMeans | None,
) -> float:
    """Eigenvalue of D^-1 A by the power method. Collective.

    Args:
        inverse: D^-1.
        vector: Where to start; the last one is left there.
    """
    x, size = vector[: A.rows], 1.0
    for _ in range(steps):
        x /= size
        A.halo.fill(vector)
        loops.call("times_diagonal", A.R, A.rows, inverse, A.times(vector, loops), x)
        if means is not None:
            means.correct(x)
        size = float(np.sqrt(total(A.halo.comm, float(np.vdot(x, x)))))
    return SAFETY * size


class Smoother:
    """Block Jacobi for the matrix of one level, in single precision. Collective to make.

    Args:
        A: The matrix, whose blocks are taken over: it has none of its own any longer.
        diagonal: That of A, where it is known.
        means: See `diagonal_of`.

    Attributes:
        halo: Nodes that a rank's rows refer to.
        sizes: Rows of a block, and owned nodes.
        largest: Estimated eigenvalue of D^-1 A.
        x: The iterate, of owned and other nodes, for one right-hand side or `EIGHT`.
    """

    def __init__(
        self,
        A: BlockRows,
        loops: CFunctions,
        diagonal: Diagonal | None = None,
        means: SurfaceMeans | None = None,
    ) -> None:
        self._loops, self.halo, self.sizes = loops, A.halo, (A.R, A.rows)
        self._means = means
        self.x: Vectors = np.empty((0, A.R))
        self._y: Vectors = self.x
        self._made: dict[tuple[int, ...], tuple[Vectors, Vectors]] = {}
        self._scale(diagonal or diagonal_of(A, loops, means=means))
        self._take(A)

    def _scale(self, diagonal: Diagonal) -> None:
        self.largest, self._vector = diagonal.largest, diagonal.vector
        self._scaled = in_single_precision(diagonal.inverse, self._loops)
        self._scaled *= np.float32(DAMPING / self.largest)

    def _take(self, A: BlockRows) -> None:
        self._matrix: Arrays = (A.start, A.columns, taken_in_single_precision(A, self._loops))

    def _rows(self) -> Arrays:
        return self._matrix

    def from_zero(self, b: Vectors) -> None:
        """The first iterate, from zero. Collective."""
        if (width := b.shape[2:]) not in self._made:  # not before: making levels needs room
            R, n = self.sizes
            shapes = ((count, R, *width) for count in (self.halo.size, n))
            self._made[width] = np.zeros(next(shapes), b.dtype), np.zeros(next(shapes), b.dtype)
        self.x, self._y = self._made[width]
        self._call("smooth_first", b, *self.sizes, self._scaled, b, self.x)
        if self._means is not None:
            self._means.correct(self.x[: self.sizes[1]])
        self.halo.fill(self.x)

    def restrict(self, b: Vectors, P: Arrays, coarse: Vectors) -> None:
        """Adds P^T (b - A x). Local.

        Args:
            b: Right-hand side, of owned nodes.
            coarse: At all coarse nodes here, is added to; with room as in `room_for`.
        """
        self._restrict("restrict_residual", b, P, coarse)

    def _restrict(self, loop: str, b: Vectors, P: Arrays, coarse: Vectors, *room: Vectors) -> None:
        (R, n), C = self.sizes, coarse.shape[1]
        matrix = (*self._rows(), len(self.x), self.x, b)
        out = (len(coarse), with_room(coarse))
        self._call(loop, b, R, C, n, *matrix, *P, *out, *room)

    def once_more(self, b: Vectors) -> Vectors:
        """The next iterate, of owned nodes; valid until the next call. Collective."""
        self.halo.fill(self.x)
        self._smooth(b)
        if self._means is not None:
            self._means.correct(self._y, self.x[: self.sizes[1]])
        return self._y

    def _smooth(self, b: Vectors) -> None:
        self._improve("smooth", b)

    def _improve(self, loop: str, b: Vectors) -> None:
        x = (len(self.x), self.x)
        self._call(loop, b, *self.sizes, *self._rows(), self._scaled, *x, b, self._y)

    def _call(self, name: str, b: Vectors, *arguments: int | AnyArray) -> None:
        self._loops.call(of_width(name, b), *arguments)

    def renew(self) -> None:
        """Follows a matrix that is not its own; any other is kept as it was. Collective."""

    def destroy(self) -> None:
        """Frees PETSc's objects. Collective."""
        self.halo.destroy()


class HalvedSmoother(Smoother):
    """The same for a matrix by the half of its blocks. Collective to make."""

    def _take(self, A: BlockRows) -> None:
        assert isinstance(A, HalfRows)
        self._matrix = A.rounded()

    def restrict(self, b: Vectors, P: Arrays, coarse: Vectors) -> None:
        """See `Smoother.restrict`."""
        self._restrict("restrict_residual_of_half", b, P, coarse, self._y)

    def _smooth(self, b: Vectors) -> None:
        self._improve("smooth_of_half", b)


class TangentSmoother(HalvedSmoother):
    """The same for a tangent, which stays where it is. Collective to make.

    So it smooths with the tangent of the moment, though coarser levels may be older: a cycle is
    positive definite as long as its smoother converges for the matrix of the finest level.

    Args:
        diagonal: That of A, where it is known.
    """

    def _take(self, A: BlockRows) -> None:
        assert isinstance(A, SymmetricRows)
        A.forget_pattern()
        self._tangent, self._version = A.half, A.half.version

    def _rows(self) -> Arrays:
        return self._tangent.start, self._tangent.columns, self._tangent.high

    def renew(self) -> None:
        """See `Smoother.renew`."""
        if self._version == self._tangent.version:
            return
        self._version = self._tangent.version
        vector = self._vector if np.isfinite(self.largest) else None
        A = SymmetricRows(self._tangent)
        self._scale(diagonal_of(A, self._loops, vector, self._means))

    def destroy(self) -> None:
        """See `Smoother.destroy`: the halo is the tangent's."""


def smoother_of(
    A: BlockRows,
    loops: CFunctions,
    diagonal: Diagonal | None = None,
    means: SurfaceMeans | None = None,
) -> Smoother:
    """The smoother that fits a matrix. Collective.

    Args:
        A: The matrix, which the smoother takes over.
        diagonal: That of A, where it is known.
        means: See `diagonal_of`.
    """
    kinds: dict[type[BlockRows], type[Smoother]]
    kinds = {SymmetricRows: TangentSmoother, HalfRows: HalvedSmoother}
    return kinds.get(type(A), Smoother)(A, loops, diagonal, means)


def taken_in_single_precision(A: BlockRows, loops: CFunctions) -> SingleArray:
    """The same of the blocks of a matrix, which loses them. Not collective.

    In their memory, whose second half is freed, if all of them are there.
    """
    if not A.whole:
        out = np.zeros(A.start[-1] * A.R * A.C + 1, dtype=np.float32)
        for first, _, part in A.parts():
            where = out[A.start[first] * A.R * A.C :]
            loops.call("in_single_precision", *part.shape, part, where)
        A.take_blocks()
        return out
    return into_single_precision(A.take_blocks(), loops)
