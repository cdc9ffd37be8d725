"""Local axes: directions in which the components of results can be asked for.

They belong to the undeformed body: at a material point they are those of its reference place, and
do not turn with it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
import ufl
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.schema import Record, quoted
from dolfin_elastic.core.shapes.directions import Direction, check_count, square, unit_vector
from dolfin_elastic.core.shapes.shapes import Point
from dolfin_elastic.core.types import FloatArray, Scalar

MATERIAL = "material"
"""Name of the axes that each material brings along."""
JOINT = "_in_"
"""Between a component and its axes, as in "cauchy_stress_rr_in_bore"."""
_ON_AXIS = 1e-10
"""Distance from an axis over the size of the body below which a point lies on it."""


@dataclass(frozen=True)
class PlacedAxes:
    """Axes on a body.

    Attributes:
        letters: Names of the three directions, such as "rtz".
        triad: Unit vectors, one a row; of cylindrical axes those at the angle 0.
        point: On the axis [m]; None: the axes are the same everywhere.
        near: Distance from the axis [m] up to which the angle is 0, because there is none.
    """

    letters: str
    triad: FloatArray
    point: tuple[float, ...] | None = None
    near: float = 0.0

    def at(self, X: FloatArray) -> FloatArray:
        """Unit vectors at places, one a row.

        Args:
            X: Places in the reference configuration [m], shape (n, 2 or 3).

        Returns:
            Shape (n, 3, 3).
        """
        rows = self._turned(list(X.T), np.sqrt, lambda r, a, b: np.where(r > self.near, a, b))
        return np.stack([np.stack([np.broadcast_to(x, len(X)) for x in e], -1) for e in rows], 1)

    def of(self, X: Expr) -> list[Expr]:
        """The three unit vectors as UFL expressions of three components.

        Args:
            X: Reference coordinates, of two or three components.
        """

        def choose(r: Scalar, a: Scalar, b: Scalar) -> Expr:
            return ufl.conditional(ufl.gt(r, self.near), a, b)

        return [ufl.as_vector(e) for e in self._turned(list(X), ufl.sqrt, choose)]

    def _turned(
        self,
        X: Sequence[Scalar],
        root: Callable[[Scalar], Scalar],
        choose: Callable[[Scalar, Scalar, Scalar], Scalar],
    ) -> list[list[Scalar]]:
        """The directions, one a row: the same formula for arrays and for UFL.

        Args:
            choose: Of a distance from the axis and two values: the first away from the axis.
        """
        first, second, along = ([float(x) for x in row] for row in self.triad)
        if self.point is None:
            return [[*first], [*second], [*along]]
        d = [x - o for x, o in zip([*X, 0.0][:3], self.point, strict=True)]
        c, s = (sum(a * b for a, b in zip(d, e, strict=True)) for e in (first, second))
        r = root(c * c + s * s)
        length = choose(r, r, 1.0)
        cosine, sine = choose(r, c / length, 1.0), choose(r, s / length, 0.0)
        return [
            [cosine * a + sine * b for a, b in zip(first, second, strict=True)],
            [cosine * b - sine * a for a, b in zip(first, second, strict=True)],
            [*along],
        ]


class LocalAxes(Record):
    """Axes in which components of results are asked for.

    Attributes:
        kind: Name of the kind in a case file.
    """

    kind: str
    letters: ClassVar[str]

    def placed(self, size: float, dim: int, *, axisymmetric: bool = False) -> PlacedAxes:
        """The axes, in metres, on a body.

        Args:
            size: Diagonal of the body's bounding box [m].
            dim: Dimension of the body, 2 or 3.

        Raises:
            InputError: The body has no such axes.
        """
        raise NotImplementedError


class CylindricalAxes(LocalAxes):
    """Radius r, angle t (right-handed about the axis) and z along an axis.

    Attributes:
        axis: x, y, z or a direction.
        point: A point of the axis, bare numbers in the mesh's unit.

    Example:
        CylindricalAxes(axis="z", point=[0, 0, 0])
    """

    kind: Literal["cylindrical"] = "cylindrical"
    letters: ClassVar[str] = "rtz"
    lengths: ClassVar[tuple[str, ...]] = ("point",)
    axis: Direction = "z"
    point: Point = (0.0, 0.0, 0.0)

    def placed(self, size: float, dim: int, *, axisymmetric: bool = False) -> PlacedAxes:
        """See `LocalAxes.placed`."""
        axis = np.array(unit_vector(self.axis))
        point = self.point
        if dim == 3:
            check_count(point, 3, "point")
        around = axisymmetric and not (axis[0] or axis[2] or point[0])
        if dim == 2 and any(axis[:2]) and not around:
            raise InputError(
                f"axes about {quoted(self.axis)} leave the plane of the body",
                where="axis",
                expected='"z", or "y" with a point at x = 0' if axisymmetric else '"z"',
            )
        first = np.eye(3)[int(np.argmin(np.abs(axis)))]
        first = np.array(unit_vector([*(first - (first @ axis) * axis)]))
        triad = np.array([first, np.cross(axis, first), axis])
        return PlacedAxes(self.letters, triad, (*point, 0.0)[:3], _ON_AXIS * size)


class RectangularAxes(LocalAxes):
    """Three directions that are the same everywhere; z is normal to x and y.

    Attributes:
        x: Direction of the first axis.
        y: Direction of the second axis, at a right angle to x.

    Example:
        RectangularAxes(x=[1, 1, 0], y=[-1, 1, 0])
    """

    kind: Literal["rectangular"] = "rectangular"
    letters: ClassVar[str] = "xyz"
    x: Direction
    y: Direction

    def placed(self, size: float, dim: int, *, axisymmetric: bool = False) -> PlacedAxes:
        """See `LocalAxes.placed`."""
        triad = square(self.x, self.y)
        if dim == 2 and triad[:2, 2].any():
            raise InputError(
                "the axes leave the plane of the body", where="x", expected="two components each"
            )
        return PlacedAxes(self.letters, triad)


AXES: Mapping[str, type[LocalAxes]] = {
    "cylindrical": CylindricalAxes,
    "rectangular": RectangularAxes,
}
"""Kind of axes to their record."""


def check_name(name: str) -> None:
    """Checks that axes can have a name.

    Raises:
        InputError: They cannot.
    """
    if not name.isidentifier() or not name.isascii() or JOINT in f"_{name}_" or name == MATERIAL:
        raise InputError(
            f"axes cannot be called {quoted(name)}",
            expected=f"letters, digits and _, without '{JOINT}', and not '{MATERIAL}'",
        )
