"""The multigrid cycle for displacements, as a preconditioner of PETSc.

PETSc's GAMG spends most of its time in Galerkin products and in products with matrices, which know
no blocks.  Here both are loops over blocks of known size, and the cycle reads single precision.

A cycle is V(1, 1) with damped block Jacobi: Briggs, Henson & McCormick, A Multigrid Tutorial
(2000).  It is symmetric where the matrix is, and positive definite as conjugate gradients need.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from dolfin_elastic.core.jit import CFunctions, compile_c
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.node_blocks import NodeBlocks
from dolfin_elastic.solvers.assembly.symmetric.blocks import SymmetricBlocks, halves
from dolfin_elastic.solvers.assembly.symmetric.several import EIGHT, Vectors, by_eights
from dolfin_elastic.solvers.linear.aggregation import galerkin, smoothed_interpolation
from dolfin_elastic.solvers.linear.block_rows import (
    BlockRows,
    Interpolation,
    PetscRows,
    SymmetricRows,
    interpolation_from_petsc,
    of_width,
    with_room,
)
from dolfin_elastic.solvers.linear.multigrid import (
    constrained_interpolation,
    mode_values,
    near_null_space,
    reordered,
)
from dolfin_elastic.solvers.linear.smoother import (
    Diagonal,
    Smoother,
    diagonal_of,
    smoother_of,
)
from dolfin_elastic.solvers.linear.surface_means import SurfaceMeans, surface_means
from dolfin_elastic.solvers.petsc.aij import aij
from dolfin_elastic.solvers.petsc.c_api import give_back

THRESHOLD = 0.08
"""Of a strong connection on the finest level; half of it on each coarser one (Vanek, Mandel &
Brezina, 1996, section 5).  Cells stretched 20:1 take 34 iterations so, with a hundredth 260."""

SMALL = 400
"""Unknowns whose matrix is inverted."""

SLOW = 0.7
"""Ratio of nodes above which a coarsening is not worth it: as where each rank has few left."""


class Level:
    """One level of the cycle.

    Args:
        P: Interpolation from the next coarser level.
    """

    def __init__(self, smoother: Smoother, P: Interpolation, loops: CFunctions) -> None:
        self.smoother, self._loops, self._coarse = smoother, loops, P.halo
        self._P = (P.start, P.columns, with_room(P.blocks))
        R, n = smoother.sizes
        self._sizes, self._rooms = (R, P.C, n), dict[tuple[int, ...], Vectors]()

    def descend(self, b: Vectors) -> Vectors:
        """Smooths from zero and restricts the residual. Collective.

        Args:
            b: Right-hand side, of owned nodes; shape (nodes, R), or (nodes, R, `EIGHT`).

        Returns:
            The coarser level's, of owned nodes; valid until the next cycle.
        """
        self.smoother.from_zero(b)
        c = self._room(b)
        c[:] = 0.0
        self.smoother.restrict(b, self._P, c)
        self._coarse.collect(c)
        return c[: self._coarse.owned]

    def _room(self, b: Vectors) -> Vectors:
        """Coarse nodes for as many right-hand sides, with room that the loops may read."""
        if (width := b.shape[2:]) not in self._rooms:
            shape = (self._coarse.size, self._sizes[1], *width)
            values = np.zeros(int(np.prod(shape)) + 2, dtype=b.dtype)
            self._rooms[width] = values[:-2].reshape(shape)
        return self._rooms[width]

    def ascend(self, b: Vectors, correction: Vectors) -> Vectors:
        """Adds the coarser level's solution and smooths. Collective.

        Args:
            b: Right-hand side, of owned nodes.
            correction: Of owned coarse nodes.

        Returns:
            The solution, of owned nodes; valid until the next cycle.
        """
        c = self._room(b)
        c[: self._coarse.owned] = correction
        self._coarse.fill(c)
        coarse = (len(c), with_room(c))
        self._loops.call(of_width("prolong", b), *self._sizes, *self._P, *coarse, self.smoother.x)
        return self.smoother.once_more(b)

    def __str__(self) -> str:
        return f"{self.smoother.halo.total} nodes x {self._sizes[0]}"

    def destroy(self) -> None:
        """Frees PETSc's objects. Collective."""
        self.smoother.destroy()


