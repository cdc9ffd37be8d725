"""A symmetric tangent by the half of its blocks, as a matrix of PETSc.

An AIJ matrix has 12 bytes for each entry, and multigrid a copy of it in single precision.  Half of
the blocks, each entry as two numbers of single precision, of which the smoother reads the first
alone, take 4 bytes an entry for both.
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from dolfin_elastic.core.compat import column_map
from dolfin_elastic.core.jit import CFunctions, compile_c
from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray, SingleArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.symmetric.several import EIGHT, by_eights
from dolfin_elastic.solvers.petsc.halo import Halo, RowsOfOthers


class SymmetricBlocks:
    """The blocks, and what PETSc calls of a matrix of type "python". Collective to make.

    Args:
        problem: Whose displacement is the only unknown.
        more: Owned row and global column of blocks that the form need not have.

    Attributes:
        halo: Nodes of a rank's rows and columns.
        dim: Rows of a block.
        start: Where each owned node's row begins, and the last one ends.
        columns: Local number of the node of each block; see halves.h for which are there.
        high: The blocks in single precision, column by column, and room for one entry more.
        low: What they lack.
        version: Grows with each change.
    """

    def __init__(
        self, problem: Problem, form: fem.Form, more: tuple[IntArray, IntArray] | None = None
    ) -> None:
        self.dim, self.version = problem.body.dim, 0
        self.loops: CFunctions = compile_c(
            problem.body.comm, "symmetric.c", {"DIM": self.dim}, problem.jit
        )
        pattern = fem.create_sparsity_pattern(form)
        pattern.finalize()
        columns, offsets = pattern.graph
        nodes = column_map(pattern)
        n = nodes.size_local
        others = np.asarray(nodes.ghosts, dtype=np.int64)
        if more is not None:
            begin, end = nodes.local_range
            distant = more[1][(more[1] < begin) | (more[1] >= end)]
            others = np.append(others, np.setdiff1d(distant, others))
        self.halo = Halo(problem.body.comm, n, others)
        row = np.repeat(np.arange(n, dtype=np.int32), np.diff(offsets[: n + 1]))
        column = columns[: len(row)]
        if more is not None:
            size = max(1, self.halo.size)
            keys = more[0] * size + self.halo.local(more[1])
            keys = np.union1d(row.astype(np.int64) * size + column, keys)
            row, column = (keys // size).astype(np.int32), (keys % size).astype(np.int32)
        kept = column >= row
        self.columns: IndexArray = np.ascontiguousarray(column[kept])
        self.start: IntArray = np.append(0, np.cumsum(np.bincount(row[kept], minlength=n)))
        size = len(self.columns) * self.dim**2
        self.high: SingleArray = np.zeros(size + 1, dtype=np.float32)
        self.low: SingleArray = np.zeros(size + 1, dtype=np.float32)
        ghosts = offsets[n:]
        self.far = OffProcessRows(self, ghosts - ghosts[0], columns[ghosts[0] :].copy())
        self._x = np.zeros((self.halo.size, self.dim)) if self.halo.comm.size > 1 else None
        self._eight: list[FloatArray] = []

    @property
    def nbytes(self) -> int:
        """Bytes of the blocks of this rank and of their places."""
        return self.high.nbytes + self.low.nbytes + self.columns.nbytes + self.start.nbytes

    def clear(self) -> None:
        """All blocks become zero. Local."""
        self.high[:] = 0.0
        self.low[:] = 0.0
        self.far.blocks[:] = 0.0

    def add_at(self, offsets: IntArray, blocks: FloatArray) -> None:
        """Adds blocks at `places`. Local.

        Args:
            blocks: Shape (blocks, R, R); of both of a pair, where this rank owns both nodes.
        """
        stored = (len(self.columns), self.high, self.low)
        self.loops.call("add_blocks", len(blocks), offsets, blocks, *stored)

    def places(self, rows: IntArray, columns: IntArray) -> IntArray:
        """Where blocks of owned rows stand; -1 where only the other half is there. Local.

        Args:
            columns: Global number of the node of each.
        """
        size, local = self.halo.size, self.halo.local(columns)
        row = np.repeat(np.arange(self.halo.owned), np.diff(self.start))
        key, wanted = row * size + self.columns, rows * size + local
        result = np.searchsorted(key, wanted)
        here = key[np.minimum(result, len(key) - 1)] == wanted if len(key) else result < 0
        if not (here | (local < rows)).all():
            raise RuntimeError("the matrix has no entries for a block")
        return np.where(here, result, -1).astype(np.int64)

    def assembled(self, prescribed: IndexArray) -> None:
        """Adds what other ranks have for rows of this one; what was kept is out of date.

        Collective.

        Args:
            prescribed: Owned entries whose diagonal is one.
        """
        self.far.collect()
        self._put_diagonal(prescribed, np.ones(len(prescribed)))

    def times(self, x: FloatArray, y: FloatArray, *, rounded: bool = False) -> None:
        """y = A x. Local.

        Args:
            x: At owned nodes and ghosts.
            y: At owned nodes.
        """
        rows = (self.halo.owned, self.start, self.columns, self.high)
        if rounded:
            self.loops.call("rounded_product", *rows, self.halo.size, x, y)
        else:
            self.loops.call("product", *rows, self.low, self.halo.size, x, y)

    def times_several(self, vectors: FloatArray, images: FloatArray) -> None:
        """Overwrites images by products with vectors, one below the other. Collective."""
        if not self._eight:
            nodes = (self.halo.size, self.halo.owned)
            self._eight = [np.zeros((count, self.dim * EIGHT)) for count in nodes]
        x, y = self._eight
        rows = (self.halo.owned, self.start, self.columns, self.high, self.low, self.halo.size)

        def times() -> FloatArray:
            self.halo.fill(x)
            self.loops.call("product_eight", *rows, x, y)
            return y

        by_eights(vectors, images, x, times, self.loops)

    def diagonal_blocks(self) -> FloatArray:
        """The first block of each row, shape (nodes, R, R). Local."""
        first, shape = self.start[:-1], (-1, self.dim, self.dim)
        high, low = (x[:-1].reshape(shape)[first] for x in (self.high, self.low))
        return np.add(high, low, dtype=np.float64)

    def aij(self) -> PETSc.Mat:
        """The same as an AIJ matrix, which the caller destroys. Collective."""
        dim, n, halo = self.dim, self.halo.owned, self.halo
        start, columns, source = in_full(self.start, self.columns, self.loops)
        blocks = np.empty((start[-1], dim, dim))
        arrays = (start, columns, source, len(self.columns), self.high, self.low, blocks)
        self.loops.call("rows_in_full", 0, n, *arrays)
        row = np.repeat(np.arange(n), np.diff(start))
        order = np.lexsort((halo.globally(columns), row))
        begins = np.zeros((n, dim), dtype=np.int64)
        begins[:] = dim * dim * start[:-1, None] + dim * np.diff(start)[:, None] * np.arange(dim)
        numbers = halo.globally(columns)[order, None] * dim + np.arange(dim)
        entries, offsets = np.empty(blocks.size), np.empty(blocks.size, dtype=PETSc.IntType)
        within = dim * (np.arange(len(columns)) - start[row])
        for r in range(dim):
            at = (begins[row, r] + within)[:, None] + np.arange(dim)
            offsets[at], entries[at] = numbers, blocks[order, r]
        rows = np.append(begins.reshape(-1), blocks.size).astype(PETSc.IntType)
        sizes = ((n * dim, None),) * 2
        matrix = PETSc.Mat().createAIJ(
            sizes, bsize=dim, comm=halo.comm, csr=(rows, offsets, entries)
        )
        matrix.assemble()
        return matrix

    def petsc(self) -> PETSc.Mat:
        """A PETSc matrix of type "python" that is these blocks, and frees them. Collective."""
        size = (self.halo.owned * self.dim, None)
        matrix = PETSc.Mat().createPython((size, size), self, self.halo.comm)
        matrix.setBlockSize(self.dim)
        matrix.setUp()
        return matrix

    # --- what PETSc calls ---

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """y = A x. Collective."""
        values = x.array_r
        if self._x is not None:
            self._x[: self.halo.owned] = values.reshape(-1, self.dim)
            self.halo.fill(self._x)
            values = self._x
        self.times(values, y.array_w)

    def multTranspose(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """See `mult`: the matrix is symmetric. Collective."""
        self.mult(matrix, x, y)

    def getDiagonal(self, matrix: PETSc.Mat, diagonal: PETSc.Vec) -> None:
        """Entries of the diagonal. Not collective."""
        arrays = (self.start, self.high, self.low, diagonal.array_w)
        self.loops.call("take_diagonal", self.halo.owned, *arrays)

    def setDiagonal(self, matrix: PETSc.Mat, diagonal: PETSc.Vec, mode: object = None) -> None:
        """Overwrites the diagonal. Not collective."""
        self._put_diagonal(np.arange(self.dim * self.halo.owned, dtype=np.int32), diagonal.array_r)

    def scale(self, matrix: PETSc.Mat, factor: float) -> None:
        """Multiplies all blocks by a power of two, or minus that. Not collective."""
        self.high *= np.float32(factor)
        self.low *= np.float32(factor)
        self.version += 1

    def _put_diagonal(self, entries: IndexArray, values: FloatArray) -> None:
        blocks = (self.halo.owned, self.start, self.high, self.low)
        self.loops.call("put_diagonal", len(entries), entries, values, *blocks)
        self.version += 1

    def destroy(self, matrix: PETSc.Mat) -> None:
        """Frees the blocks, which others may still refer to, and PETSc's objects. Collective."""
        self.high = self.low = np.empty(0, dtype=np.float32)
        self._eight.clear()
        self.far.destroy()
        self.halo.destroy()


