"""Extremes, means and integrals of fields over surfaces and regions against closed forms."""

from __future__ import annotations

import csv
from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from helpers.bodies import soft_and_hard
from mpi4py import MPI

from dolfin_elastic import Case, NeoHookean, Problem, box_body, rectangle_body, run
from dolfin_elastic.core.errors import ElasticError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.derived.part_numbers import PartNumbers
from dolfin_elastic.results.finished.run import column_unit

COMM = MPI.COMM_WORLD
ALL = ("max", "min", "mean", "integral")
LAW = NeoHookean(mu=80.0, lmbda=120.0)
H = np.array([[0.3, 0.1, 0.0], [0.0, -0.1, 0.0], [0.0, 0.0, 0.05]])


def state_of(problem: Problem, gradient: Any = H) -> State:
    u, dim = fem.Function(problem.V), problem.body.dim
    u.interpolate(lambda x: gradient[:dim, :dim] @ x[:dim])
    return State(1, 1.0, u)


@pytest.mark.parametrize("degree", [1, 2])
def test_a_linear_displacement_over_a_face_and_a_region(degree):
    """u = H X over the face x = 2 of area 1 x 1.5, and over the half x > 1 of volume 1.5."""
    body = soft_and_hard(box_body(size=(2, 1, 1.5), cells=(4, 2, 2)), at=1.0)
    problem = Problem(body, LAW, degree=degree)
    state = state_of(problem)
    names = ("displacement", "jacobian")
    face = PartNumbers(problem, "surface", "right", names, ALL)(state)
    region = PartNumbers(problem, "region", "hard", names, ALL)(state)
    for found, middle, size, over, low in (
        (face, [2, 0.5, 0.75], 1.5, "area", 2.0),
        (region, [1.5, 0.5, 0.75], 1.5, "volume", 1.0),
    ):
        mean = H @ middle
        corners = np.array([[x, y, z] for x in (low, 2) for y in (0, 1) for z in (0, 1.5)]) @ H.T
        close = {"rtol": 1e-12, "atol": 1e-14}
        np.testing.assert_allclose(found["displacement_mean"], mean, **close)
        np.testing.assert_allclose(found[f"displacement_{over}_integral"], size * mean, **close)
        np.testing.assert_allclose(found["displacement_max"], corners.max(axis=0), **close)
        np.testing.assert_allclose(found["displacement_min"], corners.min(axis=0), **close)
        lengths = np.linalg.norm(corners, axis=1)
        np.testing.assert_allclose(found["displacement_length_max"], lengths.max(), **close)
        np.testing.assert_allclose(found["displacement_length_min"], lengths.min(), **close)
        J = np.linalg.det(np.eye(3) + H)
        np.testing.assert_allclose(found[f"jacobian_{over}_integral"], size * J, **close)


def test_a_soft_material_has_its_own_extremes():
    """Beside one that is a thousand times as stiff: its nodes there show the other's stress."""
    body = soft_and_hard(box_body(size=(2, 1, 1.5), cells=(4, 2, 2)), at=1.0)
    stiff = NeoHookean(mu=8e4, lmbda=1.2e5)
    state = state_of(problem := Problem(body, {"soft": LAW, "hard": stiff}, degree=1))
    largest = {
        part: PartNumbers(problem, "region", part, ("von_mises",), ("max", "min"))(state)
        for part in ("soft", "hard")
    }
    soft, hard = largest["soft"], largest["hard"]
    np.testing.assert_allclose(hard["von_mises_max"], 1000 * soft["von_mises_max"], rtol=1e-9)
    np.testing.assert_allclose(soft["von_mises_max"], soft["von_mises_min"], rtol=1e-9)


def test_no_mean_is_beyond_the_extremes():
    """Recovered at the nodes of a face, a stress that goes up and down was 7 % below its mean."""
    problem = Problem(box_body(size=(2, 1, 1.5), cells=(4, 2, 2)), LAW, degree=1)
    u, k = fem.Function(problem.V), 2 * np.pi
    u.interpolate(
        lambda x: [0 * x[0], 0.1 * x[0] + 0.01 * np.cos(k * x[0]) * np.cos(k * x[1]), 0 * x[0]]
    )
    values = ("mean", "max", "min")
    numbers = PartNumbers(problem, "surface", "right", ("max_principal_stress",), values)
    mean, high, low = numbers(State(1, 1.0, u)).values()
    assert low < mean <= high * (1 + 1e-14)  # the sum of the integral is rounded
    assert mean == pytest.approx(8.915585347225768, rel=1e-9)


def test_a_quadratic_displacement_is_integrated_exactly():
    """u_x = x^2 over the region 1 < x < 2 and the face y = 0: 7/3 times the cross section."""
    body = soft_and_hard(box_body(size=(2, 1, 1.5), cells=(4, 2, 2)), at=1.0)
    problem = Problem(body, LAW, degree=2)
    u = fem.Function(problem.V)
    u.interpolate(lambda x: np.array([x[0] ** 2, 0 * x[0], 0 * x[0]]))
    state = State(1, 1.0, u)
    region = PartNumbers(problem, "region", "hard", ("displacement",), ("integral",))(state)
    face = PartNumbers(problem, "surface", "front", ("displacement",), ("integral",))(state)
    assert region["displacement_volume_integral"][0] == pytest.approx(7 / 3 * 1.5, rel=1e-12)
    assert face["displacement_area_integral"][0] == pytest.approx(8 / 3 * 1.5, rel=1e-12)


