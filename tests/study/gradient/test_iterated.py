"""Adjoints by iterations: where they stop, gradients have the digits that are promised."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import Fixed, NeoHookean, Pressure, Problem, Statics, Traction, box_body
from dolfin_elastic.core.parallel import total
from dolfin_elastic.solvers.linear import ksp
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.solvers.nonlinear import adjoint
from dolfin_elastic.solvers.nonlinear.adjoint import DIGITS, Adjoint
from dolfin_elastic.study.gradient.functionals import functionals
from dolfin_elastic.study.gradient.gradient import Asked, Gradients
from dolfin_elastic.study.gradient.parameters import Equilibrium

COMM, KEY, STEP = MPI.COMM_WORLD, "materials.body.mu", 1e-3
OF = ["mean displacement_z on right", "strain_energy", "norm:8 von_mises"]
BEND, SQUEEZE = Traction(on="right", value=[0, 0, -1e4]), Pressure(on="top", value=1e4)
KINDS: dict[str, tuple[float, list[Any]]] = {
    "conjugate gradients": (0.45, [BEND]),
    "follower pressure, by GMRES": (0.3, [SQUEEZE]),
    "pressure beside, by GMRES": (0.5, [BEND]),
}


def held(name: str) -> Problem:
    nu, loads = KINDS[name]
    body = box_body(size=(2, 1, 1), cells=(4, 2, 2))
    law = NeoHookean(mu=3e5, nu=nu)
    return Problem(body, law, supports=[Fixed(on="left")], loads=loads, degree=2)


def at_the_end(problem: Problem, method: str, look: Any) -> None:
    solver = Statics(problem, rtol=1e-12, linear=LinearSettings(method=method))
    solver.observer = lambda newton, state: look(newton, state) if state.done >= 1.0 else None
    for _ in solver.steps():
        pass


def gradients(name: str) -> list[Any]:
    problem, found = held(name), list[Any]()
    every = Gradients(Asked(OF, [KEY]), problem)
    at_the_end(problem, "iterative", lambda *state: found.extend(every.at(*state)))
    return found


def values(name: str, factor: float) -> np.ndarray:
    """Of the solution, with factors, for another value of the constant."""
    problem, found = held(name), list[Any]()
    problem.parameters[KEY].value = float(problem.parameters[KEY].value) * factor
    ours = functionals(OF, problem, {})

    def look(newton: Any, state: Any) -> None:
        found.append(Equilibrium(newton, lambda _: ours, ours, state.t).evaluated().numbers)

    at_the_end(problem, "direct", look)
    return np.array(found[-1])


@pytest.mark.long
@pytest.mark.parametrize("name", KINDS)
def test_gradients_are_differences_of_solutions(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """To 1e-8 of the numbers.  Differences of fourth order lose 1e-12 / STEP, and STEP^4.

    With adjoints of three digits they are not.
    """
    sides = {k: values(name, 1 + k * STEP) for k in (-2, -1, 1, 2)}
    slopes = (8 * (sides[1] - sides[-1]) - (sides[2] - sides[-2])) / (12 * STEP)

    def off() -> float:
        found = gradients(name)
        told = np.array([one.by[0].at * one.by[0].value for one in found])
        return float(np.max(np.abs(told - slopes) / [abs(one.value) for one in found]))

    assert off() < 1e-8
    monkeypatch.setattr(adjoint, "DIGITS", 1e-3)
    assert off() > 1e-8


def iterated(newton: Any) -> list[np.ndarray]:
    """Derivatives of the numbers by the unknowns."""
    ours = functionals(OF, newton.assembler.problem, {})
    Equilibrium(newton, lambda _: ours, ours, 1.0).evaluated()
    return [one.by_unknowns(newton.assembler) for one in ours]


def energy(newton: Any, field: np.ndarray) -> float:
    """x . K x with the tangent K."""
    K = newton.assembler.tangent.matrix
    x, y = K.createVecs()
    x.array_w[:] = field
    K.mult(x, y)
    result = total(COMM, float(field @ y.array_r))
    x.destroy()
    y.destroy()
    return result


def test_conjugate_gradients_stop_by_the_norm_of_energy() -> None:
    """The adjoint's error is DIGITS of it, to the factor by which multigrid is no inverse: 2.

    So the same iterations serve loads whose residuals are a hundred times apart.
    """
    found = list[tuple[float, int]]()

    def look(newton: Any, state: Any) -> None:
        for slope in iterated(newton):
            one = Adjoint(newton)
            rough = one.solve(slope, np.zeros(0))
            one._ksp.setTolerances(rtol=1e-13)
            exact = one.solve(slope, np.zeros(0)).fields
            off = energy(newton, rough.fields - exact) / energy(newton, exact)
            found.append((float(np.sqrt(off)), rough.iterations))
            one.close()

    at_the_end(held("conjugate gradients"), "iterative", look)
    errors, iterations = map(np.array, zip(*found, strict=True))
    assert np.all(errors < 2 * DIGITS)
    assert np.all(errors > DIGITS / 20)  # an iteration gains less
    assert np.ptp(iterations) <= 4


@pytest.mark.parametrize("name", ["conjugate gradients", "pressure beside, by GMRES"])
def test_an_adjoint_begins_with_those_before(name: str) -> None:
    """A number that depends on the unknowns as those before take few iterations, if any."""
    counts = list[int]()

    def look(newton: Any, state: Any) -> None:
        first, second, third = iterated(newton)
        one = Adjoint(newton)
        for slope in (first, third, 2.0 * first - 3.0 * third, second):
            counts.append(one.solve(slope, np.zeros(0)).iterations)
        one.close()

    at_the_end(held(name), "iterative", look)
    assert min(counts[:2]) > 20
    assert max(counts[2:]) <= 2  # the energy's load is that of the mean displacement, to round-off


def test_a_bent_body_has_a_preconditioner_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where Newton's is of the straight body, adjoints take a third more iterations."""
    counts = list[int]()

    def look(newton: Any, state: Any) -> None:
        for limit in (1.0, ksp.CHANGE_FOR_DIGITS):
            monkeypatch.setattr(ksp, "CHANGE_FOR_DIGITS", limit)
            assert newton.linear.kept
            one = Adjoint(newton)
            counts.append(one.solve(iterated(newton)[0], np.zeros(0)).iterations)
            assert newton.linear.kept == (limit == 1.0)
            one.close()

    at_the_end(held("conjugate gradients"), "iterative", look)
    assert counts[1] < 0.85 * counts[0]
