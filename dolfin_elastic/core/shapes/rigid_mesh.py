"""`RigidMesh`: an obstacle whose surface is the triangles of a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, ClassVar, NamedTuple, Self

import numpy as np
from pydantic import Field, PrivateAttr, field_validator

from dolfin_elastic.core.errors import InputError, keyed, nearest_first
from dolfin_elastic.core.shapes.box import Box
from dolfin_elastic.core.shapes.directions import check_components
from dolfin_elastic.core.shapes.shapes import Coordinate, Distance, Operations, Shape
from dolfin_elastic.core.shapes.surface import Followed, Near, Surface
from dolfin_elastic.core.shapes.triangles import Triangles
from dolfin_elastic.core.shapes.turn import Turn
from dolfin_elastic.core.types import FloatArray, IntArray, Scalar
from dolfin_elastic.core.units import MESH_UNITS, Size

if TYPE_CHECKING:
    from dolfin_elastic.core.native.functions import CFunctions

_DRAWN = 5000
"""Triangles that are drawn at most."""

_FINEST = 70.0
"""Boxes along the surface in each of which all corners are one, where it has more triangles."""


class Facets(NamedTuple):
    """The surface of a rigid body.

    Attributes:
        points: Corners [m], shape (n, 3).
        triangles: Rows of these, counter-clockwise seen from outside, shape (m, 3).
    """

    points: FloatArray
    triangles: IntArray

    @staticmethod
    def read(data: Mapping[str, Sequence[Sequence[float]]]) -> Facets:
        """Those of JSON data, which have the same names.

        Raises:
            InputError: There are no such corners.
        """
        points = np.array(data["points"], dtype=np.float64).reshape(-1, 3)
        triangles = np.array(data["triangles"], dtype=np.int64).reshape(-1, 3)
        if len(triangles) and not 0 <= triangles.min() <= triangles.max() < len(points):
            raise InputError("a triangle of an obstacle has corners that do not exist")
        return Facets(points, triangles)

    def to_draw(self) -> Facets:
        """Itself, or with corners that are joined where there are more triangles than one sees."""
        low, extent = self.points.min(axis=0), float(np.ptp(self.points, axis=0).max())
        result, cells = self, _FINEST
        while len(result.triangles) > _DRAWN:
            boxes = np.floor((self.points - low) * (cells / extent)).astype(np.int64)
            first, rows = np.unique(boxes, axis=0, return_index=True, return_inverse=True)[1:]
            corners = rows.reshape(-1)[self.triangles]
            whole = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
            result, cells = Facets(self.points[first], corners[whole]), 0.7 * cells
        return result


class RigidMesh(Shape):
    """What the triangles of a file enclose, or what lies behind them.

    Attributes:
        file: Path relative to the case file: .stl, .obj, .ply or another mesh; .step, .iges, .brep.
        unit: Unit of length of the file; by default the one that it states, else that of the mesh.
        size: Size of the facets of a CAD file, in its unit; by default a tenth of its diagonal.
        offset: Thickness that is added to the surface, of which edges become round.
        inside: The body is inside: the obstacle is all that lies outside of the triangles.
        turn: A rotation of the mesh where its file has it, before `move`.
        move: By how much it is moved along x, y and z from there.
        smooth: The surface is curved between the corners, but sharp where facets are at more than
            30 degrees.
    """

    in_forms: ClassVar[bool] = False
    lengths: ClassVar[tuple[str, ...]] = ("offset", "move")
    file: str = Field(min_length=1)
    unit: str | None = None
    size: Size | None = None
    offset: Size | None = None
    inside: bool = False
    turn: Turn | None = None
    move: Annotated[tuple[Coordinate, ...], Field(min_length=3, max_length=3)] | None = None
    smooth: bool = False
    _facets: Facets | None = PrivateAttr(default=None)
    _surface: Surface | Followed | None = PrivateAttr(default=None)

    @field_validator("unit")
    @classmethod
    def _is_length(cls, unit: str | None) -> str | None:
        if unit is not None and unit not in MESH_UNITS:
            raise InputError(
                f"'{unit}' is no unit of length of a mesh",
                expected=nearest_first(unit, MESH_UNITS),
            )
        return unit

    @property
    def key(self) -> str:
        """What its facets depend on."""
        return f"{self.file} in {self.unit or 'its unit'}, size {self.size}"

    def in_metres(self, scale: float) -> Self:
        """See `Record`: its rotation, too."""
        turn = None if self.turn is None else self.turn.in_metres(scale)
        return super().in_metres(scale).converted({"turn": turn})

    def with_facets(self, facets: Facets, loops: CFunctions | None = None) -> Self:
        """The same obstacle, in metres, the file of which has been read.

        Args:
            facets: Where the file has them.
            loops: Of `Surface`; without them the obstacle can only be drawn.
        """
        result, points = self.model_copy(), facets.points
        if self.turn is not None:
            centre = np.array(self.turn.point or (0.0, 0.0, 0.0), dtype=np.float64)
            points = centre + self.turn.vectors(points - centre, 3)
        points = points if self.move is None else points + np.array(self.move, dtype=np.float64)
        result._facets = Facets(points, facets.triangles)
        if loops is not None:
            result._surface = Surface(*result._facets, loops, smooth=self.smooth)
        return result

    @property
    def surface(self) -> Surface:
        """The surface, without the offset."""
        assert isinstance(self._surface, Surface)
        return self._surface

    def followed(self) -> Self:
        """See `Shape.followed`."""
        result = self.model_copy()
        result._surface = Followed(self.surface)
        return result

    def forget(self) -> None:
        """See `Shape.followed`."""
        if isinstance(self._surface, Followed):
            self._surface.forget()

    @property
    def thickness(self) -> float:
        """See `Shape.thickness`."""
        return np.inf if self.hollow else self.surface.thickness / 2 + self._offset

    @property
    def _offset(self) -> float:
        offset = self.offset or 0.0
        assert not isinstance(offset, str)
        return -offset if self.hollow else offset

    def check(self, dim: int, *, axisymmetric: bool) -> None:
        """See `Shape.check`."""
        if dim == 2:
            raise InputError(
                "a plane body meets no mesh of triangles",
                expected="plane, sphere or cylinder; or a three-dimensional body",
            )
        if self.turn is not None:
            with keyed("turn"):
                self.turn.matrix(3)
                check_components(self.turn.point, 3, "point")

    def distance(self, x: Sequence[Scalar], use: Operations) -> Distance:
        """See `Shape.distance`: of arrays only."""
        points = np.stack([np.asarray(item, dtype=np.float64) for item in x], axis=-1)
        near = self._near(points) if self._surface else self._from_corners(points.reshape(-1, 3))
        shape = points.shape[:-1]
        return (near.distance - self._offset).reshape(shape), [
            item.reshape(shape) for item in near.normal.T
        ]

    def _from_corners(self, points: FloatArray) -> Near:
        """Where the obstacle is only drawn."""
        from scipy.spatial import cKDTree

        corners = self._shown.points
        distance, row = cKDTree(corners).query(points)
        arms = points - corners[row]
        return Near(distance, arms, np.zeros((*arms.shape, 3)), corners[row], row)

    @cached_property
    def _shown(self) -> Facets:
        assert self._facets is not None
        return self._facets.to_draw()

    def _near(self, points: FloatArray) -> Near:
        assert self._surface is not None
        return self._surface.near(np.ascontiguousarray(points.reshape(-1, 3)))

    def curvature(self, x: FloatArray) -> FloatArray:
        """See `Shape.curvature`."""
        result = self._near(x).curvature.reshape(*x.shape, 3)
        return -result if self.hollow else result

    @property
    def edge_radius(self) -> float:
        """See `Shape.edge_radius`."""
        return abs(self._offset)

    def edges(self, dim: int) -> FloatArray:
        """See `Shape.edges`: those at which the body that meets it could be bent."""
        return self.surface.convex_edges(-1.0 if self.hollow else 1.0)

    def triangles(self, near: Box, dim: int) -> Triangles:
        """See `Shape.triangles`: those of the file."""
        return self._shown
