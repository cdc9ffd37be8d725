"""The tables [materials.NAME] and [output] of a case file, and how tables are read.

An error names the key inside its table; the caller that reads the table puts its own key in front.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar

from pydantic import Field, ValidationInfo, field_validator, model_validator

from dolfin_elastic.case.toml import key_text
from dolfin_elastic.core.errors import (
    InputError,
    MeshError,
    all_errors,
    keyed,
    nearest,
    nearest_first,
)
from dolfin_elastic.core.schema import (
    Record,
    WhenGiven,
    quoted,
)
from dolfin_elastic.core.shapes.shapes import Point
from dolfin_elastic.core.units import metres
from dolfin_elastic.mesh import (
    Body,
)
from dolfin_elastic.mesh.selectors import Place, Selector
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.library import completed, containing, library
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.results.checkpoint.checkpoints import CheckpointSettings
from dolfin_elastic.results.derived.sections import Section
from dolfin_elastic.results.exports.output import Export
from dolfin_elastic.results.fields import DEFAULT, FIELDS, IN_MOTION
from dolfin_elastic.results.files import LONGEST_NAME
from dolfin_elastic.results.moments import ReferencePoints, check_reference
from dolfin_elastic.results.outputs import (
    FORMATS,
    History,
    ModePicture,
    Modes,
    Picture,
    Summary,
    check_formats,
)
from dolfin_elastic.results.probes import Probe, ProbePoint, check_places
from dolfin_elastic.results.writer import Output as File
from dolfin_elastic.results.writer import Steps

T = TypeVar("T")
P = TypeVar("P", bound=Place)
Named = TypeVar("Named")
Count = Annotated[int, Field(gt=0)]
Reference = str | Point
"""A point of reference of a moment, see `check_reference`."""


_SLIP = 0.8
"""Likeness from which on a key is a slip of the pen."""


class Material(Record):
    """A table [materials.NAME]: a law with its constants, and where it holds.

    Attributes:
        law: The law; in a case file its name, with its constants beside it.
        on: Region or regions it fills; None: everything no other material names.
        source: Where its values are from; of a material of a library its name and sources.
    """

    law: Law
    on: str | list[str] | None = None
    source: str = ""

    @property
    def regions(self) -> tuple[str, ...]:
        """Names of its regions."""
        return () if self.on is None else (self.on,) if isinstance(self.on, str) else (*self.on,)

    @classmethod
    def read(cls, table: object) -> Material:
        """From a case file's table, or from a law."""
        if isinstance(table, Material):
            return table
        if isinstance(table, Law):
            return cls(law=table)
        assert isinstance(table, Mapping)
        if "material" in table:
            table = completed(table)
        constants = {key: value for key, value in table.items() if key not in ("on", "source")}
        beside = {key: value for key, value in table.items() if key not in constants}
        if "energy" in table:
            from dolfin_elastic.model.materials.user import read_energy

            return cls(law=read_energy(constants), **beside)
        return cls(law=_law_named(table)(**constants), **beside)

    def table(self) -> dict[str, Any]:
        """Back to a case file's table."""
        named = {} if self.law.written else {"law": self.law.name()}
        law = {**named, **table_of(self.law)}
        return {**law, **self.model_dump(exclude={"law"}, exclude_unset=True, exclude_none=True)}


def _law_named(table: Mapping[str, object]) -> type[Law]:
    """The class of a material's law."""
    try:
        return class_named(MATERIALS, table, "law")
    except InputError as error:
        name = table.get("law")
        if name is None:
            for key in table:
                if near := get_close_matches(str(key), ("law", "energy", "material"), 1, _SLIP):
                    raise InputError(
                        f"unknown key '{key}'",
                        where=str(key),
                        expected=f"did you mean '{near[0]}'?",
                    ) from None
            hint = 'or write material = "steel S235" for one of the library'
        elif isinstance(name, str) and (known := containing(name, library())):
            hint = f'a material of the library is material = "..."; {known}'
            raise InputError(error.what, where="law", expected=hint) from None
        else:
            raise
        raise InputError(error.what, where="law", expected=f"{error.expected}; {hint}") from None


