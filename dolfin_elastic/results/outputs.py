"""Kinds of outputs: records with the settings of one file, which open its writer.

`Output.files` in `case/tables.py` decides which of them a run writes, from the table [output].
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

from pydantic import Field, StrictBool, field_validator, model_validator

from dolfin_elastic.core.errors import InputError, nearest
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.shapes.directions import Axis
from dolfin_elastic.core.units import COMMON_UNITS
from dolfin_elastic.mesh.criteria import BoundingBox
from dolfin_elastic.mesh.selectors import Middle
from dolfin_elastic.results.scene.scene import Up, View
from dolfin_elastic.results.writer import Numbers, Output, Steps, Writer
from dolfin_elastic.results.writers.history import HistoryWriter
from dolfin_elastic.results.writers.modes import ModesWriter
from dolfin_elastic.results.writers.modes import listing as animations
from dolfin_elastic.results.writers.msh import MshWriter
from dolfin_elastic.results.writers.series import SeriesWriter
from dolfin_elastic.results.writers.summary import SummaryWriter
from dolfin_elastic.results.writers.tables import TableWriter
from dolfin_elastic.results.writers.vtkhdf import VtkhdfWriter
from dolfin_elastic.results.writers.vtu import VtuWriter
from dolfin_elastic.results.writers.xdmf import XdmfWriter

if TYPE_CHECKING:
    from dolfin_elastic.mesh.body import Body
    from dolfin_elastic.problem.problem import Problem
    from dolfin_elastic.results.scene.appearance import Appearance
    from dolfin_elastic.results.scene.clip import Clip
    from dolfin_elastic.results.scene.series import Limits


_MOST_FIELDS = 4
_FPS, _GIF = 30.0, 50.0
_MAX_LISTED = 4
"""Number of files up to which all are listed; of more the first and the last."""


def _is_film(file: str) -> bool:
    from dolfin_elastic.results.scene.series import FILMS

    return Path(file).suffix in FILMS


def limits_of(ends: Sequence[float | str]) -> Limits:
    """Ends of a colour bar from numbers, texts with units, or percentiles.

    Raises:
        InputError: They are none, or no range.
    """
    from dolfin_elastic.results.scene.series import Limits

    expected = 'for example [0, "200 MPa"], or percentiles ["2 %", "98 %"]'
    share = all(isinstance(end, str) and end.strip().endswith("%") for end in ends)
    try:
        result = [float(str(e).strip(" %")) if share else _number_of(e) for e in ends]
    except (InputError, ValueError):
        raise InputError("this is no range of colours", expected=expected) from None
    if len(result) == 2 and result[0] >= result[1]:
        raise InputError(
            "the first end of a range of colours must be below the second", expected=expected
        )
    whole = len(result) == 2 and result[0] < result[1]
    if not whole or (share and not 0 <= result[0] <= result[1] <= 100):
        raise InputError("this is no range of colours", expected=expected)
    return Limits((result[0], result[1]), share)


def check_frames(fps: float, where: str) -> None:
    """Checks that viewers show so many frames a second of a .gif.

    Args:
        where: The key or option that says so.

    Raises:
        InputError: They do not.
    """
    if fps > _GIF:
        raise InputError(
            f"viewers show at most {_GIF:g} frames a second of a .gif",
            where=where,
            expected=f"at most {_GIF:g}, or an .mp4",
        )


def _number_of(value: float | str) -> float:
    """A number in SI units."""
    if not isinstance(value, str):
        return float(value)
    parts = value.split(maxsplit=1)
    if len(parts) < 2:
        return float(value)
    known = (table[parts[1]] for table in COMMON_UNITS.values() if parts[1] in table)
    factor = next(known, None)
    if factor is None:
        raise InputError(f"unknown unit '{parts[1]}'", expected='for example "200 MPa"')
    return float(parts[0]) * factor


def check_suffix(file: str, suffix: str, *others: str) -> str:
    """Refuses names of files that have another ending, or lie outside the results' folder.

    Raises:
        InputError: It is such a name.
    """
    if not file.endswith((suffix, *others)) or file in (suffix, *others):
        endings = " or ".join(filter(None, [", ".join((suffix, *others[:-1])), *others[-1:]]))
        raise InputError(
            f"'{file}' does not end with {endings}", expected=f'for example "a{suffix}"'
        )
    if not file.isprintable():
        raise InputError(f"{file!r} is no name of a file", expected=f'for example "a{suffix}"')
    if Path(file).is_absolute() or ".." in Path(file).parts:
        raise InputError(
            f"'{file}' lies outside the folder of the results",
            expected=f'a name inside it, for example "a{suffix}"; `folder` says where that is',
        )
    return file


class FieldFile(Output):
    """Fields of selected states in one of the formats of `FORMATS`.

    Attributes:
        file: The file to open; the numbers go to a folder beside it, where it has one.
        fields: Names of `field_table`; by default displacement, von Mises and Cauchy stress, with
            a table of strengths the safety factor, and in motion velocity.
        every: The first state at or after each n-th step is written, and the last one.
        frames: If given, so many states evenly over the run are written instead.
    """

    fields: tuple[str, ...] | None = None
    every: Steps = 1
    frames: int | None = Field(default=None, ge=1)

    writer: ClassVar[type[SeriesWriter]]
    """What writes the format."""

    @field_validator("file")
    @classmethod
    def _check_file(cls, file: str) -> str:
        return check_suffix(file, Path(cls.model_fields["file"].default).suffix)

    def open(self, problem: Problem, folder: Path, saved: Numbers | None = None) -> SeriesWriter:
        """See `Output.open`."""
        return self.writer(
            problem,
            folder / self.file,
            fields=self.fields,
            every=self.every,
            frames=self.frames,
            saved=saved,
        )

    def remove(self, folder: Path) -> None:
        """See `Output.remove`."""
        self.writer.files_of(folder / self.file).remove()


class Xdmf(FieldFile):
    """XDMF with HDF5, for ParaView; see `FieldFile`."""

    file: str = "results.xdmf"
    writer = XdmfWriter


class Vtu(FieldFile):
    """VTK's XML files, a piece a rank, for ParaView and PyVista; see `FieldFile`."""

    file: str = "results.pvd"
    writer = VtuWriter


