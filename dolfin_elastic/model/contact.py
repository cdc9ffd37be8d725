"""Contact: frictionless unilateral contact of surfaces with rigid obstacles.

The gap g of a point is its signed distance to the obstacle, positive outside, and n the obstacle's
outward normal there.  One formula serves UFL expressions and arrays alike.

An obstacle is put beside the mesh as a surface or a probe is: bare numbers of its places and radii
are in the mesh's unit, and `in_metres` gives the obstacle that a problem computes with.  Its motion
is a displacement as that of a support, in metres.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, TypeAlias

from pydantic import Field, model_validator

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.types import Scalar
from dolfin_elastic.core.units import ForceDensity, Length, MeshLength, Size, metres
from dolfin_elastic.model.amplitude import Amplitude, Curve
from dolfin_elastic.model.on_surfaces import OnSurfaces
from dolfin_elastic.model.values import amplitude_of, components

if TYPE_CHECKING:  # floats where they are computed with, in what `in_metres` returns
    Coordinate: TypeAlias = float
    Radius: TypeAlias = float
else:
    Coordinate, Radius = MeshLength, Size
Place = Annotated[list[Coordinate], Field(min_length=2, max_length=3)]
Vector = Annotated[list[float], Field(min_length=2, max_length=3)]
Constant = Callable[[float], Scalar]
"""A number as a constant of a form, or as it is."""
Root = Callable[[Scalar], Scalar]
"""The square root, of UFL or of numpy."""
Gap = tuple[Scalar, list[Scalar]]
"""Signed distance [m] and components of the obstacle's outward unit normal."""


class Obstacle(Record):
    """A rigid body with a smooth surface."""

    lengths: ClassVar[tuple[str, ...]] = ()
    """Fields that are places or radii: bare numbers in the mesh's unit, or texts with a unit."""

    def in_metres(self, scale: float) -> Self:
        """The same obstacle with all its lengths in metres.

        Args:
            scale: Metres per unit of length of the mesh.
        """
        found: dict[str, object] = {}
        for key in self.lengths:
            value = getattr(self, key)
            if isinstance(value, list):
                found[key] = [metres(item, scale) for item in value]
            elif value is not None:
                found[key] = metres(value, scale)
        return self.model_copy(update=found)

    def bare_lengths(self) -> list[float]:
        """Numbers without a unit, which are in the mesh's."""
        found: list[object] = []
        for key in self.lengths:
            value = getattr(self, key)
            found += value if isinstance(value, list) else [value]
        return [float(item) for item in found if isinstance(item, int | float)]

    @property
    def thickness(self) -> float:
        """Depth below the surface down to which the signed distance is unique [m]."""
        return math.inf

    @abstractmethod
    def check(self, dim: int, *, axisymmetric: bool) -> None:
        """Raises where the obstacle, in metres, does not fit the body.

        Args:
            dim: Dimension of the body.
            axisymmetric: The body is axisymmetric about y.

        Raises:
            InputError: A vector has the wrong length, or the obstacle is none in this plane.
        """

    @abstractmethod
    def gap(self, x: Sequence[Scalar], number: Constant, root: Root) -> Gap:
        """Signed distance and outward normal at points, of an obstacle in metres.

        Args:
            x: Components of current points minus the obstacle's displacement [m]: UFL scalars, or
                arrays of one shape.
            number: Turns a number of the obstacle into an operand for `x`, such as a UFL constant.
            root: Square root for operands of this kind.
        """


class Plane(Obstacle):
    """A half space.

    Attributes:
        point: A point of its surface.
        normal: Direction from the obstacle to the free side, of any length but zero.
        axis: In place of a point and a normal: the normal is x, y, z, -x, -y or -z, ...
        at: ... and this the coordinate of the surface.
    """

    lengths: ClassVar[tuple[str, ...]] = ("point", "at")
    point: Place | None = None
    normal: Vector | None = None
    axis: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None
    at: Coordinate | None = None

    @model_validator(mode="after")
    def _whole(self) -> Plane:
        given = [getattr(self, key) is not None for key in ("point", "normal", "axis", "at")]
        if given not in ([True, True, False, False], [False, False, True, True]):
            raise InputError(
                "a plane needs point and normal, or axis and at",
                expected='{point = [0, 0, 0], normal = [0, 0, 1]} or {axis = "z", at = 0}',
            )
        if self.normal is not None and not any(self.normal):
            raise InputError("a normal cannot be zero", where="normal", expected="[0, 0, 1]")
        return self

    def check(self, dim: int, *, axisymmetric: bool) -> None:
        """See `Obstacle.check`."""
        if self.axis is not None:
            if self.axis[-1] not in "xyz"[:dim]:
                raise InputError(
                    f"a plane body has no axis '{self.axis}'", where="axis", expected="x or y"
                )
            return
        _check_length(self.point, dim, "point")
        _check_length(self.normal, dim, "normal")

    def placed(self, dim: int) -> tuple[list[float], list[float]]:
        """A point of the surface and the unit normal, of a plane in metres."""
        if self.axis is not None:
            assert self.at is not None
            unit = [1.0 if axis == self.axis[-1] else 0.0 for axis in "xyz"[:dim]]
            sign = -1.0 if self.axis.startswith("-") else 1.0
            return [self.at * item for item in unit], [sign * item for item in unit]
        assert self.point is not None
        assert self.normal is not None
        return self.point, _unit(self.normal)

    def gap(self, x: Sequence[Scalar], number: Constant, root: Root) -> Gap:
        """See `Obstacle.gap`: g = (x - point) . n."""
        point, normal = self.placed(len(x))
        n = [number(item) for item in normal]
        return sum((a - number(p)) * b for a, p, b in zip(x, point, n, strict=True)), n


