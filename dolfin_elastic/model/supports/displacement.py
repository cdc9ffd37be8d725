"""Supports that prescribe displacements: components, normals, symmetry planes, rotations."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import model_validator

from dolfin_elastic.core.errors import InputError, keyed
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.schema import UnusedKeys, refuse_unused_keys
from dolfin_elastic.core.shapes.directions import Direction, check_components, unit_vector
from dolfin_elastic.core.shapes.shapes import Point
from dolfin_elastic.core.si_text import given, listed
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.amplitude import CONSTANT, Amplitude, Curve
from dolfin_elastic.model.describe import ALONE, Setting, other_keys
from dolfin_elastic.model.records import RATES
from dolfin_elastic.model.values import (
    Component,
    FieldsAt,
    OnSurfaces,
    Vector,
    amplitude_of,
    angle_of,
    at_time,
    component,
    components,
    depends_on_time,
    number_at,
    sized,
    turned_at,
)

NORMAL = -1
"""Index of the displacement component along the surface's normal; those along axes count from 0."""


_FIXED = "fixed: no displacement"
_MOTIONS = ("displacement", "velocity", "acceleration")


class Restraint(OnSurfaces):
    """Base of all supports."""

    kind: str = ""

    part_kinds: ClassVar[tuple[str, ...]] = ("surface", "edge", "point")
    """Kinds of part that it may hold."""

    def describe(self, setting: Setting = ALONE) -> str:
        """How it holds its parts: as it was written, with units."""
        return self.kind + other_keys(self)

    @property
    def vectors(self) -> Mapping[str, tuple[Component, ...]]:
        """Keys of vectors that must have as many components as the body, with their values."""
        return {}

    def check_axis(self, dim: int) -> None:
        """Raises where its axis, if it has one, is none of a body of 2 or 3 dimensions.

        Raises:
            InputError: With the key in its table.
        """

    @property
    def time_functions(self) -> tuple[tuple[Component, ...], ...]:
        """Values that may be formulas in t, vector by vector."""
        return tuple(self.vectors.values())

    @property
    def at_rest(self) -> bool:
        """All that it prescribes is zero at all times."""
        return True

    @property
    def proportional(self) -> bool:
        """What it prescribes grows with the load parameter: without a curve or formulas in t."""
        timed = any(depends_on_time(function) for function in self.time_functions)
        return not (self.at_rest or timed) and getattr(self, "curve", None) is None


class PrescribingSupport(Restraint):
    """A support that prescribes displacements.

    Its `curve` is the amplitude over time.  Without one, constants grow with the load steps in
    statics and act from the start in motion; formulas in t are used as they are, component by
    component.
    """

    needs_flat: ClassVar[bool] = False
    """Its surfaces must lie in a plane each."""

    def prescribed_components(self, dim: int) -> tuple[int, ...]:
        """Indices of the prescribed components, or `NORMAL`, in a body of 2 or 3 dimensions."""
        raise TypeError(f"{type(self).__name__} prescribes nothing")

    def component(self, which: int) -> Component:
        """The displacement that is prescribed [m], where no `at` of its own gives it.

        Args:
            which: One of `prescribed_components`.
        """
        return 0.0

    def at(
        self,
        which: int,
        x: FloatArray,
        t: float,
        default: Amplitude,
        fields: FieldsAt | None = None,
    ) -> FloatArray | float:
        """Prescribed displacement [m], shape (n,) or one number for all points.

        Args:
            which: One of `prescribed_components`.
            x: Points of the reference configuration [m], shape (n, 3).
            t: Time [s], or load parameter.
            default: Amplitude where the support has no curve.
            fields: Gives the fields of the mesh at the points; None: they are not a number.
        """
        value = self.component(which)
        return self._scale(value, t, default) * _evaluated(value, x, t, fields)

    def _scale(self, value: Component, t: float, default: Amplitude) -> float:
        """Amplitude at time t: of the curve, 1 for a formula in t, else of the default."""
        return float(default.of(amplitude_of(value, getattr(self, "curve", None)), t))


def _evaluated(
    value: Component, x: FloatArray, t: float, fields: FieldsAt | None = None
) -> FloatArray | float:
    return number_at(value, x, t, fields) if isinstance(value, Formula) else float(value or 0.0)


