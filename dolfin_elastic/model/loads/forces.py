"""Dead loads: forces per reference area or volume, and weight."""

from __future__ import annotations

from functools import cached_property
from typing import Any, ClassVar, Literal

import ufl
from pydantic import Field
from ufl.core.expr import Expr

from dolfin_elastic.model.components import Component, components
from dolfin_elastic.model.loads.base import Load, Site


class Traction(Load):
    """Dead traction: force per reference area [Pa], fixed in direction.

    The virtual work is the integral of t . v over the reference surface, so the total force is
    t times the reference area however the body deforms.
    """

    kind: Literal["traction"] = "traction"
    on: str | list[str]
    unit: ClassVar[str] = "Pa"

    def virtual_work(self, site: Site) -> ufl.Form:
        """See the class."""
        return ufl.inner(self.field(site), site.v) * site.areas(self.parts)


class BodyForce(Load):
    """Force per reference volume [N/m^3], on regions or on the whole body."""

    kind: Literal["body-force"] = "body-force"
    on: str | list[str] | None = None
    unit: ClassVar[str] = "N/m^3"

    def virtual_work(self, site: Site) -> ufl.Form:
        """See the class."""
        return ufl.inner(self.field(site), site.v) * site.volumes(self.parts)


class Gravity(Load):
    """Weight: density times an acceleration [m/s^2], on regions or on the whole body.

    Without a value it is 9.81 m/s^2 downwards, against the last axis (z, or y in a plane).
    """

    kind: Literal["gravity"] = "gravity"
    value: list[Any] = Field(default=[])
    on: str | list[str] | None = None
    unit: ClassVar[str] = "m/s^2"
    needs_density: ClassVar[bool] = True

    @cached_property
    def values(self) -> tuple[Component, ...]:
        """The components; none stands for the standard weight."""
        return components(self.value, self.unit) if self.value else ()

    def field(self, site: Site) -> Expr:
        """The acceleration as a UFL expression."""
        down = (0.0,) * (len(site.v) - 1) + (-9.81,)
        return site.vector(self.values or down, self.amplitude)

    def virtual_work(self, site: Site) -> ufl.Form:
        """See the class."""
        g = self.field(site)
        return sum(rho * ufl.inner(g, site.v) * dx for rho, dx in site.densities(self.parts))