class Vtkhdf(FieldFile):
    """VTKHDF, for ParaView from 5.12 on; see `FieldFile`."""

    file: str = "results.vtkhdf"
    writer = VtkhdfWriter


class Tables(FieldFile):
    """CSV tables of the values at nodes and of those of cells; see `FieldFile`."""

    file: str = "results.csv"
    writer = TableWriter


class Msh(FieldFile):
    """Gmsh's .msh, whose views are the fields; see `FieldFile`."""

    file: str = "results.msh"
    writer = MshWriter


FORMATS: dict[str, type[Output]] = {
    "xdmf": Xdmf,
    "vtu": Vtu,
    "vtkhdf": Vtkhdf,
    "csv": Tables,
    "msh": Msh,
}
"""Name of a format in `output.formats` to its output."""
_EXPORTED = ("frd", "glb", "usd", "usdc", "ply", "obj")


def check_formats(names: Iterable[str]) -> tuple[str, ...]:
    """The names, each once, in their order.

    Raises:
        InputError: There is no such format, or none is given.
    """
    unique = tuple(dict.fromkeys(names))
    for index, name in enumerate(unique):
        if name in _EXPORTED:
            raise InputError(
                f"'{name}' is written at the end of a run",
                where=f"[{index}]",
                expected=f'exports = [{{file = "results.{name}"}}]',
            )
        if name not in FORMATS:
            raise InputError(
                f"unknown format '{name}'", where=f"[{index}]", expected=nearest(name, FORMATS)
            )
    if not unique:
        raise InputError("no format is given", expected=f"known: {', '.join(FORMATS)}")
    return unique


class History(Output):
    """One row of numbers a step, as a table.

    Attributes:
        file: The CSV file.
    """

    file: str = "history.csv"

    def open(self, problem: Problem, folder: Path, saved: Numbers | None = None) -> HistoryWriter:
        """See `Output.open`."""
        return HistoryWriter(problem, folder / self.file, saved)


