"""Displacement and pressure apart: what stands for the stiffness of the body."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic import Contact, NeoHookean, Problem, Statics, Support, box_body
from dolfin_elastic.core.petsc_options import PREFIX
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.linear.choice import LinearSettings, choose
from dolfin_elastic.solvers.linear.ksp import LinearSolver
from dolfin_elastic.solvers.linear.schur import SOFTER, SofterVolume, _compliances
from dolfin_elastic.solvers.petsc.options import Options


@pytest.mark.parametrize(("nu", "degree"), [(0.49, 2), (0.4999, 2), (0.4999, 1)])
def test_a_softer_volume_is_softer(nu, degree):
    """x . (K + B^T W^-1 B) x lies between x . K x and x . (K + B^T C^-1 B) x, for any x.

    So a body whose softer tangent is positive definite is stable.  C^-1 by a solve; with linear
    elements C holds the stabilisation, too.
    """
    problem = Problem(
        box_body(size=(2.0, 1.0, 1.0), cells=(4, 2, 2)),
        NeoHookean(E=1e6, nu=nu),
        degree=degree,
        formulation="mixed",
        supports=[Support(on="left")],
    )
    problem.u.interpolate(lambda x: 0.1 * np.array([x[0] * x[1], x[0] ** 2, x[2]]))
    problem.unknowns.u_to_w()
    assembler = Assembler(problem)
    x = assembler.create_vector()
    assembler.get(x)
    assembler.tangent.assemble(x)
    A, softer = assembler.tangent.matrix, SofterVolume(assembler)
    moves = softer.moves
    pressures = np.setdiff1d(np.arange(assembler.size), moves)
    W = -_compliances(problem, 1.0 if degree == 1 else 1.0 / SOFTER[0])[pressures]
    start = A.getOwnershipRange()[0]
    comm = assembler.comm
    rows = PETSc.IS().createGeneral((pressures + start).astype(PETSc.IntType), comm)
    C = A.createSubMatrix(rows, rows)
    C.scale(-1.0)
    ksp = PETSc.KSP().create(comm)
    ksp.setOperators(C)
    ksp.setType("cg")
    ksp.getPC().setType("jacobi")
    ksp.setTolerances(rtol=1e-13)
    v, Av = A.createVecs()
    strains, p = C.createVecs()
    generator = np.random.default_rng(comm.rank)
    for _ in range(3):
        v.set(0.0)
        v.array_w[moves] = generator.normal(size=len(moves))
        assembler.remove_constrained(v)
        A.mult(v, Av)
        plain = v.dot(Av)
        strains.array_w[:] = Av.array_r[pressures]
        ksp.solve(strains, p)
        stiff = plain + strains.dot(p)
        forces = softer.eliminate(Av.array_r)
        middle = comm.allreduce(float(v.array_r[moves] @ forces), op=MPI.SUM)
        squares = float(np.sum(np.square(strains.array_r) / W))
        expected = plain + comm.allreduce(squares, op=MPI.SUM)
        assert middle == pytest.approx(expected, rel=1e-10)
        assert plain < middle < stiff
    for thing in (softer, C, ksp, rows, v, Av, strains, p, x):
        thing.destroy()
    assembler.destroy()


def test_its_solve_leaves_the_preconditioner_as_it_was():
    """Conjugate gradients borrow the displacement's multigrid: iterations stay the same."""
    comm = MPI.COMM_WORLD
    problem = Problem(
        box_body(size=(2.0, 1.0, 1.0), cells=(4, 2, 2)),
        NeoHookean(E=1e6, nu=0.5),
        degree=2,
        formulation="mixed",
        supports=[Support(on="left")],
    )
    assembler = Assembler(problem)
    options = Options(choose(problem, LinearSettings(method="iterative")).options, {})
    snes = PETSc.SNES().create(assembler.comm)
    snes.setOptionsPrefix(PREFIX)
    linear = LinearSolver(assembler, options, snes.ksp, snes)
    x, b = assembler.create_vector(), assembler.create_vector()
    with options.in_force():
        snes.setFromOptions()
        linear.set_up()
        assembler.tangent.assemble(x)
        linear.take(assembler.tangent.matrix)
        b.set(1.0)
        assembler.remove_constrained(b)
        counts = []
        for _ in range(2):
            linear.ksp.solve(b, x)
            counts.append(linear.ksp.getIterationNumber())
            assert linear.split is not None
            forces = b.array_r[np.sort(assembler.displacement_dofs)]
            moved = linear.split.precondition(forces)
            # A cycle is positive definite.
            assert comm.allreduce(float(forces @ moved), op=MPI.SUM) > 0
    assert counts[0] == counts[1] > 0
    linear.destroy()
    for thing in (snes, x, b):
        thing.destroy()
    assembler.destroy()


def test_contact_that_gives_the_tangent_other_entries(caplog):
    """Vertices press on nodes beyond their elements: PETSc must not reuse the old block's entries.

    It would refuse, and the solver go on by a factorisation.
    """
    problem = Problem(
        box_body(size=(1.0, 1.0, 0.5), cells=(2, 2, 1)),
        NeoHookean(E=1e6, nu=0.49),
        degree=2,
        formulation="mixed",
        supports=[Support(on="top", displacement=[0, 0, "-0.01*t"])],
        contacts=[Contact(on="bottom", plane={"axis": "z", "at": 0}, name="floor")],
    )
    with caplog.at_level("INFO"):
        (*_, last) = Statics(problem, steps=1, linear=LinearSettings(method="iterative")).steps()
    assert last.reactions["floor"][2] > 1e4
    assert "failed" not in caplog.text
