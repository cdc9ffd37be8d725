"""A bound of the highest frequency, from the present tangent and shape of each cell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import ufl
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfin_elastic.core.parallel import largest_row
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.kinematics import variables
from dolfin_elastic.problem.material_regions import MaterialRegion
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.term_list import forms_of
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled


class FrequencyBound:
    """A bound of omega^2 at each node: none of the body's is above the largest of them.

    A linear cell of volume V in d dimensions has the stiffness V g_aJ A_iJkL g_bL, with the
    gradients g_a of its shape functions and the tangent A = dP/dF.  The norm of the matrix,

        kappa = V sqrt(A_iJkL A_iMkN H_JM H_LN),    H = sum over a of g_a (x) g_a,

    bounds its eigenvalues, so x.Kx is at most the sum over cells of kappa times that over their
    nodes of |x_a|^2, and omega^2 at most the largest sum, over the cells around a node, of kappa
    over the node's mass: the mean, by mass, of the eigenvalues' bounds of the cells around it.

    That is the condition of Courant, Friedrichs and Lewy: |g_a| is one over the cell's altitude, A
    is rho c^2 with the speed c of waves, and A with reference gradients is the spatial tangent with
    those of the deformed cell.  Of a bar in cells of length h, A = rho c^2 and H = 2/h^2, it is
    dt <= h/c.

    Springs and obstacles add at each node the sum of its row of their matrix over its mass.

    Source: R. Courant, K. Friedrichs and H. Lewy, Math. Ann. 100 (1928) 32; eigenvalues of cells
    bound those of the body: B. M. Irons and G. Treharne, Proc. 3rd Conf. Matrix Methods in
    Structural Mechanics, Wright-Patterson (1971); D. P. Flanagan and T. Belytschko, J. Appl. Mech.
    51 (1984) 35.

    Args:
        problem: Whose cells; see `applies`.
        mass: Lumped mass at every owned entry [kg].
    """

    def __init__(self, problem: Problem, assembler: Assembler, mass: FloatArray) -> None:
        self._problem, self._assembler, self._dim = problem, assembler, problem.body.dim
        self._mass = mass[:: self._dim].copy()
        d = self._dim
        stiff = sum(
            (d + 1) * self._norm(part) * problem.v[0] * problem.weak_form.volume(part, 1)
            for part in problem.regions
        )
        self._form = compiled(problem, [stiff])[0]
        bounds = forms_of(problem.terms, "bound")
        self._penalty_rows = rows_over_mass(assembler, bounds, mass)[::d]

    @staticmethod
    def applies(problem: Problem) -> bool:
        """Whether the tangent is constant in each cell, and no follower load adds to it.

        In bodies of revolution and in curved cells it is not constant.
        """
        follows = any(
            load.follower and not (load.linearises and problem.context.linear)
            for load in problem.loads
        )
        straight = int(problem.body.mesh.geometry.cmap.degree) == 1
        return straight and problem.geometry == "plane-strain" and not follows

    def _norm(self, part: MaterialRegion) -> Expr:
        """kappa/V in cells of a part [N/m^4] (UFL)."""
        problem, d = self._problem, self._dim
        gradient, F = variables(problem.weak_form.F(problem.w))
        P = problem.weak_form.response(part, problem.w).stress(F)
        A = ufl.diff(P, gradient)
        if d == 2:
            axes = range(2)
            A = ufl.as_tensor(
                [[[[A[i, j, k, m] for m in axes] for k in axes] for j in axes] for i in axes]
            )
        K = ufl.JacobianInverse(problem.body.mesh)
        ones = ufl.as_matrix([[1.0] * d] * d)  # gradients (-1, ..., -1) and the unit vectors
        H = ufl.dot(K.T, ufl.dot(ufl.Identity(d) + ones, K))
        i, j, k, m, n, o = ufl.indices(6)
        left = ufl.as_tensor(A[i, n, k, m] * H[n, j], (i, j, k, m))
        right = ufl.as_tensor(A[i, j, k, o] * H[o, m], (i, j, k, m))
        return ufl.sqrt(left[i, j, k, m] * right[i, j, k, m])

    def evaluate(self) -> FloatArray:
        """Bound of omega^2 at each owned node, at the present displacement [1/s^2]. Collective."""
        return (
            self._penalty_rows
            + self._assembler.reactions.nodal(self._form)[:: self._dim] / self._mass
        )

    def location(self, rates: FloatArray) -> tuple[float, ...]:
        """Undeformed position of the node with the largest bound [m]. Collective.

        Args:
            rates: From `evaluate` [1/s^2].
        """
        coordinates = self._problem.places[:, : self._dim]
        row = largest_row(self._problem.body.comm, rates, lambda rows: coordinates[rows])
        return () if row is None else row.place


def rows_over_mass(
    assembler: Assembler, bounds: Sequence[ufl.Form], mass: FloatArray
) -> FloatArray:
    """Bounds of the row sums of a matrix over the mass, at owned entries [1/s^2]. Collective.

    Args:
        bounds: Forms whose nodal values are these bounds.
        mass: Lumped mass at every owned entry [kg].
    """
    result = np.zeros(len(mass))
    for form in compiled(assembler.problem, bounds) if bounds else []:
        result += assembler.reactions.nodal(form) / mass
    return result


def extremes(comm: MPI.Comm, values: Sequence[float]) -> list[float]:
    """The largest of each number over all ranks. Collective.

    Args:
        comm: Of all ranks.
        values: Of this rank.
    """
    result = np.array(values, dtype=np.float64)
    comm.Allreduce(MPI.IN_PLACE, result, op=MPI.MAX)
    return [float(value) for value in result]
