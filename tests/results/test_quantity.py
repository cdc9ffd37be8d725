"""Quantities against closed forms, and their derivatives against central differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from helpers.bodies import soft_and_hard
from mpi4py import MPI

from dolfin_elastic import LinearElastic, NeoHookean, Problem, box_body, rectangle_body
from dolfin_elastic.core.errors import InputError, MeshError
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.derived.part_numbers import PartNumbers
from dolfin_elastic.results.derived.reduction import Reduction
from dolfin_elastic.results.derived.reductions import (
    REDUCTIONS,
    ending,
    percentile,
    reduced_unit,
    reduction_of,
)
from dolfin_elastic.results.quantity import Extremes, Measured, Quantity

COMM = MPI.COMM_WORLD
LAW = NeoHookean(mu=80.0, lmbda=120.0, allowable=50.0)


def state_of(problem: Problem, u: Any) -> State:
    function = fem.Function(problem.V)
    function.interpolate(u)
    if problem.W is problem.V:
        return State(1, 1.0, function)
    w = fem.Function(problem.W)
    w.sub(0).interpolate(u)
    w.x.array[:] += 1e-3 * np.cos(np.arange(len(w.x.array)))  # the pressure, too
    w.x.scatter_forward()
    function.x.array[:] = w.sub(0).collapse().x.array
    return State(1, 1.0, function, w=w)


def stretched(x: Any) -> Any:
    return np.array([0.1 * x[0], -0.05 * x[1], 0.02 * x[2] * x[0]])


@pytest.mark.parametrize("share", [1, 25, 50, 90, 95, 99])
def test_percentiles_of_a_linear_field(share: int) -> None:
    """Of u_x = c x over 0 < x < 2: below 2 c p lie the share p of volume, and of a side's area.

    To a seventh of what it changes within a cell: the mesh has 16 of them.
    """
    problem = Problem(box_body(size=(2, 1, 1.5), cells=(16, 4, 4)), LAW, degree=2)
    state = state_of(problem, stretched)
    for part in (None, "front"):
        found = Quantity("displacement_x", part, f"percentile:{share}").on(problem).of(state)
        assert found.value == pytest.approx(0.2 * share / 100, abs=0.2 / 16 * 0.15)
    # v = x^2 / 4 with x even over 0 ... 2 has the percentile p^2, the length as the component.
    bent = state_of(problem, lambda x: np.array([x[0] ** 2 / 4, 0 * x[0], 0 * x[0]]))
    found = Quantity("displacement", None, f"percentile:{share}").on(problem).of(bent)
    assert found.value == pytest.approx((share / 100) ** 2, abs=2 / 16 * 0.15)


def test_numbers_behind_a_colon(monkeypatch: pytest.MonkeyPatch) -> None:
    """A limit in pascals is large, of a component it may be negative; the unit is told for both."""
    share = Reduction(lambda samples, _: np.zeros(1), limits=(-np.inf, np.inf), unit="")
    monkeypatch.setitem(REDUCTIONS, "tried:1e6", share)
    for text, number in (("2.5e8", 2.5e8), ("-3e-2", -0.03), ("0.5", 0.5)):
        assert reduction_of(f"tried:{text}") == (share, number)
        column = f"lid_cauchy_stress_{ending(f'tried:{text}', 'area')}_xx"
        assert reduced_unit(column, {"lid_cauchy_stress_xx": "Pa"}.get) == ""
    with pytest.raises(InputError, match="unknown value 'tried:much'"):
        reduction_of("tried:much")


def test_percentiles_converge() -> None:
    """With the mesh, for the quadrature points become denser."""
    errors = []
    for n in (4, 8, 16):
        problem = Problem(rectangle_body(size=(1, 1), cells=(n, n)), LinearElastic(E=1.0, nu=0.3))
        state = state_of(problem, lambda x: np.array([x[0] * (1 + x[1]), 0 * x[0]]))
        # x (1 + y) = a < 1 holds of a share a ln 2.
        shares = np.linspace(5, 65, 13)
        names = [f"percentile:{p}" for p in shares]
        found = PartNumbers(problem, "region", None, ["displacement"], names)(state)
        values = [found[f"displacement_percentile_{p}"][0] for p in shares]
        errors.append(float(np.abs(values - shares / 100 / np.log(2)).max()))
    assert errors[2] < errors[0] / 3
    assert errors[2] < 0.01


def test_percentiles_of_few_numbers() -> None:
    """Weights 1, 2, 1 at 0, 1, 5: their middles are at 1/8, 1/2 and 7/8 of the sum."""
    values, weights = np.array([5.0, 0.0, 1.0]), np.array([1.0, 1.0, 2.0])
    mine = np.arange(3) % COMM.size == COMM.rank
    shares = [0, 0.125, 0.3125, 0.5, 0.6875, 0.875, 1]
    found = [percentile(COMM, values[mine], weights[mine], share) for share in shares]
    assert found == pytest.approx([0, 0, 0.5, 1, 3, 5, 5], abs=1e-12)
    assert np.isnan(percentile(COMM, np.array([1.0, np.nan]), np.ones(2), 0.5))
    assert percentile(COMM, np.full(4, 2.5), np.ones(4), 0.5) == 2.5


def test_places_values_and_sizes() -> None:
    """u = (x/10, -y/20, x z/50) on a box of 2 x 1 x 1.5 m of cubes of 1/2 m."""
    body = soft_and_hard(box_body(size=(2, 1, 1.5), cells=(4, 2, 3)), at=1.0)
    problem = Problem(body, {"soft": LAW, "hard": LAW}, degree=1)
    state = state_of(problem, stretched)

    def measured(*quantity: Any) -> Measured:
        return Quantity(*quantity).on(problem).of(state)

    top = measured("displacement_x", "soft", "max")
    assert top.value == pytest.approx(0.1, rel=1e-12)
    assert top.place == pytest.approx((1, 0, 0), abs=1e-12)  # of equal ones the first
    assert top.part == ""
    assert top.cell_size == pytest.approx((8 * 0.5**3 / 6) ** (1 / 3), rel=1e-9)
    assert measured("displacement_y", None, "min").value == pytest.approx(-0.05, rel=1e-12)
    length = np.linalg.norm([0.2, -0.05, 0.06])
    assert measured("displacement").value == pytest.approx(length, rel=1e-12)
    assert measured("displacement").place == pytest.approx((2, 1, 1.5), rel=1e-12)
    cells = measured("jacobian", "right")
    assert cells.part == "hard"
    assert cells.place[0] > 1.5
    assert measured("von_mises", "hard").part == "hard"
    mean = measured("displacement", "right", "mean")
    assert mean.value == pytest.approx(np.linalg.norm([0.2, -0.025, 0.03]), rel=1e-12)
    at = measured("displacement_z", (1.0, 0.5, 1.5), "at")
    assert at.value == pytest.approx(0.03, rel=1e-12)
    assert at.place == (1.0, 0.5, 1.5)
    assert measured("displacement_x", "hard", "integral").value == pytest.approx(0.225, rel=1e-12)


@pytest.mark.parametrize(
    ("quantity", "message"),
    [
        (("displacment",), "displacement"),
        (("displacement", None, "percentile:101"), "unknown value 'percentile:101'"),
        (("cauchy_stress", None, "percentile:50"), "no length"),
        (("displacement", None, "at"), "unknown value 'at'"),
        (("displacement", (1.0, 0.0, 0.0), "max"), "unknown value 'max'"),
    ],
)
def test_wrong_quantities(quantity: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Quantity(*quantity)


def test_wrong_parts_and_components() -> None:
    problem = Problem(rectangle_body(size=(1, 1), cells=(2, 2)), LAW, degree=1)
    with pytest.raises(MeshError, match="rigth"):
        Quantity("displacement", "rigth", "mean").on(problem)
    state = state_of(problem, lambda x: np.array([x[0], x[1]]))
    with pytest.raises(InputError, match="cauchy_stress_x"):
        Quantity("cauchy_stress_x", "right", "mean").on(problem).of(state)


def test_places_of_det_F() -> None:
    """u = (x^2/10 - x^3/60, y x/50 + y^2/40) at the corners of triangles: det F of each by hand.

    The smallest and largest one, with sign and place, whichever rank has the cell.
    """
    body = rectangle_body(size=(4, 1), cells=(8, 2))
    problem = Problem(body, LAW, degree=1)

    def bent(x: Any) -> Any:
        u = x[0] ** 2 / 10 - x[0] ** 3 / 60
        return np.array([u, x[1] * x[0] / 50 + x[1] ** 2 / 40])

    state = state_of(problem, bent)
    corners = body.mesh.geometry.x[body.mesh.geometry.dofmap[body.owned_cells()]][:, :, :2]
    edges = corners[:, 1:] - corners[:, :1]
    deformed = corners + np.moveaxis(bent(np.moveaxis(corners, 2, 0)), 0, 2)
    J = np.linalg.det(deformed[:, 1:] - deformed[:, :1]) / np.linalg.det(edges)
    rows = np.concatenate(COMM.allgather(np.column_stack([J, corners.mean(axis=1)])))
    found = Extremes(problem).of(state)
    for name, row in (
        ("min_jacobian", rows[rows[:, 0].argmin()]),
        ("max_jacobian", rows[rows[:, 0].argmax()]),
    ):
        assert found[name].value == pytest.approx(row[0], rel=1e-12)
        assert found[name].place == pytest.approx(tuple(row[1:]), rel=1e-12)
        assert found[name].part == problem.regions[0].name
    # No ties: the next ones are 0.1 % away, so the place is that of one cell.
    order = np.sort(rows[:, 0])
    assert order[1] - order[0] > 1e-3 < order[-1] - order[-2]
