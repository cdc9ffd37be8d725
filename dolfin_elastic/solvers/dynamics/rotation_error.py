"""Strain error at the ends of steps in which a body rotates.

Forces of a stage between the ends of a step are those of the mean displacement,
u_s = (1 - a) u1 + a u0.  With C = F^T F and the change D = F1 - F0,

    C(u_s) = (1 - a) C1 + a C0 - a (1 - a) D^T D.

Points of a body that rotates move along arcs; the mean of two positions lies on the chord, so the
body of the mean displacement is smaller than the body.  The scheme makes the stress of the stage
the right one, so at the ends of the step the body is too large: by a strain of a (1 - a)/2 w^2 h^2
where it rotates by the angle w h.  That is of second order in the step h, but of a stiff body it is
soon more than its strains.

Source: J. C. Simo & N. Tarnow, ZAMP 43 (1992) 757, section 4.
"""

from __future__ import annotations

import basix
import numpy as np
import ufl
from dolfinx import fem

from dolfin_elastic.core.jit import compile_expression
from dolfin_elastic.core.parallel import largest
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.kinematics import green_strain
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.audit.violations import Violation

SHARE = 0.06
"""Error over the largest strain so far up to which it is let pass.

The largest strain is that of the extremes of the motion; over the mean strain the error is about
twice as much."""

GROWTH = 2.0
"""Growth of the largest strain from one state to the next above which the error is no verdict."""


class RotationError:
    """Compares the strain error of rotations with the strains.  Collective to make.

    Args:
        alpha_f: Share of the old displacement in that of the stage.
    """

    def __init__(self, problem: Problem, alpha_f: float) -> None:
        self._problem, self._largest_strain, self._exceeded = problem, 0.0, False
        self._share = alpha_f * (1 - alpha_f) / 2
        nonlinear = any(not part.law.linear for part in problem.regions)
        self._needed = self._share > 0.0 and nonlinear
        if not self._needed:
            return
        mesh = problem.body.mesh
        kind = getattr(basix.CellType, mesh.topology.cell_name())
        points, _ = basix.make_quadrature(kind, 1)
        self._change = fem.Function(problem.V)
        D, F = ufl.grad(self._change), problem.weak_form.F(problem.w)
        change, strain = D.T * D, green_strain(F)
        squares = ufl.as_vector([ufl.inner(change, change), ufl.inner(strain, strain)])
        self._expression = compile_expression(mesh.comm, squares, points, problem.jit)
        self._cells = problem.body.owned_cells()

    def violation(self, du: FloatArray) -> Violation | None:
        """The warning, if the error is too large in this state and in the one before. Collective.

        Args:
            du: Change of the displacement in the last step, owned entries [m].
        """
        if not self._needed:
            return None
        self._change.x.array[: len(du)] = du
        self._change.x.scatter_forward()
        values = self._expression.eval(self._problem.body.mesh, self._cells).reshape(-1, 2)
        squares = np.nan_to_num(values).max(axis=0, initial=0.0)
        turn, strain = (largest(self._problem.body.comm, float(s)) ** 0.5 for s in squares)
        settled = strain <= GROWTH * self._largest_strain
        self._largest_strain = max(self._largest_strain, strain)
        error = self._share * turn
        before, self._exceeded = self._exceeded, settled and error > SHARE * self._largest_strain
        if not (before and self._exceeded):
            return None
        angle, share = np.degrees(np.sqrt(turn / np.sqrt(2))), 100 * error / self._largest_strain
        return Violation(
            f"the body rotates by {angle:.2g} degrees a step, with a strain error of {error:.2g} "
            f"at the ends of steps, {share:.2g} % of its largest strain: "
            "stresses and reactions are off by as much and more; a smaller dt, or scheme = "
            "'energy-momentum', whose stress follows the rotation",
            share,
        )

    # --- restarts ---

    def restart_state(self) -> list[float]:
        """See `Restartable`. Not collective."""
        return [self._largest_strain, float(self._exceeded)]

    def restore(self, saved: list[float]) -> None:
        """See `Restartable`. Not collective."""
        self._largest_strain, self._exceeded = float(saved[0]), bool(saved[1])
