"""What every load is: one external virtual-work term, and the site where it acts."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, ClassVar, Protocol

import ufl
from pydantic import model_validator
from ufl.core.expr import Expr

from dolfin_elastic.model.components import Component, components, depends_on_time
from dolfin_elastic.model.curves import CONSTANT, Amplitude, Curve
from dolfin_elastic.model.geometry import Geometry
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
    linear: bool
    """All laws are linear: loads that can act on the undeformed body do, see `Load.linearises`."""
    geometry: Geometry
    """Kind of a two-dimensional body."""

    def volumes(self, regions: Sequence[str]) -> ufl.Measure:
        """Reference volume of regions, of the whole body if there are none."""

    def areas(self, surfaces: Sequence[str]) -> ufl.Measure:
        """Reference area of surfaces."""

    def densities(self, regions: Sequence[str]) -> list[tuple[Expr, ufl.Measure]]:
        """Density [kg/m^3] and reference volume, material by material."""

    def constant(self, value: float | Sequence[float]) -> Expr:
        """A number that can change without compiling anything."""

    def unknown(self, label: str) -> Expr:
        """A number that is solved for."""

    def vector(self, values: tuple[Component, ...], amplitude: Amplitude | None) -> Expr:
        """The vector at a point of the body, times the amplitude (None: as the solver decides)."""

    def scalar(self, value: Component, amplitude: Amplitude | None) -> Expr:
        """A number or formula at a point of the body, times the amplitude."""


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
    linearises: ClassVar[bool] = False
    """Of a load that follows: where all laws are linear it acts on the undeformed body."""
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
    def vectors(self) -> dict[str, tuple[Component, ...]]:
        """Key to the components of what must have as many of them as the body."""
        return {"value": self.values}

    @property
    def conservative_if_held(self) -> bool:
        """The load has a potential if the rim of its surfaces cannot move across them."""
        return False

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

    def virtual_work(self, site: Site) -> ufl.Form:
        """External virtual work of the load, linear in `site.v`."""
        raise TypeError(f"{type(self).__name__} has no virtual work")
