"""What the estimated error does not see: that linear elements lock.

The recovered stress is an improvement of a solution that has the right form.  Near nu = 1/2 linear
elements without a pressure hardly move, and the recovered stress with them: the estimate is that of
the small stress which is left.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.mesh.body import cell_size, span
from dolfin_elastic.problem.material_regions import STIFF_IN_VOLUME, locking, poisson

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem

_SEEN = 1.6
"""Largest factor of stiffness by locking up to which the estimate is right.

Found with a thick sphere, a thick tube and a clamped block in bending, in the plane and in space,
at nu = 0.3 to 0.4999: below it the estimate is 0.91 to 1.3 times the true error, above it 0.17 to
0.9 times.  Of quadratic elements it is 0.9 to 1.1 times it at all of these (0.6 to 0.7 times at the
corners of a clamp, as at nu = 0.3), so that nothing need be said of them.
"""


@dataclass(frozen=True)
class Locking:
    """That the estimated error is too small, because linear elements lock.

    Attributes:
        part: Name of the material.
        nu: Its Poisson's ratio.
        up_to: What the relative error in the energy norm may be.
    """

    part: str
    nu: float
    up_to: float

    def cause(self) -> str:
        """Why, for people."""
        return f"linear elements lock at nu = {self.nu:g} ('{self.part}')"

    def text(self) -> str:
        """It for people."""
        return f"{self.cause()}, which this estimate does not see: up to {100 * self.up_to:.2g} %"


def unseen_locking(problem: Problem, relative: float) -> Locking | None:
    """What locking may add to an estimated error; None where the estimate is right. Collective.

    The energy of a body under forces falls by the factor f by which it is too stiff: with the
    estimated share e^2 of the rest the error is 1 - (1 - e^2)/f of the true energy, f of
    `material_regions.locking`, the largest that was found.

    Args:
        relative: Estimated relative error in the energy norm.
    """
    if problem.degree > 1 or problem.geometry == "plane-stress" or not np.isfinite(relative):
        return None
    across = span(problem.body) / cell_size(problem.body)
    loose = [part for part in problem.regions if part.compliance is None]
    stiff = [part for part in loose if poisson(part.typical) > STIFF_IN_VOLUME - 1e-9]
    if not stiff:
        return None
    worst = max(stiff, key=lambda part: poisson(part.typical))
    nu = poisson(worst.typical)
    factor = locking(nu, across)[1]
    if factor <= _SEEN:
        return None
    return Locking(worst.name, nu, float(np.sqrt(1 - max(1 - relative**2, 0.0) / factor)))
