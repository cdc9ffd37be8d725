"""Unknowns of a coarse mesh as a first guess on a finer one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from helpers.annulus import annulus
from mpi4py import MPI

from dolfin_elastic import (
    NeoHookean,
    NeoHookeanSplit,
    Problem,
    Statics,
    Support,
    Traction,
    box_body,
)
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.mesh import Body
from dolfin_elastic.mesh.refine.refinement import Refinement, refine_body
from dolfin_elastic.solvers.statics.load_stepping import InitialGuess
from dolfin_elastic.study.converge.converge import refined_unknowns

WORLD = MPI.COMM_WORLD


def bent(body: Body, **keys: Any) -> Problem:
    """A block that is held on one side and pulled aside on the other."""
    dim = body.dim
    keys = {"degree": 2, "law": NeoHookean(E=1e6, nu=0.3), **keys}
    return Problem(
        body,
        keys.pop("law"),
        supports=[Support(on="left")],
        loads=[Traction(on="right", value=[0, 4e4, 0][:dim])],
        **keys,
    )


def refined(body: Body) -> Refinement:
    """Refined where x is smallest."""
    middles = body.mesh.geometry.x[body.mesh.geometry.dofmap].mean(axis=1)
    return refine_body(body, np.flatnonzero(middles[:, 0] < 0.5).astype(np.int32))


def norm(problem: Problem, unknowns: Any) -> float:
    """Integral of |grad u|^2, exact for both degrees."""
    problem.w.x.array[:] = unknowns
    problem.unknowns.w_to_u()
    slope = ufl.grad(problem.u)
    return float(total(WORLD, fem.assemble_scalar(fem.form(ufl.inner(slope, slope) * ufl.dx))))


@pytest.mark.parametrize(
    "keys",
    [
        {"dim": 2},
        {"dim": 3, "degree": 1},
        {"dim": 2, "law": NeoHookeanSplit(E=1e6, nu=0.49), "formulation": "mixed"},
        {"dim": 2, "law": NeoHookeanSplit(E=1e6, nu=0.5)},
    ],
    ids=["plane", "solid", "mixed", "incompressible"],
)
def test_the_same_function(keys: dict[str, Any]) -> None:
    """On straight cells the finer mesh contains the coarse functions: the same gradient, 1e-12.

    Pressures have another scale there, which is taken into account.
    """
    dim = keys.pop("dim")
    coarse = bent(box_body(size=[2, 1, 1][:dim], cells=[4, 2, 1][:dim]), **keys)
    *_, state = Statics(coarse, steps=2).steps()
    known = norm(coarse, coarse.w.x.array.copy())
    refinement = refined(coarse.body)
    fine = bent(refinement.body, **keys)
    guess = refined_unknowns(refinement, coarse, coarse.w, fine)
    assert fine.num_dofs > coarse.num_dofs
    assert norm(fine, guess) == pytest.approx(known, rel=1e-12)
    assert state.max_displacement > 0.05
    if coarse.unknowns.has("pressure"):
        pressure = [p.unknowns.scale["pressure"].value for p in (coarse, fine)]
        parts = [p.W.sub(1).collapse()[1] for p in (coarse, fine)]
        values = [coarse.w.x.array[parts[0]] * pressure[0], guess[parts[1]] * pressure[1]]
        top = [largest(WORLD, float(np.abs(v).max(initial=0.0))) for v in values]
        assert top[1] == pytest.approx(top[0], rel=1e-9)


def test_curved_cells() -> None:
    """Functions of quadratic cells are followed in their reference cells: a linear one is exact."""
    body = annulus(WORLD, 2)
    refinement = refine_body(body, body.owned_cells()[::3])
    problems = [Problem(b, NeoHookean(E=1e6, nu=0.3), degree=2) for b in (body, refinement.body)]
    for problem in problems:
        problem.u.interpolate(lambda x: np.stack([2 * x[0] - x[1], x[0]]))
    guess = refined_unknowns(refinement, problems[0], problems[0].w, problems[1])
    assert np.allclose(guess, problems[1].w.x.array, rtol=0, atol=1e-12)


def test_solved_from_there() -> None:
    """One step leads to the equilibrium that load steps find, with fewer Newton iterations."""
    coarse = bent(box_body(size=[2, 1], cells=[4, 2]))
    list(Statics(coarse).steps())
    refinement = refined(coarse.body)
    fine = bent(refinement.body)
    guess = refined_unknowns(refinement, coarse, coarse.w, fine)
    (state,) = Statics(fine).steps(near=InitialGuess(guess))
    assert state.done == 1.0
    assert state.audit is not None
    assert state.audit.verdict == "pass"
    found, newton = fine.w.x.array.copy(), state.newton
    again = bent(refinement.body)
    states = list(Statics(again, first_step=0.25).steps())
    assert newton < sum(s.newton for s in states) / 2
    assert np.allclose(found, again.w.x.array, rtol=0, atol=1e-7)


def test_a_bad_guess_is_left() -> None:
    """Where Newton's method finds nothing from the guess the load grows from zero."""
    problem = bent(box_body(size=[2, 1], cells=[4, 2]))
    rng = np.random.default_rng(0)
    wild = 10.0 * rng.random(len(problem.w.x.array))
    *_, state = Statics(problem, first_step=0.25).steps(near=InitialGuess(wild))
    assert state.done == 1.0
    assert state.step > 1
