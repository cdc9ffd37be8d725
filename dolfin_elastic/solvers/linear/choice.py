"""Which linear solver, and why.

Small systems are factorised (MUMPS).  Large ones are solved by conjugate gradients, or by GMRES
when the tangent is not symmetric, with multigrid that knows the rigid-body modes: algebraic
(GAMG) for linear elements; for quadratic ones a first coarsening from quadratic to linear
elements, then the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from dolfinx import fem, la
from petsc4py import PETSc
from pydantic import Field

from dolfin_elastic.core.compat import interpolation_matrix
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.problem.constraints.dirichlet import DirichletConditions
from dolfin_elastic.problem.constraints.skew import SkewConstraints
from dolfin_elastic.problem.problem import Problem

DIRECT_LIMIT = {2: 150_000, 3: 20_000}
"""Largest number of unknowns that are factorised by default, by dimension."""


MIXED_LIMIT = {2: 100_000, 3: 10_000}
"""The same with a pressure beside the displacement."""


MIXED_MOVING = {2: 400_000, 3: 150_000}
"""The same in motion, where short steps make the pressure hard for iterations."""


LAST_DIRECT = {2: 1_000_000, 3: 150_000}
"""Largest number of unknowns that are factorised when iterations have failed."""


class LinearSettings(Record):
    """How linear systems are solved; all of it is chosen by itself by default.

    Attributes:
        method: "auto", "direct" (MUMPS) or "iterative" (Krylov with multigrid).
        petsc: PETSc options that override everything else, for example {ksp_type = "gmres"}.
    """

    method: Literal["auto", "direct", "iterative"] = "auto"
    petsc: dict[str, bool | int | float | str] = Field(default_factory=dict)


@dataclass(frozen=True)
class Choice:
    """A linear solver.

    Attributes:
        direct: Factorisation, not iterations.
        options: PETSc options without prefix.
        why: For the log.
    """

    direct: bool
    options: dict[str, Any]
    why: str


def choose(problem: Problem, settings: LinearSettings, *, moving: bool = False) -> Choice:
    """Chooses a linear solver for a problem and says why."""
    dofs, limit = problem.num_dofs, DIRECT_LIMIT[problem.body.dim]
    several = bool(problem.unknowns.extras)
    if several:
        limit = (MIXED_MOVING if moving else MIXED_LIMIT)[problem.body.dim]
    direct = settings.method == "direct" or (settings.method == "auto" and dofs <= limit)
    direct = direct or problem.unknowns.has("stretch")  # only ever in a plane: cheap to factorise
    symmetric = problem.symmetric
    size = f"{dofs} unknowns"
    if settings.method != "auto":
        size += f", '{settings.method}' asked for"
    if direct:
        kind = "Cholesky-like LDL^T" if symmetric else "LU"
        return Choice(True, factorising(symmetric), f"direct solver (MUMPS, {kind}): {size}")
    krylov = "CG" if symmetric and not several else "GMRES"
    grid = (
        "GAMG with rigid-body modes"
        if problem.degree == 1
        else "multigrid from quadratic to linear elements, then GAMG with rigid-body modes"
    )
    if several:
        grid = f"pressure by its mass matrix, displacement by {grid}"
    options = _iterative(problem, symmetric and not several)
    return Choice(False, options, f"iterative solver ({krylov}, {grid}): {size}")


def factorising(symmetric: bool) -> dict[str, Any]:
    """Options of a direct solver."""
    return {
        "ksp_type": "preonly",
        "pc_type": "cholesky" if symmetric else "lu",
        "pc_factor_mat_solver_type": "mumps",
        "mat_mumps_icntl_14": 50,  # room for pivoting on indefinite tangents
        "mat_mumps_icntl_13": 1,  # no ScaLAPACK at the root: it counts no negative pivots
        "mat_mumps_icntl_24": 1,  # a singular tangent is Newton's affair, not MUMPS's error
        "mat_mumps_icntl_20": 0,  # PETSc's distributed right-hand side can fail (dolfinx#4362)
    }


def _iterative(problem: Problem, symmetric: bool) -> dict[str, Any]:
    krylov: dict[str, Any] = {
        "ksp_type": "cg" if symmetric else "gmres",
        "ksp_max_it": 500,
        # Setting multigrid up costs as much as many iterations: once a load step is enough.
        "snes_lag_preconditioner": 20,
        "ksp_rtol": 1e-8,
    }
    if not symmetric:
        krylov |= GMRES
    inner = GAMG if problem.degree == 1 else QUADRATIC
    if problem.unknowns.extras:
        return {**krylov, "pc_type": "python", **{f"u_{k}": value for k, value in inner.items()}}
    return {**krylov, "pc_type": "gamg" if problem.degree == 1 else "python", **inner}


GMRES: dict[str, Any] = {"ksp_type": "gmres", "ksp_gmres_restart": 100, "ksp_pc_side": "right"}

GAMG: dict[str, Any] = {
    "pc_gamg_threshold": 0.01,
    "pc_gamg_coarse_eq_limit": 500,
    "pc_gamg_agg_nsmooths": 1,
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_ksp_max_it": 1,
    "mg_levels_pc_type": "pbjacobi",
}

QUADRATIC: dict[str, Any] = {
    "two_mg_levels_ksp_type": "chebyshev",
    "two_mg_levels_ksp_max_it": 1,
    "two_mg_levels_pc_type": "pbjacobi",
    **{f"two_mg_coarse_{name}": value for name, value in GAMG.items()},
}
"""Options of `PMultigrid`, whose own prefix is `two_`."""


def rigid_body_modes(
    V: fem.FunctionSpace,
    u: FloatArray | None = None,
) -> PETSc.NullSpace:
    """Orthonormal translations and rotations of a vector space, as a near null space.

    Collective.  The caller destroys it.

    Args:
        V: Blocked vector space of 2 or 3 components.
        u: Local displacement array: rotations are taken about the current places X + u, without
            which GAMG loses half its speed after a rotation by 60 degrees.
    """
    dim, index_map = V.dofmap.index_map_bs, V.dofmap.index_map
    size = index_map.size_local
    x = V.tabulate_dof_coordinates()[:size, :dim].copy()
    if u is not None:
        x += u[: dim * size].reshape(-1, dim)
    planes = [(0, 1)] if dim == 2 else [(0, 1), (1, 2), (2, 0)]
    modes = [la.vector(index_map, bs=dim) for _ in range(dim + len(planes))]
    for k, mode in enumerate(modes):
        rows = mode.array[: dim * size].reshape(-1, dim)
        if k < dim:
            rows[:, k] = 1.0
        else:
            i, j = planes[k - dim]
            rows[:, i], rows[:, j] = -x[:, j], x[:, i]
    la.orthonormalize(modes)
    comm = V.mesh.comm
    vectors = []
    for mode in modes:
        vector = PETSc.Vec().createMPI((dim * size, None), bsize=dim, comm=comm)
        vector.array_w[:] = mode.array[: dim * size]
        vectors.append(vector)
    space = PETSc.NullSpace().create(vectors=vectors, comm=comm)
    for vector in vectors:
        vector.destroy()
    return space


def _free_directions(like: PETSc.Vec, tilted: SkewConstraints) -> PETSc.Mat:
    """The matrix of 1 - P at tilted nodes and ones elsewhere, sized like a vector. Collective."""
    size, dim = like.getLocalSize(), tilted.P.shape[1]
    nodes = tilted.nodes[: tilted.count]
    plain = np.setdiff1d(np.arange(size // dim), nodes)
    own = np.arange(size).reshape(-1, dim)
    rows = np.concatenate([np.repeat(own[nodes], dim, axis=1).reshape(-1), own[plain].reshape(-1)])
    columns = np.concatenate([np.tile(own[nodes], dim).reshape(-1), own[plain].reshape(-1)])
    blocks = np.eye(dim) - tilted.P[: tilted.count]
    values = np.concatenate([blocks.reshape(-1), np.ones(plain.size * dim)])
    order = np.argsort(rows, kind="stable")
    start = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=size))])
    matrix = PETSc.Mat().createAIJ(
        ((size, None), (size, None)),
        comm=like.comm,
        csr=(
            start.astype(PETSc.IntType),
            (columns[order] + like.getOwnershipRange()[0]).astype(PETSc.IntType),
            values[order],
        ),
    )
    matrix.assemble()
    return matrix


class PMultigrid:
    """PETSc python preconditioner: quadratic elements, below them linear ones, below them GAMG.

    The coarse tangent is P^T K P with the interpolation P between elements of the same mesh.
    Constrained rows and columns of P are zero, and the coarse tangent has ones on its diagonal
    there, so that both levels keep the prescribed values.  With directions that are no entries it
    is Q_fine P Q_coarse, and their projections on the coarse diagonal.
    """

    def __init__(self, problem: Problem) -> None:
        body = problem.body
        self._coarse_space, pinned = problem.unknowns.linear()
        self._P = interpolation_matrix(self._coarse_space, problem.unknowns.U)
        coarse = DirichletConditions(
            body,
            self._coarse_space,
            problem.supports,
            axis=problem.geometry == "axisymmetric",
        )
        self._tilted = coarse.tilted
        self._fixed = self._P.createVecRight()
        self._fixed.array_w[coarse.owned] = 1.0
        self._fixed.array_w[pinned] = 1.0
        self._scale_interpolation(problem.unknowns.local(problem.dirichlet.owned))
        if problem.dirichlet.tilted is not None:
            self._project_interpolation(problem.dirichlet.tilted)
        self._problem = problem
        self._coarse: PETSc.Mat | None = None
        self._pc: PETSc.PC | None = None

    def _scale_interpolation(self, fixed: IndexArray) -> None:
        rows, columns = self._P.createVecLeft(), self._P.createVecRight()
        rows.set(1.0)
        rows.array_w[fixed] = 0.0
        columns.array_w[:] = 1.0 - self._fixed.array_r
        self._P.diagonalScale(rows, columns)
        rows.destroy()
        columns.destroy()

    def _project_interpolation(self, fine: SkewConstraints) -> None:
        """Collective."""
        left, right = self._P.createVecLeft(), self._P.createVecRight()
        factors = [_free_directions(left, fine)]
        if self._tilted is not None:
            factors.append(_free_directions(right, self._tilted))
        product = factors[0].matMult(self._P)
        for factor in factors[1:]:
            once, product = product, product.matMult(factor)
            once.destroy()
        for thing in (*factors, self._P, left, right):
            thing.destroy()
        self._P = product

    def _hold_coarse(self) -> None:
        """Adds what stands for held directions on the coarse level. Collective."""
        assert self._coarse is not None
        self._coarse.setDiagonal(self._fixed, addv=PETSc.InsertMode.ADD_VALUES)
        if self._tilted is not None:
            start, tilted = self._coarse.getOwnershipRange()[0], self._tilted
            for node, P in zip(tilted.nodes[: tilted.count], tilted.P, strict=False):
                rows = (start + node * len(P) + np.arange(len(P))).astype(PETSc.IntType)
                self._coarse.setValues(rows, rows, P, addv=PETSc.InsertMode.ADD_VALUES)
            self._coarse.assemble()

    def setUp(self, pc: PETSc.PC) -> None:
        """Makes the coarse tangent anew and sets both levels up. Collective."""
        _, matrix = pc.getOperators()
        first = self._coarse is None
        self._coarse = matrix.ptap(self._P, result=self._coarse)
        self._hold_coarse()
        if first:
            self._prepare(pc, matrix)
        assert self._pc is not None
        self._pc.getMGCoarseSolve().setOperators(self._coarse, self._coarse)
        self._pc.getMGSmoother(1).setOperators(matrix, matrix)
        self._pc.setOperators(matrix, matrix)
        self._pc.setUp()

    def _prepare(self, pc: PETSc.PC, matrix: PETSc.Mat) -> None:
        assert self._coarse is not None
        self._coarse.setBlockSizes(self._fixed.getBlockSize(), self._fixed.getBlockSize())
        if self._problem.symmetric:
            self._coarse.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            self._coarse.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        self._attach_modes()
        self._pc = PETSc.PC().create(comm=matrix.comm)
        self._pc.setOptionsPrefix(pc.getOptionsPrefix() + "two_")
        self._pc.setOperators(matrix, matrix)
        self._pc.setType("mg")
        self._pc.setMGLevels(2)
        self._pc.setMGInterpolation(1, self._P)
        coarse = self._pc.getMGCoarseSolve()
        coarse.setType("preonly")
        coarse.getPC().setType("gamg")
        self._pc.setFromOptions()

    def _attach_modes(self) -> None:
        """Gives the coarse tangent the rigid-body modes of the current places."""
        assert self._coarse is not None
        moved = None
        if self._problem.cell is None:  # places of merged nodes are not known to the space
            u = fem.Function(self._coarse_space)
            u.interpolate(self._problem.u)
            moved = u.x.array
        modes = rigid_body_modes(self._coarse_space, moved)
        self._coarse.setNearNullSpace(modes)
        modes.destroy()

    def refresh(self) -> None:
        """Makes GAMG begin anew, with the rigid-body modes of the current places. Collective."""
        if self._pc is not None:
            self._attach_modes()
            self._pc.getMGCoarseSolve().getPC().reset()

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """One V-cycle. Collective."""
        assert self._pc is not None
        self._pc.apply(x, y)

    def destroy(self, pc: PETSc.PC | None = None) -> None:
        """Frees everything. Collective."""
        for thing in (self._pc, self._coarse, self._P, self._fixed):
            if thing is not None:
                thing.destroy()