class Inverse:
    """The inverse of a small matrix, on all ranks. Collective to make."""

    def __init__(self, A: BlockRows) -> None:
        comm, size = A.halo.comm, A.halo.total
        rows = A.halo.first + np.repeat(np.arange(A.rows), np.diff(A.start))
        columns = A.halo.globally(A.columns)
        nodes = np.zeros((size, A.R, size, A.R))
        for r, c, blocks in comm.allgather((rows, columns, A.blocks)):
            nodes[r, :, c, :] = blocks
        matrix = nodes.reshape(size * A.R, -1)
        diagonal = np.abs(np.diag(matrix))
        without = np.flatnonzero(diagonal <= 1e-13 * diagonal.max(initial=0.0))
        matrix[without, without] = 1.0
        self._comm, self._halo = comm, A.halo
        self._counts = comm.allgather(A.rows * A.R)
        own = slice(A.halo.first * A.R, (A.halo.first + A.rows) * A.R)
        self._rows = np.ascontiguousarray(_inverse(matrix)[own])

    def solve(self, b: Vectors) -> FloatArray:
        """Solves for owned nodes. Collective."""
        width = int(np.prod(b.shape[2:]))
        whole = np.empty((sum(self._counts), width), dtype=b.dtype)
        self._comm.Allgatherv(b, (whole, [count * width for count in self._counts]))
        return np.asarray(self._rows @ whole, dtype=np.float64).reshape(b.shape)

    def destroy(self) -> None:
        """Frees PETSc's objects. Collective."""
        self._halo.destroy()


class Rest:
    """A matrix too large for an inverse, by PETSc's GAMG, which uses fewer ranks. Collective."""

    def __init__(self, A: BlockRows, modes: FloatArray) -> None:
        halo, R, within = A.halo, A.R, np.arange(A.R)
        node, blocks = np.repeat(np.arange(A.rows), np.diff(A.start)), A.blocks.copy()
        own = np.flatnonzero(node == A.columns)
        at, without = np.nonzero(blocks[own[:, None], within, within] == 0.0)
        blocks[own[at], without, without] = 1.0
        rows = np.broadcast_to(node[:, None, None] * R + within[:, None], blocks.shape).reshape(-1)
        columns = halo.globally(A.columns)[:, None, None] * R + within
        columns = np.broadcast_to(columns, blocks.shape).reshape(-1)
        self._halo, sizes = halo, ((A.rows * R, None),) * 2
        self._matrix = aij(halo.comm, sizes, (R, R), (rows, columns, blocks.reshape(-1)))
        self._x, self._b = self._matrix.createVecs()
        near = near_null_space(halo.comm, modes)
        self._matrix.setNearNullSpace(near)
        self._ksp = PETSc.KSP().create(halo.comm)
        self._ksp.setType("preonly")
        self._ksp.getPC().setType("gamg")
        self._ksp.setOperators(self._matrix)
        near.destroy()

    def solve(self, b: Vectors) -> FloatArray:
        """Solves for owned nodes, roughly. Collective.

        Where GAMG cannot be set up, as for a singular matrix, the result is no number: the solver
        whose cycle this is then fails.
        """
        if b.ndim == 3:
            return np.stack([self.solve(b[:, :, k]) for k in range(b.shape[2])], axis=2)
        self._b.array_w[:] = b.reshape(-1)
        try:
            self._ksp.solve(self._b, self._x)
        except PETSc.Error:
            return np.full(b.shape, np.nan)
        return np.array(self._x.array_r).reshape(b.shape)

    def destroy(self) -> None:
        """Frees PETSc's objects. Collective."""
        for thing in (self._ksp, self._matrix, self._x, self._b, self._halo):
            thing.destroy()


