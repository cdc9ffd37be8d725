"""Modes and buckling without factors: those of factors, none missed, whatever holds the body."""

from __future__ import annotations

import logging
from collections.abc import Callable
from itertools import permutations, product
from typing import Any

import numpy as np
import pytest
from helpers.bodies import made, turned
from helpers.stacked import stacked
from mpi4py import MPI

from dolfin_elastic import (
    BodyForce,
    Buckling,
    LinearElastic,
    Modal,
    Problem,
    Selector,
    StVenantKirchhoff,
    Support,
    Symmetry,
    Tie,
    Traction,
    box_body,
)
from dolfin_elastic.core.errors import ConvergenceError
from dolfin_elastic.mesh import name_parts
from dolfin_elastic.problem.state import Mode
from dolfin_elastic.solvers.eigen import lobpcg, modal
from dolfin_elastic.solvers.eigen.mode_shapes import at_rest
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.solvers.statics.settings import StaticsSettings

LAW = LinearElastic(E=1e7, nu=0.3, density=1000)


def modes(problem: Problem, method: str, count: int, **keys: Any) -> list[Mode]:
    linear = LinearSettings(method=method)
    return list(Modal(problem, count=count, linear=linear, **keys).modes())


def eigenvalues(found: list[Mode]) -> np.ndarray:
    return np.array([mode.eigenvalue for mode in found])


def bar(degree: int, **keys: Any) -> Problem:
    """A square bar, which bends both ways alike."""
    body = box_body(size=[4, 1, 1], cells=[8, 2, 2] if degree == 2 else [16, 4, 4])
    return Problem(body, LAW, degree=degree, **keys)


def tied() -> Problem:
    body = stacked(size=(1.0, 0.8, 0.6), lower=(3, 2, 2), upper=(4, 3, 2))
    held, tie = [Support(on="bottom")], [Tie(on="above", to="below")]
    return Problem(body, LAW, supports=held, ties=tie, degree=1)


def on_rollers() -> Problem:
    """Along planes that are no coordinate planes, free to move along one direction."""
    body = box_body(size=[2, 1, 1], cells=[6, 3, 3])
    turned(body, [1, 2, 3], 0.4)
    return Problem(body, LAW, supports=[Symmetry(on="left"), Symmetry(on="bottom")], degree=1)


CASES: dict[str, Callable[[], Problem]] = {
    "clamped": lambda: bar(1, supports=[Support(on="left")]),
    "clamped, quadratic": lambda: bar(2, supports=[Support(on="left")]),
    "free": lambda: bar(1),
    "free, quadratic": lambda: bar(2),
    "tied": tied,
    "on rollers": on_rollers,
}


@pytest.mark.parametrize("name", CASES)
def test_modes_are_those_of_factors(name: str) -> None:
    """Values to the tolerance; shapes to its root: their masses have the square of that."""
    problem = CASES[name]()
    direct, found = (modes(problem, method, 12) for method in ("direct", "iterative"))
    assert [mode.kind for mode in found] == [mode.kind for mode in direct]
    elastic = [k for k, mode in enumerate(direct) if mode.kind == "elastic"]
    wanted = eigenvalues(direct)[elastic]
    assert eigenvalues(found)[elastic] == pytest.approx(wanted, rel=1e-9)
    # Effective masses of modes with the same frequency depend on how they are combined.
    alone = np.diff(wanted, prepend=0.0, append=np.inf) > 1e-2 * np.append(wanted, wanted[-1])
    for k in np.flatnonzero(alone[:-1] & alone[1:]):
        for axis, whole in direct[0].whole.items():
            theirs, ours = (x[elastic[k]].effective[axis] / whole for x in (direct, found))
            assert ours == pytest.approx(theirs, abs=1e-4)


