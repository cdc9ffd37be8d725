"""Tractions, forces and body forces: dead loads, gravity, centrifugal force."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
import ufl
from pydantic import Field
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError, keyed
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.shapes.directions import Direction, check_components, unit_vector
from dolfin_elastic.core.shapes.shapes import Point
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.describe import ALONE, Setting, other_keys
from dolfin_elastic.model.loads.base import Load, LoadContext, LoadPoints
from dolfin_elastic.model.loads.point_loads import LineForce, PointForce
from dolfin_elastic.model.values import (
    PLACE,
    Component,
    Vector,
    checked_area,
    component,
    components,
    vector_at,
)


class Traction(Load):
    """Dead traction: force per reference area [Pa], fixed in direction.

    The virtual work is the integral of t . v over the reference surface, so the total force is
    t times the reference area however the body deforms.

    Example:
        Traction(on="right", value=[0, 0, "-2 kPa"])
    """

    kind: Literal["traction"] = "traction"
    on: str | list[str]
    unit: ClassVar[str] = "Pa"
    takes_fields: ClassVar[bool] = True
    sentence: ClassVar[str] = "force per area of {}"
    key_hints: ClassVar[Mapping[str, str]] = {
        **Load.key_hints,
        "force": 'a total force [N] is kind = "force" with value = [0, 0, "-2 kN"]',
    }

    def intensity(self, points: LoadPoints) -> FloatArray:
        """See `Load.intensity`."""
        return vector_at(self.values, points.X, points.t, points.fields)

    def virtual_work(self, context: LoadContext) -> ufl.Form:
        """See the class."""
        return ufl.inner(self.field(context), context.v) * context.areas(self.parts)


class Force(Load):
    """A total force [N], spread evenly over surfaces, edges or points; fixed in direction.

    Surfaces have the total over their undeformed area everywhere, edges over their length, and
    nodes an equal part each.  In a plane it is the force on the whole thickness, in a body of
    revolution on the whole ring.

    Example:
        Force(on="right", value=[0, 0, "-2 kN"])
    """

    kind: Literal["force"] = "force"
    on: str | list[str]
    unit: ClassVar[str] = "N"
    sentence: ClassVar[str] = "total force of {}, spread evenly"
    key_hints: ClassVar[Mapping[str, str]] = {
        **Load.key_hints,
        "force": 'it is the value, as in value = [0, 0, "-2 kN"]',
        "total": "the value is the total force",
    }
    part_kinds: ClassVar[tuple[str, ...]] = ("surface", "edge", "point")

    @cached_property
    def values(self) -> tuple[Component, ...]:
        """The components [N]; a field has no total, and would be one of force per area."""
        rows = self.value if isinstance(self.value, list) else [self.value]
        if any(isinstance(one, Mapping) and "field" in one for one in rows):
            raise InputError(
                "a total force is no field",
                where="value",
                expected='kind = "traction" with a field of force per area; on edges '
                '"line-force", at points "point-force"',
            )
        return super().values

    def on_kind(self, kind: str) -> Load:
        """The force on surfaces, edges or points, whichever its names stand for."""
        if kind == "surface":
            return self
        given = {key: getattr(self, key) for key in self.model_fields_set}  # with rows of files
        return (_EdgeForce if kind == "edge" else _PointsForce)(**given)

    def intensity(self, points: LoadPoints) -> FloatArray:
        """See `Load.intensity`."""
        return np.asarray(vector_at(self.values, points.X, points.t) / points.size)

    def virtual_work(self, context: LoadContext) -> ufl.Form:
        """See the class."""
        area = context.area(self.parts)
        checked_area(float(area.value))
        traction = self.field(context) / area
        return ufl.inner(traction, context.v) * context.areas(self.parts)


class _EdgeForce(LineForce):
    unit: ClassVar[str] = "N"
    shared: ClassVar[bool] = True


class _PointsForce(PointForce):
    shared: ClassVar[bool] = True


class BodyForce(Load):
    """Force per reference volume [N/m^3], on regions or on the whole body.

    Example:
        BodyForce(value=[0, 0, "-2 kN/m^3"])
    """

    kind: Literal["body-force"] = "body-force"
    on: str | list[str] | None = None
    unit: ClassVar[str] = "N/m^3"
    takes_fields: ClassVar[bool] = True
    sentence: ClassVar[str] = "force per volume of {}"

    def intensity(self, points: LoadPoints) -> FloatArray:
        """See `Load.intensity`."""
        return vector_at(self.values, points.X, points.t, points.fields)

    def virtual_work(self, context: LoadContext) -> ufl.Form:
        """See the class."""
        return ufl.inner(self.field(context), context.v) * context.volumes(self.parts)


class Gravity(Load):
    """Weight: density times an acceleration [m/s^2], on regions or on the whole body.

    Without a value it is 9.81 m/s^2 downwards, against the last axis (z, or y in a plane).

    Example:
        Gravity(value=[0, 0, -9.81])
    """

    kind: Literal["gravity"] = "gravity"
    value: Vector = Field(default=[])
    on: str | list[str] | None = None
    unit: ClassVar[str] = "m/s^2"
    takes_fields: ClassVar[bool] = True
    sentence: ClassVar[str] = "weight, with the acceleration of gravity {}"
    needs_density: ClassVar[bool] = True

    @cached_property
    def values(self) -> tuple[Component, ...]:
        """The components [m/s^2]; empty: 9.81 m/s^2 against the last axis."""
        return super().values if self.value else ()

    def describe(self, setting: Setting = ALONE) -> str:
        """See `Load.describe`."""
        if self.value:
            return super().describe(setting)
        return self.sentence.format("9.81 m/s² against the last axis") + other_keys(self, "value")

    def acceleration(self, dim: int) -> tuple[Component, ...]:
        """Its components [m/s^2] in 2 or 3 dimensions."""
        return self.values or (0.0,) * (dim - 1) + (-9.81,)

    def field(self, context: LoadContext) -> Expr:
        """The acceleration as a UFL expression."""
        return context.vector(self.acceleration(len(context.v)), self.curve, self.domain)

    def intensity(self, points: LoadPoints) -> FloatArray:
        """See `Load.intensity`."""
        assert points.density is not None
        g = vector_at(self.acceleration(points.X.shape[-1]), points.X, points.t, points.fields)
        return np.asarray(points.density[..., None] * g)

    def virtual_work(self, context: LoadContext) -> ufl.Form:
        """See the class."""
        if context.axisymmetric and self.values and self.values[0] != 0.0:
            raise InputError(
                "the weight of a body of revolution acts along its axis",
                where="value[0]",
                expected="0 across it",
            )
        g = self.field(context)
        work = sum(rho * ufl.inner(g, context.v) * dx for rho, dx in context.densities(self.parts))
        for rho, ds, where in [] if self.parts else context.masses():
            g = context.vector(self.acceleration(len(context.v)), self.curve, where)
            work += rho * ufl.inner(g, context.v) * ds
        return work


class BaseAcceleration(Load):
    """Acceleration of the base [m/s^2] that carries the body, in the frame that moves with it.

    The force per reference volume is -density a(t).  Displacements, velocities and accelerations
    are those relative to the base, whose supports are at rest.

    Source: A. K. Chopra, Dynamics of Structures (2012), section 1.7.

    Example:
        BaseAcceleration(value=["3*sin(40*t)", 0, 0])
    """

    kind: Literal["base-acceleration"] = "base-acceleration"
    on: str | list[str] | None = None
    unit: ClassVar[str] = "m/s^2"
    sentence: ClassVar[str] = "inertia in a frame that is accelerated by {}"
    needs_density: ClassVar[bool] = True

    @cached_property
    def values(self) -> tuple[Component, ...]:
        """The components of the base's acceleration [m/s^2]: numbers, formulas in t, records."""
        parts = components(self.value, self.unit, key="value")
        if any(isinstance(item, Formula) and item.names & PLACE for item in parts):
            raise InputError(
                "a base moves as one", where="value", expected="a record, or a formula in t only"
            )
        return parts

    def intensity(self, points: LoadPoints) -> FloatArray:
        """See `Load.intensity`."""
        assert points.density is not None
        return np.asarray(-points.density[..., None] * vector_at(self.values, points.X, points.t))

    def virtual_work(self, context: LoadContext) -> ufl.Form:
        """See the class."""
        if context.axisymmetric and self.values[0] != 0.0:
            raise InputError(
                "the base of a body of revolution moves along its axis",
                where="value[0]",
                expected="0 across it",
            )
        a = self.field(context)
        return sum(-rho * ufl.inner(a, context.v) * dx for rho, dx in context.inertia(self.parts))