class Support(PrescribingSupport):
    """Displacement components prescribed on surfaces, edges and points.

    Attributes:
        displacement: One entry a component [m]: a number, a text with a unit ("2 mm"), a formula
            in the reference coordinates x, y, z [m] and in t, a scalar field of the mesh, or
            "free"; or a vector field for all.  None: all components are 0.
        velocity: In place of the displacement: a record over time a component, 0 or "free"; it is
            integrated from rest [m/s].
        acceleration: The same, integrated twice [m/s^2].
        curve: Amplitude over time; without it constants grow with the load in statics.

    Example:
        Support(on="left", displacement=["2 mm", 0, "free"])
    """

    kind: Literal["displacement"] = "displacement"
    displacement: Vector | None = None
    velocity: list[object] | None = None
    acceleration: list[object] | None = None
    curve: Curve | None = None

    def describe(self, setting: Setting = ALONE) -> str:
        """See `Restraint`."""
        return self._held() + other_keys(self, *_MOTIONS)

    def _held(self) -> str:
        if self.at_rest and None not in self.values:
            return _FIXED
        if isinstance(self.displacement, Mapping):
            return f"moved by the {given(self.displacement, 'm')}"
        axes = [*zip("xyz", self.values, getattr(self, self.key) or (), strict=False)]
        by = f"{self.key} " if self.key != "displacement" else ""
        parts = [f"moved along {axis} by {by}{given(text, 'm')}" for axis, v, text in axes if v]
        for words, value in (("no displacement", 0.0), ("free", None)):
            if those := [axis for axis, v, _ in axes if v == value]:
                parts.append(f"{words} along {listed(those)}")
        return "; ".join(parts)

    @model_validator(mode="after")
    def _read_components(self) -> Support:
        _ = self.values  # fails now, not when it is used
        return self

    @cached_property
    def values(self) -> tuple[Component, ...]:
        """The components as numbers, formulas or None (free); empty if all are 0."""
        given = [key for key in _MOTIONS if getattr(self, key) is not None]
        if len(given) > 1:
            raise InputError(
                f"{' and '.join(given)} are given together", where=given[1], expected="one of them"
            )
        key = self.key
        if (written := getattr(self, key)) is None:
            return ()
        integrals = _MOTIONS.index(key)
        return components(
            written,
            RATES[integrals],
            key=key,
            may_be_free=True,
            fields=not integrals,
            integrals=integrals,
        )

    @property
    def key(self) -> str:
        """The key that prescribes the motion: that of the displacement or of one of its rates."""
        given = (key for key in _MOTIONS if getattr(self, key) is not None)
        return next(given, "displacement")

    def values_in(self, dim: int) -> tuple[Component, ...]:
        """The components in a body of 2 or 3 dimensions.

        Raises:
            InputError: There are fewer or more.
        """
        values = sized(self.values, dim) or (0.0,) * dim
        _check_length(self, self.key, values, dim)
        return values

    @property
    def vectors(self) -> Mapping[str, tuple[Component, ...]]:
        """See `Restraint`."""
        return {self.key: self.values}

    @property
    def amplitude(self) -> Amplitude | None:
        """Its curve; constant where a component is a formula in t; None: the solver's default.

        For single components see `values.amplitude_of`.
        """
        timed = self.curve is None and depends_on_time(self.values)
        return CONSTANT if timed else self.curve

    @property
    def at_rest(self) -> bool:
        """See `Restraint`."""
        return all(value in (None, 0.0) for value in self.values)

    def prescribed_components(self, dim: int) -> tuple[int, ...]:
        """See `PrescribingSupport`."""
        return tuple(i for i, value in enumerate(self.values_in(dim)) if value is not None)

    def component(self, which: int) -> Component:
        """See `PrescribingSupport`."""
        return self.values[which] if self.values else 0.0


class Fixed(PrescribingSupport):
    """Nothing moves: all components of the displacement are 0.

    Example:
        Fixed(on="left")
    """

    kind: Literal["fixed"] = "fixed"
    key_hints: ClassVar[Mapping[str, str]] = {
        key: f'{key} belongs to kind = "displacement"; kind = "fixed" needs none'
        for key in (*_MOTIONS, "curve")
    }

    def describe(self, setting: Setting = ALONE) -> str:
        """See `Restraint`."""
        return _FIXED + other_keys(self)

    def prescribed_components(self, dim: int) -> tuple[int, ...]:
        """See `PrescribingSupport`."""
        return tuple(range(dim))


