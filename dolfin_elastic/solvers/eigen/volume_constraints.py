"""Incompressible bodies: how many motions the constraint removes."""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.parallel import total
from dolfin_elastic.problem.incompressible import partly_incompressible
from dolfin_elastic.solvers.assembly.assembler import Assembler


def constrained_motions(assembler: Assembler) -> int:
    """How many motions of its displacements a body does not have, for it is incompressible.

    Each pressure that stands in none of its own rows takes one away; one that is fixed, because
    the body is held all around, stands in its own. Collective.
    """
    problem = assembler.problem
    if not partly_incompressible(problem):
        return 0
    if problem.unknowns.stabilised:  # their own rows know all but the mean
        whole = all(region.incompressible for region in problem.regions)
        known = 0 if assembler.level is None else len(assembler.level.bodies)
        return 1 - known if whole else 0
    pressures = np.setdiff1d(np.arange(assembler.size), assembler.displacement_dofs)
    diagonal = assembler.tangent.matrix.getDiagonal()
    count = total(problem.body.comm, int(np.sum(diagonal.array_r[pressures] == 0.0)))
    diagonal.destroy()
    return count
