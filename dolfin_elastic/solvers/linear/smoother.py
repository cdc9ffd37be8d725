"""Block Jacobi, the smoother of multigrid in blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.jit import CFunctions
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, SingleArray
from dolfin_elastic.solvers.linear.block_rows import BlockRows

DAMPING = 1.7
"""Step of block Jacobi, over the largest eigenvalue of D^-1 A."""

SAFETY = 1.05
"""Factor of that eigenvalue after `POWERS` steps of the power method."""

POWERS = 12


@dataclass(frozen=True)
class Diagonal:
    """Diagonal blocks D of a matrix A.

    Attributes:
        inverse: Their inverses.
        sizes: Their Frobenius norms.
        largest: Estimated eigenvalue of D^-1 A.
    """

    inverse: FloatArray
    sizes: FloatArray
    largest: float


def diagonal_of(A: BlockRows, loops: CFunctions) -> Diagonal:
    """The diagonal of a matrix, which stays as it is. Collective.

    Args:
        A: The matrix.
        loops: Those of `block_loops`.
    """
    blocks = np.zeros((A.rows, A.R, A.R))
    for first, count, part in A.parts():
        loops.call("take_diagonal", first, count, A.R, A.start, A.columns, part, blocks)
    sizes = np.sqrt(np.einsum("irc,irc->i", blocks, blocks))
    loops.call("invert_blocks", A.R, A.rows, blocks)
    return Diagonal(blocks, sizes, _largest(A, blocks, loops))


def _largest(A: BlockRows, inverse: FloatArray, loops: CFunctions) -> float:
    """Eigenvalue of D^-1 A by the power method. Collective.

    Args:
        A: The matrix.
        inverse: D^-1.
        loops: Those of `block_loops`.
    """
    halo = A.halo
    everywhere = np.zeros((halo.size, A.R))
    x = everywhere[: A.rows]
    x[:] = np.random.default_rng(halo.first).normal(size=x.shape)
    size = 1.0
    for _ in range(POWERS):
        x /= size
        halo.fill(everywhere)
        np.einsum("irc,ic->ir", inverse, A.times(everywhere, loops), out=x)
        size = float(np.sqrt(total(halo.comm, float(np.vdot(x, x)))))
    return SAFETY * size


class Smoother:
    """Block Jacobi for the matrix of one level, in single precision. Collective to make.

    Args:
        A: The matrix, whose blocks are taken over: it has none of its own any longer.
        loops: Those of `block_loops`.
        diagonal: That of A, where it is known.

    Attributes:
        halo: Nodes that a rank's rows refer to.
        matrix: First block, columns and blocks of each node's rows.
        largest: Estimated eigenvalue of D^-1 A.
        x: The iterate, of owned and other nodes.
    """

    def __init__(self, A: BlockRows, loops: CFunctions, diagonal: Diagonal | None = None) -> None:
        self._loops, self.halo, self.sizes = loops, A.halo, (A.R, A.rows)
        known = diagonal or diagonal_of(A, loops)
        self.matrix = (A.start, A.columns, taken_in_single_precision(A, loops))
        self.largest = known.largest
        self._scaled = in_single_precision(known.inverse, loops)
        self._scaled *= np.float32(DAMPING / self.largest)
        self.x, self._y = np.zeros((A.halo.size, A.R)), np.zeros((A.rows, A.R))

    def from_zero(self, b: FloatArray) -> None:
        """The first iterate, from zero. Collective."""
        self._loops.call("smooth_first", *self.sizes, self._scaled, b, self.x)
        self.halo.fill(self.x)

    def once_more(self, b: FloatArray) -> FloatArray:
        """The next iterate, of owned nodes; valid until the next call. Collective."""
        self.halo.fill(self.x)
        self._loops.call("smooth", *self.sizes, *self.matrix, self._scaled, self.x, b, self._y)
        return self._y


def in_single_precision(blocks: FloatArray, loops: CFunctions) -> SingleArray:
    """Blocks column by column, and room that the loops may read. Not collective.

    Args:
        blocks: Of shape (blocks, rows, columns).
        loops: Those of `block_loops`.
    """
    out = np.zeros(blocks.size + 1, dtype=np.float32)
    loops.call("in_single_precision", *blocks.shape, blocks, out)
    return out


def taken_in_single_precision(A: BlockRows, loops: CFunctions) -> SingleArray:
    """The same of the blocks of a matrix, which loses them. Not collective.

    In their memory, whose second half is freed, if all of them are there.

    Args:
        A: The matrix.
        loops: Those of `block_loops`.
    """
    if not A.whole:
        out = np.zeros(A.start[-1] * A.R * A.C + 1, dtype=np.float32)
        for first, _, part in A.parts():
            where = out[A.start[first] * A.R * A.C :]
            loops.call("in_single_precision", *part.shape, part, where)
        A.take_blocks()
        return out
    blocks = A.take_blocks()
    if not blocks.flags.owndata:
        return in_single_precision(blocks, loops)
    loops.call("into_single_precision", *blocks.shape, blocks)
    blocks.resize((blocks.size // 2 + 1,), refcheck=False)  # room for one entry more
    return blocks.view(np.float32)