def _check_length(support: Restraint, key: str, values: tuple[Component, ...], dim: int) -> None:
    if len(values) != dim:
        check_components(values, dim, f"support '{support.label}'.{key}")


class Normal(PrescribingSupport):
    """A roller: the displacement along the surface's reference normal is prescribed, the rest free.

    On a curved surface each node has the mean normal of the facets around it, by their areas.

    Attributes:
        displacement: Along the outward normal [m]: a number, a text with a unit, a formula, or a
            scalar field of the mesh.
        curve: Amplitude over time; without it constants grow with the load in statics.

    Example:
        Normal(on="left")
    """

    kind: Literal["normal", "roller"] = "normal"
    displacement: Any = 0.0
    curve: Curve | None = None

    part_kinds: ClassVar[tuple[str, ...]] = ("surface",)

    @model_validator(mode="after")
    def _read(self) -> Normal:
        _ = self.value
        return self

    def describe(self, setting: Setting = ALONE) -> str:
        """See `Restraint`."""
        by = ", not across it"
        if not self.at_rest:
            by = f", moved across it by {given(self.displacement, 'm')}"
        return f"free to slide along the surface{by}{other_keys(self, 'displacement')}"

    @cached_property
    def value(self) -> Component:
        """The displacement as a number or formula."""
        if isinstance(self.displacement, list | tuple):
            raise InputError(
                f"{self.displacement!r} is not a number",
                where="displacement",
                expected="one number along the outward normal; components need "
                'kind = "displacement"',
            )
        with keyed("displacement"):
            return component(self.displacement, "m", fields=True)

    @property
    def at_rest(self) -> bool:
        """See `Restraint`."""
        return self.value == 0.0

    def prescribed_components(self, dim: int) -> tuple[int, ...]:
        """See `PrescribingSupport`."""
        return (NORMAL,)

    def component(self, which: int) -> Component:
        """See `PrescribingSupport`."""
        return self.value


class Symmetry(PrescribingSupport):
    """A plane of symmetry: no displacement along its normal.  Its surfaces must be flat.

    Example:
        Symmetry(on="left")
    """

    kind: Literal["symmetry"] = "symmetry"

    part_kinds: ClassVar[tuple[str, ...]] = ("surface",)
    needs_flat: ClassVar[bool] = True

    def describe(self, setting: Setting = ALONE) -> str:
        """See `Restraint`."""
        return "plane of symmetry: no displacement across it" + other_keys(self)

    def prescribed_components(self, dim: int) -> tuple[int, ...]:
        """See `PrescribingSupport`."""
        return (NORMAL,)


