"""Springs and dashpots on surfaces, edges and points, and the table of all supports."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from typing import Any, ClassVar, Literal, Protocol, Self, TypeVar

import ufl
from pydantic import model_validator
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError, keyed
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.shapes.directions import check_components
from dolfin_elastic.core.si_text import given
from dolfin_elastic.model.amplitude import Amplitude, Curve
from dolfin_elastic.model.describe import ALONE, Setting, other_keys
from dolfin_elastic.model.supports.displacement import (
    Fixed,
    Normal,
    Restraint,
    Rotation,
    Support,
    Symmetry,
)
from dolfin_elastic.model.supports.rigid_surface import Rigid
from dolfin_elastic.model.values import (
    Component,
    Parts,
    Vector,
    checked_area,
    component,
    components,
    sized,
)

T = TypeVar("T")
_POWERS = {"surface": "^3", "edge": "^2", "point": ""}
"""Kind of part to the power of the length by which a coefficient is per area, length or node."""


class FormConstant(Protocol):
    """A constant of forms with the number that it has now."""

    @property
    def value(self) -> float:
        """The number."""


class HeldPart(Protocol):
    """Surfaces, edges or points that a spring or dashpot acts on."""

    @property
    def kind(self) -> str:
        """It is "surface", "edge" or "point"."""

    @property
    def measure(self) -> ufl.Measure:
        """Measure of the reference area of surfaces, the length of edges, the number of points."""

    @property
    def size(self) -> Callable[[], FormConstant]:
        """Gives that area, length or number as a constant [m^2, m, 1]; collective."""


class SupportContext(Protocol):
    """What forms of springs need of the problem; `problem.context.FormContext` gives it."""

    v: Expr
    """Virtual displacement: the test function."""
    u: Expr
    """Displacement [m], a part of the unknowns, by which forms are differentiated."""
    velocity: Expr
    """Velocity [m/s]; zero in statics."""
    N: Expr
    """Outward unit normal of the reference surface."""

    def held(self, names: Sequence[str]) -> HeldPart:
        """The surfaces, edges or points that the names of a support refer to."""

    def constant(self, value: float | Sequence[float]) -> Expr:
        """A number or vector whose value can change without a form being compiled again."""

    def vector(
        self, values: tuple[Component, ...], curve: Amplitude | None, parts: Parts | None = None
    ) -> Expr:
        """A vector field, each component times its amplitude.

        Args:
            values: Components: numbers, or formulas in x, y, z and t.
            curve: Amplitude that the user has given, if any.
            parts: See `value`.
        """

    def value(self, value: Component, parts: Parts | None = None) -> Expr:
        """A scalar field: a number, or a formula in x, y, z.

        Args:
            parts: What `held` is integrated over: there formulas are evaluated, not compiled.
        """


class ResistingSupport(Restraint):
    """Base of springs and dashpots: a force linear in the displacement or velocity w of a part.

    The force on the body per reference area is -(n (w . N) N + s (w - (w . N) N)) with the
    reference normal N, or -k_i w_i along each axis.  On edges it is the force per reference length,
    on points that on each node, along axes only.

    Attributes:
        normal: Coefficient n along the reference normal.
        tangential: Coefficient s across it.
        total: The numbers are those of the whole part, spread evenly over area, length or nodes.
    """

    normal: Any = None
    tangential: Any = None
    total: bool = False

    unit: ClassVar[str] = ""
    """SI unit of a coefficient of a whole part; per area it is this over m^2."""
    axes: ClassVar[str] = ""
    """Name of the field with the coefficients along the axes."""

    @model_validator(mode="after")
    def _read(self) -> Self:
        _ = self.coefficients
        return self

    @cached_property
    def coefficients(self) -> tuple[Component, ...]:
        """Along each axis, or (n, s); numbers in SI units, formulas in x, y, z, or fields.

        Raises:
            InputError: None or both kinds are given, or a number is negative.
        """
        along = getattr(self, self.axes)
        by_normal = self.normal is not None or self.tangential is not None
        if by_normal == (along is not None):
            raise InputError(
                f"'{self.axes}' and 'normal' or 'tangential' given together"
                if by_normal
                else "no coefficient is given",
                where="" if not by_normal else self.axes,
                expected=f"'normal' and 'tangential', or '{self.axes}' with a component each",
            )
        return next(iter(self._readings.values()))

    @cached_property
    def _readings(self) -> dict[str, tuple[Component, ...]]:
        """Kind of part to the coefficients in its unit, where the units that are written fit."""
        result: dict[str, tuple[Component, ...]] = {}
        errors = []
        for kind in _POWERS:
            try:
                result[kind] = self._read_in(self._unit_on(kind))
            except InputError as error:
                errors.append(error)
        if not result:
            raise errors[0]
        return result

    def _unit_on(self, kind: str) -> str:
        return self.unit + ("" if self.total else _POWERS[kind])

    def describe(self, setting: Setting = ALONE) -> str:
        """See `Restraint`."""
        unit = self._unit_on(setting.kinds.get(self.surfaces[0], "surface"))
        keys = [k for k in (self.axes, "normal", "tangential") if getattr(self, k) is not None]
        told = ", ".join(f"{key} {given(getattr(self, key), unit)}" for key in keys)
        return f"on {self.kind}s: {told}{other_keys(self, *keys, 'total')}"

    def _read_in(self, unit: str) -> tuple[Component, ...]:
        if not self.by_normal:
            written = getattr(self, self.axes)
            read = partial(components, fields=True)
            return self._checked({self.axes: _located(self.axes, read, written, unit)})
        keys, one = ("normal", "tangential"), partial(component, fields=True)
        return self._checked(
            {key: (_located(key, one, getattr(self, key) or 0.0, unit),) for key in keys}
        )

    def _checked(self, readings: Mapping[str, tuple[Component, ...]]) -> tuple[Component, ...]:
        for key, values in readings.items():
            for value in values:
                if isinstance(value, Formula):
                    if self.total or "t" in value.names:
                        raise InputError(
                            "a total is a number, no formula"
                            if self.total
                            else "a coefficient does not depend on t",
                            where=key,
                            expected="a number" if self.total else "a formula in x, y, z",
                        )
                elif value is not None and value < 0:
                    raise InputError(
                        f"{value:g} is negative", where=key, expected="a number of at least 0"
                    )
        return tuple(value for values in readings.values() for value in values)

    @property
    def by_normal(self) -> bool:
        """The coefficients are those along and across the normal."""
        return getattr(self, self.axes) is None

    @property
    def vectors(self) -> Mapping[str, tuple[Component, ...]]:
        """See `Restraint`."""
        return {} if self.by_normal else {self.axes: self.coefficients}

    def _values(self, context: SupportContext) -> list[Expr]:
        held = context.held(self.surfaces)
        self._check_kind(held.kind)
        parts = Parts(held.kind, self.surfaces)
        given = sized(self._readings[held.kind], len(context.v))
        values = [context.value(c, parts) for c in given]
        if not self.total:
            return values
        size = held.size()
        with keyed(f"support '{self.label}'"):
            checked_area(float(size.value))
        return [value / size for value in values]

    def _check_kind(self, kind: str) -> None:
        """Whether coefficients are those of a surface, edge or point."""
        where = f"support '{self.label}'"
        if self.by_normal and kind != "surface":
            raise InputError(
                f"{'an' if kind == 'edge' else 'a'} {kind} has no normal",
                where=f"{where}.{'tangential' if self.normal is None else 'normal'}",
                expected=f"'{self.axes}' with a component each",
            )
        if kind not in self._readings:
            per = {"surface": "area", "edge": "length", "point": "node"}[kind]
            unit = self.unit + _POWERS[kind]
            article = "an" if kind == "edge" else "a"
            raise InputError(
                f"the unit is not that of a {self.kind} on {article} {kind}",
                where=f"{where}.{'normal' if self.by_normal else self.axes}",
                expected=f"per {per} {unit}; or {self.unit} of the whole with total = true",
            )

    def resistance(self, context: SupportContext, w: Expr) -> Expr:
        """Force against w per area [N/m^2], length or node, a UFL vector. Collective.

        Args:
            w: Displacement [m] or velocity [m/s] of the part.
        """
        values = self._values(context)
        if not self.by_normal:
            check_components(values, len(w), f"support '{self.label}'.{self.axes}")
            return ufl.as_vector([k * w[i] for i, k in enumerate(values)])
        along = ufl.inner(w, context.N) * context.N
        return values[0] * along + values[1] * (w - along)

    @abstractmethod
    def virtual_work(self, context: SupportContext) -> ufl.Form:
        """Virtual work of the force on the body, linear in `context.v`. Collective."""

    def bound(self, context: SupportContext) -> ufl.Form:
        """Form whose assembled vector bounds the absolute row sums of the support's matrix.

        The largest coefficient times each component of `context.v`.
        """
        values = self._values(context)
        most = values[0]
        for value in values[1:]:
            most = ufl.max_value(most, value)
        return most * sum(context.v) * context.held(self.surfaces).measure


def _located(key: str, read: Callable[[object, str], T], written: object, unit: str) -> T:
    """Reads the value of a key; errors name the key."""
    try:
        return read(written, unit)
    except InputError as error:
        raise InputError(error.what, where=key + error.where, expected=error.expected) from None


class Spring(ResistingSupport):
    """Springs on a surface: an elastic foundation of given stiffness per area [N/m^3].

    On an edge the stiffness is that per length [N/m^2], on a point that at each node [N/m].

    Source of the model: E. Winkler, Die Lehre von der Elasticitaet und Festigkeit (1867).

    Attributes:
        stiffness: Stiffness along each axis instead of along and across the normal.
        displacement: Of the base that the springs stand on, components [m], formulas or fields.
        curve: Amplitude of it, as of prescribed displacements.

    Example:
        Spring(on="left", normal="2 kN/mm", total=True)
    """

    kind: Literal["spring"] = "spring"
    stiffness: Vector | None = None
    displacement: Vector | None = None
    curve: Curve | None = None

    unit: ClassVar[str] = "N/m"
    axes: ClassVar[str] = "stiffness"

    @cached_property
    def base(self) -> tuple[Component, ...]:
        """Displacement of the base [m]; empty if it is at rest."""
        if self.displacement is None:
            return ()
        return _located("displacement", partial(components, fields=True), self.displacement, "m")

    @model_validator(mode="after")
    def _read_base(self) -> Self:
        _ = self.base
        return self

    @property
    def vectors(self) -> Mapping[str, tuple[Component, ...]]:
        """See `Restraint`."""
        return {**super().vectors, "displacement": self.base}

    @property
    def at_rest(self) -> bool:
        """See `Restraint`."""
        return all(value == 0.0 for value in self.base)

    def _stretch(self, context: SupportContext) -> Expr:
        if not self.base:
            return context.u
        parts = Parts(context.held(self.surfaces).kind, self.surfaces)
        try:
            return context.u - context.vector(self.base, self.curve, parts)
        except InputError as error:
            where = f"support '{self.label}'.displacement"
            raise InputError(error.what, where=where, expected=error.expected) from None

    def virtual_work(self, context: SupportContext) -> ufl.Form:
        """See `ResistingSupport`."""
        force = self.resistance(context, self._stretch(context))
        return -ufl.inner(force, context.v) * context.held(self.surfaces).measure

    def energy(self, context: SupportContext) -> ufl.Form:
        """Stored energy [J]."""
        w = self._stretch(context)
        return 0.5 * ufl.inner(self.resistance(context, w), w) * context.held(self.surfaces).measure


class Dashpot(ResistingSupport):
    """Dashpots on a surface: a force against its velocity.  They act in motion only.

    Attributes:
        viscosity: Coefficients along each axis [N s/m^3] instead of along and across the normal; on
            an edge [N s/m^2], on a point [N s/m].

    Example:
        Dashpot(on="left", normal="40 N*s/m", tangential=0, total=True)
    """

    kind: Literal["dashpot"] = "dashpot"
    viscosity: Vector | None = None

    unit: ClassVar[str] = "N*s/m"
    axes: ClassVar[str] = "viscosity"

    def virtual_work(self, context: SupportContext) -> ufl.Form:
        """See `ResistingSupport`."""
        force = self.resistance(context, context.velocity)
        return -ufl.inner(force, context.v) * context.held(self.surfaces).measure


SUPPORTS: dict[str, type[Restraint]] = {
    "fixed": Fixed,
    "displacement": Support,
    "normal": Normal,
    "roller": Normal,
    "symmetry": Symmetry,
    "rotation": Rotation,
    "rigid": Rigid,
    "spring": Spring,
    "dashpot": Dashpot,
}
