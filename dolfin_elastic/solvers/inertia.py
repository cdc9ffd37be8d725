"""What the factorised tangent says of stability, and a push along the mode that resists least."""

from __future__ import annotations

from petsc4py import PETSc

from dolfin_elastic.solvers.newton import Newton
from dolfin_elastic.solvers.stability import uneven

NEGATIVE_PIVOTS = 12
"""Index of their number in MUMPS's INFOG."""

ITERATIONS = 5
"""Of the inverse iteration: enough for a mode that stands out."""

PUSH = 0.01
"""Size of a push over that of a cell."""


def negative_eigenvalues(newton: Newton) -> int | None:
    """Negative eigenvalues of the last tangent that a stable body has not. Collective.

    As many as negative pivots of its factorisation (Sylvester's law of inertia), less those of the
    pressures, which belong to a saddle point, and with those that scalar unknowns add.

    Returns:
        Their number; None where no symmetric factorisation is at hand.
    """
    if not (newton.direct and newton.assembler.problem.symmetric and newton.progress.newton):
        return None
    pc = newton.ksp.getPC()
    if pc.getType() != "cholesky" or "pc_factor_mat_solver_type" in newton.options.users:
        return None
    below = pc.getFactorMatrix().getMumpsInfog(NEGATIVE_PIVOTS)
    scalars = 0 if newton.bordered is None else newton.bordered.negative()
    return int(below) - newton.assembler.pressures + scalars


def disturb(newton: Newton) -> None:
    """Pushes the body a little along the mode that resists least. Collective.

    The mode is found by inverse iteration with the last tangent.
    """
    assembler = newton.assembler
    x, b = assembler.create_vector(), assembler.create_vector()
    moves, w = assembler.moves, assembler.problem.w.x
    b.array_w[moves] = uneven(assembler)
    for _ in range(ITERATIONS):
        assembler.hold(b)
        newton.ksp.solve(b, x)
        x.scale(1.0 / max(float(x.norm(PETSc.NormType.INFINITY)), 1e-300))
        x.copy(b)
    w.array[moves] += PUSH * newton.cell_size * x.array_r[moves]
    w.scatter_forward()
    assembler.problem.unknowns.tell()
    x.destroy()
    b.destroy()