@pytest.mark.parametrize("name", CASES)
def test_half_of_the_blocks_is_there(name: str) -> None:
    """Of a stiffness whose entries are prescribed by themselves; with a mass of one number a pair.

    The mass is the one of factors where motions are free.
    """
    problem = CASES[name]()
    found = [
        modal.Vibration(Modal(problem, count=1, linear=LinearSettings(method=method)))
        for method in ("direct", "iterative")
    ]
    direct, iterative = (one.spectrum for one in found)
    combined = name in ("tied", "on rollers")
    assert (iterative.A.getType() == "python") == (not combined)
    assert direct.A.getType() != "python"
    x, images = direct.A.createVecRight(), [direct.A.createVecLeft() for _ in found]
    x.array_w[:] = np.cos(np.arange(*x.getOwnershipRange()))
    for one, y in zip((direct, iterative), images, strict=True):
        one.B.mult(x, y)
    images[1].axpy(-1.0, images[0])
    assert images[1].norm() <= 1e-14 * images[0].norm()
    for thing in (*found, x, *images):
        thing.destroy()


def cubes(number: int, **keys: Any) -> Problem:
    """Equal cubes beside each other: each frequency is that of all."""
    corners = [
        np.cumsum([np.zeros(3), *np.eye(3)[list(order)]], axis=0)
        for order in permutations(range(3))
    ]
    points = np.array(list(product((0, 1), repeat=3)), dtype=float)
    cells = np.array([[int(c @ [4, 2, 1]) for c in cell] for cell in corners])
    cells = np.concatenate([cells + 8 * k for k in range(number)])
    points = np.concatenate([points + 3.0 * k * np.eye(3)[1] for k in range(number)])
    ends = {"foot": Selector(plane="z", at="min"), "head": Selector(plane="z", at="max")}
    body = name_parts(made(MPI.COMM_WORLD, cells, points), surfaces=ends)
    return Problem(body, LAW, supports=[Support(on="foot")], degree=1, **keys)


@pytest.mark.parametrize("count", [1, 3, 8, 20])
def test_more_equal_ones_than_vectors(count: int) -> None:
    """Ten of each, where a search has four vectors more than are wanted."""
    problem = cubes(10)
    direct, found = (modes(problem, method, count) for method in ("direct", "iterative"))
    assert eigenvalues(found) == pytest.approx(eigenvalues(direct), rel=1e-9)


def test_one_block_after_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dolfin_elastic.solvers.eigen.slepc.BLOCK", 5)
    problem = bar(1)
    direct, found = (modes(problem, method, 12) for method in ("direct", "iterative"))
    assert eigenvalues(found)[6:] == pytest.approx(eigenvalues(direct)[6:], rel=1e-9)


def test_missed_modes_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A first search that begins without motion of one of three cubes never moves it."""
    start, problem, later = lobpcg.Preconditioned.start, cubes(3), list[int]()

    def partly(self: Any, number: int) -> np.ndarray:
        vector = start(self, number)
        if number >= 1000:
            later.append(number)
        else:
            size = len(vector)
            vector[problem.unknowns.unknown_places[: size // 3, 1].repeat(3) > 5.0] = 0.0
        return vector

    direct = modes(problem, "direct", 4)
    monkeypatch.setattr(lobpcg.Preconditioned, "start", partly)
    found = modes(problem, "iterative", 4)
    assert eigenvalues(found) == pytest.approx(eigenvalues(direct), rel=1e-9)
    assert len(later) > 4, "a search finds what is missing, and one more that nothing is"


def test_what_does_not_converge(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Krylov-Schur iterations find the same, and that is said."""
    problem = bar(1, supports=[Support(on="left")])
    found = eigenvalues(modes(problem, "iterative", 3))
    monkeypatch.setattr(lobpcg, "STEPS", 3)
    with caplog.at_level(logging.INFO):
        others = eigenvalues(modes(problem, "iterative", 3))
    assert others == pytest.approx(found, rel=1e-8)
    if MPI.COMM_WORLD.rank == 0:
        assert "LOBPCG has not converged" in caplog.text


