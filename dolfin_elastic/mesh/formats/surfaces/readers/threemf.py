"""3MF files: a zip of XML, with a unit, objects, and where these stand."""

from __future__ import annotations

import io
import math
import posixpath
import zipfile
import zlib
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.etree.ElementTree import ParseError

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.files.xml import walk
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.formats.surfaces.readers.slicer import FILES, NEGATIVE, Roles
from dolfin_elastic.mesh.formats.surfaces.readers.soup import Soup, check_count, content

_UNITS = {
    "micron": 1e-6,
    "millimeter": 1e-3,
    "centimeter": 1e-2,
    "inch": 0.0254,
    "foot": 0.3048,
    "meter": 1.0,
}
_NO_TRIANGLES = ("beamlattice", "booleanshape", "displacementmesh", "levelset", "volumetricstack")
_MOST_OF_A_PART = 2 << 30
_MOST_RATIO = 400
"""Of the size of a part and of what it takes in the file: numbers compress to a tenth or so, and
zeros to a thousandth."""
_MOST_PARTS, _MOST_COPIES, _DEEP = 1000, 100_000, 20


@dataclass
class _Object:
    name: str
    kind: str
    points: array[float] = field(default_factory=lambda: array("d"))
    rows: array[int] = field(default_factory=lambda: array("q"))
    components: list[tuple[str, str, FloatArray]] = field(default_factory=list)


@dataclass
class _Item:
    part: str
    number: str
    placed: FloatArray
    printed: bool = True


def _key(part: str) -> str:
    """One spelling of the path of a part."""
    return posixpath.normpath(part).lstrip("/").lower()


class _Stop(Exception):  # noqa: N818 (no error)
    pass


def unit_of_3mf(path: Path) -> LengthUnit:
    """The unit that a 3MF file states; millimetres where it leaves it out. Local.

    Raises:
        MeshError: It is damaged.
    """
    package = _Package(path)
    found: list[str] = []

    def start(_: str, attributes: Mapping[str, str]) -> None:
        found.append(attributes.get("unit", "millimeter"))
        raise _Stop

    try:
        walk(package.read(package.root), start)
    except _Stop:
        pass
    except ParseError as error:
        raise package.damaged(str(error), package.root) from None
    unit = found[0].lower()
    if unit not in _UNITS:
        raise package.damaged(f"its unit '{unit}' is none of {', '.join(_UNITS)}", package.root)
    return LengthUnit.of(_UNITS[unit], stated=True)