class SphereObstacle(Obstacle):
    """A ball (a disc in a plane), or all that lies outside of one.

    Attributes:
        center: Its middle.
        radius: Its radius.
        inside: The body is inside: the obstacle is a spherical cavity.
    """

    lengths: ClassVar[tuple[str, ...]] = ("center", "radius")
    center: Place
    radius: Radius
    inside: bool = False

    @property
    def thickness(self) -> float:
        """See `Obstacle.thickness`."""
        return math.inf if self.inside else self.radius

    def check(self, dim: int, *, axisymmetric: bool) -> None:
        """See `Obstacle.check`."""
        _check_length(self.center, dim, "center")
        if axisymmetric and self.center[0] != 0.0:
            raise InputError(
                "an axisymmetric body meets spheres about its axis only",
                where="center",
                expected="[0, y]",
            )

    def gap(self, x: Sequence[Scalar], number: Constant, root: Root) -> Gap:
        """See `Obstacle.gap`: g = |x - center| - radius, or its negative inside."""
        arm = [a - number(c) for a, c in zip(x, self.center, strict=True)]
        return _round(arm, number(self.radius), root, self.inside)


class CylinderObstacle(Obstacle):
    """An endless circular cylinder, or all that lies outside of one.

    Attributes:
        axis: x, y, z or a direction; z in plane strain and plane stress, y in an axisymmetric body.
        point: A point of the axis.
        radius: Its radius.
        inside: The body is inside: the obstacle is a bore.
    """

    lengths: ClassVar[tuple[str, ...]] = ("point", "radius")
    axis: Literal["x", "y", "z"] | Vector = "z"
    point: Place
    radius: Radius
    inside: bool = False

    @model_validator(mode="after")
    def _has_direction(self) -> CylinderObstacle:
        if not isinstance(self.axis, str) and not any(self.axis):
            raise InputError("a direction cannot be zero", where="axis", expected="[0, 0, 1]")
        return self

    @property
    def thickness(self) -> float:
        """See `Obstacle.thickness`."""
        return math.inf if self.inside else self.radius

    def check(self, dim: int, *, axisymmetric: bool) -> None:
        """See `Obstacle.check`."""
        _check_length(self.point, dim, "point")
        if dim == 2 and self.axis != ("y" if axisymmetric else "z"):
            raise InputError(
                f"{'an axisymmetric' if axisymmetric else 'a plane'} body meets no cylinder along "
                f"{self.axis}",
                where="axis",
                expected='"y"' if axisymmetric else '"z"',
            )
        if axisymmetric and self.point[0] != 0.0:
            raise InputError(
                "an axisymmetric body meets cylinders about its axis only",
                where="point",
                expected="[0, 0]",
            )
        if dim == 3 and not isinstance(self.axis, str):
            _check_length(self.axis, dim, "axis")

    def gap(self, x: Sequence[Scalar], number: Constant, root: Root) -> Gap:
        """See `Obstacle.gap`: g is the distance from the axis minus the radius, or its negative."""
        arm = [a - number(p) for a, p in zip(x, self.point, strict=True)]
        if isinstance(self.axis, str):
            along = [1.0 if axis == self.axis else 0.0 for axis in "xyz"[: len(x)]]
        else:
            along = _unit(self.axis)
        a = [number(item) for item in along]
        share = sum(p * q for p, q in zip(arm, a, strict=True))
        across = [p - share * q for p, q in zip(arm, a, strict=True)]
        return _round(across, number(self.radius), root, self.inside)


