"""A load of 1e-18 of another gives 1e-18 of its displacements, stresses and reactions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import (
    Hencky,
    LinearElastic,
    NeoHookean,
    Pressure,
    Problem,
    Rigid,
    Spring,
    Statics,
    Support,
    Thermal,
    Traction,
    box_body,
    rectangle_body,
)
from dolfin_elastic.core.parallel import largest
from dolfin_elastic.results.evaluate import Evaluator

COMM = MPI.COMM_WORLD
STEEL = {"E": 210e9, "nu": 0.3}
TINY = 1e-18


def solved(make: Any, size: float) -> tuple[Problem, Any, dict[str, Any]]:
    problem = make(size)
    *_, state = Statics(problem).steps()
    fields = Evaluator(problem, ["cauchy_stress", "cauchy_stress_cell", "strain", "energy_density"])
    return problem, state, fields(state)


def beam(law: Any, size: float, **more: Any) -> Problem:
    body = box_body(size=(0.1, 0.02, 0.02), cells=(6, 2, 2))
    loads = [Traction(on="right", value=[0, 0, size])]
    return Problem(body, law, supports=[Support(on="left")], loads=loads, **more)


def plane(law: Any, size: float, geometry: Any) -> Problem:
    body = rectangle_body(size=(0.1, 0.02), cells=(6, 2))
    return Problem(
        body,
        law,
        supports=[Support(on="bottom"), Spring(on="left", stiffness=[1e9, 1e9])],
        loads=[Pressure(on="right", value=size)],
        geometry=geometry,
    )


def twisted(size: float) -> Problem:
    body = box_body(size=(0.1, 0.02, 0.02), cells=(6, 2, 2))
    rigid = Rigid(on="right", moment=[1e-4 * size, 0, 0])
    return Problem(body, LinearElastic(**STEEL), supports=[Support(on="left"), rigid])


def warmed(size: float) -> Problem:
    body = box_body(size=(0.1, 0.02, 0.02), cells=(6, 2, 2))
    law = NeoHookean(**STEEL, expansion=1.2e-5)
    return Problem(body, law, supports=[Support(on="left")], loads=[Thermal(value=1e-4 * size)])


PROBLEMS = {
    "beam": lambda size: beam(LinearElastic(**STEEL), size),
    "linear elements": lambda size: beam(LinearElastic(**STEEL), size, degree=1),
    "neo-hookean": lambda size: beam(NeoHookean(**STEEL), size),
    "with a pressure": lambda size: beam(Hencky(E=210e9, nu=0.4999), size),
    "incompressible": lambda size: beam(NeoHookean(E=210e9, nu=0.5), size),
    "plane strain": lambda size: plane(LinearElastic(**STEEL), size, "plane-strain"),
    "plane stress": lambda size: plane(NeoHookean(**STEEL), size, "plane-stress"),
    "axisymmetric": lambda size: plane(NeoHookean(**STEEL), size, "axisymmetric"),
    "rigid surface": twisted,
    "heat": warmed,
}


@pytest.mark.sample(4)
@pytest.mark.parametrize("name", PROBLEMS)
def test_everything_is_in_proportion(name):
    """To the tolerance of the solution: the strains of the larger load are below 1e-10 already."""
    large, tiny = (solved(PROBLEMS[name], size) for size in (1.0, TINY))
    scale = largest(COMM, float(np.abs(large[1].u.x.array).max(initial=0.0)))
    off = np.abs(tiny[1].u.x.array / TINY - large[1].u.x.array).max(initial=0.0)
    assert scale > 0
    assert largest(COMM, float(off)) < 1e-8 * scale
    for field, values in large[2].items():
        power = 2 if field == "energy_density" else 1
        top = largest(COMM, float(np.abs(values).max(initial=0.0)))
        off = np.abs(tiny[2][field] / TINY**power - values).max(initial=0.0)
        assert largest(COMM, float(off)) < 1e-7 * top, field
    # Reactions of a body that is warmed are in balance with themselves: round-off of its stress.
    area = 0.02**2 if large[0].body.dim == 3 else 0.1 * 0.02
    top = area * largest(COMM, float(np.abs(large[2]["cauchy_stress"]).max(initial=0.0)))
    for label, force in large[1].reactions.items():
        found = tiny[1].reactions[label] / TINY
        np.testing.assert_allclose(found, force, rtol=0, atol=1e-7 * top)
