"""Warmth and growth: no stress where nothing holds, the known stress where everything does."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
import ufl
from helpers.annulus import FREE
from mpi4py import MPI

from dolfin_elastic import (
    Dynamics,
    Growth,
    LinearElastic,
    NeoHookean,
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
from dolfin_elastic.mesh.selectors import PointSelector
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


@pytest.mark.long
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


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("load", [Thermal, Growth])
def test_another_formula_compiles_nothing(load, dim, monkeypatch):
    """Formulas are evaluated: residual, tangent and energy are the same forms with any of them."""
    known = "1000 ppm/K"

    def forms(formula):
        # UFL sorts constants by their numbers' digits: they are to be those of another process.
        monkeypatch.setattr(ufl.Constant, "_counter", itertools.count(1000))
        value = formula if load is Thermal else [formula, 1, 1]
        law = StVenantKirchhoff(E=E, nu=NU, expansion=known)
        form = Problem(box(dim), law, supports=planes(dim), loads=[load(value=value)]).weak_form
        return [
            getattr(form, name).signature() for name in ("residual", "tangent", "strain_energy")
        ]

    assert forms("1 + x*t") == forms("1.5 - t*exp(-x*y)/3")


def test_uneven_warmth_without_stress():
    """T = G y bends a free plate and leaves it without stress: u = alpha G (x y, (y^2 - x^2)/2).

    Temperatures that are linear in x and y do so in plane stress: B. A. Boley and J. H. Weiner,
    Theory of Thermal Stresses (1960), section 9.3.  Quadratic elements contain this u.
    """
    G = 20.0
    body = name_parts(
        rectangle_body(size=(2, 1), cells=(4, 3)), points={"corner": PointSelector(nearest=(0, 0))}
    )
    problem = Problem(
        body,
        LinearElastic(**ALIKE),
        supports=[
            Support(on="left", displacement=[0, FREE]),
            Support(on="corner", displacement=[FREE, 0]),
        ],
        loads=[Thermal(value=f"{G}*y*t")],
        degree=2,
        geometry="plane-stress",
    )
    *_, state = Statics(problem, steps=2).steps()
    x, y = problem.places[:, :2].T
    exact = ALPHA * G * np.column_stack([x * y, (y**2 - x**2) / 2])
    assert largest(problem, problem.u.x.array.reshape(-1, 2) - exact) < 1e-12
    stress = Evaluator(problem, ["cauchy_stress"])(state)["cauchy_stress"]
    assert largest(problem, stress) < 1e-11 * E


@pytest.mark.parametrize("degree", [1, 2])
def test_warmth_may_jump_between_cells(degree):
    """A bar between walls, half of it warm: sigma = -E alpha dT/2, and u has a bend in the middle.

    To round-off: no cell of the cold half knows of the warmth beside it.
    """
    problem = Problem(
        rectangle_body(size=(2, 1), cells=(4, 2)),
        LinearElastic(E=E, nu=0.0, expansion=ALPHA),
        supports=[
            *(Support(on=name, displacement=[0, FREE]) for name in ("left", "right")),
            Support(on=["bottom", "top"], displacement=[FREE, 0]),
        ],
        loads=[Thermal(value=f"where(x < 1, {WARMER}, 0)")],
        degree=degree,
    )
    *_, state = Statics(problem).steps()
    assert state.reactions["right"][0] == pytest.approx(-E * STRAIN / 2, rel=1e-11)
    x = problem.places[:, 0]
    exact = STRAIN / 2 * np.minimum(x, 2 - x)
    assert largest(problem, problem.u.x.array.reshape(-1, 2)[:, 0] - exact) < 1e-13


@pytest.mark.long
@pytest.mark.parametrize("scheme", ["central-differences", "newmark"])
def test_warmth_by_a_formula_in_place_and_time(scheme):
    """As by a formula in place and a curve: in motion values are taken anew at each time."""
    ends = []
    for load in (
        Thermal(value="2e3*x*t"),
        Thermal(value="200*x", curve=[[0, 0], [0.1, 1]]),
    ):
        problem = Problem(
            rectangle_body(size=(1, 1), cells=(4, 4)),
            NeoHookean(E=E, nu=NU, density=1000.0, expansion=ALPHA),
            supports=[Support(on=["left", "right"])],
            loads=[load],
            degree=1,
        )
        step = {} if scheme == "central-differences" else {"dt": 0.01, "rtol": 1e-12}
        [*_] = Dynamics(problem, scheme=scheme, end=0.1, **step).steps()
        ends.append(problem.u.x.array.copy())
    assert largest(problem, ends[0]) > 1e-3
    assert largest(problem, ends[0] - ends[1]) < 1e-10


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
        (Growth, [[1, 2, 0], [2, 1, 0], [0, 0, 1]], "value: the determinant of this growth is -3"),
    ],
)
def test_what_is_no_growth(kind, value, says):
    with pytest.raises(InputError) as caught:
        kind(value=value)
    assert says in str(caught.value)
    assert Thermal(value="80 degC").values == (80.0,)
