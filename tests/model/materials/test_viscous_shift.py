"""Relaxation times that depend on temperature: WLF and Arrhenius, and time-temperature shift."""

from __future__ import annotations

import tomllib
from typing import Any

import numpy as np
import pytest

from dolfin_elastic import (
    Case,
    LinearElastic,
    NeoHookean,
    Problem,
    Statics,
    Support,
    Thermal,
    box_body,
)
from dolfin_elastic.case.check.materials import material_information
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.point.report import material_report
from dolfin_elastic.model.point.viscous_curves import ViscousCurves
from dolfin_elastic.model.relaxation import Shift

WLF: dict[str, Any] = {"law": "wlf", "C1": 17.44, "C2": "51.6 K", "reference": "373 K"}
ARRHENIUS: dict[str, Any] = {"law": "arrhenius", "energy": "100 kJ/mol", "reference": "293 K"}
SERIES = [{"ratio": 0.6, "time": 0.5}, {"ratio": 0.4, "time": 0.05}]


def factor(table: dict[str, Any], temperature: object) -> float:
    return Shift(**table, temperature=temperature).factor


# --- the factor ---


def test_wlf_is_its_closed_form() -> None:
    """At the reference 1; and with a reference moved by d, C1 C2/(C2 + d) and C2 + d are the same.

    The second is Ferry (1980), chapter 11, (24) and (25).
    """
    assert factor(WLF, "373 K") == 1.0
    T = np.linspace(343, 473, 14)
    wanted = 10 ** (-17.44 * (T - 373) / (51.6 + T - 373))
    assert [factor(WLF, x) for x in T] == pytest.approx(list(wanted), rel=1e-13)
    moved = {"law": "wlf", "C1": 17.44 * 51.6 / 101.6, "C2": 101.6, "reference": 423}
    assert [factor(moved, x) * factor(WLF, 423) for x in T] == pytest.approx(
        list(wanted), rel=1e-12
    )


def test_universal_constants_by_the_paper() -> None:
    """Williams, Landel & Ferry (1955): 17.44 and 51.6 K from the glass transition are 8.86 and
    101.6 K from 50 K above it; rounded as they are, C1 C2 agrees to 3e-4, and so does log a.
    """
    other = {"law": "wlf", "C1": 8.86, "C2": 101.6, "reference": 423}
    decades = Shift(**other, temperature=463).decades
    own = np.log10(factor(WLF, 463) / factor(WLF, 423))
    assert decades == pytest.approx(own, rel=4e-4)


def test_arrhenius_is_its_closed_form() -> None:
    """Ten kelvin of 100 kJ/mol near 20 degC are a factor of four, as a rule of thumb has it."""
    T = np.linspace(263, 323, 7)
    wanted = np.exp(1e5 / 8.31446261815324 * (1 / T - 1 / 293))
    assert [factor(ARRHENIUS, x) for x in T] == pytest.approx(list(wanted), rel=1e-13)
    assert factor(ARRHENIUS, 283) / factor(ARRHENIUS, 293) == pytest.approx(4, rel=0.1)


def test_temperatures_have_a_zero() -> None:
    """Numbers and kelvins from absolute zero, degrees Celsius and Fahrenheit from theirs."""
    one = Shift(**{**ARRHENIUS, "reference": "20 degC"}, temperature="68 degF")
    assert [one.reference, one.temperature] == pytest.approx([293.15, 293.15], rel=1e-14)
    assert one.factor == pytest.approx(1, abs=1e-12)


# --- a law ---


def law(temperature: object, table: dict[str, Any] = WLF, **keys: Any) -> NeoHookean:
    shift = {**table, "temperature": temperature}
    return NeoHookean(E=1e6, nu=0.3, viscous=SERIES, viscous_shift=shift, **keys)


def sheared(material: Any, dt: float) -> FloatArray:
    """Reactions of a cube that is sheared in three of eight steps and held then."""
    sides = ["left", "right", "front", "back", "bottom", "top"]
    curve = [[0, 0], [3 * dt, 1], [8 * dt, 1]]
    moved = Support(on=sides, displacement=["0.2*z", 0, 0], curve=curve)
    top = Support(on="top", displacement=[0.2, 0, 0], curve=curve)
    body = box_body(size=(1, 1, 1), cells=(2, 2, 2))
    problem = Problem(body, material, supports=[moved, top], degree=1)
    states = list(Statics(problem, steps=8, end=8 * dt).steps())
    return np.array([state.reactions["top"] for state in states[1:]])


