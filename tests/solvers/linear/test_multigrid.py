"""Multigrid and splits: what PETSc is given, and that its options reach every level."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic import (
    NeoHookean,
    Normal,
    Problem,
    Statics,
    Support,
    Symmetry,
    Traction,
    box_body,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.petsc_options import PREFIX
from dolfin_elastic.problem.state import State
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.linear.choice import LinearSettings, choose
from dolfin_elastic.solvers.linear.ksp import LinearSolver
from dolfin_elastic.solvers.linear.multigrid import SOFT, constrained_interpolation
from dolfin_elastic.solvers.petsc.options import Options

ITERATIVE = LinearSettings(method="iterative")
KINDS = {
    "p1": (1, "displacement"),
    "p2": (2, "displacement"),
    "mixed p1": (1, "mixed"),
    "mixed p2": (2, "mixed"),
}


def block(kind: str, *, angle: float = 0.0) -> Problem:
    """A block on one wall and two mirrors, pulled; turned by an angle about an oblique axis."""
    body = box_body(size=(2.0, 1.0, 1.0), cells=(6, 3, 3))
    R = turn(angle)
    body.mesh.geometry.x[:] = body.mesh.geometry.x @ R.T
    degree, formulation = KINDS[kind]
    return Problem(
        body,
        NeoHookean(E=1e6, nu=0.3 if formulation == "displacement" else 0.4999),
        degree=degree,
        formulation=formulation,
        supports=[
            Normal(on="left") if angle else Support(on="left"),
            Symmetry(on=["front", "bottom"]) if angle else Support(on="front", displacement=ROLLER),
        ],
        loads=[Traction(on="right", value=list(R @ [2e4, 0, -1e4]))],
    )


ROLLER: list[Any] = ["free", 0, "free"]


def turn(angle: float) -> np.ndarray:
    """Rotation about the axis (1, 2, 3)."""
    x, y, z = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def steps(kind: str, count: int, petsc: Mapping[str, Any] | None = None) -> list[State]:
    solved = Statics(block(kind), steps=count, linear=ITERATIVE, petsc=dict(petsc or {})).steps()
    return [state for state in solved if state.newton]


@pytest.mark.parametrize("angle", [0.0, 0.5], ids=["axes", "skew"])
def test_the_interpolation_keeps_constraints(angle: float) -> None:
    """P is the plain interpolation of what is free, and P^T P is regular where nothing is."""
    problem = block("p2", angle=angle)
    coarse = problem.unknowns.linear_space()
    vertices = problem.body.mesh.topology.index_map(0).size_global
    assert coarse.dofmap.index_map.size_global == vertices
    P = constrained_interpolation(problem, coarse)
    constraints = problem.constraints
    x, y = P.createVecs()
    x.setRandom()
    P.mult(x, y)
    moved = y.array_r.copy()
    rows, skewed = constraints.skew_dofs, constraints.skewed
    fixed = constraints.constrained_part(moved)
    fixed[rows] /= SOFT
    # What is left in prescribed directions comes from the same directions of vertices alone.
    z = P.createVecRight()
    y.array_w[:] = fixed
    P.multTranspose(y, z)
    P.mult(z, y)
    rest = y.array_r - (SOFT**2 * fixed if skewed else fixed)
    free = np.ones(len(moved), dtype=bool)
    free[constraints.prescribed_dofs] = False
    free[rows] = False
    off = problem.body.comm.allreduce(float(np.abs(rest[free]).max(initial=0.0)), op=MPI.MAX)
    assert off < 1e-12
    gram = P.transposeMatMult(P)
    least = gram.getDiagonal().min()[1]
    assert least > (0.5 * SOFT**2 if angle else 1.0 - 1e-12)
    for thing in (gram, P, x, y, z):
        thing.destroy()


@contextmanager
def linear_solver(problem: Problem) -> Iterator[tuple[LinearSolver, Assembler]]:
    """A linear solver with its default options, ready for a tangent."""
    assembler = Assembler(problem)
    options = Options(choose(problem, ITERATIVE).options, {})
    snes = PETSc.SNES().create(assembler.comm)
    snes.setOptionsPrefix(PREFIX)
    linear = LinearSolver(assembler, options, snes.ksp, snes)
    with options.in_force():
        snes.setFromOptions()
        linear.set_up()
        yield linear, assembler
    linear.destroy()
    snes.destroy()
    assembler.destroy()


def iterations(linear: LinearSolver, assembler: Assembler) -> int:
    """Of a solve with the tangent where the problem is."""
    x, b = assembler.tangent.matrix.createVecs()
    assembler.get(x)
    assembler.tangent.assemble(x)
    linear.take(assembler.tangent.matrix)
    b.set(1.0)
    b.array_w[assembler.prescribed_dofs] = 0.0
    linear.ksp.solve(b, x)
    count = int(linear.ksp.getIterationNumber())
    x.destroy()
    b.destroy()
    assert linear.ksp.getConvergedReason() > 0
    return count


@pytest.mark.sample(3)
@pytest.mark.parametrize("kind", list(KINDS))
def test_refreshed_multigrid_follows_rotations(kind: str) -> None:
    """Rigid-body modes of the current places: a turned body is as easy as it was."""
    problem = block(kind)
    with linear_solver(problem) as (linear, assembler):
        first = iterations(linear, assembler)
        R = turn(1.2)
        problem.u.interpolate(lambda x: R @ x - x)
        problem.unknowns.u_to_w()
        linear.refresh()
        assert iterations(linear, assembler) <= first + 3
        problem.u.x.array[:] = 0.0
        problem.unknowns.u_to_w()
        linear.refresh()
        assert abs(iterations(linear, assembler) - first) <= 1


@pytest.mark.parametrize("kind", ["p2", "mixed p1", "mixed p2"])
def test_later_load_steps_take_no_more_iterations(kind: str) -> None:
    """Nor more on several ranks: splits that lost their order there took three times as many."""
    first, *later = steps(kind, 3)
    for state in later:
        assert state.krylov / state.newton <= 1.2 * first.krylov / first.newton


LEVELS: dict[str, dict[str, Any]] = {
    "p2": {
        "mg_levels_ksp_max_it": 4,
        "mg_coarse_pc_gamg_threshold": 0.02,
        "mg_coarse_mg_levels_ksp_max_it": 2,
    },
    "mixed p1": {"fieldsplit_u_mg_levels_ksp_max_it": 4, "fieldsplit_u_pc_gamg_threshold": 0.02},
    "mixed p2": {
        "fieldsplit_u_mg_levels_ksp_max_it": 4,
        "fieldsplit_u_mg_coarse_mg_levels_ksp_max_it": 2,
        "fieldsplit_u_mg_coarse_pc_gamg_threshold": 0.02,
        "fieldsplit_p_pc_sor_its": 2,
    },
}


@pytest.mark.parametrize("kind", list(LEVELS))
def test_options_reach_every_level_and_split(kind: str, caplog: pytest.LogCaptureFixture) -> None:
    """They change the iterations and count as used, and one that is mistyped is named."""
    mistyped = {name[:-1]: value for name, value in LEVELS[kind].items()}
    with caplog.at_level(logging.WARNING, logger="dolfin_elastic"):
        [plain] = steps(kind, 1)
        [state] = steps(kind, 1, LEVELS[kind] | mistyped)
    assert state.krylov / state.newton < plain.krylov / plain.newton
    messages = "\n".join(record.getMessage() for record in caplog.records)
    for name in LEVELS[kind]:
        assert f"'-{name}'" not in messages
        if MPI.COMM_WORLD.rank == 0:
            assert f"PETSc option '-{name[:-1]}' was not used" in messages


def test_a_direct_solver_of_the_coarse_level() -> None:
    """Any solver can stand in for GAMG, by its name."""
    [exact] = steps("p2", 1, {"mg_coarse_pc_type": "cholesky", **MUMPS})
    [plain] = steps("p2", 1, {"mg_coarse_pc_gamg_threshold": 0.01})
    assert exact.krylov <= plain.krylov
    assert exact.max_displacement == pytest.approx(plain.max_displacement, rel=1e-6)


def test_plain_gamg_of_quadratic_elements() -> None:
    """The user's choice, which knows the rigid-body modes, too."""
    [gamg] = steps("p2", 1, {"pc_type": "gamg"})
    [plain] = steps("p2", 1)
    assert gamg.max_displacement == pytest.approx(plain.max_displacement, rel=1e-6)


@pytest.mark.parametrize("kind", ["p2", "mixed p2"])
def test_more_levels_are_refused(kind: str) -> None:
    """PETSc itself would crash for want of an interpolation."""
    name = "fieldsplit_u_pc_mg_levels" if kind.startswith("mixed") else "pc_mg_levels"
    with pytest.raises(InputError, match="has two levels, not 3"):
        steps(kind, 1, {name: 3})


MUMPS = {"mg_coarse_pc_factor_mat_solver_type": "mumps"}
