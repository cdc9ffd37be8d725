"""Coarsening of algebraic multigrid by smoothed aggregation, in blocks.

Sources: P. Vanek, J. Mandel and M. Brezina, Computing 56 (1996) 179, for aggregates and smoothing;
M. Adams, M. Brezina, J. Hu and R. Tuminaro, J. Comput. Phys. 188 (2003) 593, for elasticity.
"""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.jit import CFunctions
from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray
from dolfin_elastic.solvers.linear.block_rows import BlockRows, HalfRows
from dolfin_elastic.solvers.linear.smoother import Diagonal
from dolfin_elastic.solvers.petsc.halo import Halo

LANES = 8
"""Most entries of a row of a block, as loops in C need it for their work."""

SMOOTHING = 1.4
"""Step of the smoothing of the interpolation, over the largest eigenvalue of D^-1 A."""

FLAT = 0.03
"""Ratio of what an aggregate's nodes move in two rotations of the same angle below which they as
good as lie on a line."""


def smoothed_interpolation(
    A: BlockRows,
    modes: FloatArray,
    diagonal: Diagonal,
    *,
    threshold: float,
    loops: CFunctions,
) -> tuple[BlockRows, FloatArray]:
    """Interpolation from the next coarser level, and its rigid-body modes. Collective.

    Nodes that are strongly connected are aggregated, and the rigid-body modes of an aggregate are
    unknowns.  Aggregates end at the boundaries of ranks; smoothing crosses them.

    Args:
        A: The matrix.
        modes: Rigid-body modes of owned nodes, of shape (nodes, R, modes).
        diagonal: That of A.
        threshold: |A_ij| / sqrt(|A_ii| |A_jj|) of a strong connection.
        loops: Those of `block_loops`.

    Returns:
        P, whose coarse matrix `galerkin` makes, and modes of shape (nodes, modes, modes).
    """
    n, R, C, halo = A.rows, A.R, modes.shape[2], A.halo
    strong, limit = np.empty(len(A.columns), dtype=np.float32), np.array([threshold])
    tentative = np.zeros((halo.size, R, C))
    tentative[:n] = modes
    pattern = A.start, A.columns
    for first, rows, part in A.parts():
        measured = (part, n, diagonal.sizes, strong, limit)
        loops.call("connections", first, rows, R, *pattern, *measured)
        loops.call("hold_fixed", first, rows, R, C, *pattern, part, tentative)
    own = np.empty(n, dtype=np.int32)
    count = loops.call("aggregate", n, A.start, A.columns, strong, own)
    everywhere = tentative.copy()
    factors, work = np.empty((count, C, C)), np.empty(2 * count)
    loops.call("orthonormalise", n, R, C, count, own, tentative, factors, work)
    halo.fill(tentative)
    halo.fill(everywhere)
    member, coarse = _of_ghosts(halo, own, count)
    P_start = np.empty(n + 1, dtype=np.int64)
    mark = np.full(coarse.size, -1, dtype=np.int32)
    loops.call("count_smoothed", n, A.start, A.columns, strong, member, mark, P_start)
    columns, blocks = np.empty(P_start[-1], dtype=np.int32), np.empty((P_start[-1], R, C))
    place, step = np.full(coarse.size, -1, dtype=np.int64), np.array([SMOOTHING / diagonal.largest])
    turned = _inverse_factors(factors)
    for first, rows, part in A.parts():
        loops.call(
            *("fill_smoothed", R, C, first, rows, *pattern, part, strong, diagonal.inverse),
            *(everywhere, turned, tentative, member, step, place, P_start, columns, blocks),
        )
    return BlockRows(P_start, columns, blocks, coarse), factors