class Centrifugal(Load):
    """Centrifugal force on a body that rotates about an axis, in the frame rotating with it.

    Per reference volume it is density omega^2 (I - a a^T) (x - c), with the unit axis a, a point c
    on it, and the current place x; where all laws are linear the reference place X, so that the
    problem stays linear.  The potential is -density omega^2 |(I - a a^T) (x - c)|^2/2.  The curve
    multiplies the force, not the speed.

    Attributes:
        value: Speed omega [rad/s], a number, a text such as "3000 rpm" or a formula in t.
        axis: x, y, z or a direction of any length; z by default, of a body of revolution y.
        point: A point on the axis, in the mesh's unit; the origin by default.

    Source: Goldstein, Poole & Safko, Classical Mechanics (2002), (4.91).

    Example:
        Centrifugal(value="3000 rpm", axis="z")
    """

    kind: Literal["centrifugal"] = "centrifugal"
    value: Any
    axis: Direction | None = None
    point: Point | None = None
    on: str | list[str] | None = None
    unit: ClassVar[str] = "rad/s"
    sentence: ClassVar[str] = "centrifugal force of a rotation with {}"
    needs_density: ClassVar[bool] = True
    follower: ClassVar[bool] = True
    linearises: ClassVar[bool] = True
    lengths: ClassVar[tuple[str, ...]] = ("point",)

    @cached_property
    def values(self) -> tuple[Component, ...]:
        """The angular speed [rad/s], one number or formula in t."""
        with keyed("value"):
            speed = component(self.value, self.unit)
            if isinstance(speed, Formula) and speed.names & PLACE:
                raise InputError("a body spins with one speed", expected="a formula in t only")
        return (speed,)

    @property
    def vectors(self) -> dict[str, tuple[Component, ...]]:
        """The point; the axis is left out, it has three components also in a plane."""
        return {} if self.point is None else {"point": self.point}

    def virtual_work(self, context: LoadContext) -> ufl.Form:
        """See the class."""
        dim = len(context.v)
        a, c = self._axis(context.axisymmetric), self._centre(dim, context.axisymmetric)
        place = context.X if context.linear else context.X + context.u
        r = ufl.as_vector([place[i] for i in range(dim)]) - context.constant(c)
        axis = context.constant(a[:dim])
        across = r - ufl.inner(axis, r) * axis
        force = context.factor(self.amplitude) * context.value(self.values[0]) ** 2 * across
        inertia = context.inertia(self.parts)
        return sum(rho * ufl.inner(force, context.v) * dx for rho, dx in inertia)

    def intensity(self, points: LoadPoints) -> FloatArray:
        """See `Load.intensity`; of a body of revolution only the radial part is left."""
        assert points.density is not None
        dim = points.X.shape[-1]
        a = np.array(self._axis(points.axisymmetric)[:dim])
        r = points.X - np.array(self._centre(dim, points.axisymmetric))
        (speed,) = self.values
        omega = speed.evaluate(t=points.t) if isinstance(speed, Formula) else float(speed or 0.0)
        across = r - (r @ a)[..., None] * a
        return np.asarray(points.density[..., None] * omega**2 * across)

    def _centre(self, dim: int, axisymmetric: bool) -> tuple[float, ...]:
        c = self.point or (0.0,) * dim
        check_components(c, dim, "point")
        if axisymmetric and c[0]:
            raise InputError(
                "a body of revolution spins about y only",
                where="point",
                expected="a point on the axis, [0, y]",
            )
        return c

    def _axis(self, axisymmetric: bool) -> tuple[float, ...]:
        """Unit vector of the axis, three components."""
        a = unit_vector(("y" if axisymmetric else "z") if self.axis is None else self.axis)
        if axisymmetric and (a[0] or a[2]):
            raise InputError(
                "a body of revolution spins about y only", where="axis", expected='"y"'
            )
        return a