def _inverse(matrix: FloatArray) -> FloatArray:
    """The inverse of a matrix whose symmetric part S is positive definite; else that of |S|.

    So the cycle stays positive definite where the tangent is not.  An inverse of the tangent's own
    signs would hide its negative curvature from conjugate gradients: both are negative along the
    same modes, and their product is near 1.
    """
    if not np.isfinite(matrix).all():
        return matrix  # whose numbers the solver is to see
    S = (matrix + matrix.T) / 2
    try:
        np.linalg.cholesky(S)
        return np.asarray(np.linalg.inv(matrix))
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(S)
        sizes = np.abs(values)
        kept = sizes > 1e-14 * sizes.max(initial=0.0)  # the others are of a body that can move
        return np.asarray((vectors[:, kept] / sizes[kept]) @ vectors[:, kept].T)


class Hierarchy:
    """All levels. Collective to make.

    Args:
        linear: Interpolation from linear to quadratic elements, where A is of these.
        modes: Makes the rigid-body modes of the linear elements' nodes, of shape (nodes, dim,
            modes), which are kept no longer than they are needed.
        means: What is smoothed in place of nodes of a surface of quadratic elements.

    Attributes:
        sane: There is no entry that is not a number.
    """

    def __init__(
        self,
        A: BlockRows,
        linear: Interpolation | None,
        modes: Callable[[], FloatArray],
        loops: CFunctions,
        means: SurfaceMeans | None = None,
    ) -> None:
        self._loops, self._means, self._levels = loops, means, list[Level]()
        self._interpolations: list[Interpolation] = []
        waiting: list[Callable[[], Level]] = []
        if linear is not None:
            coarse = galerkin(A, linear, loops)
            self._add(waiting, A, linear, None)
            A = coarse
            del coarse
        near, threshold, stalled = modes(), THRESHOLD, False
        while A.halo.total * A.R > SMALL and not stalled:
            diagonal = diagonal_of(A, loops)
            P, near = smoothed_interpolation(A, near, diagonal, threshold=threshold, loops=loops)
            coarse = galerkin(A, P, loops)
            self._add(waiting, A, P, diagonal)
            del diagonal
            give_back()
            self._interpolations.append(P)
            stalled = coarse.halo.total > SLOW * A.halo.total
            A, threshold = coarse, threshold / 2
            del coarse
        self._levels[:0] = [level() for level in waiting]
        A, small = A.with_blocks(), A.halo.total * A.R <= SMALL
        self._last: Inverse | Rest = Inverse(A) if small else Rest(A, near)
        self.sane = all(np.isfinite(level.smoother.largest) for level in self._levels)

    def _add(
        self,
        waiting: list[Callable[[], Level]],
        A: BlockRows,
        P: Interpolation,
        diagonal: Diagonal | None,
    ) -> None:
        """Adds a level, which takes A over. Collective.

        Args:
            waiting: Gets it if A is PETSc's, of which a copy is made, and so is the finest: the
                others are to become single before.
            P: Interpolation from the next coarser level.
            diagonal: That of A, where it is known.
        """

        def level() -> Level:
            means = None if diagonal else self._means  # of quadratic elements
            return Level(smoother_of(A, self._loops, diagonal, means), P, self._loops)

        if isinstance(A, PetscRows):
            waiting.append(level)
        else:
            self._levels.append(level())

    def cycle(self, b: Vectors, k: int = 0) -> Vectors:
        """One V cycle. Collective.

        Args:
            b: Right-hand side of level k, of owned nodes, or `EIGHT` of them, see `Level`.
            k: Level; 0 is the finest.
        """
        if k == len(self._levels):
            x = b.copy()
            x[:] = self._last.solve(b)
            return x
        level = self._levels[k]
        return level.ascend(b, self.cycle(level.descend(b), k + 1))

    def renew(self) -> None:
        """Makes the finest level follow a tangent that has changed. Collective."""
        for level in self._levels[:1]:
            level.smoother.renew()

    def __str__(self) -> str:
        return ", ".join(map(str, self._levels))

    def destroy(self) -> None:
        """Frees PETSc's objects. Collective."""
        for thing in (*self._levels, *self._interpolations, self._last):
            thing.destroy()


