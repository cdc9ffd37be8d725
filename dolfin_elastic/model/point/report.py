"""All checks and homogeneous tests of one material."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.errors import InputError, keyed
from dolfin_elastic.core.help.notebook import Shown
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.point.checks import checks
from dolfin_elastic.model.point.cyclic_curve import CyclicCurve, cyclic_curve, cyclic_findings
from dolfin_elastic.model.point.ellipticity import ellipticity, energy_growth
from dolfin_elastic.model.point.homogeneous_tests import (
    DEFORMATION_MODES,
    ResponseCurve,
    response_curve,
)
from dolfin_elastic.model.point.tested import Finding, LawUnderTest
from dolfin_elastic.model.point.time_curves import TimeCurves, time_curves, time_findings
from dolfin_elastic.model.point.viscous_curves import ViscousCurves, viscous_curves

LARGEST = 2.0
_POINTS = 30


@dataclass(frozen=True)
class MaterialReport(Shown):
    """Results of all checks and homogeneous tests of a material.

    Attributes:
        law: The material.
        findings: One for each check.
        curves: Name of a mode to its response; empty if the law is not finite near F = I.
        notes: Remarks: warnings, replaced constants, ends of curves.
        viscous: Relaxation over time, storage and loss over frequency; None: nothing relaxes.
        over_time: Relaxation, creep and loops under uniaxial stress; None: time changes nothing.
        cyclic: Uniaxial stress of a metal that yields, over some cycles; None: nothing yields.
    """

    law: Law
    findings: tuple[Finding, ...]
    curves: dict[str, ResponseCurve]
    notes: tuple[str, ...]
    viscous: ViscousCurves | None = None
    over_time: TimeCurves | None = None
    cyclic: CyclicCurve | None = None

    @property
    def failed(self) -> tuple[Finding, ...]:
        """Checks that the material does not pass."""
        return tuple(f for f in self.findings if f.verdict == "fail")


def material_report(law: Law, *, largest: float = LARGEST) -> MaterialReport:
    """Checks a material at a point and computes its response curves and range of validity.

    Not collective; takes about a second, and some of a law that remembers by equations.

    Args:
        law: Any law whose constants are numbers.
        largest: Stretches go from 1/`largest` to `largest`, shears to `largest` - 1 both ways.

    Raises:
        InputError: Constants vary in space, the energy cannot be evaluated, or `largest` is not
            above 1.
    """
    if not largest > 1:
        raise InputError(
            f"{largest:g} is no largest stretch", where="--stretch", expected="above 1"
        )
    for name in law.spatial_constants():
        raise InputError(
            "this constant varies in space",
            where=name,
            expected="numbers: a material point has no coordinates",
        )
    tested = LawUnderTest(law)
    with keyed("energy"):
        findings = checks(tested)
    notes = [law.warning] if law.warning else []
    if tested.law is not law:
        notes.append("an infinite modulus was tried as 10000 times the others")
    if any(f.verdict == "fail" and f.check == "finite values" for f in findings):
        return MaterialReport(law, tuple(findings), {}, tuple(notes))
    with np.errstate(all="ignore"):
        curves = {
            mode.name: response_curve(tested.point, mode, mode.targets(largest, _POINTS))
            for mode in DEFORMATION_MODES
        }
        findings += [*energy_growth(tested), *ellipticity(tested, curves)]
        cyclic = cyclic_curve(tested.law, largest)
        over_time = time_curves(tested.law, largest)
    findings += [] if over_time is None else time_findings(over_time)
    findings += [] if cyclic is None else cyclic_findings(cyclic)
    notes += [end for curve in curves.values() for end in curve.ends]
    viscous = viscous_curves(law)
    return MaterialReport(law, tuple(findings), curves, tuple(notes), viscous, over_time, cyclic)