def test_unstable() -> None:
    """A column beyond its load: values below zero, too."""
    law = StVenantKirchhoff(E=1e7, nu=0.0, density=1000)
    body = box_body(size=[10, 1, 1], cells=[20, 2, 2])
    problem = Problem(body, law, supports=[Support(on="left")], degree=2)
    problem.u.interpolate(lambda x: -0.005 * np.stack([x[0], 0 * x[0], 0 * x[0]]))
    found = []
    for method in ("direct", "iterative"):
        linear = LinearSettings(method=method)
        modal = Modal(problem, count=4, preload=True, linear=linear)
        found.append(list(modal.about_this_state()))
    direct, iterative = found
    assert [mode.kind for mode in iterative] == [mode.kind for mode in direct]
    assert direct[0].kind == "unstable"
    assert eigenvalues(iterative) == pytest.approx(eigenvalues(direct), rel=1e-9)


@pytest.mark.parametrize(
    ("cells", "degree", "direct"),
    [((50, 50, 2), 1, True), ((30, 30, 1), 2, True), ((24, 18, 18), 1, False)],
)
def test_thin_bodies_have_small_factors(
    cells: tuple[int, int, int], degree: int, direct: bool
) -> None:
    """Modes take them up to more unknowns; buckling does not, which would take three of them."""
    body = box_body(size=[1, 1, 1], cells=cells)
    loads = [Traction(on="right", value=[1e3, 0, 0])]
    problem = Problem(body, LAW, supports=[Support(on="left")], loads=loads, degree=degree)
    assert 20_000 < problem.num_dofs < 100_000
    assert Modal(problem).choice.direct == direct
    assert not Buckling(problem).choice.direct


# --- buckling ---

STEEP = StVenantKirchhoff(E=1e7, nu=0.3)


def load_factors(problem: Problem, method: str, count: int, **keys: Any) -> np.ndarray:
    buckling = Buckling(problem, count=count, linear=LinearSettings(method=method), **keys)
    return np.array([mode.load_factor for mode in buckling.modes()])


