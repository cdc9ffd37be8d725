"""Incompressible bodies: how many motions the constraint removes, and an undetermined pressure."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.parallel import largest, smallest, total
from dolfin_elastic.core.types import IntArray
from dolfin_elastic.problem.incompressible import is_incompressible, partly_incompressible
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.linear.nullspace import times

SMALL = 1e-10
"""Force of a uniform pressure on what is free, over that of an uneven one, that is round-off."""


def constrain(assembler: Assembler) -> int:
    """How many motions of its displacements a body does not have, for it is incompressible.

    Each pressure that stands in none of its own rows takes one away.  Of a body whose whole surface
    is held only differences of pressures matter: then one of them is put to zero in the tangent,
    which else would be singular, with a negative pivot as the others have. Collective.

    Args:
        assembler: With the tangent, which is changed.
    """
    problem = assembler.problem
    if not partly_incompressible(problem):
        return 0
    comm, matrix = problem.body.comm, assembler.tangent.matrix
    pressures = np.setdiff1d(np.arange(assembler.size), assembler.displacement_dofs)
    enclosed = _is_null(assembler, pressures)
    if problem.unknowns.stabilised:  # its own rows know all but the mean
        count = int(all(is_incompressible(region.compliance) for region in problem.regions))
    else:
        diagonal = matrix.getDiagonal()
        count = total(comm, int(np.sum(diagonal.array_r[pressures] == 0.0)))
        diagonal.destroy()
    if enclosed:
        _pin(matrix, pressures)
        count -= 1
    return count


def _is_null(assembler: Assembler, pressures: IntArray) -> bool:
    """Whether a uniform pressure exerts no force on free dofs. Collective."""
    columns = np.zeros((assembler.size, 2))
    columns[pressures, 0] = 1.0
    columns[pressures, 1] = np.arange(len(pressures)) % 2
    images = times(assembler.tangent.matrix, columns)
    even, uneven = (
        largest(assembler.comm, float(np.max(np.abs(image), initial=0.0))) for image in images.T
    )
    return even <= SMALL * uneven


def _pin(matrix: PETSc.Mat, pressures: IntArray) -> None:
    """Puts the first pressure to zero. Collective."""
    comm, start = matrix.comm.tompi4py(), matrix.getOwnershipRange()[0]
    mine = float(comm.rank) if len(pressures) else np.inf
    first = smallest(comm, mine) == mine and len(pressures) > 0
    row = np.array(pressures[:1] + start if first else [], dtype=PETSc.IntType)
    size = float(matrix.norm(PETSc.NormType.INFINITY))
    matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
    matrix.zeroRowsColumns(row, diag=-size)
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
