"""OBJ files: faces, with the names of their groups and objects."""

from __future__ import annotations

from array import array
from collections import Counter
from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import IntArray
from dolfin_elastic.mesh.formats.surfaces.readers.polygons import cut
from dolfin_elastic.mesh.formats.surfaces.readers.soup import Soup, check_count, content

_CURVED = ("curv", "curv2", "surf", "bmat", "cstype")
_LOOKS = {"vt", "vn", "vp", "s", "mg", "usemtl", "mtllib", "usemap", "maplib", "lod", "bevel"}
_LOOKS |= {"c_interp", "d_interp", "shadow_obj", "trace_obj", "#"}
"""Commands that say nothing of the shape."""


def read_obj(path: Path) -> Soup:
    """Reads an OBJ file. Local.

    Raises:
        MeshError: It is damaged, or has curved surfaces.
    """
    reading = _Reading(path.name)
    before = b""
    for number, end in enumerate(content(path).splitlines(), start=1):
        line = before + end
        if line.endswith(b"\\"):
            before = line[:-1] + b" "
            continue
        before = b""
        reading.take(number, line)
    return reading.soup()


class _Reading:
    """What has been read so far."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._numbers, self._counts = array("d"), array("q")
        self._corners, self._groups, self._lines = array("q"), array("q"), array("q")
        self._names: dict[str, int] = {"": 0}
        self._object, self._group = "", ""
        self._other: Counter[str] = Counter()

    def take(self, number: int, line: bytes) -> None:
        """One line."""
        word, _, rest = line.strip().replace(b"\t", b" ").partition(b" ")
        if word == b"v":
            self._numbers.extend(self._vertex(number, rest))
        elif word in (b"f", b"fo"):
            self._face(number, rest)
        elif word in (b"g", b"o"):
            text = " ".join(rest.partition(b"#")[0].decode("utf-8", "replace").split())
            if word == b"o":
                self._object, self._group = text, ""
            else:
                self._group = "" if text == "default" else text
        elif word and not word.startswith(b"#"):
            key = word.decode("latin-1")
            if key in _CURVED:
                raise MeshError(
                    f"'{key}' describes a curved surface, which is not read",
                    where=f"{self._name}:{number}",
                    expected="faces (f) alone, as programs export them",
                )
            if key not in _LOOKS:
                self._other[key[:20]] += 1

    def _vertex(self, number: int, rest: bytes) -> list[float]:
        try:
            values = [float(word) for word in rest.partition(b"#")[0].split()]
        except ValueError:
            values = []
        if len(values) < 3:
            raise MeshError(
                f"'v {rest.decode('latin-1').strip()[:80]}' is no vertex of three numbers",
                where=f"{self._name}:{number}",
                expected='for example "v 0.5 0 1.25"',
            )
        return values[:3]  # a weight, or colours, may follow

    def _face(self, number: int, rest: bytes) -> None:
        count = len(self._numbers) // 3
        try:
            rows = [int(word.partition(b"/")[0]) for word in rest.partition(b"#")[0].split()]
        except ValueError:
            raise MeshError(
                f"'f {rest.decode('latin-1').strip()[:80]}' is no face",
                where=f"{self._name}:{number}",
                expected='numbers of vertices, for example "f 1 2 3"',
            ) from None
        rows = [row - 1 if row > 0 else count + row for row in rows]
        if rows and not (min(rows) >= 0 and max(rows) < 1 << 40):
            raise self._lost(number)
        self._corners.extend(rows)
        self._counts.append(len(rows))
        self._lines.append(number)
        name = self._group or self._object
        self._groups.append(self._names.setdefault(name, len(self._names)))

    def _lost(self, number: int) -> MeshError:
        return MeshError(
            f"a face refers to a vertex that does not exist; there are {len(self._numbers) // 3}",
            where=f"{self._name}:{number}",
        )

    def soup(self) -> Soup:
        """All that has been read."""
        points = np.frombuffer(self._numbers, dtype=np.float64).reshape(-1, 3)
        counts, corners, groups, lines = (
            np.frombuffer(numbers, dtype=np.int64) if len(numbers) else np.empty(0, np.int64)
            for numbers in (self._counts, self._corners, self._groups, self._lines)
        )
        check_count(int(np.maximum(counts - 2, 0).sum()), self._name)
        if len(lost := np.flatnonzero(corners >= len(points))):
            face = np.searchsorted(np.cumsum(counts), lost[0], side="right")
            raise self._lost(int(lines[face]))
        triangles, owner = cut(points, counts, corners, self._name)
        notes = _left_out(self._other)
        return Soup.of(points, triangles, *_in_use(groups[owner], self._names), notes)


def _in_use(groups: IntArray, names: dict[str, int]) -> tuple[IntArray, tuple[str, ...]]:
    """Groups that have triangles."""
    every = list(names)
    used, rows = np.unique(groups, return_inverse=True)
    return rows.reshape(-1), tuple(every[k] for k in used)


def _left_out(other: Counter[str]) -> list[str]:
    if not other:
        return []
    return ["left out of the OBJ file: " + ", ".join(f"{n} '{key}'" for key, n in other.items())]
