"""Preconditioner for displacement and pressure: block triangular with a scaled mass matrix.

    P = | K  B^T |      S = - integral of (1/mu + 1/k) p q
        | 0   S  |

K is approximated by one multigrid cycle, S by its row sums; PETSc's PCFIELDSPLIT puts them
together.  S is spectrally equivalent to the Schur complement whatever the compressibility:
Silvester & Wathen, SIAM J. Numer. Anal. 31 (1994); Elman, Silvester & Wathen, Finite Elements and
Fast Iterative Solvers (2014), section 4.2.
"""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem, la
from petsc4py import PETSc

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.weak_form import UNUSED
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled
from dolfin_elastic.solvers.linear.multigrid import PMultigrid, renew, rigid_body_modes


class PressureSplit:
    """Configures PCFIELDSPLIT with the fields "u" and "p", S for "p", and multigrid for "u".

    Args:
        assembler: Of a problem with a pressure as the one scalar field.  Collective.
        pc: Of type "fieldsplit", with its prefix set and the options in force.
    """

    def __init__(self, assembler: Assembler, pc: PETSc.PC) -> None:
        self._problem = assembler.problem
        start = assembler.tangent.matrix.getOwnershipRange()[0]
        # Rows of a split have to be sorted, but the displacement has an order of its own.
        self._order = np.argsort(assembler.displacement_dofs, kind="stable").astype(np.int32)
        pressures = np.setdiff1d(np.arange(assembler.size), assembler.displacement_dofs)
        comm = assembler.comm
        self._u = PETSc.IS().createGeneral(
            (assembler.displacement_dofs[self._order] + start).astype(PETSc.IntType), comm
        )
        self._u.setBlockSize(self._block_size())
        self._p = PETSc.IS().createGeneral((pressures + start).astype(PETSc.IntType), comm)
        entries = PETSc.Vec().createMPI((len(pressures), None), comm=comm)
        entries.array_w[:] = _schur_diagonal(self._problem)[pressures]
        self._S = PETSc.Mat().createDiagonal(entries)
        entries.destroy()
        pc.setFieldSplitIS(("u", self._u), ("p", self._p))
        pc.setFieldSplitSchurPreType(PETSc.PC.FieldSplitSchurPreType.USER, self._S)
        pc.setFromOptions()  # the user may want another approximation of the Schur complement
        pc.setOperators(assembler.tangent.matrix, assembler.tangent.matrix)
        pc.setUp()  # makes the solvers of the splits; they are set up at their first use
        self._ksp = pc.getFieldSplitSubKSP()[0]
        if self._problem.symmetric:
            K = self._ksp.getOperators()[1]
            K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            K.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        self._multigrid: PMultigrid | None = None
        inner = self._ksp.getPC()
        if inner.getType() == "mg" and self._problem.degree > 1:
            self._multigrid = PMultigrid(self._problem, inner, self._order)
        else:
            self._set_modes()

    def _block_size(self) -> int:
        """Components of a node, where all nodes' rows are numbered in a row; else 1."""
        dim = self._problem.body.dim
        nodes = np.argsort(self._order).reshape(-1, dim)
        apart = (nodes[:, :1] % dim != 0) | (nodes != nodes[:, :1] + np.arange(dim))
        return 1 if total(self._problem.body.comm, int(apart.any())) else dim

    def _set_modes(self) -> None:
        unknowns = self._problem.unknowns
        modes = rigid_body_modes(unknowns.U, unknowns.single_valued, self._order)
        self._ksp.getOperators()[1].setNearNullSpace(modes)
        modes.destroy()

    def refresh(self) -> None:
        """Rebuilds multigrid, with the rigid-body modes of the current places."""
        if self._multigrid is not None:
            self._multigrid.refresh()
        else:
            self._set_modes()
            renew(self._ksp)

    def destroy(self) -> None:
        """Frees what it owns, not the PC. Collective."""
        if self._multigrid is not None:
            self._multigrid.destroy()
        for thing in (self._ksp, self._u, self._p, self._S):
            thing.destroy()


def _schur_diagonal(problem: Problem) -> FloatArray:
    """Row sums of S, the scaled mass matrix of pressures, at all local unknowns. Collective."""
    scale = problem.unknowns.scale["pressure"]
    q = problem.unknowns.auxiliary("pressure", ufl.TestFunction(problem.W))
    form = sum(
        -((1 / region.shear + region.compliance) if region.compliance else UNUSED / region.shear)
        * scale
        * q
        * problem.weak_form.volume(region, 2)
        for region in problem.regions
    )
    sums = la.vector(problem.W.dofmap.index_map, problem.W.dofmap.index_map_bs)
    fem.assemble_vector(sums.array, compiled(problem, [form])[0])
    sums.scatter_reverse(la.InsertMode.add)
    return np.asarray(sums.array)
