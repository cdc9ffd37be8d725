"""Whether a step stayed on its path or has jumped to an equilibrium of another one.

Where the load grows little by little, the energy that a body takes up lies between what the nodal
forces before and after the step would have done over it.  A body that has passed an energy barrier
within the step breaks this: the forces before and after may be alike, and yet the energy is not.
"""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import cell_size
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.assembly.energy_momentum import Strain

SLACK = 0.02
"""Share of the energy of a step by which it may miss the bounds."""

SMALL = 2e-3
"""Share of all stored energy by which it may miss them, too: where nodes come into contact one
after the other, the energy of a discrete body goes up and down a little."""


class PathEnergyCheck:
    """Compares the energy of steps with the work of the internal forces over them.

    Args:
        assembler: Of a problem at rest.

    Attributes:
        strain: Measures the stored energy.
    """

    def __init__(self, assembler: Assembler) -> None:
        self._assembler = assembler
        self.strain = Strain(assembler.problem)
        self._before: tuple[float, FloatArray, FloatArray] | None = None
        self._now: tuple[float, FloatArray, FloatArray] | None = None

    def evaluate(self) -> None:
        """Evaluates energy and forces of the present equilibrium. Collective.

        Its nodal forces are assembled already, in `Assembler.residual`.
        """
        a = self._assembler
        forces = a.residual.owned + a.reactions.loads() + a.reactions.restraints()
        forces, moved = forces[a.displacement_dofs], a.problem.w.x.array[a.displacement_dofs].copy()
        if a.cell is not None:
            whole = a.cell.work()
            if a.comm.rank == 0:
                forces, moved = np.append(forces, whole[0]), np.append(moved, whole[1])
        self._now = self.strain.energy(), forces, moved

    def finite(self) -> bool:
        """Whether the energy evaluated last is finite, if there is one."""
        return self.strain.none or self._now is None or bool(np.isfinite(self._now[0]))

    def accept(self) -> None:
        """Begins the next step at the state evaluated last."""
        self._before = self._now

    def jumped(self, residual: float) -> bool:
        """Whether the step took up another energy than its path would have given. Collective.

        Along a path on which forces grow steadily, the energy taken up lies between the work of
        the forces before and that of the forces after the step over the whole displacement.  The
        bounds are widened by round-off and by the residual that is left, which does work, too.

        Args:
            residual: Norm of the free residual that Newton's method may leave [N].
        """
        problem = self._assembler.problem
        if self.strain.none or problem.eigenstrains or problem.unknowns.stabilised:
            return False  # what is stored is not what the forces have done
        if self._before is None or self._now is None:
            return False
        (was, f, u), (now, g, v) = self._before, self._now
        du = v - u
        sums = np.array([np.dot(f, du), np.dot(g, du), np.dot(du, du)])
        before, after, square = total(self._assembler.comm, sums)
        gained = now - was
        slack = SLACK * max(abs(gained), abs(before), abs(after))
        slack += SMALL * max(abs(was), abs(now)) + 2 * residual * np.sqrt(square)
        slack += round_off(self._assembler)[1]
        return bool(abs(gained - (before + after) / 2) > abs(after - before) / 2 + slack)


def round_off(assembler: Assembler) -> tuple[float, float]:
    """Size of the round-off of all nodal forces [N] and of the stored energy [J]. Collective.

    The stress is known to machine precision of the stiffness, because F = I + grad u is.
    """
    diagonal = assembler.tangent.matrix.getDiagonal()
    stiff, sum_of_all = float(diagonal.norm()), float(diagonal.norm(0))
    diagonal.destroy()
    small, h = 40 * np.finfo(float).eps, cell_size(assembler.problem.body)
    return small * stiff * h, small * sum_of_all * h**2