def halves(matrix: PETSc.Mat) -> SymmetricBlocks | None:
    """What a PETSc matrix is made of, if it is that; else None. Not collective."""
    context = matrix.getPythonContext() if matrix.getType() == "python" else None
    return context if isinstance(context, SymmetricBlocks) else None


class OffProcessRows:
    """What this rank has for rows of other ranks. Collective to make.

    Args:
        start: Where the row of each ghost begins, and the last one ends.
        columns: Local number of the node of each block.

    Attributes:
        start: As given.
        columns: As given.
        blocks: Shape (blocks, R, R), row by row.
    """

    def __init__(self, of: SymmetricBlocks, start: IntArray, columns: IndexArray) -> None:
        self._of, self.start, self.columns = of, start, columns
        self.blocks = np.zeros((len(columns), of.dim, of.dim))
        halo = of.halo
        without = np.zeros(halo.size + 1, dtype=np.int64)  # those of owned nodes
        without[halo.owned : halo.owned + len(start)] = start
        without[halo.owned + len(start) :] = start[-1]
        self._exchange = RowsOfOthers(halo, without)
        nodes = np.repeat(self._exchange.nodes, np.diff(self._exchange.start)).astype(np.int64)
        self._places = of.places(nodes, self._exchange.bring(halo.globally(columns)))

    def collect(self) -> None:
        """Adds the blocks to the rows of their owners. Collective."""
        self._of.add_at(self._places, self._exchange.bring(self.blocks))

    def destroy(self) -> None:
        """Frees PETSc's object. Collective."""
        self._exchange.destroy()


def in_full(
    start: IntArray, columns: IndexArray, loops: CFunctions
) -> tuple[IntArray, IndexArray, IndexArray]:
    """Where rows of all blocks begin, their columns, and where each block stands. Local.

    Args:
        start: Where rows of half of them begin, and the last one ends.
        loops: With those of `HALVES`.
    """
    n = len(start) - 1
    full = np.empty(n + 1, dtype=np.int64)
    loops.call("count_in_full", n, start, columns, full)
    every, source = (np.empty(full[-1], dtype=np.int32) for _ in range(2))
    room = np.empty(n, dtype=np.int64)
    loops.call("columns_in_full", n, start, columns, full, room, every, source)
    return full, every, source