@pytest.mark.parametrize(
    ("geometry", "thickness", "area", "volume"),
    [("plane-strain", 0.1, 0.1, 0.1), ("axisymmetric", 1.0, 4 * np.pi, 3 * np.pi)],
)
def test_plane_and_round_bodies(geometry, thickness, area, volume):
    """Thickness 0.1; or the ring between r = 1 and 2 of height 1. det F = 1 is their measure."""
    body = rectangle_body(size=(1, 1), cells=(3, 2), origin=(1, 0))
    body = soft_and_hard(body, at=5.0)
    problem = Problem(body, LAW, degree=1, geometry=geometry, thickness=thickness)
    state = state_of(problem, np.zeros((3, 3)))
    face = PartNumbers(problem, "surface", "right", ("jacobian",), ALL)(state)
    region = PartNumbers(problem, "region", "soft", ("jacobian", "normal"), ALL)(state)
    assert face["jacobian_area_integral"] == pytest.approx([area], rel=1e-12)
    assert region["jacobian_volume_integral"] == pytest.approx([volume], rel=1e-12)
    assert region["jacobian_mean"] == pytest.approx([1.0], rel=1e-12)
    assert len(region["normal_max"]) == 2


def test_derived_and_recovered_fields():
    """Of a homogeneous state all but the integral are its value."""
    body = soft_and_hard(box_body(size=(2, 1, 1.5), cells=(4, 2, 2)), at=1.0)
    problem = Problem(body, LAW, degree=1)
    L = np.array([1.3, 0.9, 1.05])
    state = state_of(problem, np.diag(L - 1))
    sigma = (80 * (L**2 - 1) + 120 * np.log(np.prod(L))) / np.prod(L)
    values = PartNumbers(
        problem, "surface", "right", ("tresca", "principal_stretches", "material"), ALL
    )(state)
    assert values["tresca_mean"] == pytest.approx([max(sigma) - min(sigma)], rel=1e-10)
    assert values["tresca_max"] == pytest.approx([max(sigma) - min(sigma)], rel=1e-10)
    assert values["principal_stretches_mean"] == pytest.approx([1.3, 1.05, 0.9], rel=1e-12)
    assert values["principal_stretches_min"] == pytest.approx([1.3, 1.05, 0.9], rel=1e-12)
    assert values["material_max"] == pytest.approx([0.0])


def case(**probes: Any) -> dict[str, Any]:
    return {
        "mesh": {"box": {"size": [2, 1, 1.5], "cells": [3, 2, 2]}, "degree": 1},
        "materials": {"rubber": {"law": "neo-hookean", "mu": 80.0, "lambda": 0.0}},
        "support": [{"on": "left"}],
        "load": [{"kind": "traction", "on": "right", "value": [20.0, 0, 0]}],
        "statics": {"steps": 2, "rtol": 1e-12},
        "output": {"probes": probes},
    }


def test_the_integral_of_the_traction_is_the_applied_force(folder):
    """P N over the pulled face: 20 Pa times 1.5 m^2, and the reaction of the other end."""
    tables = case(
        end={"on": "right", "fields": ["first_piola"], "values": ["integral", "mean"]},
        grip={"on": "left", "fields": ["first_piola", "reaction"], "values": ["integral"]},
        middle={"on": "right", "fields": ["tresca"]},
        half={"on": "right", "fields": ["tresca", "displacement"], "values": ["percentile:50"]},
    )
    assert list(run(Case.from_dict(tables), output=folder))

    def compare() -> None:
        *_, row = csv.DictReader((folder / "history.csv").open())
        assert float(row["end_first_piola_area_integral_xx"]) == pytest.approx(30.0, rel=1e-9)
        assert float(row["end_first_piola_mean_xx"]) == pytest.approx(20.0, rel=1e-9)
        assert float(row["grip_first_piola_area_integral_xx"]) == pytest.approx(30.0, rel=1e-9)
        assert float(row["grip_reaction_x"]) == pytest.approx(-30.0, rel=1e-9)
        # Without a second Lame constant the cross section, and so the stress, stays as it is.
        assert float(row["middle_tresca"]) == pytest.approx(20.0, rel=1e-9)
        units = {name: column_unit(name, timed=False) for name in row}
        assert float(row["half_tresca_percentile_50"]) == pytest.approx(20.0, rel=1e-9)
        assert float(row["half_displacement_percentile_50_x"]) > 0
        assert units["half_tresca_percentile_50"] == "Pa"
        assert units["half_displacement_percentile_50_x"] == "m"
        assert units["half_displacement_length_percentile_50"] == "m"
        assert units["end_first_piola_area_integral_xx"] == "Pa m^2"
        assert units["end_first_piola_mean_xx"] == "Pa"
        assert units["grip_reaction_x"] == "N"
        assert units["middle_tresca"] == "Pa"

    on_root(COMM, compare)


@pytest.mark.parametrize(
    ("probe", "where", "message"),
    [
        ({"on": "right", "values": ["maks"]}, "output.probes.p.values[0]", "unknown value 'maks'"),
        (
            {"on": "right", "values": ["percentile:101"]},
            "output.probes.p.values[0]",
            "expected a number from 0 to 100 behind the colon, for example 'percentile:95'",
        ),
        ({"at": [1, 0, 0], "values": ["max"]}, "output.probes.p.values", "this is a point"),
        ({"on": "right", "fields": ["rank"]}, "output.probes.p.fields", "cannot read 'rank'"),
        ({"on": "right", "fields": ["trsca"]}, "output.probes.p.fields", "tresca"),
        ({"on": "rigth", "values": ["max"]}, "output.probes.p.on", "right"),
    ],
)
def test_wrong_numbers_are_refused(folder, probe, where, message):
    with pytest.raises(ElasticError) as caught:
        list(run(Case.from_dict(case(p=probe)), output=folder))
    assert where in str(caught.value)
    assert message in str(caught.value)
