"""Concentrated loads: forces at points and along lines, by place or by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import model_validator

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.shapes.directions import check_count
from dolfin_elastic.core.shapes.shapes import Point, PositiveLength
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.loads.base import Load
from dolfin_elastic.model.values import Component


class ConcentratedLoad(Load):
    """A dead force on points of the body, by the shape functions of the cells that hold them.

    In a plane it is that of the whole thickness, in a body of revolution of the whole ring.

    Attributes:
        on: Names of points or edges of the mesh, in place of coordinates.
        tolerance: How far off the body the point may lie; None: 1e-3 of the body's diagonal.
    """

    on: str | list[str] | None = None
    tolerance: PositiveLength | None = None
    concentrated: ClassVar[bool] = True
    takes_fields: ClassVar[bool] = True
    key_hints: ClassVar[Mapping[str, str]] = {
        **Load.key_hints,
        "total": 'a total force [N] of all that `on` names is kind = "force"',
    }
    shared: ClassVar[bool] = False
    """The value is that of all nodes together, or of the whole edge."""
    lengths: ClassVar[tuple[str, ...]] = ("tolerance",)
    places: ClassVar[tuple[str, ...]] = ()
    """Keys of coordinates."""
    named: ClassVar[str] = ""
    """What `on` names, in words."""

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        given = [key for key in self.places if getattr(self, key) is not None]
        if self.on is not None and given:
            raise InputError(
                f"on and {given[0]} are given together",
                where="on",
                expected="leave one of them out",
            )
        if self.on is None:
            missing = [key for key in self.places if key not in given]
            if missing:
                raise InputError(
                    "this key is missing",
                    where=missing[0],
                    expected=f"coordinates, or on with the name of {self.named}",
                )
        elif self.tolerance is not None:
            raise InputError(
                "tolerance needs coordinates, and `on` is given",
                where="tolerance",
                expected="leave it out",
            )
        return self

    @property
    def points(self) -> dict[str, Point]:
        """Key to point: the one where the force acts, or both ends of the line; none by name."""
        points = {key: getattr(self, key) for key in self.places}
        return {} if None in points.values() else points

    def samples(self) -> tuple[FloatArray, FloatArray]:
        """Quadrature points [m], shape (n, dim), and weights [1 or m], shape (n,), by place.

        Of a load `in_metres`.
        """
        return np.array([*self.points.values()]), np.ones(len(self.points))

    @property
    def vectors(self) -> dict[str, tuple[Component, ...]]:
        """See `Load.vectors`."""
        return {"value": self.values, **self.points}


class PointForce(ConcentratedLoad):
    """A force [N] at a point; the stress there grows without bound under refinement.

    Attributes:
        at: The undeformed place, in the mesh's unit; the force goes with its material point.
        on: Named points, each of whose nodes bears the force.

    Example:
        PointForce(at=[1, 0, 0], value=[0, 0, "-2 kN"])
    """

    kind: Literal["point-force", "force"] = "point-force"
    at: Point | None = None
    unit: ClassVar[str] = "N"
    sentence: ClassVar[str] = "force of {} at a point"
    part_kinds: ClassVar[tuple[str, ...]] = ("point",)
    lengths: ClassVar[tuple[str, ...]] = ("at", "tolerance")
    places: ClassVar[tuple[str, ...]] = ("at",)
    named: ClassVar[str] = "a point"


class LineForce(ConcentratedLoad):
    """A force per undeformed length [N/m] along a straight line, or along edges of a solid.

    Attributes:
        start: Where the line begins, in the mesh's unit.
        end: Where it ends.
        on: Named edges in place of both.

    Example:
        LineForce(start=[1, 0, 0], end=[1, 1, 0], value=[0, 0, "-2 kN/m"])
    """

    kind: Literal["line-force", "force"] = "line-force"
    start: Point | None = None
    end: Point | None = None
    unit: ClassVar[str] = "N/m"
    sentence: ClassVar[str] = "force of {} along a line"
    part_kinds: ClassVar[tuple[str, ...]] = ("edge",)
    lengths: ClassVar[tuple[str, ...]] = ("start", "end", "tolerance")
    places: ClassVar[tuple[str, ...]] = ("start", "end")
    named: ClassVar[str] = "an edge"

    @property
    def points(self) -> dict[str, Point]:
        """See `ConcentratedLoad.points`."""
        points = super().points
        if points:
            count = len(points["start"])
            check_count(points["end"], count, "end", f"{count}, as start has")
        if points and points["start"] == points["end"]:
            raise InputError("the line has no length", where="end", expected="another point")
        return points

    def samples(self) -> tuple[FloatArray, FloatArray]:
        """Gauss points of the whole line."""
        start, end = (np.array(point) for point in self.points.values())
        x, weights = np.polynomial.legendre.leggauss(16)
        length = float(np.linalg.norm(end - start))
        return start + (1 + x)[:, None] / 2 * (end - start), weights * length / 2
