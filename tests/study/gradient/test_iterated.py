"""Adjoints by iterations: where they stop, gradients have the digits that are promised."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import Fixed, NeoHookean, Pressure, Problem, Statics, Traction, box_body
from dolfin_elastic.core.parallel import total
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


@pytest.mark.parametrize("name", KINDS)
def test_gradients_are_differences_of_solutions(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_conjugate_gradients_stop_by_the_norm_of_energy() -> None:
    """The error is DIGITS of the adjoint in that norm, to the factor of 2 by which a cycle of
    multigrid differs from the inverse; by the residual some loads would take a digit more."""
    found = list[tuple[float, int]]()

    def look(newton: Any, state: Any) -> None:
        ours = functionals(OF, newton.assembler.problem, {})
        Equilibrium(newton, lambda _: ours, ours, state.t).evaluated()
        one, K = Adjoint(newton), newton.assembler.tangent.matrix
        x, y = K.createVecs()
        for number in ours:
            slope, vectors = number.by_unknowns(newton.assembler), []
            for digits in (DIGITS, 1e-13):
                one._ksp.setTolerances(rtol=digits)
                vectors.append(one.solve(slope, np.zeros(0)))
            rough, exact = (vector.fields for vector in vectors)
            energies = []
            for field in (rough - exact, exact):
                x.array_w[:] = field
                K.mult(x, y)
                energies.append(total(COMM, float(field @ y.array_r)))
            found.append((float(np.sqrt(energies[0] / energies[1])), vectors[0].iterations))
        one.destroy()
        x.destroy()
        y.destroy()

    at_the_end(held("conjugate gradients"), "iterative", look)
    errors = np.array([error for error, _ in found])
    assert np.all(errors < 2 * DIGITS)
    assert np.all(errors > DIGITS / 20)  # an iteration gains less
    iterations = [count for _, count in found]
    assert max(iterations) - min(iterations) <= 4
