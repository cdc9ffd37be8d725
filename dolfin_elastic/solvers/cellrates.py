"""The stable step by cells: from the present tangent and shape of each of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfin_elastic.compiler import compile_expression
from dolfin_elastic.parts import Part
from dolfin_elastic.problem import Problem
from dolfin_elastic.solvers.assembler import Assembler, compiled

Floats = npt.NDArray[np.float64]


class CellRates:
    """A bound of omega^2 for each cell, and so for the body: none of its frequencies is higher.

    As x.Kx and x.Mx are sums over cells, no eigenvalue of the body exceeds the largest of its
    cells.  A linear cell of d dimensions and volume V has the stiffness V g_aJ A_iJkL g_bL, with
    the gradients g_a of its shape functions and the tangent A = dP/dF, and the masses
    rho V/(d + 1).  The norm of the matrix bounds its eigenvalues, symmetric or not,

        omega^4 <= ((d + 1)/rho)^2 A_iJkL A_iMkN H_JM H_LN,    H = sum over a of g_a (x) g_a.

    It counts the present stiffness and the shape at once: A with reference gradients is the spatial
    tangent with those of the deformed cell, whose lengths are one over its altitudes.  Of a bar,
    A = rho c^2 and H = 2/h^2, it is the condition dt <= h/c of Courant, Friedrichs and Lewy.

    Springs and obstacles add, at each node, the sum of a row of their matrix over the node's mass;
    it is shared among the cells as the mass is.

    Source: B. M. Irons and G. Treharne, A bound theorem in eigenvalues and its practical
    applications, Proc. 3rd Conf. Matrix Methods in Structural Mechanics, Wright-Patterson (1971);
    D. P. Flanagan and T. Belytschko, J. Appl. Mech. 51 (1984) 35; R. Courant, K. Friedrichs and H.
    Lewy, Math. Ann. 100 (1928) 32.

    Args:
        problem: Whose cells; see `fits`.
        assembler: Of this problem.
        mass: Lumped mass at every owned entry [kg].
    """

    def __init__(self, problem: Problem, assembler: Assembler, mass: Floats) -> None:
        self._problem = problem
        mesh = problem.body.mesh
        middle = np.full((1, problem.body.dim), 1 / (problem.body.dim + 1))
        self._norms = [
            (part.cells, compile_expression(mesh.comm, self._norm(part), middle, problem.jit))
            for part in problem.parts
        ]
        self._held = self._holding(assembler, mass)

    @staticmethod
    def fits(problem: Problem) -> bool:
        """One tangent serves a cell, and no load adds to it.

        In a body of revolution the tangent changes inside a cell, also in a curved one.
        """
        follows = any(
            load.follows and not (load.linearises and problem.site.linear) for load in problem.loads
        )
        straight = int(problem.body.mesh.geometry.cmap.degree) == 1
        return straight and problem.geometry == "plane-strain" and not follows

    def _norm(self, part: Part) -> Expr:
        """The bound in cells of a part [1/s^2] (UFL)."""
        problem, d = self._problem, self._problem.body.dim
        F = ufl.variable(problem.F(problem.w))
        P = problem.response(part, problem.w).stress(F)
        A = ufl.diff(P, F)
        if d == 2:
            ways = range(2)
            A = ufl.as_tensor(
                [[[[A[i, j, k, m] for m in ways] for k in ways] for j in ways] for i in ways]
            )
        K = ufl.JacobianInverse(problem.body.mesh)
        H = ufl.dot(K.T, ufl.dot(ufl.Identity(d) + _ones(d), K))
        i, j, k, m, n, o = ufl.indices(6)
        left = ufl.as_tensor(A[i, n, k, m] * H[n, j], (i, j, k, m))
        right = ufl.as_tensor(A[i, j, k, o] * H[o, m], (i, j, k, m))
        square = left[i, j, k, m] * right[i, j, k, m]
        return (d + 1) / problem.site.density(part) * ufl.sqrt(square)

    def _holding(self, assembler: Assembler, mass: Floats) -> Floats:
        """What springs and obstacles add in each owned cell [1/s^2]. Collective."""
        problem = self._problem
        forms = [spring.bound(problem.site) for spring in problem.springs]
        forms += [touch.bound for touch in problem.touching]
        cells = problem.body.owned_cells()
        if not forms:
            return np.zeros(len(cells))
        stiff = fem.Function(problem.V)
        for form in compiled(problem, forms):
            stiff.x.array[: assembler.size] += assembler.nodal(form)
        stiff.x.array[: assembler.size] /= mass
        stiff.x.scatter_forward()
        nodes = stiff.x.array.reshape(-1, problem.body.dim).max(axis=1)
        return np.asarray(nodes[problem.V.dofmap.list[cells]].max(axis=1))

    def now(self) -> Floats:
        """The bound in each owned cell at the present displacement [1/s^2]. Not collective."""
        rates = self._held.copy()
        for cells, norm in self._norms:
            if len(cells):
                rates[cells] += norm.eval(self._problem.body.mesh, cells)[:, 0]
        return rates

    def place(self, rates: Floats) -> tuple[float, ...]:
        """Reference midpoint of the cell with the largest rate [m]. Collective."""
        mesh = self._problem.body.mesh
        mine: tuple[float, tuple[float, ...]] = (-np.inf, ())
        if len(rates):
            row = int(np.argmax(rates))
            middle = mesh.geometry.x[mesh.geometry.dofmap[row]].mean(axis=0)
            mine = float(rates[row]), tuple(map(float, middle[: self._problem.body.dim]))
        return max(mesh.comm.allgather(mine), key=lambda pair: pair[0])[1]


def _ones(d: int) -> Expr:
    return ufl.as_matrix([[1.0] * d] * d)


def extremes(comm: MPI.Comm, values: Sequence[float]) -> list[float]:
    """The largest of each number over all ranks. Collective."""
    found = np.array(values, dtype=np.float64)
    comm.Allreduce(MPI.IN_PLACE, found, op=MPI.MAX)
    return [float(value) for value in found]
