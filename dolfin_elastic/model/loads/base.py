"""Base of all loads: one external virtual-work term each, and what it needs of the problem."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import ufl
from pydantic import model_validator
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError, keyed
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.si_text import given
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.amplitude import CONSTANT, Amplitude, Curve
from dolfin_elastic.model.describe import ALONE, Setting, other_keys
from dolfin_elastic.model.values import (
    Component,
    FieldsAt,
    Parts,
    Vector,
    component,
    components,
    depends_on_time,
)

if TYPE_CHECKING:
    from dolfin_elastic.model.supports.displacement import Restraint


class LoadContext(Protocol):
    """What forms of loads need of the problem; `problem.context.FormContext` gives it."""

    v: Expr
    """Virtual displacement: the test function."""
    u: Expr
    """Displacement [m], a part of the unknowns, by which forms are differentiated."""

    @property
    def F(self) -> Expr:
        """The 3x3 deformation gradient."""

    X: Expr
    """Reference coordinates."""
    N: Expr
    """Outward unit normal of the reference surface."""

    @property
    def axisymmetric(self) -> bool:
        """The body is axisymmetric about y: its first coordinate is the radius."""

    @property
    def linear(self) -> bool:
        """All laws are linear, see `Load.linearises`."""

    def volumes(self, regions: Sequence[str]) -> ufl.Measure:
        """Measure of the reference volume of regions; of the whole body if no name is given."""

    def areas(self, surfaces: Sequence[str]) -> ufl.Measure:
        """Measure of the reference area of surfaces."""

    def area(self, surfaces: Sequence[str]) -> Expr:
        """Reference area of surfaces as a constant [m^2]. Collective."""

    def surface(self, surfaces: Sequence[str]) -> tuple[LoadPoints, ufl.Measure]:
        """Quadrature points of the reference area of surfaces, and its measure. Collective."""

    def densities(self, regions: Sequence[str]) -> list[tuple[Expr, ufl.Measure]]:
        """Density [kg/m^3] and measure of the reference volume, material by material."""

    def masses(self) -> list[tuple[Expr, ufl.Measure, Parts]]:
        """Mounted masses: their density [kg/m^2], and measure and names of their surfaces."""

    def inertia(self, regions: Sequence[str]) -> list[tuple[Expr, ufl.Measure]]:
        """`densities`, and without regions those of mounted masses, with their measures."""

    def constant(self, value: float | Sequence[float] | FloatArray) -> Expr:
        """A number or vector whose value can change without a form being compiled again."""

    def unknown(self, label: str) -> Expr:
        """A scalar unknown of the bordered system, such as the pressure of a cavity."""

    def vector(
        self, values: tuple[Component, ...], curve: Amplitude | None, parts: Parts | None = None
    ) -> Expr:
        """A vector field, each component times its amplitude.

        Args:
            values: Components: numbers, or formulas in x, y, z and t.
            curve: Amplitude that the user has given, if any.
            parts: See `value`.
        """

    def factor(self, amplitude: Amplitude | None) -> Expr:
        """A constant that has the value of an amplitude; None: of the solver's default."""

    def factors(self, values: tuple[Component, ...], curve: Amplitude | None) -> list[Expr]:
        """The amplitude of each component as a constant, see `values.amplitude_of`.

        Args:
            values: Components: numbers, or formulas in x, y, z and t.
            curve: Amplitude that the user has given, if any.
        """

    def value(self, value: Component, parts: Parts | None = None) -> Expr:
        """A scalar field: a number, or a formula in x, y, z and t.

        Args:
            parts: Where it is integrated, by `volumes`, `densities` or `areas` as they are: there
                formulas are evaluated.  None: anywhere, and a formula is a polynomial in each cell.
        """

    def scalar(
        self, value: Component, amplitude: Amplitude | None, parts: Parts | None = None
    ) -> Expr:
        """A scalar field times an amplitude.

        Args:
            value: A number, or a formula in x, y, z and t.
            amplitude: The amplitude; None: the solver's default.
            parts: See `value`.
        """


@dataclass(frozen=True)
class LoadPoints:
    """Points of the reference configuration at which the intensity of a load is evaluated.

    Attributes:
        X: Points [m], shape (..., dim).
        t: Time [s], or load parameter.
        N: Outward unit normals, shape of X, on surfaces only.
        density: Mass density [kg/m^3], shape (...), for loads that need it.
        size: Area of all surfaces, or volume of all regions, of the load [m^2, m^3].
        axisymmetric: The body is axisymmetric about y.
        weights: Quadrature weights times area or volume, shape (...); None: single places.
        total: Sum of an array over all ranks, collective.
        fields: Gives the fields of the mesh at the points, for loads that have any.
    """

    X: FloatArray
    t: float
    N: FloatArray | None = None
    density: FloatArray | None = None
    size: float = 1.0
    axisymmetric: bool = False
    weights: FloatArray | None = None
    total: Callable[[FloatArray], FloatArray] = lambda own: own
    fields: FieldsAt | None = None