class Rotation(PrescribingSupport):
    """Rigid motion of a surface: u = (R - I)(X - c) + d, with any angle.

    R = I + sin(a) K + (1 - cos(a)) K^2, K the cross product with the axis.  Source: O. Rodrigues,
    J. Math. Pures Appl. 5 (1840) 380.

    Attributes:
        point: A point c on the axis of the undeformed body, in the mesh's unit.
        axis: x, y, z or a direction; in a plane body z.
        angle: "90 deg", a number in rad, or a formula in t; right-handed about the axis.
        velocity: In place of the angle: a constant rate, "90 deg/s" or a number in rad/s, or a
            record over time; it is integrated from rest.
        displacement: Translation d [m]: numbers, texts with units, or formulas in t.
        curve: Amplitude of angle and translation over time, not of an angle by its velocity;
            without it as in `displacement`.

    Example:
        Rotation(on="left", point=[0, 0, 0], axis="x", angle="90 deg")
    """

    kind: Literal["rotation"] = "rotation"
    point: Point
    axis: Direction | None = None
    angle: Any = None
    velocity: object = None
    displacement: list[Any] | None = None
    curve: Curve | None = None
    lengths: ClassVar[tuple[str, ...]] = ("point",)
    angles: ClassVar[Mapping[str, str]] = {"angle": "rad"}

    @model_validator(mode="after")
    def _read(self) -> Rotation:
        _ = self.rotation_angle, self.translation
        if self.velocity is not None and self.displacement is None:
            what = "the velocity says how the angle changes over time"
            expected = "leave one of them out; a record over time may stand for the velocity"
            refuse_unused_keys(self, [UnusedKeys(["curve"], what, expected)])
        return self

    def describe(self, setting: Setting = ALONE) -> str:
        """See `Restraint`."""
        moved = f", and moved by {given(self.displacement, 'm')}" if self.displacement else ""
        turned = f"by {given(self.angle, 'rad')}"
        if self.velocity is not None:
            turned = f"at {given(self.velocity, 'rad/s')}"
        return (
            f"turned {turned} about the axis {given(self.axis or 'z')} "
            f"through {given(self.point, 'm')}{moved}"
            + other_keys(self, "angle", "velocity", "axis", "point", "displacement")
        )

    @cached_property
    def translation(self) -> tuple[Component, ...]:
        """The translation d as numbers and formulas; empty if it is zero."""
        if self.displacement is None:
            return ()
        parts = components(self.displacement, "m", key="displacement")
        if any(isinstance(item, Formula) and not item.names <= {"t"} for item in parts):
            raise InputError(
                "a rigid motion is the same at all points",
                where="displacement",
                expected="numbers or formulas in t",
            )
        return parts

    @cached_property
    def rotation_angle(self) -> Component:
        """The angle [rad] as a number or formula."""
        if self.angle is not None and self.velocity is not None:
            raise InputError(
                "angle and velocity are given together", where="velocity", expected="one of them"
            )
        if self.velocity is not None:
            return turned_at(self.velocity)
        if self.angle is None:
            raise InputError(
                "this key is missing",
                where="angle",
                expected='for example "90 deg"; or velocity = "90 deg/s"',
            )
        return angle_of(self.angle)

    def place(self, t: float, default: Amplitude) -> FloatArray:
        """The point's present place c + d [m], of shape (3,).

        Args:
            t: Time [s], or load parameter.
            default: Amplitude where the support has no curve.
        """
        result = np.zeros(3)
        result[: len(self.point)] = self.point
        for i, item in enumerate(self.translation):
            value = np.asarray(_evaluated(item, np.zeros((1, 3)), t)).item()
            result[i] += self._scale(item, t, default) * value
        return result

    @cached_property
    def direction(self) -> tuple[float, ...]:
        """Unit vector of the axis."""
        return unit_vector("z" if self.axis is None else self.axis)

    @property
    def vectors(self) -> Mapping[str, tuple[Component, ...]]:
        """See `Restraint`."""
        return {"point": self.point, "displacement": self.translation}

    @property
    def time_functions(self) -> tuple[tuple[Component, ...], ...]:
        """See `Restraint`."""
        return (*super().time_functions, (self.rotation_angle,))

    @property
    def at_rest(self) -> bool:
        """See `Restraint`."""
        return all(value == 0.0 for value in (self.rotation_angle, *self.translation))

    def check_axis(self, dim: int) -> None:
        """See `Restraint`."""
        if dim == 3 and self.axis is None:
            raise InputError("this key is missing", where="axis", expected='for example "z"')
        if dim == 2 and any(self.direction[:2]):
            raise InputError(
                "a plane body turns about z only", where="axis", expected="leave it out"
            )

    def prescribed_components(self, dim: int) -> tuple[int, ...]:
        """See `PrescribingSupport`.

        Raises:
            InputError: The axis or a vector does not fit the body.
        """
        with keyed(f"support '{self.label}'"):
            self.check_axis(dim)
        _check_length(self, "point", self.point, dim)
        if self.translation:
            _check_length(self, "displacement", self.translation, dim)
        return tuple(range(dim))

    def at(
        self,
        which: int,
        x: FloatArray,
        t: float,
        default: Amplitude,
        fields: FieldsAt | None = None,
    ) -> FloatArray | float:
        """See `PrescribingSupport`."""
        angle = at_time(self.rotation_angle, t)
        if self.velocity is None:
            angle *= self._scale(self.rotation_angle, t, default)
        r = x - np.array([*self.point, 0.0])[:3]
        Kr = np.cross(self.direction, r)
        KKr = np.cross(self.direction, Kr)
        # 1 - cos(a) = 2 sin^2(a/2): small angles lose no digits.
        rotated = np.sin(angle) * Kr + 2 * np.sin(angle / 2) ** 2 * KKr
        if not self.translation:
            return np.asarray(rotated[:, which])
        d = self.translation[which]
        return np.asarray(rotated[:, which] + self._scale(d, t, default) * at_time(d, t))