def check_name_of_folder(folder: str) -> None:
    """Refuses what names no folder of results.

    Raises:
        InputError: It is blank, or too long.
    """
    if not folder.strip():
        raise InputError(
            f"{quoted(folder)} is no name of a folder",
            expected='for example "results", or "." for that of the case file',
        )
    if any(len(part.encode(errors="replace")) > LONGEST_NAME for part in Path(folder).parts):
        raise InputError(f"{quoted(folder)}: file name too long", expected="a shorter one")


class Output(Record):
    """The table [output]: what is written, where, and how often.

    Attributes:
        folder: Folder of the results, relative to the case file's; by default the case file's
            name with "_results", in the folder where the run is started.
        fields: Fields for ParaView; by default displacement and stresses, with a table of strengths
            also the safety factor.
        formats: Formats of the fields, names from `FORMATS`.
        every: Fields are written every so many steps, and at the end; by default every step, with
            an explicit scheme about 200 states.
        pictures: Pictures of the deformed body.
        exports: Results for other programs, written at the end of the run.
        probes: Name to a point or surface of the undeformed body, where fields are read off at
            every step.
        moments: Name of a support, spring, contact or tie to the point, fixed in space, about which
            its moment is a column of history.csv: "middle" of the undeformed surface, coordinates,
            bare numbers in the mesh's unit, or the name of a surface, edge or point for its
            middle; or a table of several points, each with a name.
        sections: Name to an inner surface or plane whose force and moment are columns of
            history.csv.
        checkpoint: How often the data are written from which a run can restart; false: never.
        frames: Frames of an animation of one period of a mode.
        amplitude: Largest displacement of a mode's animation, over the body's longest side.
    """

    folder: str | None = None
    fields: tuple[str, ...] | None = None
    formats: tuple[str, ...] = ("xdmf",)
    every: Steps | None = None
    pictures: list[WhenGiven[Picture]] = Field(default=[])
    exports: list[WhenGiven[Export]] = Field(default=[])
    probes: dict[str, ProbePoint] = Field(default={})
    moments: dict[str, Reference | dict[str, Reference]] = Field(default={})
    sections: dict[str, Section] = Field(default={})
    checkpoint: WhenGiven[CheckpointSettings] = CheckpointSettings.model_construct()
    frames: Count = 20
    amplitude: Annotated[float, Field(gt=0)] = 0.1

    @field_validator("folder")
    @classmethod
    def _is_folder(cls, folder: str | None) -> str | None:
        if folder is not None:
            check_name_of_folder(folder)
        return folder

    _known_formats = field_validator("formats")(staticmethod(check_formats))

    @field_validator("pictures", mode="before")
    @classmethod
    def _tables(cls, pictures: object) -> object:
        for one in pictures if isinstance(pictures, list) else [pictures]:
            if isinstance(one, str):
                row = f"{{file = {quoted(one)}}}"
                raise InputError(f"{quoted(one)} is wrong", expected=f"write pictures = [{row}]")
        return pictures

    @field_validator("pictures")
    @classmethod
    def _distinct_files(cls, pictures: list[Picture]) -> list[Picture]:
        for index, picture in enumerate(pictures):
            if picture.file in [other.file for other in pictures[:index]]:
                raise InputError(
                    f"'{picture.file}' is the file of a picture above",
                    where=f"[{index}].file",
                    expected="a file of its own",
                )
        return pictures

    @model_validator(mode="after")
    def _check_exports(self) -> Self:
        if self.exports and "xdmf" not in self.formats:
            raise InputError(
                "exports are made from results.xdmf",
                where="exports",
                expected='formats = ["xdmf", ...]',
            )
        written = self.fields or (*DEFAULT, *IN_MOTION)
        files = [picture.file for picture in self.pictures]
        files += [f"results.{name}" for name in self.formats]
        for index, one in enumerate(self.exports):
            missing = [n for n in ("displacement", one.field) if n and n not in written]
            if missing:
                raise InputError(
                    f"'{missing[0]}' is not written, and exports show what is",
                    where=f"exports[{index}].field",
                    expected=f'fields = [..., "{missing[0]}"]',
                )
            if one.file in files:
                raise InputError(
                    f"'{one.file}' is the file of an output above",
                    where=f"exports[{index}].file",
                    expected="a file of its own",
                )
            files.append(one.file)
        return self

    @field_validator("probes", "sections")
    @classmethod
    def _named(cls, probes: dict[str, Named], info: ValidationInfo) -> dict[str, Named]:
        for name in probes:
            if not name.strip() or not name.isprintable():
                raise InputError(
                    f"{quoted(name)} is no name of a {str(info.field_name).removesuffix('s')}",
                    where=key_text(name),
                    expected="a text that can begin the names of columns of history.csv",
                )
        return probes

    @field_validator("moments", mode="before")
    @classmethod
    def _about_points(cls, moments: object) -> object:
        for name, value in moments.items() if isinstance(moments, Mapping) else ():
            try:
                check_reference(value)
            except InputError as error:
                raise error.at(key_text(name)) from None
        return moments

    def check_probes(self, body: Body) -> None:
        """Checks that the probes' points lie in the body. Collective.

        Raises:
            MeshError: A point lies outside, or has too few coordinates.
        """
        try:
            check_places(self.probes, body, body.unit.metres)
        except MeshError as error:
            raise error.at("output.probes") from None

    def check_clips(self, body: Body) -> None:
        """Checks that the planes that cut pictures meet the body. Collective.

        Raises:
            InputError: One does not.
        """
        for i, picture in enumerate(self.pictures):
            try:
                picture.clips(body)
            except InputError as error:
                raise error.at(f"output.pictures[{i}]") from None

    def check_exports(self, folder: Path) -> None:
        """Checks that exports can be made, and that surfaces for them can be read. Not collective.

        Args:
            folder: That of the case file.

        Raises:
            InputError: One cannot.
        """
        for i, one in enumerate(self.exports):
            try:
                one.check(folder)
            except InputError as error:
                raise error.at(f"output.exports[{i}]") from None

    def make_probe(self, problem: Problem) -> Probe:
        """The probe that evaluates the fields at its points and surfaces. Collective."""
        unit = problem.body.unit.metres
        return Probe.of(self.probes, problem, unit, self.reference_points(unit), self.sections)

    def reference_points(self, scale: float) -> ReferencePoints:
        """Label of a support to the points of reference of its moment.

        Args:
            scale: Metres per unit of the mesh.
        """

        def place(point: Reference) -> list[float] | str:
            return point if isinstance(point, str) else [metres(x, scale) for x in point]

        return {
            label: {name: place(point) for name, point in given.items()}
            if isinstance(given, dict)
            else {"": place(given)}
            for label, given in self.moments.items()
        }

    def files(
        self,
        frames: int | None = None,
        title: str = "",
        *,
        states: bool = True,
        modes: bool = False,
    ) -> list[File]:
        """The outputs of a run.

        Args:
            frames: Number of states whose fields are written, if `every` is not given; None: all.
            title: Title of pictures without one of their own.
        """
        keys: dict[str, object] = {"fields": self.fields}
        keys |= {"frames": frames} if self.every is None else {"every": self.every}
        pictures = [
            p if p.title is not None else p.model_copy(update={"title": title})
            for p in self.pictures
        ]
        result: list[File] = []
        if states:
            result = [*(FORMATS[name].from_keys(keys) for name in self.formats), History()]
        last = [Summary(), *self.exports]  # exports are made of what is there
        if not modes:
            return [*result, *pictures, *last]
        drawn = [ModePicture(**{**table_of(p), "amplitude": self.amplitude}) for p in pictures]
        return [*result, Modes(frames=self.frames, amplitude=self.amplitude), *drawn, *last]

    def only(self, *, modes: bool, states: bool, motion: bool | None) -> Self:
        """What of it one of several analyses gives.

        Args:
            modes: It gives modes, which have pictures without a field, and no film.
            states: It gives states; exports of modes alone have no field.
            motion: It is a motion, or not; None: no analysis of the case is.
        """

        def given(name: str) -> bool:
            field = FIELDS.get(name)
            if motion is None or field is None:  # one of the body is in all analyses
                return True
            return not (field.statics if motion else field.motion)

        pictures = [p for p in self.pictures if all(map(given, p.fields))]
        if modes:
            bare = [(p, table_of(p)) for p in self.pictures if not p.film]
            pictures = [type(p)(**{k: v for k, v in t.items() if k != "field"}) for p, t in bare]
        if states:
            exports = [e for e in self.exports if e.field is None or given(e.field)]
        else:
            exports = [e.model_copy(update={"field": None}) for e in self.exports]
        keys: dict[str, object] = {"pictures": pictures, "exports": exports}
        if self.fields is not None:
            keys["fields"] = tuple(filter(given, self.fields))
        keys["probes"] = {
            name: probe.model_copy(update={"fields": fields})
            for name, probe in self.probes.items()
            if (fields := tuple(filter(given, probe.fields)))
        }
        return self.model_copy(update=keys)

    def names(self) -> list[str]:
        """Names of files that the case gives its results."""
        return [one.file for one in (*self.pictures, *self.exports)]


