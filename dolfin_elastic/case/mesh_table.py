"""The table [mesh] of a case file: one mesh, or parts that are placed beside each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from mpi4py import MPI
from pydantic import Field, field_validator, model_validator

from dolfin_elastic.case.toml import key_text
from dolfin_elastic.core.errors import InputError, UnitError, nearest_first
from dolfin_elastic.core.schema import Record, WhenGiven
from dolfin_elastic.core.shapes.turn import Turn
from dolfin_elastic.core.units import MESH_UNITS, LengthUnit, MeshLength, Time, to_si
from dolfin_elastic.mesh import Body, box_body, rectangle_body
from dolfin_elastic.mesh.assembly.placement import Place, Placed, check_names
from dolfin_elastic.mesh.distribute import is_cad
from dolfin_elastic.mesh.formats.surfaces.options import is_surface
from dolfin_elastic.mesh.generate import number_of_cells
from dolfin_elastic.mesh.local_size import MOST_CELLS, NO_SIZES, CadSizes, LocalSize
from dolfin_elastic.mesh.selectors import Selector
from dolfin_elastic.model.kinematics import Geometry
from dolfin_elastic.problem.material_regions import Formulation

Count = Annotated[int, Field(gt=0)]
_OF_IMAGES = ("size", "curved")
"""Keys of files that images have, too."""


class Box(Record):
    """A box of tetrahedra with surfaces left, right (x), front, back (y), bottom, top (z).

    Attributes:
        size: Lengths of the three edges.
        cells: Number of little cubes along each edge; each makes six tetrahedra.
        origin: The corner with the smallest coordinates.
    """

    size: Annotated[list[MeshLength], Field(min_length=3, max_length=3)]
    cells: Annotated[list[Count], Field(min_length=3, max_length=3)]
    origin: Annotated[list[MeshLength], Field(min_length=3, max_length=3)] = Field(
        default=[0, 0, 0]
    )


class Rectangle(Record):
    """A rectangle of triangles (plane strain) with surfaces left, right (x), bottom, top (y).

    Attributes:
        size: Lengths of the two edges.
        cells: Number of little squares along each edge; each makes two triangles.
        origin: The corner with the smallest coordinates.
    """

    size: Annotated[list[MeshLength], Field(min_length=2, max_length=2)]
    cells: Annotated[list[Count], Field(min_length=2, max_length=2)]
    origin: Annotated[list[MeshLength], Field(min_length=2, max_length=2)] = Field(default=[0, 0])


class Source(Record):
    """Where a mesh comes from: exactly one of `file`, `image`, `box` and `rectangle`.

    Attributes:
        file: Mesh or CAD file, or a closed surface (.stl, .obj, .ply, .3mf), relative to the case
            file's folder.
        image: Image of voxels (.nii, .mha, .vti, a DICOM folder) whose regions are filled, relative
            to the case file's folder.
        labels: Of an image, name of each region to its value, or several values.
        threshold: Of a grey image: voxels from this value on are the region "body".
        box: A box made on the spot.
        rectangle: A rectangle made on the spot.
        size: Size of the elements, for CAD files, surfaces and images only.
        deviation: Distance between elements and surface that does no harm, for surfaces only: where
            the surface is curved, elements are not smaller than that needs.
        repair: Whether a surface is mended; a note says what that has changed.
        angle: Between triangles of a surface, from which on their edge divides patches [degrees];
            by default 40.
        time_limit: Time that Gmsh may take for a file.
        join: Whether bodies of a STEP, IGES or BREP file that touch are joined; True by default.
        curved: Whether the elements of a CAD file, surface or image follow curved surfaces; by
            default where the displacement is quadratic.  Of a finished mesh, false: its elements
            are straight.
        unit: Unit of length of the mesh and of bare numbers about it; by default that of a STEP,
            IGES or 3MF file or an image, else "m"; required for .stl, .obj and .ply.
    """

    kinds: ClassVar[tuple[str, ...]] = ("file", "image", "box", "rectangle")
    """Keys of which one is given."""

    file: str | None = None
    image: str | None = None
    labels: dict[str, int | Annotated[list[int], Field(min_length=1)]] | None = None
    threshold: float | None = None
    box: WhenGiven[Box] | None = None
    rectangle: WhenGiven[Rectangle] | None = None
    size: MeshLength | None = None
    deviation: MeshLength | None = None
    repair: bool | None = None
    angle: Annotated[float, Field(gt=0, le=180)] | None = None
    time_limit: Time = Field(default=600.0, gt=0)
    curved: bool | None = None
    join: bool | None = None
    unit: str | None = None

    @field_validator("unit")
    @classmethod
    def _is_length(cls, unit: str | None) -> str | None:
        if unit is not None and unit not in MESH_UNITS:
            raise UnitError(
                f"'{unit}' is no unit of length of a mesh",
                expected=nearest_first(unit, MESH_UNITS),
            )
        return unit

    @model_validator(mode="after")
    def _one_mesh(self) -> Self:
        given = [key for key in self.kinds if getattr(self, key) is not None]
        if len(given) != 1:
            what = f"{' and '.join(given)} given together" if given else "no mesh is given"
            raise InputError(what, expected=f"expected exactly one of {', '.join(self.kinds)}")
        key = given[0]
        wrong = {
            "size": (self.size, f"a {key} takes no element size", f"use {key}.cells"),
            "curved": (self.curved, f"a {key} has no curved surfaces", "leave it out"),
            "join": (self.join is not None, f"a {key} is a single body", "leave it out"),
            "deviation": (self.deviation, f"a {key} is no surface of triangles", "leave it out"),
            "repair": (self.repair is not None, f"a {key} has nothing to mend", "leave it out"),
            "angle": (self.angle, f"a {key} has its own names of surfaces", "leave it out"),
        }
        for name, (value, what, expected) in wrong.items():
            if key == "parts" and getattr(self, name) is not None:
                raise InputError(
                    "each part has a key of its own for this",
                    where=name,
                    expected=f"write mesh.parts.NAME.{name}",
                )
            if value and key != "file" and not (key == "image" and name in _OF_IMAGES):
                raise InputError(what, where=name, expected=expected)
        self._check_labels(key)
        return self

    def _check_labels(self, key: str) -> None:
        """Refuses labels of what is no image, and an image without them."""
        given = [name for name in ("labels", "threshold") if getattr(self, name) is not None]
        if key == "image" and len(given) != 1:
            raise InputError(
                "labels and threshold given together" if given else "labels are missing",
                where="image",
                expected="either labels = {bone = 1, marrow = [2, 3]}, or of a grey image "
                "threshold = VALUE",
            )
        if key != "image" and given:
            raise InputError(
                f"a {key} has no voxels", where=given[0], expected="image in place of it"
            )

    @property
    def kind(self) -> str:
        """The key of `kinds` that is given."""
        return next(key for key in self.kinds if getattr(self, key) is not None)

    @property
    def metres(self) -> float | None:
        """The key `unit` in metres; None without it."""
        return None if self.unit is None else to_si(f"1 {self.unit}", "m")

    @property
    def cad(self) -> bool:
        """Gmsh meshes its file."""
        return self.file is not None and is_cad(self.file)

    @property
    def surface(self) -> bool:
        """Its file is a surface that is filled."""
        return self.file is not None and is_surface(self.file)

    @property
    def cells_made(self) -> float:
        """Number of triangles or tetrahedra of a box or rectangle; 0 of a file."""
        made = self.box or self.rectangle
        return 0.0 if made is None else float(number_of_cells(made.cells))

    def body(
        self,
        folder: Path,
        comm: MPI.Comm,
        *,
        curved: bool | None,
        local: CadSizes = NO_SIZES,
        trust: bool = False,
    ) -> Body:
        """Reads or generates the mesh. Collective.

        Args:
            folder: Folder that `file` is relative to.
            comm: The ranks that share the mesh.
            curved: Of CAD files, see `read_body`; of a finished mesh the key itself counts.
            local: Local element sizes of a CAD file.
            trust: A script may do all that its user may, see `read_body`.

        Raises:
            MeshError: The file cannot be read, or is no mesh of triangles or tetrahedra.
        """
        if self.file is not None:
            from dolfin_elastic.mesh import read_body

            return read_body(
                folder / self.file,
                comm=comm,
                scale=self.metres,
                size=self.size,
                curved=curved if self.cad or self.surface else self.curved,
                join=self.join,
                trust=trust,
                time_limit=self.time_limit,
                local=local if self.cad else NO_SIZES,
                deviation=self.deviation,
                repair=self.repair,
                angle=self.angle,
            )
        if self.image is not None:
            from dolfin_elastic.mesh.images.labels.body import label_body

            return label_body(
                folder / self.image,
                self.labels,
                threshold=self.threshold,
                comm=comm,
                scale=self.metres,
                size=self.size,
                curved=curved,
                time_limit=self.time_limit,
            )
        made = self.box or self.rectangle
        assert made is not None
        make, scale = box_body if self.box else rectangle_body, self.metres or 1.0

        def number(length: float | str) -> float:
            return to_si(length, "m") / scale if isinstance(length, str) else float(length)

        return make(
            size=[number(length) for length in made.size],
            cells=made.cells,
            origin=[number(length) for length in made.origin],
            comm=comm,
            scale=scale,
        )


class Part(Source):
    """A table [mesh.parts.NAME]: a mesh, and where it is placed.

    Attributes:
        move: By how much the part is moved along x, y and z, after `turn`.
        turn: A rotation of the part.
    """

    key_hints: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("refine", "degree", "formulation", "geometry", "thickness", "quadrature_degree"),
        "this is a key of [mesh], for all parts",
    )

    move: Place | None = None
    turn: WhenGiven[Turn] | None = None


class MeshTable(Source):
    """The table [mesh]: exactly one of `file`, `image`, `box`, `rectangle` and `parts`.

    Attributes:
        parts: Name to one of several meshes, which share no nodes.
        refine: How often every edge is halved, or places where the elements are smaller.
        unit: Unit of length of the mesh and of bare numbers about it; by default that of a STEP or
            IGES file, else "m".  Of parts, that of those which have none of their own.
        degree: Degree of the displacement in the elements, 1 or 2; by default 2, in explicit motion
            1.
        formulation: "displacement", "mixed" (with a pressure, for nearly incompressible materials)
            or "auto".
        geometry: What a two-dimensional body is: "plane-strain", "plane-stress" or "axisymmetric".
        thickness: Of a plane body; 1 m by default.
        quadrature_degree: Overrides the degree of exactness of the internal forces' integral.
    """

    kinds: ClassVar[tuple[str, ...]] = (*Source.kinds, "parts")

    parts: dict[str, Part] | None = None
    refine: Annotated[int, Field(ge=0, le=10)] | list[WhenGiven[LocalSize]] | None = None
    degree: Literal[1, 2] | None = None
    formulation: Formulation = "auto"
    geometry: Geometry = "plane-strain"
    thickness: MeshLength | None = None
    quadrature_degree: Annotated[int, Field(ge=0, le=20)] | None = None

    @field_validator("parts")
    @classmethod
    def _named(cls, parts: dict[str, Part] | None) -> dict[str, Part] | None:
        if parts is not None:
            check_names(parts)
        return parts

    @property
    def sources(self) -> Mapping[str, Source]:
        """Dotted key to each mesh, parts with the keys that [mesh] has for all of them."""
        if self.parts is None:
            return {"mesh": self}
        shared = {key: getattr(self, key) for key in ("unit", "time_limit")}
        result = {}
        for name, part in self.parts.items():
            own = {key: getattr(part, key) for key in Source.model_fields}
            given = {key: value for key, value in own.items() if key in part.model_fields_set}
            result[f"mesh.parts.{key_text(name)}"] = Source(**{**shared, **given})
        return result

    @property
    def generated_cells(self) -> float:
        """Number of triangles or tetrahedra of boxes and rectangles; 0 of files.

        Where elements are smaller in some places, those before these are made.
        """
        number = sum(source.cells_made for source in self.sources.values())
        times = self.refine if isinstance(self.refine, int) else 0
        refined = number * 2.0 ** (self.dim_made * times)
        return refined if refined <= MOST_CELLS else number  # else `mesh.refine` is refused

    @property
    def dim_made(self) -> int:
        """Dimension of what is generated, if anything is."""
        return 2 if any(source.rectangle for source in self.sources.values()) else 3

    def local_sizes(self, surfaces: Mapping[str, Sequence[Selector]]) -> CadSizes:
        """Where the elements of a CAD file are smaller.

        Args:
            surfaces: Name to selectors, to which places may refer.
        """
        places = self.refine if isinstance(self.refine, list) else ()
        return CadSizes(places if self.cad else (), surfaces)

    def together(self, bodies: Sequence[Body]) -> Body:
        """The meshes as one: of parts, each at its place. Collective.

        Args:
            bodies: The mesh of each of `sources`.

        Raises:
            MeshError: The parts do not fit to each other.
        """
        if self.parts is None:
            return bodies[0]
        from dolfin_elastic.mesh.assembly.of_parts import parts_body

        every = zip(self.parts.items(), self.sources.values(), bodies, strict=True)
        placed, bare, known = {}, list[str](), True
        for (name, part), source, body in every:
            placed[name] = Placed(body, part.move, part.turn)
            if source.unit is None and not body.unit.stated:
                bare += [name] if source.file is not None else []
                known = False
        unit = None if self.metres is None else LengthUnit.of(self.metres)
        result = parts_body(placed, unit=unit)
        text = f"lengths of {', '.join(bare)} in m: neither file nor unit says what they are in"
        information = (*result.information, text) if bare else result.information
        return replace(result, unit=replace(result.unit, stated=known), information=information)

    def refined(self, body: Body) -> Body:
        """The mesh with its names, refined where Gmsh has not done so. Collective.

        Args:
            body: From `together`, with all names.

        Raises:
            MeshError: A place does not exist, or there would be too many cells.
        """
        if not self.refine:
            return body
        from dolfin_elastic.mesh.refine.local import refined_locally, refined_uniformly

        if isinstance(self.refine, int):
            return refined_uniformly(body, self.refine)
        return body if self.cad else refined_locally(body, self.refine)