class Load(Record):
    """A load: its fields are the keys of its case-file table.

    Attributes:
        kind: The load's name in a case file.
        value: Components in SI units, texts with units, formulas in x, y, z [m] and t; of some
            kinds also fields of the mesh, see `takes_fields`.
        curve: Amplitude over time.  Without one, loads grow with the load steps in statics and
            act in full from the start in motion, and formulas in t are used as they are,
            component by component.
        on: Its surface or region, or a list of them; without one the whole body.
    """

    kind: str = ""
    value: Vector
    curve: Curve | None = None

    key_hints: ClassVar[Mapping[str, str]] = {
        "moment": 'a moment on a surface is kind = "remote-force", as in '
        '[[load]] kind = "remote-force", on = "tip", moment = [0, "100 N*m", 0]',
    }
    unit: ClassVar[str] = ""
    """SI unit of `value`."""
    sentence: ClassVar[str] = ""
    """What it does, with {} for its value; "KIND of {}" by default, see `describe`."""
    needs_density: ClassVar[bool] = False
    """The load is proportional to mass."""
    along_normal: ClassVar[bool] = False
    """The load acts along the outward normal of its surfaces."""
    follower: ClassVar[bool] = False
    """The load depends on the displacement, so that it has a load stiffness."""
    linearises: ClassVar[bool] = False
    """Of a follower load: where all laws are linear, it acts on the undeformed body."""
    part_kinds: ClassVar[tuple[str, ...]] = ()
    """Kinds of part that `on` names; empty: surfaces where `on` is needed, else regions."""
    concentrated: ClassVar[bool] = False
    """The load acts at points, not on volumes or surfaces, see `point_loads`."""
    is_eigenstrain: ClassVar[bool] = False
    """The load is no force but changes the natural state, see `eigenstrain`."""
    conservative: ClassVar[bool] = True
    """The load has a potential, so that its load stiffness is symmetric."""
    takes_fields: ClassVar[bool] = False
    """Its value, or a component of it, may be a field of the mesh."""

    @model_validator(mode="after")
    def _read_components(self) -> Load:
        if getattr(self, "on", None) == []:
            raise InputError(
                "no name is given",
                where="on",
                expected=f"a name of a {self.part_kinds[0]}"
                if self.part_kinds
                else "a surface's name"
                if type(self).model_fields["on"].is_required()
                else "a region's name; left out, it is the whole body",
            )
        _ = self.values, self.vectors  # fails now, not when it is used
        return self

    @cached_property
    def values(self) -> tuple[Component, ...]:
        """The components as numbers or formulas."""
        return components(self.value, self.unit, key="value", fields=self.takes_fields)

    @property
    def vectors(self) -> dict[str, tuple[Component, ...]]:
        """Keys of vectors that must have as many components as the body, with their values."""
        return {"value": self.values}

    @property
    def conservative_if_edge_fixed(self) -> bool:
        """The load has a potential if the edge of its surfaces has no displacement across them."""
        return False

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the surfaces or regions of the load; empty: the whole body.

        Where they overlap the load acts once.
        """
        on = getattr(self, "on", None)
        return () if on is None else (on,) if isinstance(on, str) else tuple(on)

    @property
    def amplitude(self) -> Amplitude | None:
        """Its curve; constant for a formula in t; None: the solver's default.

        Of loads with one value; components have one each, see `values.amplitude_of`.
        """
        timed = self.curve is None and depends_on_time(self.values)
        return CONSTANT if timed else self.curve

    @property
    def domain(self) -> Parts:
        """Where its integral is taken."""
        surfaces = "on" in type(self).model_fields and type(self).model_fields["on"].is_required()
        return Parts("surface" if surfaces else "region", self.parts)

    @property
    def support(self) -> Restraint | None:
        """The support that applies it, if it is no virtual work but a force of a support."""
        return None

    def describe(self, setting: Setting = ALONE) -> str:
        """What it does, without its place: as it was written, with units."""
        sentence = self.sentence or f"{self.kind} of {{}}"
        return sentence.format(given(self.value, self.unit)) + other_keys(self, "value")

    def field(self, context: LoadContext) -> Expr:
        """The load's vector as a UFL expression, for an integral over its parts."""
        return context.vector(self.values, self.curve, self.domain)

    def intensity(self, points: LoadPoints) -> FloatArray | None:
        """Force per reference area or volume on the undeformed body, without its amplitude.

        The integrand of `virtual_work` in numbers, which the check of a case integrates before
        anything is compiled.

        Returns:
            Shape of `points.X` [N/m^2 or N/m^3]; None: the load has no such density.
        """
        return None

    def virtual_work(self, context: LoadContext) -> ufl.Form:
        """External virtual work of the load, linear in `context.v`."""
        raise TypeError(f"{type(self).__name__} has no virtual work")


class ScalarLoad(Load):
    """A load whose value is no vector.

    Attributes:
        value: A number, a text with a unit, or a formula in x, y, z [m] (undeformed) and t.
    """

    value: Any

    @cached_property
    def values(self) -> tuple[Component, ...]:
        """The value, one number or formula."""
        with keyed("value"):
            return (component(self.value, self.unit, fields=self.takes_fields),)

    @property
    def vectors(self) -> dict[str, tuple[Component, ...]]:
        """See `Load.vectors`: none."""
        return {}
