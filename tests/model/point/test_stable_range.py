"""Up to which stretches a material is stable, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.laws import make
from scipy.optimize import brentq

from dolfin_elastic import MooneyRivlin, StVenantKirchhoff, Yeoh
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.model.point.stable_range import LARGEST, limits, stable_ranges

pytestmark = pytest.mark.usefixtures("serial_only")
GRID = LARGEST ** (1 / 24)
"""Ratio of neighbouring stretches: bounds are the last stable ones of the grid."""
C10, C01 = -0.25e6, 0.9e6


def within_a_step(low: float, high: float, bounds: tuple[float, float]) -> None:
    """The range ends inside the true one, at most a step before its ends."""
    for found, exact in ((1 / low, 1 / bounds[0]), (high, bounds[1])):
        if exact < LARGEST:
            assert found <= 1.002 * exact < 1.003 * GRID * found
        else:
            assert found == pytest.approx(LARGEST)


def test_mooney_rivlin_with_a_negative_constant():
    """Incompressible: c10 + c01 s^2 > 0 for each stretch s, and a force that rises.

    Baker and Ericksen's inequalities are those of ellipticity here; the force of a bar,
    2 (s - 1/s^2) (c10 + c01/s), has its maximum where c10 (1 + 2/s^3) + 3 c01/s^4 = 0.
    Source: P. Rosakis, Arch. Ration. Mech. Anal. 109 (1990) 1; R. W. Ogden, Non-linear Elastic
    Deformations (1984), section 4.3.
    """
    least = np.sqrt(-C10 / C01)
    top = brentq(lambda s: C10 * (1 + 2 / s**3) + 3 * C01 / s**4, 1.2, 3.0)
    uniaxial, equibiaxial, shear = stable_ranges(MooneyRivlin(c10=C10, c01=C01, nu=0.4999))
    # Squeezed to s a bar has sides of s^-1/2; of a sheet the thickness is s^-2.
    within_a_step(uniaxial.low, uniaxial.high, (least, top))
    assert equibiaxial.high <= 1.002 * least**-0.5 < 1.003 * GRID * equibiaxial.high
    assert not uniaxial.whole
    assert not equibiaxial.whole
    assert shear.whole


def test_st_venant_kirchhoff():
    """The stress E s (s^2 - 1)/2 of a bar falls below s = 1/sqrt(3)."""
    found = stable_ranges(StVenantKirchhoff(E=1e6, nu=0.0))[0]
    within_a_step(found.low, found.high, (3**-0.5, LARGEST * 2))


@pytest.mark.long
def test_what_limits_a_law_is_named():
    law = MooneyRivlin(c10=C10, c01=C01, nu=0.49)
    assert law.destabilising() == ("c10 = -2.5e+05 Pa",)
    assert "(uniaxial)" in limits(law)
    assert "(equibiaxial)" in limits(law)
    soft = Yeoh(c10=0.19e6, c20=-0.05e6, nu=0.49)
    assert soft.destabilising() == ("c20 = -5e+04 Pa",)
    assert "(simple-shear)" in limits(soft)
    # c30 makes up for it: there is nothing to say.
    assert limits(Yeoh(c10=0.19e6, c20=-0.02e6, c30=5e3, nu=0.49)) == ""


@pytest.mark.long
@pytest.mark.parametrize("name", [n for n, law in MATERIALS.items() if not law.linear])
def test_laws_that_are_not_said_to_be_limited_are_stable(name):
    law = make(name)
    assert bool(limits(law)) == law.limited
