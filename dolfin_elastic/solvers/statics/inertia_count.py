"""What the factorised tangent says of stability, and a push along the mode that resists least."""

from __future__ import annotations

from petsc4py import PETSc

from dolfin_elastic.solvers.diagnostics.stability import uneven
from dolfin_elastic.solvers.nonlinear.newton import Newton

NEGATIVE_PIVOTS = 12
"""Index of their number in MUMPS's INFOG."""

ITERATIONS = 5
"""Of the inverse iteration: enough for a mode that stands out."""

HALVINGS = 20
"""Of a push that turns a cell inside out."""


def negative_eigenvalues(newton: Newton) -> int | None:
    """Negative eigenvalues of the last tangent that a stable body has not. Collective.

    As many as negative pivots of its factorisation (Sylvester's law of inertia), less those of the
    pressures, which belong to a saddle point, and with those that scalar unknowns add.

    Returns:
        Their number; None where no symmetric factorisation is at hand.
    """
    if not (newton.linear.direct and newton.assembler.problem.symmetric):
        return None
    pc = newton.ksp.getPC()
    if pc.getType() != "cholesky":
        return None
    if pc.getFactorSolverType() != "mumps":
        return None
    if newton.shift > 0.0 or not (newton.result.newton or newton.factorised):
        newton.factorise()
    below = pc.getFactorMatrix().getMumpsInfog(NEGATIVE_PIVOTS)
    scalars = 0 if newton.bordered is None else newton.bordered.negative()
    return int(below) - newton.assembler.pressures + scalars


def disturb(newton: Newton, size: float) -> None:
    """Pushes the body along the mode that resists least. Collective.

    The mode is found by inverse iteration with the last tangent.

    Args:
        newton: The solver; its problem is where the push begins.
        size: Largest displacement of the push [m]; less where a cell would turn inside out.
    """
    assembler = newton.assembler
    x, b = assembler.create_vector(), assembler.create_vector()
    moves = assembler.displacement_dofs
    b.array_w[moves] = uneven(assembler)
    for _ in range(ITERATIONS):
        assembler.remove_constrained(b)
        newton.ksp.solve(b, x)
        x.scale(1.0 / max(float(x.norm(PETSc.NormType.INFINITY)), 1e-300))
        x.copy(b)
    mode = x.array_r[moves].copy()
    x.destroy()
    b.destroy()
    w, guard = assembler.problem.w.x, newton.guard
    start = w.array[moves].copy()
    for halving in range(HALVINGS):
        w.array[moves] = start + size / 2**halving * mode
        w.scatter_forward()
        assembler.problem.unknowns.w_to_u()
        if guard is None or guard.watch.smallest()[0] > 0.0:
            break
