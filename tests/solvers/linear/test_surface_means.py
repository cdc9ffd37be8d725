"""Multigrid where contact is stiff: iterations that do not grow with the penalty."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from petsc4py import PETSc

from dolfin_elastic import Contact, LinearElastic, Problem, Support, box_body
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.linear.hierarchy import Multigrid

FREE = "free"
SIDES = [Support(on="left", displacement=[0, FREE, FREE])]
SHAPES: dict[str, dict[str, Any]] = {
    "plane": {"plane": {"axis": "z", "at": 0}},
    "sphere": {"sphere": {"center": [0.4, 0.6, -2.0], "radius": 2.0}},
}


def block(shape: str, share: float, *, friction: float = 0.0, stiffer: float = 1.0) -> Problem:
    """A block of quadratic elements, a share of whose bottom is pressed on an obstacle.

    Collective.

    Args:
        stiffer: Penalty over that by default.
    """
    row = {"on": "bottom", "friction": friction, **SHAPES[shape]}
    problem = Problem(
        box_body(size=(1, 1, 1), cells=(4, 4, 4)),
        LinearElastic(E=1e6, nu=0.3),
        degree=2,
        supports=[Support(on="top"), *SIDES],
        contacts=[Contact.model_validate(row)],
    )
    pair = problem.contact_pairs[0]
    problem.terms.begin(moving=False)
    pair.eps *= stiffer
    X = pair.places()
    pressed = np.hypot(X[:, 0] - 0.4, X[:, 1] - 0.6) <= share
    pushed = 1e3 + pair.eps * pair.pressing_gaps()
    pair.lam.x.array[pair.nodes] = np.where(pressed, pushed, -1e12)
    pair.lam.x.scatter_forward()
    # Faces are curbed by the pressure, which multipliers have in equilibrium.
    pressures = np.where(pressed, 1e3, 0.0)
    pair.values = lambda: pressures
    return problem


def solved(problem: Problem, kind: str) -> tuple[int, float]:
    """Iterations to 1e-10, and how far the solution is from that of factors, over its norm."""
    assembler = Assembler(problem, iterated=kind == "cg")
    x, b, exact = (assembler.create_vector() for _ in range(3))
    assembler.tangent.assemble(x)
    b.array_w[:] = np.sin(1 + np.arange(*b.getOwnershipRange()) ** 1.3)
    b.array_w[assembler.prescribed_dofs] = 0.0
    ksp = PETSc.KSP().create(assembler.comm)
    ksp.setType(kind)
    ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
    if kind == "gmres":
        ksp.setPCSide(PETSc.PC.Side.RIGHT)
        ksp.setGMRESRestart(200)
    ksp.setTolerances(rtol=1e-10, max_it=200)
    ksp.setOperators(assembler.tangent.matrix)
    multigrid = Multigrid(problem, ksp.getPC(), blocks=assembler.tangent.blocks)
    ksp.solve(b, x)
    assert ksp.getConvergedReason() > 0  # conjugate gradients: also that the cycle is definite
    with assembler.tangent.entries() as matrix:
        factors = PETSc.KSP().create(assembler.comm)
        factors.setType("preonly")
        factors.getPC().setType("lu")
        factors.getPC().setFactorSolverType("mumps")
        factors.setOperators(matrix)
        factors.solve(b, exact)
        factors.destroy()
    size = exact.norm()
    exact.axpy(-1.0, x)
    result = ksp.getIterationNumber(), float(exact.norm() / size)
    ksp.destroy()
    multigrid.destroy()
    for vector in (x, b, exact):
        vector.destroy()
    assembler.destroy()
    return result


@pytest.mark.parametrize("shape", SHAPES)
def test_iterations_do_not_grow_with_the_penalty(shape):
    """A fifth and all of a surface, penalties up to a hundred times that by default.

    25 without contact, 27 with it, 28 with the penalty by default, of which nodes are smoothed by
    themselves; where the normals turn by 1/8 over an element and the penalty is stiff, 39.  Nodes
    by themselves take 142 to 160.
    """
    without = solved(block(shape, -1.0), "cg")[0]
    for share, stiffer in ((0.2, 1.0), (0.2, 100.0), (2.0, 100.0)):
        iterations, off = solved(block(shape, share, stiffer=stiffer), "cg")
        turns = shape == "sphere" and share > 1.0
        assert iterations <= (1.7 if turns else 1.2) * without
        assert off < 1e-8


def test_a_surface_that_sticks():
    """Friction: the penalty along the surface is as stiff, and GMRES needs as few; 24 and 33."""
    without = solved(block("sphere", -1.0, friction=0.5), "gmres")[0]
    iterations, off = solved(block("sphere", 2.0, friction=0.5, stiffer=100.0), "gmres")
    assert iterations <= 1.5 * without
    assert off < 1e-8