class Summary(Output):
    """The summary of a run as JSON.

    Attributes:
        file: The JSON file.
        case: Tables of the case, of which the summary holds a copy.
        model: What is noted of its model, of which it holds a copy, too.
    """

    file: str = "summary.json"
    case: dict[str, Any] = Field(default={})
    model: dict[str, Any] = Field(default={})

    def open(self, problem: Problem, folder: Path, saved: Numbers | None = None) -> SummaryWriter:
        """See `Output.open`."""
        return SummaryWriter(problem, folder / self.file, saved, case=self.case, model=self.model)


class ClipPlane(Record):
    """A plane that takes away a part of the body in a picture.

    Attributes:
        plane: The axis across it.
        at: Its coordinate in the undeformed body, a bare number in the mesh's unit; "middle": of
            the body.
        keep: What stays; by default what is farther from the camera.
    """

    plane: Axis
    at: Middle = "middle"
    keep: Literal["above", "below"] | None = None

    def clip(self, body: Body) -> Clip:
        """The plane in a body. Collective.

        Raises:
            InputError: The body has no such axis, or the plane misses it.
        """
        from dolfin_elastic.results.scene.clip import Clip

        unit = body.unit
        space = BoundingBox.of(body, unit.metres)
        axis, at = space.plane(self.plane, self.at)
        ends = float(space.low[axis]), float(space.high[axis])
        if not ends[0] < at < ends[1]:
            raise InputError(
                f"the plane {self.plane} = {at / unit.metres:.4g} {unit.name} misses the body",
                where="at",
                expected=f"between {ends[0] / unit.metres:.4g} and {ends[1] / unit.metres:.4g} "
                f'{unit.name}, or "middle"',
            )
        return Clip(axis, at, None if self.keep is None else self.keep == "below")


class Picture(Output):
    """A picture of the deformed body, or a film; what draws it is imported when there is one.

    Attributes:
        file: The PNG file; where `every` is a number, the step's number is added to its name.  Of a
            film the .mp4 or .gif file.
        field: Name of `field_table` whose value colours the surface, of a vector or tensor its
            norm; or several names, which are seen side by side.
        view: Direction from which the body is seen.
        up: Axis that is up; by default the one against which weight acts, else z.
        clip: Planes that take away a part of the body, or one.
        scale: Magnification of the displacement.
        every: "last"; or n for the first state at or after each n-th step, and the last one.  Of a
            film "last" stands for as many states as it needs.
        title: Text above the body; by default the case's title.
        range: Ends of the colours in the field's SI unit, or percentiles ["2 %", "98 %"]; by
            default the smallest and largest value, of a series those of all its pictures.
        mark: The largest value is marked, of safety factors the smallest; by default in pictures
            and not in films.
        obstacles: The rigid obstacles of contacts are drawn.
        fps: Frames a second of a film.
        speed: Time [s], in statics load, that passes in a second of a film; by default 1, in
            statics 0.2.
    """

    file: str = "picture.png"
    field: str | list[str] = "von_mises"
    view: View = "isometric"
    scale: float = 1.0
    every: Literal["last"] | int = "last"
    title: str | None = None
    range: list[float | str] | None = None
    mark: StrictBool | None = None
    obstacles: bool = True
    up: Up | None = None
    clip: ClipPlane | list[ClipPlane] = Field(default=[])
    fps: float | None = Field(default=None, gt=0, le=240)
    speed: float | None = Field(default=None, gt=0)

    @field_validator("file")
    @classmethod
    def _check_file(cls, file: str) -> str:
        from dolfin_elastic.results.scene.series import FILMS

        return check_suffix(file, ".png", *FILMS)

    @field_validator("field")
    @classmethod
    def _check_field(cls, field: str | list[str]) -> str | list[str]:
        names = [field] if isinstance(field, str) else field
        if not 1 <= len(names) <= _MOST_FIELDS:
            raise InputError(
                f"{len(names)} fields given", expected=f"one, or up to {_MOST_FIELDS} side by side"
            )
        return field

    @field_validator("every")
    @classmethod
    def _check_every(cls, every: str | int) -> str | int:
        if isinstance(every, int) and every < 1:
            raise InputError(f"{every} is wrong", expected='"last", 1, 2, 3, ...')
        return every

    @field_validator("range")
    @classmethod
    def _check_range(cls, ends: list[float | str] | None) -> list[float | str] | None:
        if ends is not None:
            limits_of(ends)
        return ends

    @model_validator(mode="after")
    def _check_film(self) -> Self:
        given = [key for key in ("fps", "speed") if getattr(self, key) is not None]
        if given and not _is_film(self.file):
            raise InputError(
                f"'{self.file}' is no film", where=given[0], expected='file = "film.mp4", or ".gif"'
            )
        if self.file.endswith(".gif"):
            check_frames(self.fps or 0.0, "fps")
        return self

    @property
    def film(self) -> bool:
        """It is a film."""
        return _is_film(self.file)

    @property
    def fields(self) -> list[str]:
        """Names of the fields, which are seen side by side."""
        return [self.field] if isinstance(self.field, str) else self.field

    def open(self, problem: Problem, folder: Path, saved: Numbers | None = None) -> Writer:
        """See `Output.open`."""
        from dolfin_elastic.results.scene.pictures import Film, PictureWriter

        return PictureWriter(
            problem,
            folder / self.file,
            fields=self.fields,
            saved=saved,
            appearance=self.appearance(problem.body),
            every=None if self.every == "last" else self.every,
            film=Film(self.fps or _FPS, self.speed),
        )

    def clips(self, body: Body) -> list[Clip]:
        """The planes that take away a part. Collective.

        Raises:
            InputError: One of them misses the body.
        """
        single = isinstance(self.clip, ClipPlane)
        planes = [self.clip] if isinstance(self.clip, ClipPlane) else self.clip
        result = []
        for i, plane in enumerate(planes):
            try:
                result.append(plane.clip(body))
            except InputError as error:
                raise error.at("clip" if single else f"clip[{i}]") from None
        return result

    def appearance(self, body: Body) -> Appearance:
        """How the pictures show the body. Collective."""
        from dolfin_elastic.results.scene.appearance import Appearance
        from dolfin_elastic.results.scene.series import Limits

        return Appearance(
            self.scale,
            self.view,
            self.title or "",
            limits=Limits() if self.range is None else limits_of(self.range),
            marks=not self.film if self.mark is None else self.mark,
            obstacles=self.obstacles,
            up=self.up,
            clips=self.clips(body),
            film=self.film,
        )

    def listing(self, folder: Path) -> list[str]:
        """See `Output.listing`; of many pictures the first, the last and their number."""
        from dolfin_elastic.results.scene.pictures import picture_files

        path = folder / self.file
        names = [str(p.relative_to(folder)) for p in picture_files(path)] if folder.is_dir() else []
        if len(names) <= _MAX_LISTED:
            return names
        return [f"{names[0]} ... {names[-1]} ({len(names)} pictures)"]


