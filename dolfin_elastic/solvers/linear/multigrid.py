"""Multigrid for displacements: from quadratic to linear elements, then algebraic.

PETSc's PCMG does the work; what it cannot know is the interpolation between the elements and the
rigid-body modes, which smoothed aggregation has to represent on all coarser levels: P. Vanek, J.
Mandel and M. Brezina, Computing 56 (1996) 179; M. Adams, M. Brezina, J. Hu and R. Tuminaro, J.
Comput. Phys. 188 (2003) 593.
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic.core.compat import interpolation_matrix
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.problem.constraints.rows import Rows
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.matrix import transformation
from dolfin_elastic.solvers.petsc.aij import from_entries

VERTEX = 0.9
"""Weight above which a row of the interpolation belongs to a vertex: there it is 1, and 1/2 at
most elsewhere."""

ZERO = 1e-10
"""Weight below which an entry of the interpolation is round-off."""


SOFT = 1e-2
"""Factor of skew directions of vertices in the interpolation.  The stiffness there, SOFT^2 of K's
size, must not hinder the rigid-body modes of the coarser levels, which do not know of it."""


class PMultigrid:
    """Two levels of PCMG: quadratic elements, below them linear ones, solved for by GAMG.

    The coarse tangent is P^T K P.  Constraints are kept by P itself: with D the projection on the
    prescribed directions of the quadratic elements' nodes and C the same at the vertices,

        P = (1 - D) I (1 - C) + D V

    (with ties D and C hold the tied components, too, and I T stands for I, T their elimination at
    the vertices)
    where I interpolates and V copies vertices.  So a coarse free direction moves no prescribed
    one, and along the prescribed directions of vertices the coarse tangent has what K has there:
    ones, or the stiffness that stands for skew supports (times `SOFT` twice).

    Args:
        problem: With quadratic elements.  Collective.
        pc: Of type "mg", for the displacement's block of the tangent, with its options in force.
        order: The entry of the displacement (owned, of `unknowns.U`) behind each row of the
            block; None: they are the same.

    Raises:
        InputError: The user wants another number of levels.
    """

    def __init__(self, problem: Problem, pc: PETSc.PC, order: IndexArray | None = None) -> None:
        _check_levels(pc)
        pc.setMGLevels(2)  # not by an option, which GAMG would refuse in the place of PCMG
        self._problem, self._pc = problem, pc
        self._space = problem.unknowns.linear_space()
        self._P = constrained_interpolation(problem, self._space, order)
        # GAMG takes the near null space from its matrix, which PCMG makes in the middle of its
        # set-up where nobody can reach it, or from the first field of its DM.
        self._field = PETSc.IS().createGeneral(np.empty(0, PETSc.IntType), comm=problem.body.comm)
        self._dm = PETSc.DMShell().create(comm=problem.body.comm)
        self._dm.setField(0, self._field)
        self._set_modes()
        pc.setMGInterpolation(1, self._P)
        pc.getMGCoarseSolve().getPC().setDM(self._dm)

    def _set_modes(self) -> None:
        """Rigid-body modes of the current places. Collective."""
        moved = None
        if self._problem.cell is None:  # merged nodes of a periodic cell have several places
            u = fem.Function(self._space)
            u.interpolate(self._problem.u)
            moved = u.x.array
        modes = rigid_body_modes(self._space, moved)
        self._field.compose("nearnullspace", modes)
        modes.destroy()

    def refresh(self) -> None:
        """Makes GAMG coarsen anew, with the rigid-body modes of the current places. Collective."""
        self._set_modes()
        coarse, smoother = self._pc.getMGCoarseSolve(), self._pc.getMGSmoother(1)
        renew(coarse)
        for pc in (self._pc, smoother.getPC(), coarse.getPC()):
            pc.setFailedReason(PETSc.PC.FailedReason.NOERROR)  # PCMG never forgets a failure

    def destroy(self) -> None:
        """Frees what it owns, not the PC. Collective."""
        for thing in (self._P, self._dm, self._field):
            thing.destroy()


def _check_levels(pc: PETSc.PC) -> None:
    """Refuses more than two levels: PETSc would crash without further interpolations."""
    levels = PETSc.Options(pc.getOptionsPrefix()).getInt("pc_mg_levels", 2)
    if levels != 2:
        raise InputError(
            f"multigrid from quadratic to linear elements has two levels, not {levels}",
            where="solver.petsc",
            expected="leave -pc_mg_levels out; -mg_coarse_pc_gamg_ options shape the levels below",
        )


def renew(ksp: PETSc.KSP) -> None:
    """Makes a solver set its preconditioner up from nothing, for the same operators. Collective.

    Without `PC.reset`, GAMG keeps the near null space that it was made with.
    """
    operators = ksp.getOperators()
    ksp.getPC().reset()
    ksp.setOperators(*operators)


def constrained_interpolation(
    problem: Problem, coarse: fem.FunctionSpace, order: IndexArray | None = None
) -> PETSc.Mat:
    """From linear to quadratic elements, with the constraints of both; see `PMultigrid`.

    Collective.  The caller destroys it.

    Args:
        coarse: Space of linear elements on the same mesh.
        order: See `PMultigrid`.
    """
    plain, unknowns = interpolation_matrix(coarse, problem.unknowns.U), problem.unknowns
    row = np.arange(plain.getLocalSize()[0])
    constraints, free = problem.constraints, Rows(*problem.constraints.at(unknowns.merged_dofs))
    I, V = rows_above(plain, ZERO), rows_above(plain, VERTEX)  # noqa: E741
    T = transformation(problem, free, I, row, prescribed=0.0)
    moved = T.matMult(I)
    followed = V.transposeMatMult(moved)
    masters = I.matMult(followed)
    P, softened = rows_above(masters, 0.0, order), rows_above(V, 0.0, order)
    places = (row if order is None else np.argsort(order)).astype(np.int32)
    at = Rows(*constraints.at(lambda dofs: places[unknowns.merged_dofs(dofs)]))
    first, held = plain.getOwnershipRange()[0], at.prescribed_dofs
    i, j, v = at.eliminated(first)
    i, j = np.concatenate([held, i]), np.concatenate([first + held, j])
    D = from_entries(P, i, j, np.concatenate([np.ones(len(held)), v]), square=True)
    vertices, prescribed = D.matMult(softened), D.matMult(P)
    factors = P.createVecLeft()
    factors.set(1.0)
    factors.array_w[at.skew_dofs.reshape(-1)] = SOFT
    vertices.diagonalScale(factors)
    _add(P, -1.0, prescribed)
    _add(P, 1.0, vertices)
    result = rows_above(P, ZERO)
    things = (plain, I, V, T, moved, followed, masters, P, softened, D, vertices, prescribed)
    for thing in (*things, factors):
        thing.destroy()
    return result


def _add(matrix: PETSc.Mat, factor: float, other: PETSc.Mat) -> None:
    matrix.axpy(factor, other, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)


def rows_above(matrix: PETSc.Mat, least: float, order: IndexArray | None = None) -> PETSc.Mat:
    """A matrix's entries above a size, its owned rows in another order. Collective."""
    start, columns, values = matrix.getValuesCSR()
    rows = np.repeat(np.arange(len(start) - 1), np.diff(start))
    if order is not None:
        rows = np.argsort(order)[rows]
    large = np.abs(values) > least
    return from_entries(matrix, rows[large], columns[large], values[large])


