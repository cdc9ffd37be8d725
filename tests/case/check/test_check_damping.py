"""What a check says of damping and added mass, beside what a run does."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import Problem, box_body
from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.damping import _rates, damping_of
from dolfin_elastic.case.check.report import report
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import total
from dolfin_elastic.mesh import Body
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.assembly.energy_momentum import lumped
from dolfin_elastic.solvers.dynamics.explicit.frequency_bound import FrequencyBound
from dolfin_elastic.solvers.dynamics.explicit.mass_scaling import scaled

COMM = MPI.COMM_WORLD
RUBBER = {"law": "neo-hookean", "E": 1e7, "nu": 0.3, "density": 1000}
CENTRAL = {"scheme": "central-differences", "end": 0.1}


def case(**motion: Any) -> Case:
    return Case.from_dict(
        {
            "mesh": {"box": {"size": [1, 1, 1], "cells": [4, 4, 4]}, "degree": 1},
            "materials": {"rubber": RUBBER},
            "support": [{"on": "left"}],
            "dynamics": {"initial_velocity": [0, "x", 0], **motion},
        }
    )


def thin(altitude: float) -> Body:
    """A box with a vertex near the middle, over a face of a cell by a fraction of the mesh size."""
    body = box_body(size=(1, 1, 1), cells=(4, 4, 4))
    x = body.mesh.geometry.x
    x[np.linalg.norm(x - 0.5, axis=1) < 1e-9] += (0.25 - 0.25 * altitude) * np.array([1.0, 0, 0])
    return body


@pytest.mark.parametrize("dim", [2, 3])
def test_the_bound_is_that_of_a_run(dim: int) -> None:
    """In closed form of two materials at rest; to round-off."""
    one = Case.from_dict(
        {
            "mesh": {
                "rectangle": {"size": [1, 1], "cells": [4, 4]},
                "degree": 1,
                "geometry": "plane-strain",
            }
            if dim == 2
            else {"box": {"size": [1, 1, 1], "cells": [4, 2, 2]}, "degree": 1},
            "regions": {"half": {"box": [[0] * dim, [0.5, 1, 1][:dim]]}},
            "materials": {
                "rubber": RUBBER,
                "lead": {**RUBBER, "nu": 0.45, "density": 11000, "on": "half"},
            },
            "dynamics": {**CENTRAL, "initial_velocity": [1] + [0] * (dim - 1)},
        }
    )
    body = one.read_body(COMM)
    problem = one.make_problem(body)
    assembler = Assembler(problem)
    mass = lumped(problem, assembler)
    expected = FrequencyBound(problem, assembler, mass).evaluate()
    rates, nodal = _rates(one, problem)
    for found, there in ((rates, expected), (nodal, mass[::dim])):
        sums = [total(COMM, np.array([x.sum(), (x**2).sum()])) for x in (found, there)]
        assert sums[0] == pytest.approx(sums[1], rel=1e-10)
    assembler.destroy()


@pytest.mark.parametrize("dt", [None, 4e-4])
def test_as_much_mass_as_a_run_adds(dt: float | None) -> None:
    keys = {} if dt is None else {"dt": dt}
    one = case(**CENTRAL, mass_scaling=0.6, **keys)
    problem: Problem = one.make_problem(thin(0.02))
    (line,), notes = damping_of(one, problem)
    assert not notes
    assembler = Assembler(problem)
    mass = lumped(problem, assembler)
    found = scaled(problem, assembler, mass, most=0.6, dt=dt)
    assembler.destroy()
    added = 100 * found.numbers["added_mass_fraction"]
    assert added > 0.1
    assert line.startswith(f"mass scaling: about {added:.2g} % of the mass at ")
    assert "most at (0.7" in line


def test_what_a_run_would_refuse_is_noted() -> None:
    one = case(**CENTRAL, mass_scaling="0.1 %", dt=1e-3)
    _, (note,) = damping_of(one, one.make_problem(thin(0.02)))
    assert "above the limit of 0.1 %: a run would be refused" in note
    line = damping_of(case(**CENTRAL, mass_scaling="1 %"), one.make_problem(thin(1.0)))
    assert line == (["mass scaling: no element is thin, and no mass is added"], [])


def test_ratios_of_rayleigh_damping() -> None:
    """a/(2 w) + b w/2 at sqrt(E/rho)/2 = 50 Hz, at the least, at ten steps a period."""
    rayleigh = [2.0, 1e-4]
    found = report(case(end=1.0, dt="1 ms", rayleigh=rayleigh))
    a, b = rayleigh
    least = np.sqrt(a / b)
    waves = {50.0: "a wave along the part", least / (2 * np.pi): "the least", 100.0: "10 steps"}
    for f, what in waves.items():
        ratio = 100 * (a / (4 * np.pi * f) + b * np.pi * f)
        assert f"{ratio:.2g} % at {f:.3g} Hz ({what}" in found.damping[0]
    assert not any("damping ratio" in note for note in found.notes)


@pytest.mark.parametrize(("rayleigh", "key"), [([2000, 0], "mass"), ([0, 0.1], "stiffness")])
def test_an_overdamped_part_is_noted(rayleigh: list[float], key: str) -> None:
    """What is named gives 2 %, to the two digits that it has."""
    found = report(case(end=1.0, dt="1 ms", rayleigh=rayleigh))
    (note,) = (one for one in found.notes if one.startswith("dynamics.rayleigh: "))
    assert "creeps and does not vibrate" in note
    usual = float(note.rpartition(f"{key} = ")[2])
    a, b = (usual, 0.0) if key == "mass" else (0.0, usual)
    w = 2 * np.pi * 50
    assert a / (2 * w) + b * w / 2 == pytest.approx(0.02, rel=0.05)


def test_bulk_viscosity() -> None:
    found = report(case(**CENTRAL, bulk_viscosity=0.06))
    assert "ratio 0.06 of the volume mode" in found.damping[0]
    assert "at most 0.94 of that without" in found.damping[0]
    much = report(case(**CENTRAL, bulk_viscosity=1.5))
    assert any("above critical damping of an element" in note for note in much.notes)


def test_bodies_without_a_bound_are_refused() -> None:
    tables: dict[str, Any] = {
        "mesh": {"rectangle": {"size": [1, 1], "cells": [2, 2]}, "degree": 1},
        "materials": {"rubber": RUBBER},
        "dynamics": {**CENTRAL, "mass_scaling": 0.1, "initial_velocity": [0, 1]},
    }
    tables["mesh"]["geometry"] = "axisymmetric"
    with pytest.raises(InputError, match="which are not known in bodies of revolution"):
        report(Case.from_dict(tables))
