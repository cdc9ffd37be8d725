"""The cyclic curve of a metal at a point, against the closed form of uniaxial stress."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dolfin_elastic import J2, Hencky, J2Logarithmic
from dolfin_elastic.case.material_report import usual_stretch, write
from dolfin_elastic.cli.console_materials import as_json, report_table
from dolfin_elastic.model.materials.plasticity import Plastic
from dolfin_elastic.model.point.cyclic_curve import CyclicCurve, cyclic_curve
from dolfin_elastic.model.point.report import material_report
from dolfin_elastic.report.laws import materials_of

pytestmark = pytest.mark.usefixtures("serial_only")

E, NU, YIELD, H, KIN = 200e9, 0.3, 250e6, 2e9, 5e9
KINDS: list[tuple[type[Plastic], float]] = [
    (J2, 0.0),
    (J2, KIN),
    (J2Logarithmic, 0.0),
    (J2Logarithmic, KIN),
]
TIGHT = 1e-8
"""Of what follows from a strain to round-off; the tangent is that of a step of 1e-14."""


def metal(kind: type[Plastic], **keys: Any) -> Plastic:
    return kind(E=E, nu=NU, **{"yield_stress": YIELD, "hardening": H, **keys})


def closed_form(curve: CyclicCurve, kinematic: float) -> tuple[np.ndarray, np.ndarray]:
    """Stress and equivalent plastic strain of linear hardening, from turn to turn.

    On the way from a turn the stress rises with E up to the limit b +- (yield + H a), then with
    E (H + kinematic)/(E + H + kinematic), b the back stress and a the plastic strain there.
    """
    p = a = 0.0
    stress, plastic = [], []
    for strain in curve.strain:
        trial = E * (strain - p) - kinematic * p
        grown = max(abs(trial) - YIELD - H * a, 0.0) / (E + kinematic + H)
        p, a = p + math.copysign(grown, trial), a + grown
        stress.append(E * (strain - p))
        plastic.append(a)
    return np.array(stress), np.array(plastic)


@pytest.mark.parametrize(("kind", "kinematic"), KINDS)
def test_a_curve_is_that_of_the_closed_form(kind: type[Plastic], kinematic: float) -> None:
    largest = 1.012
    keys = {"kinematic": kinematic} if kinematic else {}
    curve = cyclic_curve(metal(kind, **keys), largest)
    assert curve is not None
    stress, plastic = closed_form(curve, kinematic)
    assert curve.stress == pytest.approx(stress, rel=TIGHT, abs=TIGHT * YIELD)
    assert curve.plastic == pytest.approx(plastic, rel=TIGHT, abs=1e-13)
    # Two and a half cycles, as far each way.
    most = largest - 1 if kind is J2 else math.log(largest)
    turns = curve.strain[np.flatnonzero(np.abs(np.abs(curve.strain) - most) < 1e-12)]
    assert np.sign(turns).tolist() == [1, -1, 1, -1, 1]
    # Numbers: E H/(E + H), and the stress as far from the back stress the other way.
    slope = H + kinematic
    assert curve.yields == pytest.approx(YIELD, rel=TIGHT)
    assert curve.tangent == pytest.approx(E * slope / (E + slope), rel=TIGHT)
    turned = YIELD + E * slope / (E + slope) * (most - YIELD / E)
    back = kinematic * (most - turned / E)
    assert curve.turned == pytest.approx(turned, rel=TIGHT)
    assert curve.again == pytest.approx(2 * back - turned, rel=TIGHT)
    assert curve.bauschinger == pytest.approx(1 - 2 * back / turned, rel=TIGHT)


@pytest.mark.parametrize("kind", [J2, J2Logarithmic])
def test_curved_hardening(kind: type[Plastic]) -> None:
    """Voce's law: on the first pull the stress is that of the curve at the plastic strain."""
    voce = {"saturation": 350e6, "rate": 200, "slope": 1e9}
    curve = cyclic_curve(metal(kind, hardening=voce), 1.02)
    assert curve is not None
    first = slice(1, int(np.argmax(curve.strain)) + 1)
    a = curve.plastic[first]
    wanted = YIELD + 1e9 * a + 100e6 * (1 - np.exp(-200 * a))
    assert curve.stress[first] == pytest.approx(wanted, rel=TIGHT)
    assert curve.strain[first] == pytest.approx(wanted / E + a, rel=TIGHT)
    slope = 1e9 + 200 * 100e6
    assert curve.tangent == pytest.approx(E * slope / (E + slope), rel=TIGHT)


def test_lateral_strain_and_cauchy_stress() -> None:
    """Plastic strains keep the volume, so that J is that of Hooke's law."""
    curve = cyclic_curve(metal(J2Logarithmic), 1.012)
    assert curve is not None
    J = np.exp((1 - 2 * NU) * curve.stress / E)
    assert curve.stretch * curve.lateral**2 == pytest.approx(J, rel=1e-12)
    assert J * curve.cauchy == pytest.approx(curve.stress, rel=1e-12)


def test_what_has_no_cycles() -> None:
    """Elastic laws, and a metal that is not strained up to its yield stress."""
    assert cyclic_curve(Hencky(E=E, nu=NU), 1.02) is None
    assert cyclic_curve(metal(J2), 1 + 0.99 * YIELD / E) is None


def test_a_viscous_metal_is_strained_slowly() -> None:
    curve = cyclic_curve(metal(J2, plastic_viscosity=1e9), 1.012)
    assert curve is not None
    assert curve.stress == pytest.approx(closed_form(curve, 0.0)[0], rel=TIGHT, abs=TIGHT * YIELD)
    report = material_report(metal(J2, plastic_viscosity=1e9), largest=1.012)
    (cycles,) = (f for f in report.findings if f.check == "cycles")
    assert cycles.text.endswith("without the stress of its viscosity")


def test_a_curve_is_told_and_written(tmp_path: Path) -> None:
    law = metal(J2, kinematic=KIN)
    assert usual_stretch(law) == pytest.approx(1 + 10 * YIELD / E)
    report = material_report(law, largest=1.0125)
    (cycles,) = (f for f in report.findings if f.check == "cycles")
    assert "between strains of 1.25 and -1.25 %" in cycles.text
    assert "tangent modulus after yield is 6.763 GPa" in cycles.text
    assert "Bauschinger's effect: " in cycles.text
    *_, table, picture = write("steel", report, tmp_path)
    assert (table.name, picture.name) == ("steel_cyclic.csv", "steel_cyclic.png")
    assert picture.stat().st_size > 10_000
    rows = np.genfromtxt(table, delimiter=",", names=True)
    assert report.cyclic is not None
    assert rows["stress"] == pytest.approx(report.cyclic.stress, rel=1e-10)
    read = json.loads(as_json(report_table(report)))
    assert read["cyclic"]["plastic_strain"][-1] == pytest.approx(report.cyclic.plastic[-1])


def test_the_report_draws_cycles() -> None:
    steel = {"law": "linear-elastic", "E": E, "nu": NU}
    (one,) = materials_of({"materials": {"steel": steel}})
    (other,) = materials_of({"materials": {"steel": {**steel, "law": "j2", "yield": YIELD}}})
    assert len(other.charts) == len(one.charts) + 1
    assert any(name == "cycles" for name, _ in other.constants)
