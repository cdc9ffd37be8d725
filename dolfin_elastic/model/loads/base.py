"""What every load is: one external virtual-work term, and the context where it acts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Protocol

import ufl
from pydantic import model_validator
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.amplitude import CONSTANT, Amplitude, Curve
from dolfin_elastic.model.values import Component, components, depends_on_time

PLACE = frozenset("xyz")
"""Names of the place in formulas."""


class LoadContext(Protocol):
    """What a load finds on the body it acts on; see `context.FormContext`."""

    v: Expr
    """Virtual displacement."""
    u: Expr
    """Displacement, of the unknowns: derivatives see it."""

    @property
    def F(self) -> Expr:
        """The 3x3 deformation gradient."""

    X: Expr
    """Reference coordinates."""
    N: Expr
    """Outward unit normal of the reference surface."""

    @property
    def axisymmetric(self) -> bool:
        """A body of revolution about y: its first coordinate is the radius."""

    @property
    def linear(self) -> bool:
        """All laws are linear: see `Load.linearises`."""

    def volumes(self, regions: Sequence[str]) -> ufl.Measure:
        """Reference volume of regions, of the whole body if there are none."""

    def areas(self, surfaces: Sequence[str]) -> ufl.Measure:
        """Reference area of surfaces."""

    def area(self, surfaces: Sequence[str]) -> Expr:
        """Size of the reference area of surfaces [m^2]."""

    def densities(self, regions: Sequence[str]) -> list[tuple[Expr, ufl.Measure]]:
        """Density [kg/m^3] and reference volume, material by material."""

    def constant(self, value: float | Sequence[float]) -> Expr:
        """A number that can change without compiling anything."""

    def unknown(self, label: str) -> Expr:
        """A number that is solved for."""

    def vector(self, values: tuple[Component, ...], curve: Amplitude | None) -> Expr:
        """The vector at a point of the body, each component times its amplitude."""

    def factor(self, amplitude: Amplitude | None) -> Expr:
        """A number that follows an amplitude (None: as the solver decides)."""

    def factors(self, values: tuple[Component, ...], curve: Amplitude | None) -> list[Expr]:
        """What follows the amplitude of each component, see `components.amplitude_of`."""

    def value(self, value: Component) -> Expr:
        """A number or formula at a point of the body."""

    def scalar(self, value: Component, amplitude: Amplitude | None) -> Expr:
        """A number or formula at a point of the body, times the amplitude."""


@dataclass(frozen=True)
class LoadPoints:
    """Points of the undeformed body at which a load is asked how strong it is.

    Attributes:
        X: Places [m], shape (..., dim).
        t: Time [s], or load parameter.
        N: Outward unit normals, shape of X, on surfaces only.
        density: Mass density [kg/m^3], shape (...), for loads that need it.
        size: Area or volume of all points' part [m^2, m^3].
        axisymmetric: They are those of a body of revolution about y.
    """

    X: FloatArray
    t: float
    N: FloatArray | None = None
    density: FloatArray | None = None
    size: float = 1.0
    axisymmetric: bool = False


class Load(Record):
    """A load: its fields are the keys of its case-file table.

    Attributes:
        kind: The load's name in a case file.
        value: Components in SI units, texts with units, or formulas in x, y, z [m] and t.
        curve: Amplitude over time.  Without one, loads grow with the load steps in statics and
            act in full from the start in motion, and formulas in t are taken as they are,
            component by component.
    """

    kind: str = ""
    value: list[Any]
    curve: Curve | None = None

    unit: ClassVar[str] = ""
    """SI unit of `value`."""
    needs_density: ClassVar[bool] = False
    """The load is proportional to mass."""
    along_normal: ClassVar[bool] = False
    """The load acts along the outward normal of its surfaces."""
    follower: ClassVar[bool] = False
    """The load depends on the displacement."""
    linearises: ClassVar[bool] = False
    """Of a load that follows: where all laws are linear it acts on the undeformed body."""
    concentrated: ClassVar[bool] = False
    """The load acts at points, not on volumes or surfaces: see `concentrated`."""
    is_eigenstrain: ClassVar[bool] = False
    """The load is no force but changes the rest state: see `growth`."""
    conservative: ClassVar[bool] = True
    """The load has a potential, so its part of the tangent is symmetric."""

    @model_validator(mode="after")
    def _read_components(self) -> Load:
        if getattr(self, "on", None) == []:
            raise InputError(
                "no name is given",
                where="on",
                expected="a surface's name"
                if type(self).model_fields["on"].is_required()
                else "a region's name; left out, it is the whole body",
            )
        _ = self.values, self.vectors  # fails now, not when it is used
        return self

    @cached_property
    def values(self) -> tuple[Component, ...]:
        """The components as numbers or formulas."""
        return components(self.value, self.unit, key="value")

    @property
    def vectors(self) -> dict[str, tuple[Component, ...]]:
        """Key to the components of what must have as many of them as the body."""
        return {"value": self.values}

    @property
    def conservative_if_edge_fixed(self) -> bool:
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
        """Its curve; constant where a formula already says how it changes; None: not said.

        Of loads with one value; components have one each, see `components.amplitude_of`.
        """
        timed = self.curve is None and depends_on_time(self.values)
        return CONSTANT if timed else self.curve

    def field(self, context: LoadContext) -> Expr:
        """The load's vector as a UFL expression."""
        return context.vector(self.values, self.curve)

    def intensity(self, points: LoadPoints) -> FloatArray | None:
        """Force per reference area or volume on the undeformed body, without its amplitude.

        A report integrates it before anything is compiled: the same as `virtual_work`, in numbers.

        Returns:
            Shape of `points.X` [N/m^2 or N/m^3]; None: the load cannot be told so.
        """
        return None

    def virtual_work(self, context: LoadContext) -> ufl.Form:
        """External virtual work of the load, linear in `context.v`."""
        raise TypeError(f"{type(self).__name__} has no virtual work")


@contextmanager
def keyed(key: str) -> Iterator[None]:
    """Gives faults inside the key that they belong to."""
    try:
        yield
    except InputError as error:
        raise error.at(key) from None