def mode_values(
    V: fem.FunctionSpace, u: FloatArray | None = None, places: FloatArray | None = None
) -> FloatArray:
    """Translations and rotations at owned nodes of a vector space, of shape (nodes, dim, modes).

    Args:
        V: Blocked vector space of 2 or 3 components.
        u: Local displacement array [m]: rotations are taken about the current places X + u,
            without which multigrid loses half its speed after a rotation by 60 degrees.
        places: Reference places of the nodes [m], where they are known.
    """
    dim, size = V.dofmap.index_map_bs, V.dofmap.index_map.size_local
    x = (V.tabulate_dof_coordinates() if places is None else places)[:size, :dim].copy()
    if u is not None:
        x += u[: dim * size].reshape(-1, dim)
    planes = [(0, 1)] if dim == 2 else [(0, 1), (1, 2), (2, 0)]
    modes = np.zeros((size, dim, dim + len(planes)))
    modes[:, range(dim), range(dim)] = 1.0
    for k, (i, j) in enumerate(planes, start=dim):
        modes[:, i, k], modes[:, j, k] = -x[:, j], x[:, i]
    return modes


def rigid_body_modes(
    V: fem.FunctionSpace, u: FloatArray | None = None, order: IndexArray | None = None
) -> PETSc.NullSpace:
    """Orthonormal translations and rotations of a vector space, as a near null space.

    Collective.  The caller destroys it.

    Args:
        V: See `mode_values`.
        u: See `mode_values`.
        order: Owned entry of V behind each entry of the modes; None: they are the same.
    """
    values = mode_values(V, u)
    return near_null_space(V.mesh.comm, values if order is None else reordered(values, order))


def reordered(modes: FloatArray, order: IndexArray) -> FloatArray:
    """Modes with their components in another order.

    Args:
        modes: Of shape (nodes, components, modes).
        order: The component behind each one of the result.
    """
    return modes.reshape(-1, modes.shape[2])[order].reshape(modes.shape)


def near_null_space(comm: MPI.Comm, modes: FloatArray) -> PETSc.NullSpace:
    """Modes, made orthonormal, as a near null space. Collective.

    The caller destroys it.

    Args:
        comm: The ranks.
        modes: At owned nodes, of shape (nodes, components, modes).
    """
    nodes, dim, count = modes.shape
    vectors = [
        PETSc.Vec().createMPI((nodes * dim, None), bsize=dim, comm=comm) for _ in range(count)
    ]
    for k, vector in enumerate(vectors):
        vector.array_w[:] = modes[:, :, k].reshape(-1)
        for other in vectors[:k]:
            vector.axpy(-vector.dot(other), other)
        vector.normalize()
    space = PETSc.NullSpace().create(vectors=vectors, comm=comm)
    for vector in vectors:
        vector.destroy()
    return space
