"""Extremes of det F by a loop over the cells against an expression of it."""

from __future__ import annotations

import basix
import numpy as np
import pytest
from helpers.annulus import annulus
from mpi4py import MPI

from dolfin_elastic import (
    Body,
    FixedCorotated,
    LinearElastic,
    NeoHookean,
    Problem,
    Selector,
    box_body,
    name_parts,
    rectangle_body,
)
from dolfin_elastic.core.parallel import largest
from dolfin_elastic.solvers.nonlinear.jacobian import (
    CellExtremes,
    JacobianWatch,
    _ByExpression,
    _ByLoop,
)

COMM = MPI.COMM_WORLD
SOFT = NeoHookean(E=1.0, nu=0.3)


def bend(problem: Problem) -> None:
    """A displacement whose det F differs from cell to cell, from below 1 to above."""
    dim = problem.body.dim
    problem.u.interpolate(
        lambda x: 0.2 * np.sin([x[0] * x[1] + x[2], 3 * x[1] + x[0], x[2] - 2 * x[0] + x[1]])[:dim]
    )
    problem.u.x.scatter_forward()


def both(problem: Problem, *, linear: bool = False) -> list[CellExtremes]:
    kind = getattr(basix.CellType, problem.body.mesh.topology.cell_name())
    points, _ = basix.make_quadrature(kind, 2)
    return [how(problem, points, linear=linear)() for how in (_ByLoop, _ByExpression)]


def check(problem: Problem, *, linear: bool = False) -> None:
    """Values of all cells to round-off of sums of some ten terms, on each rank."""
    found, known = both(problem, linear=linear)
    off = [np.abs(one - other) for one, other in zip(found, known, strict=True)]
    assert largest(COMM, float(max(np.max(a, initial=0.0) for a in off))) < 1e-13
    assert len(found.least) == len(problem.body.owned_cells())
    assert len(found.squares) == (len(found.least) if linear else 0)


def solid() -> Body:
    return box_body(size=(1.0, 0.8, 0.6), cells=(3, 2, 2))


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("body", [solid, lambda: rectangle_body(size=(1.0, 0.5), cells=(4, 2))])
def test_the_same_by_an_expression(body, degree):
    problem = Problem(body(), SOFT, degree=degree)
    bend(problem)
    check(problem)


def test_curved_cells():
    problem = Problem(annulus(COMM, 4), SOFT, degree=2)
    bend(problem)
    check(problem)


def test_gradients_in_cells_of_linear_laws():
    """Of these cells only, though gradients are larger in others."""
    body = name_parts(
        solid(),
        regions={
            "left": Selector(box=[[0, 0, 0], [0.34, 1, 1]]),
            "right": Selector(box=[[0.33, 0, 0], [1, 1, 1]]),
        },
    )
    problem = Problem(body, {"left": LinearElastic(E=1.0, nu=0.3), "right": SOFT}, degree=1)
    bend(problem)
    check(problem, linear=True)
    value, place = JacobianWatch(problem).steepest()
    assert value > 0.0
    assert place[0] < 1 / 3


def test_what_is_no_number_counts_as_inverted():
    problem = Problem(solid(), SOFT, degree=1)
    problem.u.x.array[:] = np.nan
    wrong = 0
    for least, most, squares in both(problem, linear=True):
        wrong += not (np.all(least == -np.inf) and np.all(most == -np.inf) and not squares.any())
    assert largest(COMM, wrong) == 0


def test_inverted_cells_that_may_be():
    """The right half is mirrored: its law goes on there, that of the left one would not."""
    halves = {
        "left": Selector(box=[[0, 0, 0], [0.5, 1, 1]]),
        "right": Selector(box=[[0.5, 0, 0], [1, 1, 1]]),
    }
    body = name_parts(box_body(size=(1, 1, 1), cells=(2, 1, 1)), regions=halves)
    laws = {"left": SOFT, "right": FixedCorotated(E=1.0, nu=0.3)}
    for place, refused in (("right", 1.0), ("left", -0.5)):
        problem = Problem(body, laws, degree=1)
        side = 1.0 if place == "right" else -1.0
        problem.u.interpolate(
            lambda x, side=side: [
                -1.5 * side * np.maximum(side * (x[0] - 0.5), 0),
                0 * x[1],
                0 * x[2],
            ]
        )
        problem.u.x.scatter_forward()
        problem.unknowns.u_to_w()
        watch = JacobianWatch(problem)
        assert watch.survives
        assert watch.inverted() == 6
        assert watch.smallest()[0] == pytest.approx(-0.5, rel=1e-12)
        assert watch.refused()[0] == pytest.approx(refused, rel=1e-12)


def test_unknowns_beside_the_displacement_are_left_to_the_expression():
    alone = Problem(solid(), SOFT, degree=2)
    mixed = Problem(solid(), NeoHookean(E=1.0, nu=0.5), degree=2)
    assert isinstance(JacobianWatch(alone)._evaluate, _ByLoop)
    assert isinstance(JacobianWatch(mixed)._evaluate, _ByExpression)
