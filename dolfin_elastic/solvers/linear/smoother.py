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
        largest: Estimated eigenvalue of D^-1 A.
    """

    inverse: FloatArray
    largest: float


def diagonal_of(A: BlockRows, loops: CFunctions) -> Diagonal:
    """The diagonal of a matrix, which stays as it is. Collective.

    Args:
        A: The matrix.
        loops: Those of `block_loops`.
    """
    inverse = _inverses(A, loops)
    return Diagonal(inverse, _largest(A, in_single_precision(A.blocks, loops), inverse, loops))


def _inverses(A: BlockRows, loops: CFunctions) -> FloatArray:
    inverse = np.zeros((A.rows, A.R, A.R))
    loops.call("invert_diagonal", A.R, A.rows, A.start, A.columns, A.blocks, inverse)
    return inverse


def _largest(A: BlockRows, single: SingleArray, inverse: FloatArray, loops: CFunctions) -> float:
    """Eigenvalue of D^-1 A by the power method. Collective.

    Args:
        A: Whose rows, columns and halo.
        single: Its blocks.
        inverse: D^-1.
        loops: Those of `block_loops`.
    """
    scaled, halo = in_single_precision(inverse, loops), A.halo
    everywhere, y, none = np.zeros((halo.size, A.R)), *np.zeros((2, A.rows, A.R))
    x = everywhere[: A.rows]
    x[:] = np.random.default_rng(halo.first).normal(size=x.shape)
    size = 1.0
    for _ in range(POWERS):
        x /= size
        halo.fill(everywhere)
        arrays = (A.start, A.columns, single, scaled, everywhere, none, y)
        loops.call("smooth", A.R, A.rows, *arrays)
        x -= y
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
        inverse = _inverses(A, loops) if diagonal is None else diagonal.inverse
        blocks = _into_single_precision(A.take_blocks(), loops)
        self.matrix = (A.start, A.columns, blocks)
        known = diagonal or Diagonal(inverse, _largest(A, blocks, inverse, loops))
        self.largest = known.largest
        self._scaled = in_single_precision(inverse, loops) * np.float32(DAMPING / self.largest)
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


def _into_single_precision(blocks: FloatArray, loops: CFunctions) -> SingleArray:
    """The same in the memory of the blocks, whose second half is freed. Not collective.

    Args:
        blocks: Of shape (blocks, rows, columns); no longer used.
        loops: Those of `block_loops`.
    """
    if not blocks.flags.owndata:
        return in_single_precision(blocks, loops)
    loops.call("into_single_precision", *blocks.shape, blocks)
    blocks.resize((blocks.size // 2 + 1,), refcheck=False)  # room for one entry more
    return blocks.view(np.float32)