class Multigrid:
    """What PETSc calls as a PC of type "python". Collective to make.

    `PC.reset` lets the next solve make the levels anew.  The PC is not kept here: it holds this
    object, and neither would ever be freed.

    Args:
        order: See `multigrid.PMultigrid`.
        blocks: What the tangent has beside its elements; None: nothing, or its displacement is
            not the only unknown.
    """

    def __init__(
        self,
        problem: Problem,
        pc: PETSc.PC,
        order: IndexArray | None = None,
        blocks: NodeBlocks | None = None,
    ) -> None:
        self._problem, self._order = problem, order
        self._hierarchy: Hierarchy | None = None
        self._space: fem.FunctionSpace | None = None
        self._linear: Interpolation | None = None
        self._half: SymmetricBlocks | None = None
        self._means: SurfaceMeans | None = None
        dim = problem.body.dim
        sizes = {"DIM": dim, "MODES": 3 * dim - 3}
        self._loops = compile_c(problem.body.comm, "multigrid.c", sizes, problem.jit)
        if problem.degree > 1:
            self._space = problem.unknowns.linear_space()
            interpolation = constrained_interpolation(problem, self._space, order)
            self._linear = interpolation_from_petsc(interpolation, dim, dim, self._loops)
            interpolation.destroy()
            if blocks is not None:
                self._means = surface_means(problem, blocks, self._space)
        pc.setType("python")
        pc.setPythonContext(self)

    def setUp(self, pc: PETSc.PC) -> None:
        """Makes the levels, with the rigid-body modes of the current places. Collective."""
        self.reset(pc)
        give_back()  # what outputs needed: this is where most memory is in use
        dim = self._problem.body.dim
        self._half = halves(pc.getOperators()[1])
        A: BlockRows = (
            PetscRows(pc.getOperators()[1], dim, dim, self._loops)
            if self._half is None
            else SymmetricRows(self._half)
        )
        self._hierarchy = Hierarchy(A, self._linear, self._modes, self._loops, self._means)
        give_back()  # what making them needed for the moment
        if not self._hierarchy.sane:
            pc.setFailedReason(PETSc.PC.FailedReason.SUBPC_ERROR)

    def _modes(self) -> FloatArray:
        """Rigid-body modes at the nodes of linear elements, about the current places."""
        problem, space = self._problem, self._space
        if space is None:
            unknowns = problem.unknowns
            modes = mode_values(unknowns.U, unknowns.single_valued, unknowns.unknown_places)
            return modes if self._order is None else reordered(modes, self._order)
        moved = None
        if problem.cell is None:  # merged nodes of a periodic cell have several places
            u = fem.Function(space)
            u.interpolate(problem.u)
            moved = u.x.array
        return mode_values(space, moved)

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """One cycle. Collective."""
        if self._half is not halves(pc.getOperators()[1]):
            self.setUp(pc)  # other pairs of nodes have blocks
        assert self._hierarchy is not None
        self._hierarchy.renew()
        b = x.array_r.reshape(-1, self._problem.body.dim)
        y.array_w[:] = self._hierarchy.cycle(b).reshape(-1)

    def apply_to_several(self, pc: PETSc.PC, vectors: FloatArray) -> None:
        """One cycle for each of several vectors. Collective.

        Args:
            vectors: Owned entries, one vector below the other, which are overwritten.
        """
        pc.setUp()
        hierarchy, dim = self._hierarchy, self._problem.body.dim
        assert hierarchy is not None
        hierarchy.renew()
        b = np.empty((vectors.shape[1] // dim, dim, EIGHT), dtype=np.float32)
        by_eights(vectors, vectors, b, lambda: hierarchy.cycle(b), self._loops)

    def view(self, pc: PETSc.PC, viewer: PETSc.Viewer) -> None:
        """Names the levels. Collective.

        Args:
            viewer: Where to.
        """
        if self._hierarchy is not None:
            viewer.printfASCII(f"  multigrid in blocks, V(1, 1): {self._hierarchy}\n")

    def reset(self, pc: PETSc.PC | None) -> None:
        """Frees the levels. Collective."""
        if self._hierarchy is not None:
            self._hierarchy.destroy()
        self._hierarchy = None

    def destroy(self, pc: PETSc.PC | None = None) -> None:
        """Frees the levels. Collective."""
        self.reset(pc)
        if self._linear is not None:
            self._linear.destroy()
        if self._means is not None:
            self._means.destroy()
        self._linear = self._means = None
