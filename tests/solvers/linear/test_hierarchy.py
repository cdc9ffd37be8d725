"""Multigrid in blocks: its products, its interpolation, its cycle, and what PETSc makes of it."""

from __future__ import annotations

import gc
import tracemalloc
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic import (
    LinearElastic,
    Problem,
    Statics,
    Support,
    Traction,
    box_body,
    rectangle_body,
)
from dolfin_elastic.core.errors import ConvergenceError
from dolfin_elastic.core.jit import CFunctions, compile_c
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.linear import block_rows, hierarchy, ksp
from dolfin_elastic.solvers.linear.aggregation import galerkin, smoothed_interpolation
from dolfin_elastic.solvers.linear.block_rows import (
    BlockRows,
    Interpolation,
    PetscRows,
    interpolation_from_petsc,
)
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.solvers.linear.hierarchy import Multigrid
from dolfin_elastic.solvers.linear.multigrid import constrained_interpolation, mode_values
from dolfin_elastic.solvers.linear.smoother import (
    diagonal_of,
    random_vector,
    taken_in_single_precision,
)
from dolfin_elastic.solvers.petsc.halo import Halo

ITERATIVE = LinearSettings(method="iterative")


def block(n: int = 4, *, dim: int = 3, degree: int = 1, held: bool = True) -> Problem:
    """A block or a rectangle, on one wall or free."""
    if dim == 3:
        body = box_body(size=(2.0, 1.0, 1.0), cells=(2 * n, n, n))
    else:
        body = rectangle_body(size=(2.0, 1.0), cells=(2 * n, n))
    force = [0.0] * (dim - 1) + [1e3]
    return Problem(
        body,
        LinearElastic(E=1e6, nu=0.3),
        degree=degree,
        supports=[Support(on="left")] if held else [],
        loads=[Traction(on="right", value=force)] if held else [],
    )


@contextmanager
def tangent(problem: Problem) -> Iterator[PETSc.Mat]:
    assembler = Assembler(problem)
    x = assembler.create_vector()
    assembler.tangent.assemble(x)
    yield assembler.tangent.matrix
    x.destroy()
    assembler.destroy()


def loops(problem: Problem) -> CFunctions:
    dim = problem.body.dim
    sizes = {"DIM": dim, "MODES": 3 * dim - 3}
    return compile_c(problem.body.comm, "multigrid.c", sizes, problem.jit)


def coarsen(A: BlockRows, modes: FloatArray, threshold: float, kernels: CFunctions) -> Any:
    """The next coarser level: interpolation, matrix and modes."""
    diagonal = diagonal_of(A, kernels)
    P, found = smoothed_interpolation(A, modes, diagonal, threshold=threshold, loops=kernels)
    return SimpleNamespace(P=P, A=galerkin(A, P, kernels), modes=found)


def to_petsc(A: BlockRows | Interpolation) -> PETSc.Mat:
    """The same as a matrix of PETSc; by its insertion, block by block."""
    A = A if isinstance(A, Interpolation) else A.with_blocks()
    comm, count = A.halo.comm, len(A.start) - 1
    first = sum(comm.allgather(count)[: comm.rank])
    sizes = ((count * A.R, None), (A.halo.owned * A.C, None))
    matrix = PETSc.Mat().createAIJ(sizes, comm=comm)
    matrix.setUp()
    matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
    columns = A.halo.globally(A.columns)
    for i in range(count):
        for k in range(A.start[i], A.start[i + 1]):
            rows = (first + i) * A.R + np.arange(A.R)
            at = rows.astype(PETSc.IntType), (columns[k] * A.C + np.arange(A.C)).astype("i4")
            matrix.setValues(*at, A.blocks[k])
    matrix.assemble()
    return matrix