def read_3mf(path: Path) -> Soup:
    """Reads the objects that a 3MF file builds, each where it stands. Local.

    Raises:
        MeshError: It is damaged, or more than surfaces.
    """
    package = _Package(path)
    model = _Model(package)
    model.load(package.root)
    items = [item for item in model.items if item.printed or model.leave_out("not to be printed")]
    items = (
        items
        if model.items
        else [
            _Item(package.root, number, np.eye(4))
            for (part, number), one in model.objects.items()
            if part == _key(package.root) and one.kind == "model"
        ]
    )
    placed = [leaf for item in items for leaf in model.leaves(item.part, item.number, item.placed)]
    total = sum(len(one.rows) // 3 for one, _, _ in placed)
    check_count(total, path.name)
    return _joined(placed, path.name, model.notes)


class _Package:
    """The zip file."""

    def __init__(self, path: Path) -> None:
        self.name = path.name
        try:
            self._zip = zipfile.ZipFile(io.BytesIO(content(path)))
        except (zipfile.BadZipFile, ValueError, NotImplementedError, OSError) as error:
            raise MeshError(
                f"it is no 3MF file: {error}", where=self.name, expected="all of the file"
            ) from None
        if len(self._zip.infolist()) > _MOST_PARTS:
            raise MeshError(
                f"it has {len(self._zip.infolist())} parts", where=self.name, expected="a 3MF file"
            )
        self._names = {name.lower(): name for name in self._zip.namelist()}
        self.root = self._root()

    def _root(self) -> str:
        """Path of the part with the model."""
        found: list[str] = []

        def start(_: str, attributes: Mapping[str, str]) -> None:
            if attributes.get("Type", "").endswith("/3dmodel"):
                found.append(attributes.get("Target", ""))

        if "_rels/.rels" in self._names:
            try:
                walk(self.read("_rels/.rels"), start)
            except ParseError as error:
                raise self.damaged(str(error), "_rels/.rels") from None
        return found[0] if found else "3D/3dmodel.model"

    def read(self, part: str) -> bytes:
        """The content of a part."""
        key = _key(part)
        if key not in self._names:
            raise MeshError(f"it has no part '{part[:80]}'", where=self.name, expected="a 3MF file")
        info = self._zip.getinfo(self._names[key])
        limit = min(_MOST_OF_A_PART, 100_000 + _MOST_RATIO * info.compress_size)
        try:
            with self._zip.open(info) as file:
                data = file.read(limit + 1)
        except (zipfile.BadZipFile, zlib.error, RuntimeError, OSError, EOFError) as error:
            raise self.damaged(str(error), part) from None
        except NotImplementedError as error:
            raise self.damaged(str(error), part) from None
        if len(data) > limit:
            raise self.damaged(
                f"it is larger than {limit} bytes, though only {info.compress_size} are stored",
                part,
            )
        return data

    def roles(self) -> Roles:
        """What slicers say of its parts."""
        try:
            return Roles([self.read(part) for part in FILES if _key(part) in self._names])
        except ParseError as error:
            raise self.damaged(str(error), "Metadata") from None

    def damaged(self, what: str, part: str) -> MeshError:
        """An error of a part."""
        return MeshError(
            f"its part '{part[:80]}' cannot be read: {what}",
            where=self.name,
            expected="a 3MF file as programs export it",
        )


class _Model:
    """Objects of all parts, and what is built of them."""

    def __init__(self, package: _Package) -> None:
        self._package = package
        self.objects: dict[tuple[str, str], _Object] = {}
        self.items: list[_Item] = []
        self._left_out: Counter[str] = Counter()
        self._roles = package.roles()
        self._loaded: set[str] = set()
        self._copies = 0

    @property
    def notes(self) -> list[str]:
        """What is no material of the body."""
        parts = ", ".join(f"{count} '{what}'" for what, count in self._left_out.items())
        return [f"left out of the 3MF file: {parts}"] if parts else []

    def leave_out(self, what: str) -> bool:
        """Counts a part that is no material; False.

        Raises:
            MeshError: It is to be subtracted, so the body without it would be another one.
        """
        if what == NEGATIVE:
            raise MeshError(
                "a part of it is a volume to subtract from others, which is not done",
                where=self._package.name,
                expected="the body after the subtraction, as the slicer exports it to .stl",
            )
        self._left_out[what] += 1
        return False

    def load(self, part: str) -> None:
        """Reads a part, and those that it refers to."""
        key = _key(part)
        if key in self._loaded:
            return
        self._loaded.add(key)
        reading = _Reading(self, part)
        try:
            walk(self._package.read(part), reading.start)
        except ParseError as error:
            raise self._package.damaged(str(error), part) from None
        except (ValueError, KeyError, OverflowError) as error:
            kind = "" if isinstance(error, ValueError) else f"{type(error).__name__} "
            raise self._package.damaged(f"{kind}{error}", part) from None
        for other in reading.others:
            self.load(other)

    def leaves(
        self, part: str, number: str, placed: FloatArray, depth: int = 0, name: str = ""
    ) -> Iterator[tuple[_Object, FloatArray, str]]:
        """Meshes of an object, with where they stand and their names."""
        one = self.objects.get((_key(part), number))
        self._copies += 1
        if one is None or depth > _DEEP or self._copies > _MOST_COPIES:
            raise self._package.damaged(
                f"object {number} does not exist"
                if one is None
                else f"object {number} consists of itself, or of too many others",
                part,
            )
        if one.kind not in ("model", ""):
            self.leave_out(f"object of the type {one.kind[:40]}")
            return
        if len(one.rows):
            yield self._material(number, one), placed, one.name or name
        for other, inner, matrix in one.components:
            if role := self._roles.of_part(number, inner):
                self.leave_out(role)
                continue
            yield from self.leaves(
                other or part, inner, matrix @ placed, depth + 1, one.name or name
            )

    def _material(self, number: str, one: _Object) -> _Object:
        """The object without triangles that are no material."""
        rows: IntArray = np.frombuffer(one.rows, dtype=np.int64).reshape(-1, 3)
        of = self._roles.material(number, len(rows), self.leave_out)
        return one if of.all() else replace(one, rows=array("q", rows[of].ravel().tobytes()))


class _Reading:
    """One part."""

    def __init__(self, model: _Model, part: str) -> None:
        self._model, self._part = model, part
        self._key = _key(part)
        self._now: _Object | None = None
        self.others: list[str] = []

    def start(self, tag: str, attributes: Mapping[str, str]) -> None:
        """An element begins."""
        name = tag.rpartition("}")[2]
        if name == "vertex" and self._now is not None:
            self._now.points.extend(float(attributes[axis]) for axis in "xyz")
        elif name == "triangle" and self._now is not None:
            self._now.rows.extend(int(attributes[key]) for key in ("v1", "v2", "v3"))
        elif name == "object":
            text = " ".join(attributes.get("name", "").split())
            self._now = _Object(text, attributes.get("type", "model"))
            self._model.objects[self._key, attributes["id"]] = self._now
        elif name == "component" and self._now is not None:
            other = self._path(attributes)
            matrix = _matrix(attributes.get("transform"))
            self._now.components.append((other, attributes["objectid"], matrix))
        elif name == "item":
            placed = _matrix(attributes.get("transform"))
            part = self._path(attributes) or self._part
            printed = attributes.get("printable", "1") != "0"
            self._model.items.append(_Item(part, attributes["objectid"], placed, printed))
        elif name in _NO_TRIANGLES:
            raise ValueError(f"'{name}' is not read; only surfaces of triangles are")

    def _path(self, attributes: Mapping[str, str]) -> str:
        """Part that a reference of the production extension names."""
        found = next((v for k, v in attributes.items() if k.endswith("}path")), "")
        if found:
            self.others.append(found)
        return found


def _matrix(text: str | None) -> FloatArray:
    """A transform, for rows of points from the left, shape (4, 4)."""
    result = np.eye(4)
    if text:
        numbers = [float(word) for word in text.split()]
        if len(numbers) != 12 or not all(map(math.isfinite, numbers)):
            raise ValueError(f"'{text[:80]}' is no transform of twelve numbers")
        result[:, :3] = np.reshape(numbers, (4, 3))
    return result


def _joined(placed: list[tuple[_Object, FloatArray, str]], name: str, notes: list[str]) -> Soup:
    points: list[FloatArray] = []
    triangles: list[IntArray] = []
    solids: list[IntArray] = []
    names: list[str] = []
    start = 0
    for one, matrix, label in placed:
        own = np.frombuffer(one.points, dtype=np.float64).reshape(-1, 3)
        rows: IntArray = np.frombuffer(one.rows, dtype=np.int64).reshape(-1, 3)
        if not len(rows):
            continue
        if rows.min() < 0 or rows.max() >= len(own):
            raise MeshError(
                f"a triangle of '{label}' refers to a vertex that does not exist; there are "
                f"{len(own)}",
                where=name,
            )
        if np.linalg.det(matrix[:3, :3]) < 0:
            rows = rows[:, ::-1]  # a mirror image
        points.append(own @ matrix[:3, :3] + matrix[3, :3])
        triangles.append(rows + start)
        solids.append(np.full(len(rows), len(names)))
        names.append(label)
        start += len(own)
    zero = np.zeros(sum(map(len, triangles)), dtype=np.int64)
    return Soup(
        np.concatenate(points),
        np.concatenate(triangles),
        zero,
        ("",),
        np.concatenate(solids),
        names,
        notes,
    )
