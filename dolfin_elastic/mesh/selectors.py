"""`Selector`: a part of a body, picked by where it lies.

    [surfaces]
    foot  = {plane = "z", at = "min"}
    bore  = {cylinder = {axis = "z", point = [0, 0, 0], radius = 5}}
    step  = [{plane = "x", at = 10}, {normal = [0, 1, 0], box = [[0, 0, 0], [10, 10, 2]]}]
    glue  = {between = ["steel", "rubber"]}
    neck  = {cut = true, plane = "z", at = 20, of = "bolt"}
    holes = {faces = [7, 8]}
    round = {cylinder = {radius = "6 mm"}}
    [regions]
    core  = {sphere = {center = [0, 0, 0], radius = "2 mm"}}
    [edges]
    seam  = {between = ["foot", "bore"]}
    [points]
    tip   = {nearest = [10, 0, 0]}

The keys of one selector must all hold; of a list of selectors one is enough.  A bare length is in
the mesh's unit, one with a unit ("2 mm") is what it says.  Numbers and kinds of faces, and
cylinders and spheres without a position, are those of the CAD file that the mesh is made of.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.shapes.directions import Axis, Direction
from dolfin_elastic.core.shapes.shapes import (
    Cylinder,
    Point,
    Shape,
    Sphere,
)
from dolfin_elastic.core.units import Size, finite_length, no_switch


def _level(value: float | str) -> float | str:
    word = isinstance(value, str) and not any(sign.isdigit() for sign in value)
    if word and value not in ("min", "max"):
        raise ValueError('should be "min", "max", a number, or a length such as "2 mm"')
    return value if value in ("min", "max") else finite_length(value)


def _middle(value: float | str) -> float | str:
    return value if value == "middle" else finite_length(value)


Level = Annotated[float | str, BeforeValidator(no_switch), AfterValidator(_level)]
Middle = Annotated[float | str, BeforeValidator(no_switch), AfterValidator(_middle)]
FaceNumber = Annotated[int, Field(gt=0)]
FaceKind = Literal[
    "plane", "cylinder", "cone", "sphere", "torus", "surface", "hole", "shaft", "fillet", "round"
]
_GEOMETRIC = ("plane", "box", "sphere", "cylinder", "normal", "line", "nearest")
_OF_FACES = ("faces", "kind", "cone", "torus")


class Cone(Record):
    """Conical faces of a CAD file.

    Attributes:
        angle: Between axis and surface [degrees]; any by default.
    """

    angle: Annotated[float, Field(gt=0, lt=90)] | None = None


class Torus(Record):
    """Toroidal faces of a CAD file.

    Attributes:
        radius: Of the tube; any by default.
        major: Distance of the tube's middle from the axis; any by default.
    """

    radius: Size | None = None
    major: Size | None = None


class Place(Record):
    """Keys that all selectors share; all keys that are given must hold.

    Attributes:
        plane: On the plane x, y or z = `at`.
        at: "min" or "max" (of the whole body), or a coordinate.
        box: Two opposite corners.
        sphere: On the sphere; of cells, midpoint inside.
        cylinder: On the cylinder; of cells, midpoint inside.
        of: Search only this part, which has its name already.
        tolerance: How far off a vertex may lie; by default 1e-6 of the body's diagonal.
    """

    picks_faces: ClassVar[bool] = False
    """Whether faces of a CAD file can be picked by what they are, not by where."""

    plane: Axis | None = None
    at: Level | None = None
    box: tuple[Point, Point] | None = None
    sphere: Sphere | None = None
    cylinder: Cylinder | None = None
    of: str | None = None
    tolerance: Size | None = None

    @model_validator(mode="after")
    def _level_of_plane(self) -> Self:
        if (self.plane is None) != (self.at is None):
            raise ValueError('plane and at belong together, as in {plane = "z", at = "min"}')
        if not self.picks_faces:
            self.check_placed()
        return self

    @property
    def shapes(self) -> dict[str, Shape]:
        """Key of each shape that was given, to the shape."""
        values = {key: getattr(self, key) for key in type(self).model_fields}
        return {key: value for key, value in values.items() if isinstance(value, Shape)}

    def check_placed(self) -> None:
        """Checks that spheres and cylinders have a place.

        Raises:
            MeshError: A key is missing.
        """
        for key, shape in self.shapes.items():
            shape.check_placed(key)

    def given(self) -> list[str]:
        """The geometric keys that were given."""
        return [key for key in (*_GEOMETRIC, *_OF_FACES) if getattr(self, key, None) is not None]


class Selector(Place):
    """Facets of the boundary, or cells, picked by geometry; all keys given must hold.

    A box takes facets with all vertices, cells with their midpoint, inside.  Facets may also be
    picked by the face of a CAD file on which they lie, also cylinders and spheres without position.

    Attributes:
        faces: Numbers of faces of a CAD file (of curves, if the body is plane).
        kind: What these faces are, as `look` lists them; faces between joined bodies are picked
            by number only.
        cone: Conical ones.
        torus: Toroidal ones.
        normal: Facets whose outward normal is within `angle` degrees of this direction.
        angle: Degrees, 20 by default.
        between: Inner facets between the cells of these two regions.
        cut: Inner facets that stand for the plane: those between the cells with their middle
            beyond it and the others, of the body or of the region `of`.
        all: The whole boundary, or all cells.

    Example:
        Selector(plane="z", at="min")
    """

    normal: Direction | None = None
    angle: Annotated[float, Field(gt=0, le=180)] | None = None
    faces: Annotated[tuple[FaceNumber, ...], Field(min_length=1)] | None = None
    kind: FaceKind | None = None
    cone: Cone | None = None
    torus: Torus | None = None
    between: Annotated[list[str], Field(min_length=2, max_length=2)] | None = None
    cut: bool = False
    all: bool = False

    picks_faces: ClassVar[bool] = True

    key_hints: ClassVar[Mapping[str, str]] = {
        "line": "edges on a line stand in the table [edges]",
        "nearest": "a point stands in the table [points]",
    }

    @model_validator(mode="after")
    def _whole(self) -> Selector:
        if self.angle is not None and self.normal is None:
            raise ValueError("angle goes with normal")
        if self.cut and self.plane is None:
            raise ValueError('cut goes with plane and at, as in {cut = true, plane = "z", at = 2}')
        if self.is_inner:
            of_boundary = [*self.by_face, *(["normal"] if self.normal is not None else [])]
            if of_boundary:
                raise ValueError(f"inner facets are wanted: {of_boundary[0]} is of the boundary")
        if self.between and (self.cut or self.of):
            raise ValueError("between stands alone, without cut or of")
        if not (self.all or self.of or self.between or self.given()):
            raise ValueError(
                "say where: plane and at, box, sphere, cylinder, normal, between, of, or all; of a "
                "CAD file also faces, kind, cone, or torus"
            )
        return self

    @property
    def is_inner(self) -> bool:
        """It picks facets inside the body."""
        return self.cut or self.between is not None

    @property
    def by_face(self) -> list[str]:
        """The keys that pick faces of a CAD file by what they are."""
        keys = [key for key in _OF_FACES if getattr(self, key) is not None]
        return keys + [key for key, shape in self.shapes.items() if not shape.placed]


class Line(Record):
    """A straight line."""

    start: Point
    end: Point


class EdgeSelector(Place):
    """Mesh edges of the boundary of a solid that lie on lines; all keys given must hold.

    Of the mesh edges on a plane, sphere or cylinder those remain that do not lie inside of an area
    on it: its outline, and where it cuts other surfaces.

    Attributes:
        between: Edges that belong to each of these surfaces.
        line: Edges on this straight line.
        all: All sharp edges.
        angle: Degrees between the normals on both sides from which an edge is sharp, 30 by default;
            if it is given, edges that are not sharp are left out.

    Example:
        EdgeSelector(between=["left", "top"])
    """

    between: Annotated[list[str], Field(min_length=2)] | None = None
    line: Line | None = None
    all: bool = False
    key_hints: ClassVar[Mapping[str, str]] = {
        "nearest": "a point stands in the table [points]",
        "normal": "the surfaces that a normal picks stand in the table [surfaces]",
    }
    angle: Annotated[float, Field(gt=0, lt=180)] | None = None

    @model_validator(mode="after")
    def _somewhere(self) -> EdgeSelector:
        if not (self.all or self.of or self.between or self.given()):
            raise ValueError(
                "say where: between, line, plane and at, box, sphere, cylinder, of, or all"
            )
        return self


class PointSelector(Place):
    """Vertices of cells; all keys given must hold.

    Attributes:
        nearest: The one vertex nearest to this point, at most `tolerance` away; by default the mean
            length of a cell.
        between: Vertices that belong to each of these surfaces, edges or points.

    Example:
        PointSelector(nearest=["2 mm", 0, 0])
    """

    nearest: Point | None = None
    between: Annotated[list[str], Field(min_length=2)] | None = None
    key_hints: ClassVar[Mapping[str, str]] = {
        "line": "edges on a line stand in the table [edges]",
        "normal": "the surfaces that a normal picks stand in the table [surfaces]",
    }

    @model_validator(mode="after")
    def _somewhere(self) -> PointSelector:
        if not (self.of or self.between or self.given()):
            raise ValueError(
                "say where: nearest, between, plane and at, box, sphere, cylinder, or of"
            )
        return self
