"""`Shape`: planes, spheres and cylinders, by which parts are selected, and which bodies touch.

The fields of a shape are the keys of its table.  It stands beside a mesh as a surface or a probe
does: bare numbers of its places and radii are in the mesh's unit, and `in_metres` gives the shape
that is computed with.  One formula of its distance serves UFL expressions and arrays alike.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated, ClassVar, NamedTuple, Self, TypeAlias

import numpy as np
from pydantic import Field, model_validator

from dolfin_elastic.core.errors import InputError, MeshError
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.shapes.box import Box, point_of
from dolfin_elastic.core.shapes.directions import Along, Direction, check_components, unit_vector
from dolfin_elastic.core.shapes.triangles import ROUND, WIDE, Triangles, across, revolved, whole
from dolfin_elastic.core.types import FloatArray, Scalar
from dolfin_elastic.core.units import MeshLength, Size, metres

if TYPE_CHECKING:  # floats where they are computed with, in what `in_metres` returns
    Coordinate: TypeAlias = float
    PositiveLength: TypeAlias = float
else:
    Coordinate, PositiveLength = MeshLength, Size
Point = Annotated[tuple[Coordinate, ...], Field(min_length=2, max_length=3)]
_DEEP = 0.04
"""Depth of a drawn line over the diagonal of the body beside."""
Distance = tuple[Scalar, list[Scalar]]
"""Signed distance [m], and components of the unit normal along which it grows."""


class Operations(NamedTuple):
    """What distances are computed with, of UFL or of numpy.

    Attributes:
        number: A number of the shape as an operand, such as a constant of a form.
        root: The square root.
        choose: Of three operands the second where the first is not below 0, elsewhere the third.
    """

    number: Callable[[float], Scalar]
    root: Callable[[Scalar], Scalar]
    choose: Callable[[Scalar, Scalar, Scalar], Scalar]


ARRAYS = Operations(float, np.sqrt, lambda sign, a, b: np.where(np.asarray(sign) >= 0.0, a, b))


class Shape(Record):
    """A body with a surface."""

    in_forms: ClassVar[bool] = True
    """Whether its distance can be written in UFL."""
    anchor: ClassVar[tuple[str, str]] = ("", "")
    """Key of the point that says where it is, if it may be left out, and what is expected there."""

    def bare_lengths(self) -> list[float]:
        """Numbers without a unit, which are in the mesh's."""
        rows = [v if isinstance(v, tuple) else (v,) for v in self.given_lengths().values()]
        return [float(x) for row in rows for x in row if isinstance(x, int | float)]

    def selecting(self, scale: float, dim: int, where: str) -> Self:
        """The shape in metres, by which parts of a body are selected, of which `where` is the key.

        Further coordinates of its places than the body has are left out. See `point_of`.
        """
        result: dict[str, object] = {
            key: point_of(value, scale, dim, f"{where}.{key}")
            if isinstance(value, tuple)
            else metres(value, scale)
            for key, value in self.given_lengths().items()
        }
        return self.converted(result)

    @property
    def placed(self) -> bool:
        """Whether it says where it is; if not, it stands for all faces of a CAD file like it."""
        return not self.anchor[0] or getattr(self, self.anchor[0]) is not None

    def check_placed(self, where: str) -> None:
        """Raises a `MeshError` with the missing key if it does not say where it is.

        Args:
            where: Key of the shape.
        """
        if not self.placed:
            key, expected = self.anchor
            raise MeshError("this key is missing", where=f"{where}.{key}", expected=expected)

    @property
    def hollow(self) -> bool:
        """Whether it stands for all that lies outside of it, by its key `inside`."""
        return bool(getattr(self, "inside", False))

    @property
    def thickness(self) -> float:
        """Depth below the surface down to which the signed distance is unique [m]."""
        return math.inf if self.hollow else float(getattr(self, "radius", math.inf))

    def check(self, dim: int, *, axisymmetric: bool) -> None:
        """Raises where the shape, in metres, cannot be met by a body.

        Raises:
            InputError: A vector has the wrong length, or the shape is none in this plane.
        """
        for key, value in self.given_lengths().items():
            if isinstance(value, tuple):
                check_components(value, dim, key)

    @abstractmethod
    def distance(self, x: Sequence[Scalar], use: Operations) -> Distance:
        """Signed distance, negative inside, and outward normal at points, of a shape in metres.

        Args:
            x: Components of points [m]: UFL scalars, or arrays of one shape.
            use: Of UFL where `x` is, else `ARRAYS`.
        """

    def gap(self, x: Sequence[Scalar], use: Operations) -> Distance:
        """Signed distance and normal towards the side on which bodies may be. See `distance`."""
        distance, normal = self.distance(x, use)
        return (
            (-1.0 * distance, [-1.0 * item for item in normal])
            if self.hollow
            else (distance, normal)
        )

    def gaps(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gaps [m] and normals at points, shape (..., dim), of a shape in metres. See `gap`."""
        distance, normal = self.gap(list(np.moveaxis(x, -1, 0)), ARRAYS)
        gaps = np.asarray(distance, dtype=np.float64)
        return gaps, np.stack([np.broadcast_to(item, gaps.shape) for item in normal], axis=-1)

    def curvature(self, x: FloatArray) -> FloatArray:
        """Second derivatives of the gap at points [1/m], of a shape in metres.

        Args:
            x: Points [m], shape (..., dim).

        Returns:
            Shape (..., dim, dim); 0 of planes.
        """
        return np.zeros((*x.shape, x.shape[-1]))

    @property
    def edge_radius(self) -> float:
        """Radius by which its `edges` are round [m]."""
        return 0.0

    def edges(self, dim: int) -> FloatArray:
        """Ends of its edges that could enter a face, shape (n, 2, dim) [m]; of tips both alike."""
        return np.empty((0, 2, dim))

    def followed(self) -> Self:
        """The same shape for a set of points that moves, whose normals do not jump for ever."""
        return self

    def forget(self) -> None:
        """Normals of a shape that is `followed` may jump again, and its points may be others."""

    def off(self, x: FloatArray) -> FloatArray:
        """Signed distances of points, shape (..., dim), of a shape in metres."""
        return np.asarray(self.distance(list(np.moveaxis(x, -1, 0)), ARRAYS)[0])

    def outside(self, x: FloatArray) -> FloatArray:
        """Distances of points, shape (..., dim), of a shape in metres; 0 within."""
        return np.maximum(self.off(x), 0.0)

    def drawn(self, near: Box, dim: int) -> Triangles:
        """Its surface, counter-clockwise seen from where bodies may be. See `triangles`."""
        points, triangles = self.triangles(near, dim)
        return points, triangles[:, ::-1] if self.hollow else triangles

    @abstractmethod
    def triangles(self, near: Box, dim: int) -> Triangles:
        """Its surface, counter-clockwise seen from outside; what is endless beside a box.

        Args:
            dim: Of the body; in a plane what the shape fills of it.
        """


class Plane(Shape):
    """A half space.

    Attributes:
        point: A point of its surface.
        normal: Direction from the obstacle to the free side, of any length but zero.
        axis: In place of a point and a normal: the normal is x, y, z, -x, -y or -z, ...
        at: ... and this the coordinate of the surface.
    """

    lengths: ClassVar[tuple[str, ...]] = ("point", "at")
    point: Point | None = None
    normal: Direction | None = None
    axis: Along | None = None
    at: Coordinate | None = None

    @model_validator(mode="after")
    def _whole(self) -> Plane:
        given = [getattr(self, key) is not None for key in ("point", "normal", "axis", "at")]
        if given not in ([True, True, False, False], [False, False, True, True]):
            raise InputError(
                "a plane needs point and normal, or axis and at",
                expected='{point = [0, 0, 0], normal = [0, 0, 1]} or {axis = "z", at = 0}',
            )
        return self

    def check(self, dim: int, *, axisymmetric: bool) -> None:
        """See `Shape.check`."""
        super().check(dim, axisymmetric=axisymmetric)
        check_components(self.axis, dim, "axis")
        check_components(self.normal, dim, "normal")

    def frame(self, dim: int) -> tuple[Sequence[float], Sequence[float]]:
        """A point of the surface and the unit normal, of a plane in metres."""
        if self.axis is not None:
            assert self.at is not None
            normal = unit_vector(self.axis)[:dim]
            return [self.at * abs(item) for item in normal], normal
        assert self.point is not None
        assert self.normal is not None
        return self.point, unit_vector(self.normal)[:dim]

    def distance(self, x: Sequence[Scalar], use: Operations) -> Distance:
        """See `Shape.distance`: (x - point) . n."""
        point, normal = self.frame(len(x))
        n = [use.number(item) for item in normal]
        return sum((a - use.number(p)) * b for a, p, b in zip(x, point, n, strict=True)), n

    def triangles(self, near: Box, dim: int) -> Triangles:
        """See `Shape.triangles`: a square, in a plane a strip, where it is nearest to the box."""
        point, normal = (whole(vector) for vector in self.frame(dim))
        foot = near.middle - normal * float((near.middle - point) @ normal)
        size = WIDE * near.diagonal
        if dim == 2:
            a, down = size * np.cross(normal, [0.0, 0.0, 1.0]), -_DEEP * near.diagonal * normal
            corners = [foot - a, foot + a, foot + a + down, foot - a + down]
        else:
            a, b = (size * one for one in across(normal))
            corners = [foot - a - b, foot + a - b, foot + a + b, foot - a + b]
        return np.array(corners), np.array([[0, 1, 2], [0, 2, 3]])


class Sphere(Shape):
    """A sphere (in 2D a circle); without a centre all faces of a CAD file that are like it."""

    lengths: ClassVar[tuple[str, ...]] = ("center", "radius")
    anchor: ClassVar[tuple[str, str]] = ("center", "for example [0, 0, 0]")
    center: Point | None = None
    radius: PositiveLength

    def check(self, dim: int, *, axisymmetric: bool) -> None:
        """See `Shape.check`."""
        super().check(dim, axisymmetric=axisymmetric)
        if axisymmetric and self.center and self.center[0] != 0.0:
            raise InputError(
                "an axisymmetric body meets spheres about its axis only",
                where="center",
                expected="[0, y]",
            )

    def distance(self, x: Sequence[Scalar], use: Operations) -> Distance:
        """See `Shape.distance`: |x - center| - radius."""
        assert self.center is not None
        arm = [a - use.number(c) for a, c in zip(x, self.center, strict=True)]
        return _round(arm, use.number(self.radius), use)

    def curvature(self, x: FloatArray) -> FloatArray:
        """See `Shape.curvature`."""
        return _round_curvature(self, x, np.eye(x.shape[-1]))

    def triangles(self, near: Box, dim: int) -> Triangles:
        """See `Shape.triangles`."""
        assert self.center is not None
        fall = np.linspace(np.pi, 0, ROUND // 2 + 1)
        if dim == 2:
            return _disc(self.center, self.radius)
        along, radii = self.radius * np.cos(fall), self.radius * np.sin(fall)
        return revolved(whole(self.center), np.eye(3)[2], along, radii)

    def volume(self, dim: int) -> float:
        """Its volume [m^3], or area in 2D, rounded up."""
        return (4.2 if dim == 3 else 3.2) * self.radius**dim


class SphereObstacle(Sphere):
    """A ball (a disc in a plane), or all that lies outside of one.

    Attributes:
        center: Its middle.
        radius: Its radius.
        inside: The body is inside: the obstacle is a spherical cavity.
    """

    center: Point
    inside: bool = False


class Cylinder(Shape):
    """An endless circular cylinder (in 2D, with axis z, a circle).

    Without a point of its axis all faces of a CAD file that are like it.

    Attributes:
        axis: Its direction; z by default, any if there is no point.
        point: Of the axis.
        radius: Its radius.
    """

    lengths: ClassVar[tuple[str, ...]] = ("point", "radius")
    anchor: ClassVar[tuple[str, str]] = ("point", "a point of the axis, for example [0, 0, 0]")
    axis: Direction | None = None
    point: Point | None = None
    radius: PositiveLength

    @property
    def direction(self) -> tuple[float, ...]:
        """Unit vector along the axis, three components."""
        return unit_vector(self.axis or "z")

    def selecting(self, scale: float, dim: int, where: str) -> Self:
        """See `Shape.selecting`.

        Raises:
            MeshError: The axis lies in the plane of a plane body.
        """
        shape = super().selecting(scale, dim, where)
        if dim == 2 and any(self.direction[:2]):
            raise MeshError(
                "the body is plane: the axis of a cylinder must be z",
                where=f"{where}.axis",
                expected='"z"',
            )
        return shape

    def check(self, dim: int, *, axisymmetric: bool) -> None:
        """See `Shape.check`."""
        super().check(dim, axisymmetric=axisymmetric)
        along = 1 if axisymmetric else 2
        if dim == 2 and any(a for i, a in enumerate(self.direction) if i != along):
            raise InputError(
                f"{'an axisymmetric' if axisymmetric else 'a plane'} body meets no cylinder along "
                f"{self.axis}",
                where="axis",
                expected='"y"' if axisymmetric else '"z"',
            )
        if axisymmetric and self.point and self.point[0] != 0.0:
            raise InputError(
                "an axisymmetric body meets cylinders about its axis only",
                where="point",
                expected="[0, 0]",
            )
        if dim == 3:
            check_components(self.axis, dim, "axis")

    def distance(self, x: Sequence[Scalar], use: Operations) -> Distance:
        """See `Shape.distance`: the distance from the axis minus the radius."""
        assert self.point is not None
        arm = [a - use.number(p) for a, p in zip(x, self.point, strict=True)]
        a = [use.number(item) for item in self.direction[: len(x)]]
        share = sum(p * q for p, q in zip(arm, a, strict=True))
        arm = [p - share * q for p, q in zip(arm, a, strict=True)]
        return _round(arm, use.number(self.radius), use)

    def curvature(self, x: FloatArray) -> FloatArray:
        """See `Shape.curvature`."""
        a = np.array(self.direction[: x.shape[-1]])
        return _round_curvature(self, x, np.eye(len(a)) - np.outer(a, a))

    def triangles(self, near: Box, dim: int) -> Triangles:
        """See `Shape.triangles`."""
        assert self.point is not None
        if dim == 2 and self.direction[2]:
            return _disc(self.point, self.radius)
        axis, point = np.array(self.direction), whole(self.point)
        along = float((near.middle - point) @ axis) + WIDE * near.diagonal * np.array([-1.0, 1.0])
        return revolved(point, axis, along, np.full(2, self.radius))


class CylinderObstacle(Cylinder):
    """An endless circular cylinder, or all that lies outside of one.

    Attributes:
        axis: x, y, z or a direction; z in plane strain and plane stress, y in an axisymmetric body.
        point: A point of the axis.
        radius: Its radius.
        inside: The body is inside: the obstacle is a bore.
    """

    axis: Direction = "z"
    point: Point
    inside: bool = False


def _round(arm: list[Scalar], radius: Scalar, use: Operations) -> Distance:
    # On the axis or in the centre the normal is not defined.  The small term makes it 0 there and
    # keeps derivatives finite; elsewhere it is below round-off.
    length = use.root(sum(item * item for item in arm) + 1e-16 * radius * radius)
    return length - radius, [item / length for item in arm]


def _round_curvature(shape: Sphere | Cylinder, x: FloatArray, across: FloatArray) -> FloatArray:
    """(A - n n)/r, r the distance from centre or axis, A what leaves out the axis."""
    distance, normal = shape.distance(list(np.moveaxis(x, -1, 0)), ARRAYS)
    n = np.stack([np.asarray(item) for item in normal], axis=-1)
    r = np.asarray(distance) + shape.radius
    result = (across - n[..., :, None] * n[..., None, :]) / r[..., None, None]
    return -result if shape.hollow else result


def _disc(centre: Sequence[float], radius: float) -> Triangles:
    return revolved(whole(centre), np.eye(3)[2], np.zeros(2), np.array([radius, 0.0]))
