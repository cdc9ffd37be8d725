"""Warmth and growth: no stress where nothing holds, the known stress where everything does."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.annulus import FREE
from mpi4py import MPI

from dolfin_elastic import (
    Growth,
    LinearElastic,
    Problem,
    Selector,
    Statics,
    StVenantKirchhoff,
    Support,
    Thermal,
    box_body,
    name_parts,
    rectangle_body,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.results.evaluate import Evaluator

E, NU, ALPHA, WARMER = 1e6, 0.3, 1e-3, 50.0
STRAIN = ALPHA * WARMER
ALIKE: dict[str, Any] = {"E": E, "nu": NU, "expansion": "1000 ppm/K"}


def planes(dim: int) -> list[Support]:
    """Symmetry planes, which hinder no growth along the axes."""
    names = ["left", "front", "bottom"] if dim == 3 else ["left", "bottom"]
    return [
        Support(on=name, displacement=[0 if i == k else FREE for i in range(dim)])
        for k, name in enumerate(names)
    ]


def largest(problem: Problem, values: np.ndarray) -> float:
    return problem.body.comm.allreduce(float(np.abs(values).max(initial=0.0)), op=MPI.MAX)


def box(dim: int) -> Any:
    return (box_body if dim == 3 else rectangle_body)(size=(1,) * dim, cells=(2,) * dim)


@pytest.mark.sample(2)
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", ["linear-elastic", "st-venant-kirchhoff", "neo-hookean-split"])
@pytest.mark.parametrize("formulation", ["displacement", "mixed"])
def test_free_growth_is_free_of_stress(name, dim, formulation):
    """Warmth, and on top of it growth along the axes: every point goes where it wants to.

    Stretches multiply; small strains add up.
    """
    if formulation == "mixed" and name != "neo-hookean-split":
        pytest.skip("one law with a pressure tells")
    problem = Problem(
        box(dim),
        MATERIALS[name](**({"mu": E, "nu": NU, "expansion": ALPHA} if "split" in name else ALIKE)),
        supports=planes(dim),
        loads=[Thermal(value=WARMER), Growth(value=[1.1, 0.9, 1.0 + STRAIN])],
        degree=2,
        formulation=formulation,
        geometry="plane-strain" if dim == 3 else "plane-stress",
    )
    *_, state = Statics(problem, steps=2, rtol=1e-12, atol=1e-9).steps()
    warm, grown = 1 + STRAIN, np.array([1.1, 0.9, 1 + STRAIN])[:dim]
    stretch = warm + grown - 1 if name == "linear-elastic" else warm * grown
    x = problem.V.tabulate_dof_coordinates()[:, :dim]
    # Round-off, amplified by the condition of the tangent.
    assert largest(problem, problem.u.x.array.reshape(-1, dim) - (stretch - 1) * x) < 1e-11
    stress = Evaluator(problem, ["cauchy_stress"])(state)["cauchy_stress"]
    assert largest(problem, stress) < 1e-9 * E
    assert abs(state.energies["strain"]) < 1e-15 * E  # differences of numbers of the size of E


@pytest.mark.sample(1)
@pytest.mark.parametrize("geometry", ["solid", "plane-strain", "axisymmetric"])
def test_clamped_all_around(geometry):
    """sigma = -E alpha dT/(1 - 2 nu) in all directions, across the plane too."""
    dim = 3 if geometry == "solid" else 2
    problem = Problem(
        box(dim),
        LinearElastic(**ALIKE),
        supports=[Support(on=["left", "right", "bottom", "top"] + ["front", "back"] * (dim == 3))],
        loads=[Thermal(value=WARMER)],
        geometry="plane-strain" if dim == 3 else geometry,
        degree=1,
    )
    assert problem.linear
    *_, state = Statics(problem).steps()
    stress = Evaluator(problem, ["cauchy_stress"])(state)["cauchy_stress"]
    exact = -E * STRAIN / (1 - 2 * NU) * np.eye(3).ravel()
    assert largest(problem, stress.reshape(-1, 9) - exact) < 1e-11 * E


def test_bar_between_walls():
    """Held lengthwise only: sigma = -E alpha dT, reaction of the cross-section."""
    problem = Problem(
        box(3),
        LinearElastic(**ALIKE),
        supports=[*planes(3), Support(on="right", displacement=[0, FREE, FREE])],
        loads=[Thermal(value=f"{WARMER}*t")],
        degree=1,
    )
    *_, state = Statics(problem).steps()
    assert state.reactions["right"][0] == pytest.approx(-E * STRAIN, rel=1e-11)


def test_large_growth_held():
    """St. Venant-Kirchhoff that grew by g all around and is held: Fe = I/g, Jg = g^3, so
    P = g^3 g^-1 Fe S(Fe), S = (3 lmbda + 2 mu) (g^-2 - 1)/2 I.
    """
    g = 1.15  # at 1.18 this material gives way
    law = StVenantKirchhoff(E=E, nu=NU)
    problem = Problem(
        box(3),
        law,
        supports=[Support(on=["left", "right", "bottom", "top", "front", "back"])],
        loads=[Growth(value=[[g, 0, 0], [0, g, 0], [0, 0, g]])],
        degree=1,
    )
    *_, state = Statics(problem).steps()
    stress = Evaluator(problem, ["cauchy_stress"])(state)["cauchy_stress"]
    bulk = 3 * law.lmbda + 2 * law.mu
    exact = g**2 / g * bulk * (g**-2 - 1) / 2 * np.eye(3).ravel()
    assert largest(problem, stress.reshape(-1, 9) - exact) < 1e-11 * E


def test_bimetal():
    """Two strips of equal height and stiffness bend to the curvature 3/2 (a2 - a1) dT/h, h the
    height of both: Timoshenko, J. Opt. Soc. Am. 11 (1925), (5).  Plane stress, P2.

    The ends, free, disturb a length of h; the middle is a circle to 1e-3.
    """
    n, h = 40, 0.05
    body = name_parts(
        rectangle_body(size=(1, h), cells=(n, 4)),
        regions={
            "lower": Selector(box=((0, 0), (1, h / 2))),
            "upper": Selector(box=((0, h / 2), (1, h))),
        },
    )
    problem = Problem(
        body,
        LinearElastic(**ALIKE),
        supports=[Support(on="left")],
        loads=[Thermal(on="lower", value=1.0)],
        degree=2,
        geometry="plane-stress",
    )
    [*_] = Statics(problem).steps()
    x = problem.V.tabulate_dof_coordinates()
    u = problem.u.x.array.reshape(-1, 2)

    def height(at: float) -> float:
        near = np.flatnonzero(np.linalg.norm(x - [at, h / 2, 0], axis=1) < 1e-9)
        mine = u[near[0], 1] if len(near) else -np.inf
        return problem.body.comm.allreduce(float(mine), op=MPI.MAX)

    bent = (height(0.75) - 2 * height(0.5) + height(0.25)) / 0.25**2
    assert bent == pytest.approx(1.5 * ALPHA / h, rel=1e-3)


def test_only_where_it_is_said():
    """A region that cuts through the material; two loads on it multiply."""
    body = name_parts(
        rectangle_body(size=(2, 1), cells=(4, 2)),
        regions={"east": Selector(box=((1, 0), (2, 1)))},
    )
    problem = Problem(
        body,
        StVenantKirchhoff(E=E, nu=0.0),
        supports=[
            Support(on="left", displacement=[0, FREE]),
            Support(on=["bottom"], displacement=[FREE, 0]),
        ],
        loads=[Growth(on="east", value=[1.1, 1]), Growth(on="east", value=[1.2, 1])],
        degree=1,
    )
    [*_] = Statics(problem, steps=2, rtol=1e-12).steps()
    x = problem.V.tabulate_dof_coordinates()[:, 0]
    exact = 0.32 * np.maximum(x - 1, 0)
    assert largest(problem, problem.u.x.array.reshape(-1, 2)[:, 0] - exact) < 1e-10


def test_warmth_needs_a_coefficient():
    with pytest.raises(InputError) as caught:
        Problem(box(2), LinearElastic(E=E, nu=NU), loads=[Thermal(value=3)], degree=1)
    assert "materials.body.expansion: load[0] (thermal) needs a coefficient" in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "value", "says"),
    [
        (Thermal, "3 mm", "value: '3 mm' has the wrong unit"),
        (Thermal, [1, 2], "value: [1, 2] is not a number"),
        (Growth, [1.1], "value: [1.1] is no growth"),
        (Growth, [1.1, 0, 1], "value: a stretch must be above 0"),
        (Growth, [[1, 0], [0, 1], [1, 1]], "value: this is no 3x3 list"),
    ],
)
def test_what_is_no_growth(kind, value, says):
    with pytest.raises(InputError) as caught:
        kind(value=value)
    assert says in str(caught.value)
    assert Thermal(value="80 degC").values == (80.0,)