def _round(arm: list[Scalar], radius: Scalar, root: Root, inside: bool) -> Gap:
    # On the axis or in the centre the normal is not defined.  The small term makes it 0 there and
    # keeps derivatives finite; elsewhere it is below round-off.
    length = root(sum(item * item for item in arm) + 1e-16 * radius * radius)
    sign = -1.0 if inside else 1.0
    return sign * (length - radius), [sign * item / length for item in arm]


def _unit(vector: Sequence[float]) -> list[float]:
    length = math.hypot(*vector)
    return [item / length for item in vector]


def _check_length(vector: Sequence[float] | None, dim: int, where: str) -> None:
    if vector is not None and len(vector) != dim:
        raise InputError(
            f"{len(vector)} components given",
            where=where,
            expected=f"the body is {dim}-dimensional, expected {dim}",
        )


class Contact(OnSurfaces):
    """Surfaces of the body that cannot penetrate a rigid obstacle, without friction.

    Attributes:
        on: Name of a surface that may touch it, or several.
        plane: A half space; exactly one of the three shapes is given.
        sphere: A ball, or the spherical cavity in which the body lies.
        cylinder: A cylinder, or the bore in which the body lies.
        motion: Displacement of the obstacle [m]: numbers, texts with units, or formulas in t.
        curve: Amplitude of the motion over time, as that of a support.
        gap_tolerance: Penetration that statics leaves [m]; 1e-3 of the cells' size there.
        stiffness: Pressure per depth [Pa/m]; about 10 (K + 4 mu/3)/h of the cells there.
    """

    plane: Plane | None = None
    sphere: SphereObstacle | None = None
    cylinder: CylinderObstacle | None = None
    motion: list[Any] = Field(default=[])
    curve: Curve | None = None
    gap_tolerance: Length | None = Field(default=None, gt=0)
    stiffness: ForceDensity | None = Field(default=None, gt=0)

    @model_validator(mode="after")
    def _one_shape(self) -> Contact:
        given = [key for key in SHAPES if getattr(self, key) is not None]
        if len(given) != 1:
            what = f"{' and '.join(given)} are given" if given else "the obstacle has no shape"
            raise InputError(what, expected=f"exactly one of {', '.join(SHAPES)}")
        for index, value in enumerate(self.values):
            if isinstance(value, Formula) and value.names - {"t"}:
                raise InputError(
                    "the obstacle is rigid: its motion depends on t only",
                    where=f"motion[{index}]",
                    expected='for example "0.01*sin(pi*t)"',
                )
        return self

    @cached_property
    def values(self) -> tuple[float | Formula, ...]:
        """Components of the obstacle's displacement; empty: it is at rest."""
        return components(self.motion, "m", key="motion") if self.motion else ()  # type: ignore[return-value]

    @property
    def shape(self) -> str:
        """Which of `SHAPES` is given."""
        return next(key for key in SHAPES if getattr(self, key) is not None)

    @property
    def obstacle(self) -> Obstacle:
        """The rigid obstacle, of any shape."""
        found: Obstacle = getattr(self, self.shape)
        return found

    def in_metres(self, scale: float) -> Self:
        """The same contact with the obstacle in metres, see `Obstacle.in_metres`.

        Args:
            scale: Metres per unit of length of the mesh.
        """
        return self.model_copy(update={self.shape: self.obstacle.in_metres(scale)})

    def displacement_at(self, t: float, default: Amplitude, dim: int) -> list[float]:
        """Displacement of the obstacle at time t [m], `dim` components.

        Args:
            t: Time [s], or load parameter.
            default: Amplitude where the contact has no curve.
            dim: Dimension of the body.
        """
        if not self.values:
            return [0.0] * dim
        return [
            (amplitude_of(v, self.curve) or default).at(t)
            * float(v.evaluate(t=t) if isinstance(v, Formula) else v)
            for v in self.values
        ]

    def check(self, dim: int, *, axisymmetric: bool) -> None:
        """Raises where the obstacle, in metres, or its motion does not fit the body.

        Args:
            dim: Dimension of the body.
            axisymmetric: The body is axisymmetric about y.

        Raises:
            InputError: With the key inside the contact's table.
        """
        try:
            self.obstacle.check(dim, axisymmetric=axisymmetric)
        except InputError as error:
            raise error.at(self.shape) from None
        if self.values:
            _check_length([0.0] * len(self.values), dim, "motion")
        if axisymmetric and self.values and self.values[0] != 0.0:
            raise InputError(
                "an obstacle about the axis moves along it only",
                where="motion[0]",
                expected="0",
            )


SHAPES = ("plane", "sphere", "cylinder")
