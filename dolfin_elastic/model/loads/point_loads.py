"""Concentrated loads: forces at points and along lines."""

from __future__ import annotations

from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import Length
from dolfin_elastic.model.loads.base import Load, keyed
from dolfin_elastic.model.values import Component, components

Point = tuple[float, ...]


class ConcentratedLoad(Load):
    """A dead force on points of the body, by the shape functions of the cells that hold them.

    In a plane it is that of the whole thickness, in a body of revolution of the whole ring.

    Attributes:
        tolerance: How far off the body a point may lie [m]; None: 1e-3 of the body's diagonal.
    """

    tolerance: Length | None = Field(default=None, ge=0)
    concentrated: ClassVar[bool] = True

    def place(self, key: str) -> Point:
        """The point of a key [m], 2 or 3 coordinates.

        Raises:
            InputError: It is no list of numbers.
        """
        with keyed(key):
            found = components(getattr(self, key), "m")
            if not all(isinstance(item, float) for item in found):
                raise InputError("a formula cannot stand here", expected="expected numbers")
        return tuple(float(item) for item in found)  # type: ignore[arg-type]

    @property
    def points(self) -> dict[str, Point]:
        """Key to point: the one where the force acts, or both ends of the line."""
        raise TypeError(f"{type(self).__name__} has no points")

    def samples(self) -> tuple[FloatArray, FloatArray]:
        """Quadrature points [m], shape (n, dim), and weights [1 or m], shape (n,)."""
        return np.array([*self.points.values()]), np.ones(len(self.points))

    @property
    def vectors(self) -> dict[str, tuple[Component, ...]]:
        """See `Load.vectors`."""
        return {"value": self.values, **self.points}


class PointForce(ConcentratedLoad):
    """A force [N] at a point; the stress there grows without bound under refinement.

    Attributes:
        at: The undeformed place [m]; the force goes with its material point.
    """

    kind: Literal["point-force"] = "point-force"
    at: list[Any]
    unit: ClassVar[str] = "N"

    @cached_property
    def points(self) -> dict[str, Point]:
        """See `ConcentratedLoad.points`."""
        return {"at": self.place("at")}


class LineForce(ConcentratedLoad):
    """A force per undeformed length [N/m] along a straight line.

    Attributes:
        start: Where the line begins [m].
        end: Where it ends [m].
    """

    kind: Literal["line-force"] = "line-force"
    start: list[Any]
    end: list[Any]
    unit: ClassVar[str] = "N/m"

    @cached_property
    def points(self) -> dict[str, Point]:
        """See `ConcentratedLoad.points`."""
        start, end = self.place("start"), self.place("end")
        if start == end or len(start) != len(end):
            raise InputError("the line has no length", where="end", expected="another point")
        return {"start": start, "end": end}

    def samples(self) -> tuple[FloatArray, FloatArray]:
        """Gauss points of the whole line."""
        start, end = (np.array(point) for point in self.points.values())
        x, weights = np.polynomial.legendre.leggauss(16)
        length = float(np.linalg.norm(end - start))
        return start + (1 + x)[:, None] / 2 * (end - start), weights * length / 2
