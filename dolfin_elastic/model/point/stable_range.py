"""The stretches up to which a material is stable in homogeneous tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.point.ellipticity import PATHS, acoustic_eigenvalues
from dolfin_elastic.model.point.homogeneous_tests import (
    DEFORMATION_MODES,
    DeformationMode,
    ResponseCurve,
    response_curve,
)
from dolfin_elastic.model.point.tested import LawUnderTest

LARGEST = 2.0
"""Stretches are looked at from 1/`LARGEST` to it, shears up to `LARGEST` - 1."""
_POINTS = 24


@dataclass(frozen=True)
class StableRange:
    """Where a law is strongly elliptic and its force rises, in one homogeneous test.

    Attributes:
        mode: Kind of deformation.
        low: Smallest stable stretch (or shear) that was looked at.
        high: The largest one.
        whole: All that were looked at are stable.
    """

    mode: DeformationMode
    low: float
    high: float
    whole: bool

    def in_words(self) -> str:
        """For example "stretch 0.53 to 1.7 (uniaxial)"."""
        return f"{self.mode.symbol} {self.low:.2g} to {self.high:.2g} ({self.mode.name})"


def stable_ranges(law: Law) -> tuple[StableRange, ...]:
    """The stable range about the rest in each of `PATHS`.

    Stable means strongly elliptic, and that the nominal stress rises with the stretch: beyond its
    maximum a body under a dead load has no equilibrium, and one that is pulled necks.  Not
    collective; takes up to a second.

    Source: J. Marsden and T. Hughes, Mathematical Foundations of Elasticity (1983), section 4.3;
    R. Hill, J. Mech. Phys. Solids 5 (1957) 229 (loads that rise).
    """
    tested, modes = LawUnderTest(law), [mode for mode in DEFORMATION_MODES if mode.name in PATHS]
    with np.errstate(all="ignore"):
        return tuple(
            _range(tested, response_curve(tested.point, mode, mode.targets(LARGEST, _POINTS)))
            for mode in modes
        )


def _range(tested: LawUnderTest, curve: ResponseCurve) -> StableRange:
    stress = curve.P[:, *curve.mode.shown]
    good = (acoustic_eigenvalues(tested.point, curve.F) > 0) & rising(stress, curve.rest)
    low, high = curve.interval(good)
    whole = (low, high) == (0, len(good) - 1) and not curve.ends
    return StableRange(curve.mode, float(curve.values[low]), float(curve.values[high]), whole)


def rising(stress: AnyArray, rest: int) -> AnyArray:
    """Whether a stress rises from the neighbour on the side of the rest, shape (n,).

    Args:
        stress: Along one mode, shape (n,).
        rest: Index of the state at F = I.
    """
    rises = np.diff(stress) > 0
    good = np.ones(len(stress), dtype=bool)
    good[:rest], good[rest + 1 :] = rises[:rest], rises[rest:]
    return good


def limits(law: Law) -> str:
    """The stable ranges of a law in words, of the tests in which it does not stay stable.

    Returns:
        Empty where it is stable throughout.
    """
    return ", ".join(stable.in_words() for stable in stable_ranges(law) if not stable.whole)