def difference(one: PETSc.Mat, other: PETSc.Mat) -> float:
    """Relative, in the Frobenius norm."""
    size = one.norm()
    one.axpy(-1.0, other, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    return float(one.norm() / size)


@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize("dim", [2, 3])
def test_blocks_and_products_are_those_of_petsc(dim: int, symmetric: bool) -> None:
    """A itself and P^T A P, for aggregates and from linear to quadratic elements: to round-off.

    Of a symmetric matrix half of P^T A P is taken from the other half.
    """
    problem = block(2, dim=dim, degree=2)
    kernels, space = loops(problem), problem.unknowns.linear_space()
    with tangent(problem) as matrix:
        A = PetscRows(matrix, dim, dim, kernels).with_blocks()
        assert A.symmetric  # as PETSc was told
        A.symmetric = symmetric
        same = to_petsc(A)
        assert difference(same, matrix) < 1e-15
        interpolation = constrained_interpolation(problem, space)
        P = interpolation_from_petsc(interpolation, dim, dim, kernels)
        level = galerkin(A, P, kernels)
        expected, found = matrix.ptap(interpolation), to_petsc(level)
        assert difference(found, expected) < 1e-14
        coarse = coarsen(level, mode_values(space), 0.01, kernels)
        petsc = to_petsc(coarse.P)
        more, less = expected.ptap(petsc), to_petsc(coarse.A)
        assert difference(less, more) < 1e-14
        things = (same, interpolation, expected, found, petsc, more, less)
        for thing in (*things, A, P, level, coarse.P, coarse.A):
            thing.destroy()


@pytest.mark.parametrize("dim", [2, 3])
def test_rows_of_the_tangent_may_be_taken_a_few_at_a_time(
    dim: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next level is that of all rows at once, to round-off, and so are single blocks."""
    problem = block(4, dim=dim)
    kernels, modes = loops(problem), mode_values(problem.unknowns.U)
    with tangent(problem) as matrix:
        whole = PetscRows(matrix, dim, dim, kernels).with_blocks()
        monkeypatch.setattr(block_rows, "PART", 200)
        some = PetscRows(matrix, dim, dim, kernels)
        assert len(list(some.parts())) > 1
        one, other = (coarsen(A, modes, 0.08, kernels) for A in (whole, some))
        for a, b in ((one.P, other.P), (one.A, other.A)):
            assert np.array_equal(a.start, b.start)
            assert np.array_equal(a.columns, b.columns)
            most = np.abs(a.blocks).max(initial=0.0)
            off = 1e-12 if a.blocks.dtype == np.float64 else 1e-6
            assert np.abs(a.blocks - b.blocks).max(initial=0.0) < off * most
        singles = [taken_in_single_precision(A, kernels)[:-1] for A in (whole, some)]
        count = whole.start[-1] * dim * dim  # behind them is room that the loops may read
        assert np.array_equal(*(single[:count] for single in singles))
        for thing in (whole, some, one.P, one.A, other.P, other.A):
            thing.destroy()


@pytest.mark.parametrize("threshold", [0.01, 0.1])
@pytest.mark.parametrize("dim", [2, 3])
def test_rigid_bodies_are_interpolated(dim: int, threshold: float) -> None:
    """Of a free body P times the coarse modes are the modes, which smoothing leaves: A m = 0.

    To single precision, in which P is kept; their energy in the coarse matrix is that of round-off.
    With weak connections, too, whose nodes count as if they moved with the aggregate.
    """
    problem = block(4, dim=dim, held=False)
    kernels, modes = loops(problem), mode_values(problem.unknowns.U)
    with tangent(problem) as matrix:
        A = PetscRows(matrix, dim, dim, kernels).with_blocks()
        coarse = coarsen(A, modes, threshold, kernels)
        assert 1 < coarse.A.halo.total < A.halo.total / 4
        P, count = to_petsc(coarse.P), modes.shape[2]
        x, y = P.createVecs()
        for k in range(count):
            x.array_w[:] = coarse.modes[:, :, k].reshape(-1)
            P.mult(x, y)
            assert coarse.P.blocks.dtype == np.float32
            assert np.abs(y.array_r - modes[:, :, k].reshape(-1)).max(initial=0.0) < 3e-7
        for thing in (P, x, y, A, coarse.P, coarse.A):
            thing.destroy()


@pytest.mark.parametrize("dim", [2, 3])
def test_the_coarse_matrix_is_that_of_the_rounded_interpolation(dim: int) -> None:
    """P^T A P of the numbers that the cycle uses, to round-off, by a product of dense matrices.

    So rounding costs rigid motions of a free body no more energy than its square, 1e-13, of that
    of other motions.
    """
    problem = block(3, dim=dim, held=False)
    kernels, modes = loops(problem), mode_values(problem.unknowns.U)
    with tangent(problem) as matrix:
        A = PetscRows(matrix, dim, dim, kernels)
        coarse = coarsen(A, modes, 0.08, kernels)
        fine, P, found = (dense(M) for M in (A, coarse.P, coarse.A))
        assert np.array_equal(P, P.astype(np.float32))
        assert np.abs(P.T @ fine @ P - found).max() < 1e-14 * np.abs(found).max()
        rigid = np.concatenate(problem.body.comm.allgather(coarse.modes)).reshape(len(found), -1)
        energy = np.einsum("ik,ij,jk->k", rigid, found, rigid)
        size = np.abs(found).max() * np.sum(rigid**2, axis=0)
        assert np.abs(energy / size).max() < 1e-13
        for thing in (A, coarse.P, coarse.A):
            thing.destroy()


def dense(A: BlockRows | Interpolation) -> FloatArray:
    """All of a matrix, on all ranks."""
    A = A if isinstance(A, Interpolation) else A.with_blocks()
    comm, rows = A.halo.comm, len(A.start) - 1
    nodes = np.zeros((rows, A.R, A.halo.total, A.C))
    row = np.repeat(np.arange(rows), np.diff(A.start))
    nodes[row, :, A.halo.globally(A.columns), :] = A.blocks
    return np.concatenate(comm.allgather(nodes)).reshape(-1, A.halo.total * A.C)


@pytest.mark.long
@pytest.mark.usefixtures("serial_only")
def test_making_it_needs_little_memory() -> None:
    """At most 18 bytes an entry of the tangent (13), 11 of which stay with an AIJ matrix.

    28 while interpolations were made in double precision.  Counted are arrays of numpy.
    """
    problem = block(14)
    with tangent(problem) as matrix:
        pc = PETSc.PC().create(problem.body.comm)
        pc.setOperators(matrix)
        multigrid = Multigrid(problem, pc)
        tracemalloc.start()
        pc.setUp()
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < 18.0 * matrix.getInfo()["nz_used"]
        for thing in (pc, multigrid):
            thing.destroy()


def applied(pc: PETSc.PC, matrix: PETSc.Mat, values: FloatArray) -> PETSc.Vec:
    x, y = matrix.createVecs()
    x.array_w[:] = values
    pc.apply(x, y)
    x.destroy()
    return y


@pytest.mark.parametrize("degree", [1, 2])
def test_the_cycle_is_symmetric_and_positive(degree: int) -> None:
    """As conjugate gradients need: (a, M b) = (b, M a), to single precision."""
    problem = block(4, degree=degree)
    with tangent(problem) as matrix:
        pc = PETSc.PC().create(problem.body.comm)
        pc.setOperators(matrix)
        multigrid = Multigrid(problem, pc)
        pc.setUp()
        draw = np.random.default_rng(problem.body.comm.rank).normal
        a, b = (matrix.createVecLeft() for _ in range(2))
        for vector in (a, b):
            vector.array_w[:] = draw(size=vector.getLocalSize())
        Ma, Mb = applied(pc, matrix, a.array_r), applied(pc, matrix, b.array_r)
        assert a.dot(Mb) == pytest.approx(b.dot(Ma), abs=1e-6 * np.sqrt(a.dot(Ma) * b.dot(Mb)))
        assert a.dot(Ma) > 0.0
        for thing in (pc, a, b, Ma, Mb, multigrid):
            thing.destroy()


def iterations(problem: Problem, petsc: dict[str, Any] | None = None) -> int:
    options = {"ksp_rtol": 1e-6, **(petsc or {})}
    *_, state = Statics(problem, linear=ITERATIVE, petsc=options).steps()
    return state.krylov


@pytest.mark.long
@pytest.mark.sample(2)
@pytest.mark.parametrize(
    ("dim", "degree", "coarse", "fine"), [(3, 1, 6, 12), (3, 2, 3, 6), (2, 1, 16, 48)]
)
def test_iterations_do_not_grow_with_the_mesh(
    dim: int, degree: int, coarse: int, fine: int
) -> None:
    """By a third at most, where the number of unknowns grows eightfold; GAMG takes no fewer."""
    few = iterations(block(coarse, dim=dim, degree=degree))
    many = iterations(block(fine, dim=dim, degree=degree))
    assert many <= 1.34 * few
    theirs = "mg_coarse_pc_gamg_threshold" if degree > 1 else "pc_gamg_threshold"
    assert many <= 1.2 * iterations(block(fine, dim=dim, degree=degree), {theirs: 0.01})


@pytest.mark.parametrize(
    ("size", "cells", "most"),
    [((40, 1, 1), (20, 10, 10), 130), ((20, 20, 1), (20, 20, 12), 55)],
    ids=["stretched", "flat"],
)
def test_iterations_with_stretched_cells(
    size: tuple[float, float, float], cells: tuple[int, int, int], most: int
) -> None:
    """In two Newton iterations: 68 and 31 on one rank, 114 at most on three, where aggregates end
    at more boundaries; interpolated over weak connections, too, 518 and 240."""
    problem = Problem(
        box_body(size=size, cells=cells),
        LinearElastic(E=1e9, nu=0.3),
        degree=1,
        supports=[Support(on="left")],
        loads=[Traction(on="right", value=[0.0, 0.0, -1.0])],
    )
    assert iterations(problem) <= most


def test_ranks_with_few_aggregates_leave_the_rest_to_gamg(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where coarsening stalls on many ranks: the same solution, with few more iterations."""
    *_, plain = Statics(block(6), linear=ITERATIVE).steps()
    monkeypatch.setattr(hierarchy, "SMALL", 0)
    monkeypatch.setattr(hierarchy, "SLOW", 0.0)
    *_, state = Statics(block(6), linear=ITERATIVE).steps()
    assert state.max_displacement == pytest.approx(plain.max_displacement, rel=1e-7)
    assert state.krylov <= plain.krylov + 6


def test_numbers_that_are_none_fail_on_all_ranks() -> None:
    """PETSc says that the preconditioner failed; nobody waits."""
    problem = block()
    with tangent(problem) as matrix:
        if problem.body.comm.rank == 0:
            matrix.setValue(5, 5, np.nan)
        matrix.assemble()
        ksp = PETSc.KSP().create(problem.body.comm)
        ksp.setType("cg")
        ksp.setOperators(matrix)
        multigrid = Multigrid(problem, ksp.getPC())
        x, b = matrix.createVecs()
        b.set(1.0)
        ksp.solve(b, x)
        assert ksp.getConvergedReason() < 0
        for thing in (ksp, x, b, multigrid):
            thing.destroy()


def test_it_is_freed_with_its_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    """PETSc's PC holds it; were the PC held by it, both would stay for ever."""
    made: list[weakref.ref[Multigrid]] = []
    set_up = Multigrid.setUp

    def seen(self: Multigrid, pc: PETSc.PC) -> None:
        made.append(weakref.ref(self))
        set_up(self, pc)

    monkeypatch.setattr(Multigrid, "setUp", seen)
    iterations(block())
    gc.collect()
    assert made
    assert all(one() is None for one in made)


@pytest.mark.parametrize("factorises", [True, False])
def test_an_error_of_petsc_is_a_failed_linear_solve(monkeypatch, factorises):
    """Another solver is tried after it; without one the run ends with what has failed."""

    def fail(*_: object) -> None:
        raise PETSc.Error(77)

    monkeypatch.setattr(Multigrid, "setUp", fail)
    if not factorises:
        monkeypatch.setattr(ksp, "LAST_DIRECT", {3: 0})
    statics = Statics(block(2), linear=ITERATIVE)
    if factorises:
        (*_, last) = statics.steps()
        assert last.load_factor == 1.0
    else:
        with pytest.raises(ConvergenceError, match="the preconditioner or factorisation failed"):
            list(statics.steps())


def test_a_rest_that_gamg_refuses_is_no_number():
    """So the solver whose cycle it is fails, and no error of PETSc ends the run."""
    n = 400
    halo = Halo(MPI.COMM_SELF, n, np.zeros(0, dtype=np.int64))
    ring = (np.arange(n)[:, None] + [-1, 0, 1]) % n
    blocks = np.full((3 * n, 2, 2), np.nan)
    A = BlockRows(3 * np.arange(n + 1), ring.astype(np.int32).reshape(-1), blocks, halo)
    rest = hierarchy.Rest(A, np.ones((n, 2, 1)))
    assert np.isnan(rest.solve(np.ones((n, 2)))).all()
    rest.destroy()


@pytest.mark.parametrize(("dim", "degree", "n"), [(2, 2, 12), (3, 1, 8), (3, 2, 4)])
def test_cycles_of_several_vectors(dim: int, degree: int, n: int) -> None:
    """Eight at once and the rest give what each gives by itself, in single precision.

    Which rounds by 2^-24; parts of a cycle add up to a few times that.
    """
    problem = block(n, dim=dim, degree=degree)
    with tangent(problem) as matrix:
        pc = PETSc.PC().create(matrix.comm)
        pc.setOperators(matrix)
        multigrid = Multigrid(problem, pc)
        x, y = matrix.createVecs()
        first, size = x.getOwnershipRange()[0], x.getSize()
        vectors = np.array([random_vector(first + k * size, x.getLocalSize()) for k in range(11)])
        images = vectors.copy()
        multigrid.apply_to_several(pc, images)
        for vector, image in zip(vectors, images, strict=True):
            x.array_w[:] = vector
            pc.apply(x, y)
            largest = matrix.comm.tompi4py().allreduce(np.max(np.abs(y.array_r)), op=MPI.MAX)
            np.testing.assert_allclose(image, y.array_r, rtol=0, atol=2.0**-21 * largest)
        for thing in (multigrid, pc, x, y):
            thing.destroy()
