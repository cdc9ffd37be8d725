"""Estimate of the memory that a solution needs.

Measured on a cube and a square of neo-Hookean material in one load step, on one rank, with PETSc
3.22: what a process grows by, per unknown, from before the solver is made to its peak.

| | unknowns | kB each |
|---|---|---|
| direct, 3D, linear | 6591, 17496, 46875 | 7.0, 7.0, 9.0 |
| direct, 3D, quadratic | 3993, 14739, 36501 | 8.3, 9.0, 11.2 |
| direct, 2D, linear | 7442, 45602 | 2.4, 1.7 |
| direct, 2D, quadratic | 13122, 65522 | 2.4, 2.1 |
| iterative, 3D, linear | 17496, 59049 | 2.4, 2.1 |
| iterative, 3D, quadratic | 14739, 46875 | 4.0, 3.2 |
| iterative, 2D, linear | 45602 | 1.1 |

Factors of n unknowns grow with n^(4/3) in 3D and with n log n in a plane: R. J. Lipton, D. J. Rose
and R. E. Tarjan, SIAM J. Numer. Anal. 16 (1979) 346.  The constants below are fitted to the table,
which they meet within 25 %.  Slender bodies need less.  A tangent that is not symmetric has factors
of twice the size; with those of its symmetric part it needs as much as a symmetric one (9.2 and 9.1
kB for 14739 quadratic and 46875 linear unknowns).  Where a pressure is solved for too, nothing has
been measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.files.memory import check_memory
from dolfin_elastic.mesh.distribute import BYTES
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.linear.choice import Choice

BASE = 0.14e9
"""A process with all libraries and a small mesh [byte]."""

CHECKED = {(2, 1): 900, (2, 2): 1700, (3, 1): 1300, (3, 2): 3700}
"""Memory per element of a check [byte], the mesh included, by dimension and degree.

Measured as the growth of resident memory up to its peak, of 2.8e5 to 3.8e5 elements on one rank:

| load | body force | gravity | pressure |
|---|---|---|---|
| cube, linear | 1173 | 1058 | 636 |
| cube, quadratic | 3665 | 3205 | 1304 |
| row of cubes, linear | 1266 | 1160 | 855 |
| row of cubes, quadratic | | 3559 | 1588 |

On two ranks together it is the same within 3 %.  Of a row of cubes with springs on all its sides it
is 2184 and 6232: nobody computes such a body, so this does not count.  The solution needs more.
"""


def check_elements(
    comm: MPI.Comm, number: float, dim: int, degree: int, *, made: bool = False
) -> None:
    """Refuses a mesh whose check does not fit into the memory. Collective.

    Args:
        comm: The ranks that share the mesh.
        number: Of elements, on all ranks.
        dim: 2 or 3.
        made: The mesh has been made, and its memory is no longer free.

    Raises:
        MeshError: It does not fit, on every rank.
    """
    each = CHECKED[dim, degree] - (BYTES[dim] if made else 0)
    advice = "fewer elements" if degree == 1 else "fewer elements, mesh.degree = 1"
    check_memory(comm, number, each, where="", expected=advice)


@dataclass(frozen=True)
class Memory:
    """An estimate, see the module.

    Attributes:
        total: Of all ranks together [byte].
        solver: "direct", "iterative" or "explicit".
    """

    total: float
    solver: str


def memory(problem: Problem, choice: Choice | None) -> Memory:
    """Estimates the memory of a solution. Not collective.

    Args:
        choice: The linear solver; None: an explicit scheme.
    """
    solver = "explicit" if choice is None else "direct" if choice.direct else "iterative"
    each = per_unknown(
        problem.num_dofs,
        problem.body.dim,
        problem.degree,
        direct=solver == "direct",
        symmetric=choice is None or choice.options.get("pc_type") != "lu",
    )
    return Memory(BASE * problem.body.comm.size + each * problem.num_dofs, solver)


def per_unknown(n: int, dim: int, degree: int, *, direct: bool, symmetric: bool = True) -> float:
    """Bytes per unknown of the matrix and of its factors or multigrid hierarchy.

    Args:
        n: Number of unknowns on all ranks.
        dim: 2 or 3.
        symmetric: Its factors are those of a symmetric matrix.
    """
    matrix = {(2, 1): 1.1e3, (2, 2): 1.5e3, (3, 1): 2.1e3, (3, 2): 3.3e3}[dim, degree]
    if not direct:
        return matrix
    in_space = {1: 190.0, 2: 230.0}[degree] * n ** (1 / 3)
    factors = in_space if dim == 3 else 60.0 * float(np.log2(n + 1))
    return matrix + factors * (1 if symmetric else 2)