# --- reading ---


def as_table(value: object) -> dict[str, Any]:
    """A table, or a record as one.

    Raises:
        InputError: It is neither.
    """
    if isinstance(value, Record):
        return table_of(value)
    if not isinstance(value, Mapping):
        raise InputError(f"{quoted(value)} is wrong", expected="expected a table")
    return dict(value)


def class_named(
    kinds: Mapping[str, type[T]],
    table: object,
    key: str,
    advice: Mapping[str, str] | None = None,
) -> type[T]:
    """The class that a table's `law` or `kind` names.

    Args:
        key: Which of its keys holds the name.
        advice: Words that are no names, and what to write for them; with it, all names are listed.

    Raises:
        InputError: It names none, or an unknown one.
    """
    name = as_table(table).get(key)
    if name is None:
        raise InputError("this key is missing", where=key, expected=f"known: {', '.join(kinds)}")
    if not isinstance(name, str):
        raise InputError(f"{quoted(name)} is wrong", where=key, expected="expected a text")
    if name not in kinds:
        known = nearest(name, kinds)
        if advice is not None:
            known = nearest_first(name, kinds, advice.get(name.casefold(), ""))
        raise InputError(f"unknown {key} '{name}'", where=key, expected=known)
    return kinds[name]


def read_named(tables: object, read: Callable[[object], T]) -> dict[str, T]:
    """Reads each entry of a table of tables.

    Args:
        read: Reads one entry; its errors get the name in front.
    """
    result = {}
    with all_errors() as attempt:
        for name, table in as_table(tables).items():
            with attempt(), keyed(key_text(name)):
                result[name] = read(table)
    return result


def read_list(rows: Iterable[object], read: Callable[[object], T]) -> list[T]:
    """Reads each entry of a list of tables.

    Args:
        read: Reads one entry; its errors get the index in front.
    """
    result = []
    with all_errors() as attempt:
        for index, row in enumerate(rows):
            with attempt(), keyed(f"[{index}]"):
                result.append(read(row))
    return result


def selectors(kind: type[P]) -> Callable[[object], list[P]]:
    """Reads one selector, or several whose parts are joined; a text is the name of a part.

    Args:
        kind: `Selector`, `EdgeSelector` or `PointSelector`.
    """

    def one(value: object) -> P:
        if isinstance(value, str) and issubclass(kind, Selector):
            value = {"of": value}
        return value if isinstance(value, kind) else kind(**as_table(value))

    def read(value: object) -> list[P]:
        return read_list(value, one) if isinstance(value, list | tuple) else [one(value)]

    return read


def table_of(record: Record) -> dict[str, Any]:
    """A record as the table it was read from: without keys that were left out."""
    return record.model_dump(exclude_unset=True, exclude_none=True, by_alias=True)