def _inverse_factors(factors: FloatArray) -> FloatArray:
    """Inverse triangular factors of aggregates, without rotations that they cannot tell.

    As those of one node, or about the line on which all nodes are: there factors are singular.

    Args:
        factors: Of shape (aggregates, modes, modes).
    """
    sizes = np.diagonal(factors, axis1=1, axis2=2)
    rotations = slice(sizes.shape[1] // 2 + sizes.shape[1] % 2, None)
    untold = sizes == 0.0
    untold[:, rotations] |= sizes[:, rotations] < FLAT * sizes[:, rotations].max(axis=1)[:, None]
    aggregate, mode = np.nonzero(untold)
    regular = factors.copy()
    regular[aggregate, mode], regular[aggregate, :, mode] = 0.0, 0.0
    regular[aggregate, mode, mode] = 1.0
    inverse = np.linalg.inv(regular)
    inverse[aggregate, mode, mode] = 0.0
    return np.asarray(inverse)


def _of_ghosts(halo: Halo, member: IndexArray, count: int) -> tuple[IndexArray, Halo]:
    """Aggregates of all nodes here, and those of other ranks among them. Collective.

    Args:
        halo: The nodes.
        member: Aggregate of each owned node; negative where it has none.
        count: Aggregates of this rank.
    """
    none = Halo(halo.comm, count, np.empty(0, dtype=np.int64))
    if halo.comm.size == 1:
        return member, none
    numbers = np.full(halo.size, -1, dtype=np.int64)
    numbers[: halo.owned] = np.where(member >= 0, member + none.first, -1)
    halo.fill(numbers)
    others = numbers[halo.owned :]
    coarse = Halo(halo.comm, count, np.unique(others[others >= 0]))
    none.destroy()
    found = np.where(numbers >= 0, coarse.local(numbers), -1)
    return found.astype(np.int32), coarse


def galerkin(A: BlockRows, P: BlockRows, loops: CFunctions) -> BlockRows:
    """The matrix P^T A P of a coarser level. Collective.

    Args:
        A: Square.
        P: Interpolation to the owned nodes of A.
        loops: Those of `block_loops`.
    """
    R, C, coarse = P.R, P.C, P.halo
    start, columns, blocks, numbers = _with_ghosts(A, P)
    m, size = coarse.size, len(numbers)
    W = _product_pattern((A.start, A.columns), (start, columns), size, loops)
    transposed = _transposed(P.start, P.columns, m)
    A_start, A_columns = _product_pattern(transposed, W, size, loops)
    most = int(np.diff(W[0]).max(initial=0))
    rows = np.repeat(np.arange(m), np.diff(A_start))
    A_columns = A_columns[np.lexsort((A_columns, rows))]
    side = coarse.owners(numbers) if A.symmetric else np.arange(size)
    if A.symmetric:
        kept = (side[rows] != side[A_columns]) | (numbers[rows] <= numbers[A_columns])
        A_columns = A_columns[kept]
        A_start = np.concatenate([[0], np.cumsum(np.bincount(rows[kept], minlength=m))])
    del W, transposed, rows  # the blocks are about to take most memory
    A_blocks = np.zeros((len(A_columns), C, C))
    place = np.full(size, -1, dtype=np.int32)
    work = (place, np.empty(most, dtype=np.int32), np.empty((most, R, LANES)))
    for first, count, part in A.parts():
        loops.call(
            *("galerkin", R, C, first, count, A.start, A.columns, part, start, columns, blocks),
            *(A_start, A_columns, A_blocks, side, numbers, *work),
        )
    found = _summed(coarse, A_start, numbers[A_columns], A_blocks)
    return HalfRows(*found, loops) if A.symmetric else BlockRows(*found)


def _product_pattern(
    A: tuple[IntArray, IndexArray], B: tuple[IntArray, IndexArray], size: int, loops: CFunctions
) -> tuple[IntArray, IndexArray]:
    """Where rows of a product A B begin, and their columns, not sorted.

    Args:
        A: Where the rows of the first factor begin, and their columns.
        B: The same of the second.
        size: Columns of the second.
        loops: Those of `block_loops`.
    """
    rows = len(A[0]) - 1
    start, nothing = np.empty(rows + 1, dtype=np.int64), np.empty(0, dtype=np.int32)
    loops.call("product_pattern", rows, *A, *B, np.full(size, -1, np.int32), start, nothing, 0)
    columns = np.empty(start[-1], dtype=np.int32)
    loops.call("product_pattern", rows, *A, *B, np.full(size, -1, np.int32), start, columns, 1)
    return start, columns


def _with_ghosts(A: BlockRows, P: BlockRows) -> tuple[IntArray, IndexArray, FloatArray, IntArray]:
    """The rows of P of all nodes of A here, and the global number of each coarse node. Collective.

    Behind the coarse nodes of P come those that only rows of ghosts have.
    """
    coarse = P.halo
    numbers = coarse.globally(np.arange(coarse.size, dtype=np.int32))
    if coarse.comm.size == 1:
        return P.start, P.columns, P.blocks, numbers
    found = A.halo.rows(P.start, coarse.globally(P.columns), P.blocks)
    columns = found.columns
    own = (columns >= coarse.first) & (columns < coarse.first + coarse.owned)
    further = np.setdiff1d(columns[~own], coarse.ghosts)
    known = own | np.isin(columns, coarse.ghosts)
    local = np.where(
        known, coarse.local(columns), coarse.size + np.searchsorted(further, columns)
    ).astype(np.int32)
    return (
        np.concatenate([P.start, P.start[-1] + found.start[1:]]),
        np.concatenate([P.columns, local]),
        np.concatenate([P.blocks, found.blocks]),
        np.concatenate([numbers, further]),
    )


def _transposed(start: IntArray, columns: IndexArray, size: int) -> tuple[IntArray, IndexArray]:
    """Rows that each column has entries in."""
    rows = np.repeat(np.arange(len(start) - 1, dtype=np.int32), np.diff(start))
    begins = np.concatenate([[0], np.cumsum(np.bincount(columns, minlength=size))])
    return begins.astype(np.int64), rows[np.argsort(columns, kind="stable")]


def _summed(
    halo: Halo, start: IntArray, columns: IntArray, blocks: FloatArray
) -> tuple[IntArray, IndexArray, FloatArray, Halo]:
    """Adds the parts of rows that several ranks have. Collective.

    Args:
        halo: Nodes of the rows.
        start: Where their rows begin, and the last one ends.
        columns: Global column of each block.
        blocks: Shape (blocks, C, C).

    Returns:
        Where rows begin, local columns, blocks, and the nodes.
    """
    owned = halo.owned
    rows = np.repeat(np.arange(owned, dtype=np.int32), np.diff(start[: owned + 1]))
    if halo.comm.size > 1:
        others = halo.rows_of_others(start, columns, blocks)
        assert others.nodes is not None
        count = start[owned]
        rows = np.concatenate([rows, np.repeat(others.nodes, np.diff(others.start))])
        columns = np.concatenate([columns[:count], others.columns])
        keys, entry = np.unique(rows.astype(np.int64) * halo.total + columns, return_inverse=True)
        own_blocks, blocks = blocks[:count], np.zeros((len(keys), *blocks.shape[1:]))
        blocks[entry[:count]] = own_blocks
        np.add.at(blocks, entry[count:], others.blocks)
        rows, columns = (keys // halo.total).astype(np.int32), keys % halo.total
    own = (columns >= halo.first) & (columns < halo.first + owned)
    result = Halo(halo.comm, owned, np.unique(columns[~own]))
    begins = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=owned))]).astype(np.int64)
    return begins, result.local(columns), blocks, result
