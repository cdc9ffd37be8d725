"""`BoxObstacle` and `ConeObstacle`: obstacles with edges, corners and tips.

Outside of them the nearest point may lie on an edge or in a corner: there the distance is a round
one, and the normal turns.  Inside it is the distance from the nearest face.  With round edges a
shape is all that is not farther than their radius from a smaller one with sharp edges.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, ClassVar, TypeAlias

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from dolfin_elastic.core.errors import InputError, UnitError
from dolfin_elastic.core.shapes.box import Box
from dolfin_elastic.core.shapes.directions import Direction, check_components, square, unit_vector
from dolfin_elastic.core.shapes.shapes import Distance, Operations, Point, PositiveLength, Shape
from dolfin_elastic.core.shapes.triangles import WIDE, Triangles, block, revolved, whole
from dolfin_elastic.core.types import FloatArray, Scalar
from dolfin_elastic.core.units import no_switch, to_si

_TINY = 1e-60
"""Square of a length [m^2] that keeps derivatives of roots finite where they do not count."""
_ON_AXIS = 1e-20
"""Square of the distance from an axis, over that from the tip, below which there is no normal."""


def radians(angle: float | str) -> float:
    """An angle that is written beside a mesh: a number in degrees, or a text with a unit."""
    try:
        return math.radians(float(angle))
    except ValueError:
        return to_si(angle, "rad")


def _acute(angle: float | str) -> float | str:
    try:
        between = 0.0 < radians(angle) < math.pi / 2
    except UnitError as error:
        raise UnitError(error.what, expected='degrees, or an angle such as "0.5 rad"') from None
    if not between:
        raise ValueError("should be above 0 and below 90 degrees")
    return angle


if TYPE_CHECKING:
    AcuteAngle: TypeAlias = float | str
else:
    AcuteAngle = Annotated[float | str, BeforeValidator(no_switch), AfterValidator(_acute)]


class BoxObstacle(Shape):
    """A box, or all that lies outside of one.

    Attributes:
        center: Its middle.
        size: Lengths of its sides.
        x: Direction of the first side.
        y: Of the second side, at a right angle to x; by default at one to z, too.
        inside: The body is inside: the obstacle is a case.
        rounding: Radius of its edges and corners.
    """

    lengths: ClassVar[tuple[str, ...]] = ("center", "size", "rounding")
    center: Point
    size: Annotated[tuple[PositiveLength, ...], Field(min_length=2, max_length=3)]
    x: Direction = "x"
    y: Direction | None = None
    inside: bool = False
    rounding: PositiveLength | None = None

    @property
    def thickness(self) -> float:
        """See `Shape.thickness`."""
        return math.inf if self.hollow else min(self.size) / 2

    @property
    def edge_radius(self) -> float:
        """See `Shape.edge_radius`."""
        return self.rounding or 0.0

    @property
    def sharp(self) -> FloatArray:
        """Half the sides of the box with sharp edges within it."""
        return np.asarray(np.array(self.size) / 2 - (self.rounding or 0.0))

    def sides(self, dim: int) -> FloatArray:
        """Unit vectors along its sides, right-handed, shape (dim, dim)."""
        a = unit_vector(self.x)
        level = (-a[1], a[0], 0.0) if any(a[:2]) else "y"
        result = square(self.x, level if self.y is None else self.y)[:dim, :dim]
        result[-1] *= np.sign(np.linalg.det(result))  # in a plane y may be to the right of x
        return result

    def check(self, dim: int, *, axisymmetric: bool) -> None:
        """See `Shape.check`."""
        super().check(dim, axisymmetric=axisymmetric)
        check_components(self.x, dim, "x")
        check_components(self.y, dim, "y")
        if self.rounding is not None and self.sharp.min() < 0.0:
            raise InputError(
                "edges have a larger radius than half of the smallest side",
                where="rounding",
                expected=f"at most {min(self.size) / 2:g} m",
            )
        sides = self.sides(dim)
        if not axisymmetric:
            return
        upright = self.center[0] == 0.0 and np.isclose(sides, 0.0).any()
        if not upright and self.center[0] < np.abs(sides[:, 0]) @ np.array(self.size) / 2:
            raise InputError(
                "an axisymmetric body meets boxes about its axis, with sides along x and y, or "
                "beside it",
                where="center",
                expected="[0, y], or all of the box at x >= 0",
            )

    def _local(self, x: Sequence[Scalar], use: Operations) -> tuple[list[Scalar], list[Scalar]]:
        """How far points lie beyond the faces along each side, and on which side of the middle."""
        arm = [a - use.number(c) for a, c in zip(x, self.center, strict=True)]
        along = [_combined(row, arm, use) for row in self.sides(len(x))]
        signs = [use.choose(a, 1.0, -1.0) for a in along]
        rows = zip(along, signs, self.sharp, strict=True)
        return [a * sign - use.number(float(half)) for a, sign, half in rows], signs

    def distance(self, x: Sequence[Scalar], use: Operations) -> Distance:
        """See `Shape.distance`: |max(q, 0)|, or max q inside, q as far as it is beyond each face.

        Source: I. Quilez, Distance functions, 2008 (iquilezles.org/articles/distfunctions).
        """
        q, signs = self._local(x, use)
        most = q[0]
        nearest: list[Scalar] = [float(i == 0) for i in range(len(q))]
        for j, one in enumerate(q[1:], 1):
            nearest = [use.choose(most - one, n, float(i == j)) for i, n in enumerate(nearest)]
            most = use.choose(most - one, most, one)
        beyond = [use.choose(one, one, 0.0) for one in q]
        length = use.root(sum(one * one for one in beyond) + _TINY)
        rows = zip(nearest, beyond, signs, strict=True)
        local = [sign * use.choose(-1.0 * most, n, b / length) for n, b, sign in rows]
        normal = [_combined(column, local, use) for column in self.sides(len(x)).T]
        return _less(use.choose(-1.0 * most, most, length), self.rounding, use), normal

    def curvature(self, x: FloatArray) -> FloatArray:
        """See `Shape.curvature`: round edges and corners outside."""
        sides = self.sides(x.shape[-1])
        along = (x - np.array(self.center)) @ sides.T
        beyond = np.maximum(np.abs(along) - self.sharp, 0.0)
        off = np.count_nonzero(beyond, axis=-1) > 1
        n, length = np.sign(along) * beyond, np.linalg.norm(beyond, axis=-1)
        length = np.where(off, length, 1.0)[..., None]
        n /= length
        local = (beyond > 0)[..., None] * np.eye(x.shape[-1]) - n[..., :, None] * n[..., None, :]
        local *= np.where(off, -1.0 if self.hollow else 1.0, 0.0)[..., None, None]
        return np.asarray(sides.T @ (local / length[..., None]) @ sides)

    def _corners(self, half: FloatArray) -> Triangles:
        """Those of a box with such halves of its sides about its middle, and its triangles."""
        points, triangles = block(len(half))
        return np.array(self.center) + points * half @ self.sides(len(half)), triangles

    def edges(self, dim: int) -> FloatArray:
        """See `Shape.edges`."""
        if self.hollow:
            return super().edges(dim)
        x, _ = self._corners(self.sharp)
        if dim == 2:
            return np.stack([x, x], axis=1)
        beside = [[0, 1], [1, 2], [2, 3], [3, 0]]
        upright = [[i, i + 4] for i in range(4)]
        return x[np.array([*beside, *(np.array(beside) + 4).tolist(), *upright])]

    def triangles(self, near: Box, dim: int) -> Triangles:
        """See `Shape.triangles`."""
        x, triangles = self._corners(np.array(self.size) / 2)
        return np.array([whole(row) for row in x]), triangles


class ConeObstacle(Shape):
    """An endless circular cone (a wedge in a plane), or all that lies outside of one.

    Attributes:
        tip: Its point.
        axis: Direction from the tip into the cone.
        half_angle: Between axis and surface, in degrees without a unit.
        inside: The body is inside: the obstacle is a funnel.
        rounding: Radius of its end, which touches the surface of the sharp cone that ends at `tip`.
    """

    lengths: ClassVar[tuple[str, ...]] = ("tip", "rounding")
    angles: ClassVar[Mapping[str, str]] = {"half_angle": "deg"}
    tip: Point
    axis: Direction
    half_angle: AcuteAngle
    inside: bool = False
    rounding: PositiveLength | None = None

    @property
    def edge_radius(self) -> float:
        """See `Shape.edge_radius`."""
        return self.rounding or 0.0

    @property
    def sharp(self) -> FloatArray:
        """Tip of the sharp cone within it, the middle of its round end."""
        tip = np.array(self.tip)
        axis = np.array(unit_vector(self.axis)[: len(tip)])
        return np.asarray(tip + (self.rounding or 0.0) / self.slope[1] * axis)

    @property
    def slope(self) -> tuple[float, float]:
        """Cosine and sine of its half angle."""
        angle = radians(self.half_angle)
        return math.cos(angle), math.sin(angle)

    def check(self, dim: int, *, axisymmetric: bool) -> None:
        """See `Shape.check`."""
        super().check(dim, axisymmetric=axisymmetric)
        check_components(self.axis, dim, "axis")
        if axisymmetric and (unit_vector(self.axis)[0] or self.tip[0]):
            raise InputError(
                "an axisymmetric body meets cones about its axis only",
                where="axis" if unit_vector(self.axis)[0] else "tip",
                expected='tip = [0, y] and axis = "y" or "-y"',
            )

    def distance(self, x: Sequence[Scalar], use: Operations) -> Distance:
        """See `Shape.distance`: r cos(angle) - z sin(angle), or the distance from the tip.

        z is along the axis and r off it: the nearest point of the surface lies
        z cos(angle) + r sin(angle) from the tip, or is the tip where that is negative.
        """
        c, s = (use.number(item) for item in self.slope)
        a = [use.number(item) for item in unit_vector(self.axis)[: len(x)]]
        arm = [p - use.number(q) for p, q in zip(x, map(float, self.sharp), strict=True)]
        z = sum(p * q for p, q in zip(arm, a, strict=True))
        off = [p - z * q for p, q in zip(arm, a, strict=True)]
        square_off, square_arm = (sum(p * p for p in row) for row in (off, arm))
        r = use.root(square_off + _ON_AXIS * square_arm + _TINY)
        length = use.root(square_arm + _TINY)
        from_tip = z * c + r * s
        normal = [
            use.choose(from_tip, c * p / r - s * q, d / length)
            for p, q, d in zip(off, a, arm, strict=True)
        ]
        return _less(use.choose(from_tip, r * c - z * s, length), self.rounding, use), normal

    def curvature(self, x: FloatArray) -> FloatArray:
        """See `Shape.curvature`: that of circles about the axis, and of spheres about the tip."""
        dim, (c, s) = x.shape[-1], self.slope
        a, arm = np.array(unit_vector(self.axis)[:dim]), x - self.sharp
        z, one = arm @ a, np.eye(dim)
        off = arm - z[..., None] * a
        r, length = np.linalg.norm(off, axis=-1), np.linalg.norm(arm, axis=-1)
        side = z * c + r * s >= 0.0
        across = (one - np.outer(a, a)) * float(dim > 2)  # a wedge has flat sides
        n = np.where(side[..., None], off * float(dim > 2), arm)
        far = np.maximum(np.where(side, r, length), math.sqrt(_TINY))[..., None, None]
        n = n / far[..., 0]
        result = np.where(side[..., None, None], c * across, one) - (
            np.where(side, c, 1.0)[..., None, None] * n[..., :, None] * n[..., None, :]
        )
        return np.asarray((-result if self.hollow else result) / far)

    def edges(self, dim: int) -> FloatArray:
        """See `Shape.edges`: its tip."""
        return np.array([[self.sharp, self.sharp]] * (not self.hollow)).reshape(-1, 2, dim)

    def triangles(self, near: Box, dim: int) -> Triangles:
        """See `Shape.triangles`: the part of its surface that is nearest to the box."""
        (c, s), tip, axis = self.slope, whole(self.tip), np.array(unit_vector(self.axis))
        arm, wide = near.middle - tip, WIDE * near.diagonal
        z = float(arm @ axis)
        middle = z * c + float(np.linalg.norm(arm - z * axis)) * s
        # A round end is drawn as a blunt one.
        begin = (self.rounding or 0.0) * c / s
        from_tip = np.array([max(middle - wide, begin), max(middle + wide, begin + wide)])
        along, radii = c * from_tip, s * from_tip
        if dim == 3:
            return revolved(tip, axis, along, radii)
        off = np.array([-axis[1], axis[0], 0.0])
        rows = zip(np.append(along, along[::-1]), np.append(-radii, radii[::-1]), strict=True)
        points = np.array([tip + p * axis + q * off for p, q in rows])
        return points, np.array([[0, 1, 2], [0, 2, 3]])


def _less(distance: Scalar, radius: float | str | None, use: Operations) -> Scalar:
    """The distance from all that is not farther than a radius from a shape."""
    return distance if radius is None else distance - use.number(float(radius))


def _combined(factors: FloatArray, values: Sequence[Scalar], use: Operations) -> Scalar:
    """The sum of factors times values."""
    return sum(use.number(float(f)) * value for f, value in zip(factors, values, strict=True))