class ModePicture(Picture):
    """A picture of each mode, coloured by its displacement.

    Attributes:
        amplitude: Largest displacement in the picture, over the body's longest side.
    """

    amplitude: float = Field(default=0.1, gt=0)

    def open(self, problem: Problem, folder: Path, saved: Numbers | None = None) -> Writer:
        """See `Output.open`."""
        from dolfin_elastic.results.scene.pictures import ModePictureWriter

        return ModePictureWriter(
            problem,
            folder / self.file,
            amplitude=self.amplitude,
            appearance=self.appearance(problem.body),
        )


class Modes(Output):
    """Modes of vibration or buckling: a table, and an animation of each for ParaView.

    Attributes:
        file: The CSV file; animations are called mode_01.xdmf, mode_02.xdmf ... beside it.
        frames: Number of frames of one period.
        amplitude: Largest displacement of an animation, over the body's longest side.
    """

    file: str = "modes.csv"
    frames: int = Field(default=20, ge=1)
    amplitude: float = Field(default=0.1, gt=0)

    def open(self, problem: Problem, folder: Path, saved: Numbers | None = None) -> ModesWriter:
        """See `Output.open`."""
        return ModesWriter(
            problem, folder / self.file, frames=self.frames, amplitude=self.amplitude
        )

    def listing(self, folder: Path) -> list[str]:
        """See `Output.listing`; of many animations the first and the last."""
        names = [path.name for path in animations(folder)]
        if len(names) > _MAX_LISTED:
            names = [f"{names[0]} ... {names[-1]}"]
        return [*super().listing(folder), *names]
