"""Numbers with a derivative: their values against those of runs, dQ/dw against differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from helpers.bodies import soft_and_hard
from mpi4py import MPI

from dolfin_elastic import Fixed, NeoHookean, Problem, box_body, rectangle_body
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import total
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.quantity import Quantity
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.study.gradient.functionals import functionals

COMM = MPI.COMM_WORLD
LAW = NeoHookean(mu=80.0, lmbda=120.0, allowable=50.0)
INTEGRALS = [
    ("displacement_x", "right", "integral"),
    ("displacement", "hard", "mean"),
    ("first_piola_xx", "right", "integral"),
    ("cauchy_stress", "top", "mean"),
    ("von_mises", "hard", "mean"),
    ("energy_density", None, "integral"),
    ("pressure", "hard", "mean"),
    ("green_strain_xy", "soft", "integral"),
]
OTHERS = ["norm:8 von_mises on hard", "norm:6 displacement on top", "displacement_y of probe"]
OTHERS += ["displacement of probe", "reaction of left", "reaction_x of left", "strain_energy"]
PROBES = {"probe": (1.31, 0.43, 0.27)}


def stretched(x: Any) -> Any:
    return np.array([0.1 * x[0], -0.05 * x[1], 0.02 * x[2] * x[0]])


def problem_of(kind: str) -> Problem:
    """Two materials, at a displacement that is no equilibrium."""
    if kind in ("box", "mixed"):
        body, more = box_body(size=(2, 1, 1.5), cells=(2, 1, 2)), {}
    else:
        body, more = rectangle_body(size=(2, 1), cells=(4, 2), origin=(0.5, 0)), {"geometry": kind}
    if kind == "plane-stress":
        more["thickness"] = 0.3
    law = NeoHookean(mu=80.0, nu=0.4999) if kind == "mixed" else LAW
    body = soft_and_hard(body, at=1.0)
    more["supports"] = [Fixed(on="left")]
    problem = Problem(body, {"soft": law, "hard": law}, degree=2, **more)
    dim = body.dim
    u = fem.Function(problem.V)
    u.interpolate(lambda x: stretched(x if dim == 3 else [x[0], x[1], 0 * x[0]])[:dim])
    moves = problem.unknowns.mixed_dofs(np.arange(len(u.x.array), dtype=np.int32))
    if problem.W is not problem.V:
        problem.w.x.array[:] = 1e-3 * np.cos(np.arange(len(problem.w.x.array)))
    problem.w.x.array[moves] = u.x.array
    problem.w.x.scatter_forward()
    problem.unknowns.w_to_u()
    return problem


def name_of(quantity: tuple[str, str | None, str]) -> str:
    field, part, reduction = quantity
    return f"{reduction} {field} on {part}" if part else f"{reduction} {field}"


@pytest.mark.parametrize("quantity", INTEGRALS)
@pytest.mark.parametrize("kind", ["box", "plane-stress", "axisymmetric", "mixed"])
def test_integrals(quantity: tuple[str, str | None, str], kind: str) -> None:
    """Values of the same quantity in results, of vectors and tensors the length of their mean."""
    problem = problem_of(kind)
    here = differentiated(name_of(quantity), problem)
    state = State(1, 1.0, problem.u, w=None if problem.w is problem.u else problem.w)
    assert here == pytest.approx(Quantity(*quantity).on(problem).of(state).value, rel=1e-10)


@pytest.mark.long
@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("kind", ["box", "mixed"])
def test_others(name: str, kind: str) -> None:
    differentiated(name, problem_of(kind))


def differentiated(name: str, problem: Problem) -> float:
    """A value; its dQ/dw in a direction against central differences."""
    places = {n: place[: problem.body.dim] for n, place in PROBES.items()}
    (one,) = functionals([name], problem, places)
    assembler = Assembler(problem)

    def value() -> float:
        assembler.residual.assemble()
        return one.value(assembler.residual.owned)

    here = value()
    slope, w = one.by_unknowns(assembler), problem.w
    along = fem.Function(problem.W)
    along.x.array[: len(slope)] = np.cos(np.arange(len(slope)))
    along.x.scatter_forward()
    exact = total(COMM, float(slope @ along.x.array[: len(slope)]))
    start, values = w.x.array.copy(), list[float]()
    for step in (1e-6, -1e-6):
        w.x.array[:] = start + step * along.x.array
        problem.unknowns.w_to_u()
        values.append(value())
    assembler.destroy()
    difference = (values[0] - values[1]) / 2e-6
    assert exact == pytest.approx(difference, rel=1e-6, abs=1e-7 * abs(here))
    w.x.array[:] = start
    problem.unknowns.w_to_u()
    return here


def test_what_has_no_derivative() -> None:
    problem = problem_of("box")
    for name in (
        "percentile:50 displacement on right",
        "mean tresca on right",
        "mean normal_x on right",
    ):
        with pytest.raises(InputError, match="has no derivative"):
            functionals([name], problem, {})
    examples = "for example 'displacement_z of probe', 'reaction_z of left', 'mean von_mises on "
    for name in ("contact_area of ball", "obstacle displacement", "contact_force_ball", "volume"):
        with pytest.raises(InputError, match=f"'{name}' is no number.*; {examples}"):
            functionals([name], problem, PROBES)
    slips = {"strain_enrgy": "strain_energy", "mean von_misses on top": "von_mises"}
    for name, near in slips.items():
        with pytest.raises(InputError, match=f"; did you mean '{near}'"):
            functionals([name], problem, PROBES)
    with pytest.raises(InputError, match="probe is a point; 'displacement_z of probe'"):
        functionals(["von_mises of probe"], problem, PROBES)
