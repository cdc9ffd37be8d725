"""Point masses: what is mounted on a body and not modelled, by its weight and inertia."""

from __future__ import annotations

from pydantic import Field

from dolfin_elastic.core.si_text import given
from dolfin_elastic.core.units import Mass
from dolfin_elastic.model.describe import ALONE, Setting, other_keys
from dolfin_elastic.model.values import OnSurfaces


class PointMass(OnSurfaces):
    """A mass that is mounted on surfaces, spread evenly over their undeformed area.

    It moves with them, has a weight where gravity acts on the whole body, and inertia in motion
    and modes.  It has no stiffness, and no moment of inertia beyond that of its spread.

    Attributes:
        mass: The total [kg]; in a plane on the whole thickness, of a body of revolution on the
            whole ring.

    Example:
        PointMass(on="right", mass="2 kg")
    """

    mass: Mass = Field(gt=0)

    def describe(self, setting: Setting = ALONE) -> str:
        """What it is."""
        return f"mounted mass of {given(self.mass, 'kg')}{other_keys(self, 'mass')}"

    @property
    def label(self) -> str:
        """Its name."""
        return self.name or f"mass_{'+'.join(self.surfaces)}"
