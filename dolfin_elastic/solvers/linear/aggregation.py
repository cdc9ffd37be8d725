"""Coarsening of algebraic multigrid by smoothed aggregation, in blocks.

Sources: P. Vanek, J. Mandel and M. Brezina, Computing 56 (1996) 179, for aggregates and smoothing;
M. Adams, M. Brezina, J. Hu and R. Tuminaro, J. Comput. Phys. 188 (2003) 593, for elasticity.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from dolfin_elastic.core.jit import CFunctions
from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray, SingleArray
from dolfin_elastic.solvers.linear.block_rows import (
    BlockRows,
    HalfRows,
    Interpolation,
    room_for,
    with_room,
)
from dolfin_elastic.solvers.linear.smoother import Diagonal
from dolfin_elastic.solvers.petsc.c_api import give_back
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
) -> tuple[Interpolation, FloatArray]:
    """Interpolation from the next coarser level, and its rigid-body modes. Collective.

    Nodes that are strongly connected are aggregated, and the rigid-body modes of an aggregate are
    unknowns.  Aggregates end at the boundaries of ranks; smoothing crosses them.

    Args:
        modes: Rigid-body modes of owned nodes, of shape (nodes, R, modes); where a component is
            prescribed they may become zero.
        threshold: |A_ij| / sqrt(|A_ii| |A_jj|) of a strong connection.

    Returns:
        P, whose coarse matrix `galerkin` makes, and modes of shape (nodes, modes, modes).
    """
    n, R, C, halo = A.rows, A.R, modes.shape[2], A.halo
    pattern = A.pattern()
    strong, limit = np.empty(len(pattern[1]), dtype=np.float32), np.array([threshold])
    modes = _with_ghosts_behind(modes, halo)
    for first, rows, part in A.parts():
        measured = (part, n, diagonal.sizes, strong, limit)
        loops.call("connections", first, rows, R, *pattern, *measured)
        loops.call("hold_fixed", first, rows, R, C, *pattern, part, modes)
    own = np.empty(n, dtype=np.int32)
    count = loops.call("aggregate", n, *pattern, strong, own)
    tentative = modes.copy()
    factors, work = np.empty((count, C, C)), np.empty(2 * count)
    loops.call("orthonormalise", n, R, C, count, own, tentative, factors, work)
    halo.fill(tentative)
    halo.fill(modes)
    member, coarse = _of_ghosts(halo, own, count)
    start, offset = np.empty(n + 1, dtype=np.int64), np.full(coarse.size, -1, dtype=np.int32)
    members = (halo.size, member, coarse.size)
    loops.call("count_smoothed", n, *pattern, strong, *members, offset, start)
    offset[:] = -1
    columns, blocks = np.empty(start[-1], dtype=np.int32), room_for(start[-1], R, C)
    room = np.empty((int(np.diff(start).max(initial=0)), R, LANES))
    turned, step = _inverse_factors(factors), np.array([SMOOTHING / diagonal.largest])
    for first, rows, part in A.parts():
        loops.call(
            *("fill_smoothed", R, C, first, rows, *pattern, part, strong, diagonal.inverse),
            *(halo.size, modes, tentative, member, count, turned, step, start, columns),
            *(with_room(blocks), coarse.size, offset, len(room), room),
        )
    return Interpolation(start, columns, blocks, coarse), factors


def _with_ghosts_behind(modes: FloatArray, halo: Halo) -> FloatArray:
    """Modes of all nodes here, those of other ranks still zero; the same ones where there are none.

    Args:
        modes: Of owned nodes.
    """
    if halo.size == len(modes):
        return modes
    result = np.zeros((halo.size, *modes.shape[1:]))
    result[: len(modes)] = modes
    return result


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
    result = np.where(numbers >= 0, coarse.local(numbers), -1)
    return result.astype(np.int32), coarse


def galerkin(A: BlockRows, P: Interpolation, loops: CFunctions) -> BlockRows:
    """The matrix P^T A P of a coarser level. Collective.

    Args:
        P: Interpolation to the owned nodes of A.
    """
    start, columns, P_blocks, numbers = _with_ghosts(A, P)
    side = P.halo.owners(numbers) if A.symmetric else np.arange(len(numbers))
    sides = (side.astype(np.int32), numbers)
    pattern, most = _coarse_pattern(A, P, (start, columns), sides, loops)
    give_back()  # what this and making P needed: the blocks are about to take most memory
    blocks = np.zeros((len(pattern[1]), P.C, P.C))
    for_columns = np.full(len(numbers), -1, dtype=np.int32)
    work = (most, np.empty(most, dtype=np.int32), np.empty((most, P.R, LANES)))
    interpolation = (len(start) - 1, start, columns, with_room(P_blocks))
    coarse = (P.halo.size, *pattern, blocks, len(numbers), *sides, for_columns)
    for first, count, part in A.parts():
        rows = (first, count, *A.pattern(), part)
        loops.call("galerkin", P.R, P.C, *rows, *interpolation, *coarse, *work)
    result = _summed(P.halo, numbers, *pattern, blocks)
    return HalfRows(*result, loops) if A.symmetric else BlockRows(*result)


Pattern: TypeAlias = tuple[IntArray, IndexArray]
"""Where rows begin and the last one ends, and columns of their entries."""


def _coarse_pattern(
    A: BlockRows,
    P: Interpolation,
    every: Pattern,
    sides: tuple[IndexArray, IntArray],
    loops: CFunctions,
) -> tuple[Pattern, int]:
    """Rows and sorted columns of P^T A P, and the most blocks that a row of A P has. Local.

    Args:
        every: Its rows of all nodes here.
        sides: See `product_pattern` in multigrid.c, with a side and a number for each column.
    """
    size = len(sides[0])
    product = _product_pattern(A.pattern(), every, None, size, loops)
    most = int(np.diff(product[0]).max(initial=0))
    transposed = _transposed((P.start, P.columns), P.halo.size, loops)
    halved = sides if A.symmetric else None
    pattern = _product_pattern(transposed, product, halved, size, loops)
    del product, transposed
    turned = _transposed(pattern, size, loops)  # and back: this sorts the columns
    return _transposed(turned, P.halo.size, loops), most


def _product_pattern(
    A: Pattern,
    B: Pattern,
    halved: tuple[IndexArray, IntArray] | None,
    size: int,
    loops: CFunctions,
) -> Pattern:
    """Rows of a product A B, and their columns, not sorted.

    Args:
        halved: The sides, if only one half is wanted.
    """
    rows, nothing = len(A[0]) - 1, np.empty(0, dtype=np.int32)
    half = (0, nothing, np.empty(0, dtype=np.int64)) if halved is None else (1, *halved)
    start, mark = np.empty(rows + 1, dtype=np.int64), np.full(size, -1, dtype=np.int32)
    # Most of this is never touched and takes no memory; to count columns first would take as long.
    inner = len(B[0]) - 1
    columns = np.empty(loops.call("most_of_product", rows, *A, inner, B[0]), dtype=np.int32)
    result = (mark, start, len(columns), columns)
    loops.call("product_pattern", rows, *A, inner, *B, size, *half, *result)
    return start, columns[: start[-1]]


def _with_ghosts(
    A: BlockRows, P: Interpolation
) -> tuple[IntArray, IndexArray, SingleArray, IntArray]:
    """The rows of P of all nodes of A here, and the global number of each coarse node. Collective.

    Behind the coarse nodes of P come those that only rows of ghosts have.
    """
    coarse = P.halo
    numbers = coarse.globally(np.arange(coarse.size, dtype=np.int32))
    if coarse.comm.size == 1:
        return P.start, P.columns, P.blocks, numbers
    result = A.halo.rows(P.start, coarse.globally(P.columns), P.blocks)
    columns = result.columns
    own = (columns >= coarse.first) & (columns < coarse.first + coarse.owned)
    further = np.setdiff1d(columns[~own], coarse.ghosts)
    known = own | np.isin(columns, coarse.ghosts)
    local = np.where(
        known, coarse.local(columns), coarse.size + np.searchsorted(further, columns)
    ).astype(np.int32)
    count = len(P.columns)
    blocks = room_for(count + len(local), P.R, P.C)
    blocks[:count], blocks[count:] = P.blocks, result.blocks
    return (
        np.concatenate([P.start, P.start[-1] + result.start[1:]]),
        np.concatenate([P.columns, local]),
        blocks,
        np.concatenate([numbers, further]),
    )


def _transposed(pattern: Pattern, size: int, loops: CFunctions) -> Pattern:
    """Rows that each of so many columns has entries in, sorted. Local."""
    start, room = np.empty(size + 1, dtype=np.int64), np.empty(size, dtype=np.int64)
    rows = np.empty(len(pattern[1]), dtype=np.int32)
    loops.call("transpose", len(pattern[0]) - 1, size, *pattern, start, rows, room)
    return start, rows


def _summed(
    halo: Halo, numbers: IntArray, start: IntArray, nodes: IndexArray, blocks: FloatArray
) -> tuple[IntArray, IndexArray, FloatArray, Halo]:
    """Adds the parts of rows that several ranks have. Collective.

    Args:
        numbers: Global number of each node of the columns.
        start: Where their rows begin, and the last one ends.
        nodes: Column of each block.
        blocks: Shape (blocks, C, C).

    Returns:
        Where rows begin, local columns, blocks, and the nodes.
    """
    owned = halo.owned
    if halo.comm.size == 1:
        return start, nodes, blocks, Halo(halo.comm, owned, numbers[:0])
    columns = numbers[nodes]
    others = halo.rows_of_others(start, columns, blocks)
    assert others.nodes is not None
    count = start[owned]
    rows = np.repeat(np.arange(owned, dtype=np.int32), np.diff(start[: owned + 1]))
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
