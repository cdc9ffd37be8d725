"""Loads: one external virtual-work term each, and their table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
import numpy.typing as npt
import ufl
from pydantic import Field, model_validator
from ufl.core.expr import Expr

from dolfin_elastic.model.components import (
    Component,
    components,
    depends_on_time,
    vector_at,
)
from dolfin_elastic.model.curves import CONSTANT, Amplitude, Curve
from dolfin_elastic.schema import Record


class Site(Protocol):
    """What a load finds on the body it acts on; see `site.BodySite`."""

    v: Expr
    """Virtual displacement."""
    u: Expr
    """Displacement, of the unknowns: derivatives see it."""
    F: Expr
    """The 3x3 deformation gradient."""
    X: Expr
    """Reference coordinates."""
    N: Expr
    """Outward unit normal of the reference surface."""

    def volumes(self, regions: Sequence[str]) -> ufl.Measure:
        """Reference volume of regions, of the whole body if there are none."""

    def areas(self, surfaces: Sequence[str]) -> ufl.Measure:
        """Reference area of surfaces."""

    def densities(self, regions: Sequence[str]) -> list[tuple[Expr, ufl.Measure]]:
        """Density [kg/m^3] and reference volume, material by material."""

    def constant(self, value: float | Sequence[float]) -> Expr:
        """A number that can change without compiling anything."""

    def vector(self, values: tuple[Component, ...], amplitude: Amplitude | None) -> Expr:
        """The vector at a point of the body, times the amplitude (None: as the solver decides)."""

    def scalar(self, value: Component, amplitude: Amplitude | None) -> Expr:
        """A number or formula at a point of the body, times the amplitude."""


Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Places:
    """Points of the undeformed body at which a load is asked how strong it is.

    Attributes:
        X: Places [m], shape (..., dim).
        t: Time [s], or load parameter.
        N: Outward unit normals, shape of X, on surfaces only.
        density: Mass density [kg/m^3], shape (...), for loads that need it.
    """

    X: Floats
    t: float
    N: Floats | None = None
    density: Floats | None = None


class Load(Record):
    """A load: its fields are the keys of its case-file table.

    Attributes:
        kind: The load's name in a case file.
        value: Components in SI units, texts with units, or formulas in x, y, z [m] and t.
        curve: Amplitude over time.  Without one, loads grow with the load steps in statics and
            act in full from the start in motion, and formulas in t are taken as they are.
    """

    kind: str = ""
    value: list[Any]
    curve: Curve | None = None

    unit: ClassVar[str] = ""
    """SI unit of `value`."""
    needs_density: ClassVar[bool] = False
    """The load is proportional to mass."""
    follows: ClassVar[bool] = False
    """The load depends on the displacement."""
    conservative: ClassVar[bool] = True
    """The load has a potential, so its part of the tangent is symmetric."""

    @model_validator(mode="after")
    def _read_components(self) -> Load:
        _ = self.values  # fails now, not when it is used
        return self

    @cached_property
    def values(self) -> tuple[Component, ...]:
        """The components as numbers or formulas."""
        return components(self.value, self.unit)

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the surfaces or regions the load acts on, once where they overlap.

        None: the whole body.
        """
        on = getattr(self, "on", None)
        return () if on is None else (on,) if isinstance(on, str) else tuple(on)

    @property
    def amplitude(self) -> Amplitude | None:
        """Its curve; constant where formulas already say how it changes; None: not said."""
        timed = self.curve is None and depends_on_time(self.values)
        return CONSTANT if timed else self.curve

    def field(self, site: Site) -> Expr:
        """The load's vector as a UFL expression."""
        return site.vector(self.values, self.amplitude)

    def intensity(self, places: Places) -> Floats | None:
        """Force per reference area or volume on the undeformed body, without its amplitude.

        A report integrates it before anything is compiled: the same as `virtual_work`, in numbers.

        Returns:
            Shape of `places.X` [N/m^2 or N/m^3]; None: the load cannot be told so.
        """
        return None

    def virtual_work(self, site: Site) -> ufl.Form:
        """External virtual work of the load, linear in `site.v`."""
        raise TypeError(f"{type(self).__name__} has no virtual work")


class Traction(Load):
    """Dead traction: force per reference area [Pa], fixed in direction.

    The virtual work is the integral of t . v over the reference surface, so the total force is
    t times the reference area however the body deforms.
    """

    kind: Literal["traction"] = "traction"
    on: str | list[str]
    unit: ClassVar[str] = "Pa"

    def intensity(self, places: Places) -> Floats:
        """See the class."""
        return vector_at(self.values, places.X, places.t)

    def virtual_work(self, site: Site) -> ufl.Form:
        """See the class."""
        return ufl.inner(self.field(site), site.v) * site.areas(self.parts)


class BodyForce(Load):
    """Force per reference volume [N/m^3], on regions or on the whole body."""

    kind: Literal["body-force"] = "body-force"
    on: str | list[str] | None = None
    unit: ClassVar[str] = "N/m^3"

    def intensity(self, places: Places) -> Floats:
        """See the class."""
        return vector_at(self.values, places.X, places.t)

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

    def acceleration(self, dim: int) -> tuple[Component, ...]:
        """Its components [m/s^2] in 2 or 3 dimensions."""
        return self.values or (0.0,) * (dim - 1) + (-9.81,)

    def field(self, site: Site) -> Expr:
        """The acceleration as a UFL expression."""
        return site.vector(self.acceleration(len(site.v)), self.amplitude)

    def intensity(self, places: Places) -> Floats:
        """See the class."""
        assert places.density is not None
        g = vector_at(self.acceleration(places.X.shape[-1]), places.X, places.t)
        return np.asarray(places.density[..., None] * g)

    def virtual_work(self, site: Site) -> ufl.Form:
        """See the class."""
        g = self.field(site)
        return sum(rho * ufl.inner(g, site.v) * dx for rho, dx in site.densities(self.parts))


LOADS: dict[str, type[Load]] = {
    str(kind.model_fields["kind"].default): kind for kind in (Traction, BodyForce, Gravity)
}