def pressed(degree: int, *, slender: bool = False) -> Problem:
    """A square column, which buckles both ways nearly alike."""
    length, along = (20, 40) if slender else (4, 16)
    cells = [along // degree, 4 // degree, 4 // degree]
    body = box_body(size=[length, 1, 1], cells=cells)
    held, loads = [Support(on="left")], [Traction(on="right", value=[-1e3, 0, 0])]
    return Problem(body, STEEP, degree=degree, supports=held, loads=loads)


def edge_loaded() -> Problem:
    """A thin cantilever across its height, which buckles under loads of either sign."""
    body = box_body(size=[4, 1, 0.1], cells=[16, 4, 1])
    held, loads = [Support(on="left")], [Traction(on="right", value=[0, 1e3, 0])]
    return Problem(body, STEEP, degree=2, supports=held, loads=loads)


def pressed_and_tied() -> Problem:
    body = stacked(size=(0.2, 0.2, 1.0), lower=(2, 2, 4), upper=(3, 3, 4))
    keys: dict[str, Any] = {"supports": [Support(on="bottom")], "degree": 1}
    loads = [Traction(on="top", value=[0, 0, -1e3])]
    return Problem(body, STEEP, ties=[Tie(on="above", to="below")], loads=loads, **keys)


def pressed_on_rollers() -> Problem:
    """Along planes that are no coordinate planes."""
    body = box_body(size=[8, 1, 1], cells=[24, 3, 3])
    along = turned(body, [1, 2, 3], 0.4) @ [-1e3, 0, 0]
    held = [Support(on="left"), Symmetry(on="right")]
    return Problem(body, STEEP, supports=held, loads=[BodyForce(value=along)], degree=1)


PRESSED: dict[str, tuple[Callable[[], Problem], dict[str, Any]]] = {
    "a column": (lambda: pressed(1), {"count": 6}),
    "a column, quadratic": (lambda: pressed(2), {"count": 6}),
    "a slender column": (lambda: pressed(1, slender=True), {"count": 4}),
    "a slender column, quadratic": (lambda: pressed(2, slender=True), {"count": 4}),
    "both signs": (edge_loaded, {"count": 3, "negative": True}),
    "tied": (pressed_and_tied, {"count": 3}),
    "on rollers": (pressed_on_rollers, {"count": 2}),
    "about a loaded state": (
        lambda: pressed(2, slender=True),
        {"count": 2, "preload": 3.0, "statics": StaticsSettings(steps=1)},
    ),
    "ten of each": (
        lambda: cubes(10, loads=[Traction(on="head", value=[0, 0, -1e3])]),
        {"count": 3},
    ),
}


@pytest.mark.parametrize("name", PRESSED)
def test_load_factors_are_those_of_factors(name: str, caplog: pytest.LogCaptureFixture) -> None:
    """To the tolerance, repeated ones included, and none is missed."""
    make, keys = PRESSED[name]
    problem = make()
    direct = load_factors(problem, "direct", **keys)
    with caplog.at_level(logging.INFO):
        found = load_factors(problem, "iterative", **keys)
    assert found == pytest.approx(direct, rel=1e-9)
    assert "factorising" not in caplog.text


def test_missed_load_factors_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A first search that begins without motion of one of three cubes never moves it."""
    loads = [Traction(on="head", value=[0, 0, -1e3])]
    start, problem = lobpcg.Preconditioned.start, cubes(3, loads=loads)

    def partly(self: Any, number: int) -> np.ndarray:
        vector = start(self, number)
        if number < 1000:
            size = len(vector)
            vector[problem.unknowns.unknown_places[: size // 3, 1].repeat(3) > 5.0] = 0.0
        return vector

    direct = load_factors(problem, "direct", 3)
    monkeypatch.setattr(lobpcg.Preconditioned, "start", partly)
    assert load_factors(problem, "iterative", 3) == pytest.approx(direct, rel=1e-9)


def test_load_factors_that_do_not_converge(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Factors find the same, and that is said."""
    problem, solve = pressed(1), lobpcg.Lobpcg.solve
    direct = load_factors(problem, "direct", 2)

    def fails(self: Any, count: int, tolerance: float, *more: float) -> None:
        if tolerance < 1.0:  # that of a question by yes or no
            raise lobpcg.NotConvergedError
        solve(self, count, tolerance, *more)

    monkeypatch.setattr(lobpcg.Lobpcg, "solve", fails)
    with caplog.at_level(logging.INFO):
        assert load_factors(problem, "iterative", 2) == pytest.approx(direct, rel=1e-9)
    if MPI.COMM_WORLD.rank == 0:
        assert "LOBPCG has not converged: factorising instead" in caplog.text


def test_conjugate_gradients_that_do_not_converge(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The stiffness is positive, and is not said to be anything else."""
    problem = pressed(1)
    direct = load_factors(problem, "direct", 2)
    monkeypatch.setattr(lobpcg.Cycle, "solve", lambda self, b, x: False)
    with caplog.at_level(logging.INFO):
        assert load_factors(problem, "iterative", 2) == pytest.approx(direct, rel=1e-9)
    if MPI.COMM_WORLD.rank == 0:
        assert "conjugate gradients do not converge: factorising instead" in caplog.text
        assert "not positive" not in caplog.text


def test_unstable_without_factors() -> None:
    """A straight column beyond its load is nothing to linearise about: seen without factors."""
    problem = pressed(2, slender=True)
    buckling = Buckling(problem, count=1, linear=LinearSettings(method="iterative"))
    at_rest(problem)
    problem.u.interpolate(lambda x: -0.006 * np.stack([x[0], 0 * x[0], 0 * x[0]]))
    with pytest.raises(ConvergenceError, match="the body is not stable under 0 times the loads"):
        next(buckling.about_this_state())