@pytest.mark.long
@pytest.mark.parametrize(("table", "temperature"), [(WLF, 380.0), (ARRHENIUS, "0 degC")])
def test_a_body_at_two_temperatures(table: dict[str, Any], temperature: Any) -> None:
    """The same forces after times in the proportion of the factor: the master curve, shifted."""
    a, dt = factor(table, temperature), 0.03
    master = sheared(NeoHookean(E=1e6, nu=0.3, viscous=SERIES), dt)
    shifted = sheared(law(temperature, table), a * dt)
    size = np.abs(master).max()
    assert size > 1e4
    assert np.abs(shifted - master).max() < 1e-12 * size
    other = sheared(law(temperature, table), dt)
    assert np.abs(other - master).max() > 0.01 * size


def test_curves_and_report_are_those_of_the_temperature() -> None:
    """Relaxation, storage and loss over time and frequency that the factor multiplies."""
    a, t, omega = factor(WLF, 380), np.logspace(-3, 2, 11), np.logspace(-2, 3, 11)
    plain = LinearElastic(E=1, nu=0.3, viscous=SERIES)
    warm = LinearElastic(E=1, nu=0.3, viscous=SERIES, viscous_shift={**WLF, "temperature": 380})
    one, other = ViscousCurves(plain, t, omega, None), ViscousCurves(warm, a * t, omega / a, None)
    assert other.relaxation == pytest.approx(one.relaxation, rel=1e-13)
    assert other.storage == pytest.approx(one.storage, rel=1e-13)
    assert other.loss == pytest.approx(one.loss, rel=1e-13)
    (row,) = (f for f in material_report(warm).findings if f.check == "relaxation")
    assert row.values["times"] == pytest.approx([0.05 * a, 0.5 * a], rel=1e-13)


# --- in a case file ---

CASE: dict[str, Any] = {
    "mesh": {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}},
    "materials": {
        "gel": {
            "energy": "mu/2*(I1 - 3) - mu*ln(J) + mu*ln(J)^2",
            "parameters": {"mu": "1 MPa"},
            "viscous": SERIES,
            "viscous_shift": {**ARRHENIUS, "temperature": "30 degC"},
        }
    },
    "support": [{"on": "left"}],
    "statics": {"steps": 20},
}


def test_it_is_read_and_written_back() -> None:
    case = Case(**CASE)
    again = Case(**tomllib.loads(case.to_toml()))
    assert again.materials == case.materials
    text = "materials.gel.viscous_shift: at 303.1 K all times are 0.253 times those of 293 K"
    assert text in material_information(case)


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"law": "vft"}, "law: unknown|law.*wlf"),
        ({"C1": -1}, "C1: -1 is wrong; expected a number above 0"),
        ({"C2": "2 m"}, "C2: '2 m' has the wrong unit"),
        ({"C2": None}, "C2: this key of 'wlf' is missing"),
        ({"energy": 1}, "energy: 'wlf' has no such constant"),
        ({"law": "arrhenius"}, "C1: 'arrhenius' has no such constant"),
        (
            {"law": "arrhenius", "C1": None, "C2": None},
            "energy: this key of 'arrhenius' is missing",
        ),
        ({"temperature": 0}, "temperature: 0.0 is wrong; expected a number above 0"),
        ({"temperature": "-300 degC"}, 'temperature: "-300 degC" is wrong'),
        ({"temperature": 321.4}, "at 321.4 K nothing relaxes by 'wlf', whose limit is 321.4 K"),
        ({"temperature": 321.5}, "temperature: the times are shifted by 8.98e"),
        ({"temperature": "hot"}, "temperature: 'hot' is not a number"),
        ({"temperature": True}, "temperature: "),
        ({"reference": None}, "reference: "),
    ],
)
def test_refused(keys: dict[str, Any], text: str) -> None:
    table = {**WLF, "temperature": 380, **keys}
    given = {key: value for key, value in table.items() if value is not None}
    with pytest.raises(InputError, match=f"viscous_shift.*{text}"):
        NeoHookean(E=1, nu=0.3, viscous=SERIES, viscous_shift=given)


def test_nothing_to_shift() -> None:
    with pytest.raises(InputError, match="viscous_shift: nothing relaxes without `viscous`"):
        NeoHookean(E=1, nu=0.3, viscous_shift={**WLF, "temperature": 380})


def test_a_load_that_changes_the_temperature_is_refused() -> None:
    body = box_body(size=(1, 1, 1), cells=(1, 1, 1))
    with pytest.raises(InputError, match=r"load\[0\] \(thermal\) changes the temp") as caught:
        Problem(
            body, law(380, expansion=1e-5), supports=[Support(on="left")], loads=[Thermal(value=9)]
        )
    assert caught.value.where.endswith(".viscous_shift")
