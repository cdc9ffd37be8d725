"""`CadFaces`: the faces of the CAD file that a mesh was made of, picked by number or kind."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from dolfin_elastic.core.errors import InputError, MeshError
from dolfin_elastic.core.types import IndexArray, IntArray
from dolfin_elastic.core.units import METRE, LengthUnit, metres
from dolfin_elastic.mesh.selectors import Selector

if TYPE_CHECKING:
    from dolfin_elastic.mesh.formats.cad.faces import CadFace

_SAME = 1e-3
"""Relative difference of radii that are the same, unless a tolerance is given."""
_ALONG = 1e-3
"""Angle between axes that are parallel."""
_MOST = 6
"""Faces that a message lists."""


def _none() -> IndexArray:
    return np.empty(0, dtype=np.int32)


def _no_numbers() -> IntArray:
    return np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class CadFaces:
    """The faces of a CAD model, and the facets of a mesh that lie on them.

    Attributes:
        faces: Number to face; the curves of a plane body.
        dim: Of the body.
        unit: Unit of length of the file, for messages.
        facets: Local facets on faces, sorted.
        numbers: The face of each, shape (facets,).
        inside: Faces between joined bodies.
    """

    faces: Mapping[int, CadFace]
    dim: int
    unit: LengthUnit = METRE
    facets: IndexArray = field(default_factory=_none)
    numbers: IntArray = field(default_factory=_no_numbers)
    inside: frozenset[int] = frozenset()

    def numbers_of(self, facets: IndexArray) -> IntArray:
        """The face of each local facet, 0 where there is none, shape (n,)."""
        if not len(self.facets):
            return np.zeros(len(facets), dtype=np.int64)
        at = np.minimum(np.searchsorted(self.facets, facets), len(self.facets) - 1)
        return np.asarray(np.where(self.facets[at] == facets, self.numbers[at], 0))

    def facets_of(self, chosen: Iterable[int]) -> IndexArray:
        """Local facets of faces, sorted."""
        return np.asarray(self.facets[np.isin(self.numbers, list(chosen))])

    def text(self, number: int) -> str:
        """A face in words: "3 (cylinder r 6 mm, fillet)"."""
        words = self.faces[number].description(self.unit.name, self.unit.metres, self.dim)
        return f"{number} ({words})"

    def named(self, name: str) -> tuple[int, ...]:
        """The faces that a name says by number, "face 3", or kind and size, "hole r 4.5".

        All faces of that kind and size on the surface of the body; the unit is the file's unless
        one is written.  What `text` says of a face is a name, too, where it has a number.
        """
        text = " ".join(name.casefold().split())
        if number := re.fullmatch(r"(?:face|curve) (\d{1,9})", text):
            return (int(number[1]),) if int(number[1]) in self.faces else ()
        outer = {n: face for n, face in self.faces.items() if n not in self.inside}
        if size := re.fullmatch(r"([a-z]+) r (\d+(?:\.\d*)?(?:e[-+]?\d\d?)?)( ?[a-zµ]+)?", text):
            with suppress(InputError):
                unit = size[3].strip() if size[3] else ""
                r = metres(f"{size[2]} {unit}" if unit else float(size[2]), self.unit.metres)
                return tuple(n for n, face in outer.items() if _is_round(face, size[1], r))
        words = {n: self.text(n).partition("(")[2][:-1].casefold() for n in outer}
        return tuple(n for n, one in words.items() if one == text and re.search(r"\d", one))

    def listed(self, numbers: Iterable[int]) -> str:
        """The first faces in words."""
        every = list(numbers)
        text = ", ".join(map(self.text, every[:_MOST]))
        return text + (f" and {len(every) - _MOST} more" if len(every) > _MOST else "")

    def alike(self, name: str) -> str:
        """Advice where no surface has a name: the faces that it may mean, else those there are."""
        words = {word for word in re.split(r"[^a-z0-9]+", name.lower()) if word}
        words |= {re.sub(r"(s|\d+)$", "", word) for word in words}
        meant = [n for n, face in self.faces.items() if words & {face.kind, face.form} - {""}]
        number = re.fullmatch(r"(?:face|surface)?[ _-]*(\d+)", name.lower())
        if number and int(number[1]) in self.faces:
            meant = [int(number[1])]
        one = (meant or list(self.faces) or [1])[0]
        names = [f'"face {one}"']
        if (face := self.faces.get(one)) and face.radius and face.major is None:
            size = f"{face.radius / self.unit.metres:.4g}"
            names.append(f'"{face.form or face.kind} r {size}"')
        return (
            f"faces of the CAD file are named by number or size, as {' or '.join(names)}: "
            f"it has {self.listed(meant or self.faces)}; `dolfin-elastic look` draws them"
        )


def _is_round(face: CadFace, word: str, radius: float) -> bool:
    """A face of a kind or form, with a radius [m]."""
    words = (face.kind, face.form, "circle" if face.kind == "cylinder" else "")
    if face.radius is None or face.major is not None or word not in words:
        return False
    return abs(face.radius - radius) <= _SAME * radius


def chosen_faces(faces: CadFaces | None, selector: Selector, scale: float) -> set[int]:
    """Numbers of the faces that a selector names by number or kind.

    Args:
        faces: The faces; None: of a finished mesh.
        selector: One whose `by_face` is true.
        scale: Metres per unit of bare numbers.

    Raises:
        MeshError: There are none.
    """
    if faces is None or not faces.faces:
        raise MeshError(
            "this picks faces of a CAD file, but the mesh was not made of one",
            where=selector.by_face[0],
            expected="pick by plane and at, normal, box, or a sphere or cylinder with its position",
        )
    chosen = set(faces.faces)
    if selector.faces is not None:
        chosen = set(selector.faces)
        if unknown := sorted(chosen - set(faces.faces)):
            raise MeshError(
                f"there is no face {unknown[0]}",
                where="faces",
                expected=f"the file has the faces {_ranges(faces.faces)}",
            )
    for key, fits, distance in _tests(selector, scale):
        fitting = {number for number in chosen if fits(faces.faces[number])}
        if not fitting:
            near = sorted(chosen, key=lambda number: distance(faces.faces[number]))
            alike = [number for number in near if distance(faces.faces[number]) < _FAR] or near
            raise MeshError(
                "no face of the CAD file is like that",
                where=key,
                expected=f"the nearest are {faces.listed(alike)}",
            )
        chosen = fitting
    return chosen


_Test: TypeAlias = "tuple[str, Callable[[CadFace], bool], Callable[[CadFace], float]]"
"""Key, whether a face fits, and how far it is from fitting."""
_FAR = math.inf
"""How far a face of another kind is from fitting."""


def _tests(selector: Selector, scale: float) -> list[_Test]:
    tests: list[_Test] = []
    if selector.kind is not None:
        wanted = selector.kind
        tests.append(
            (
                "kind",
                lambda face: wanted in (face.kind, face.form),
                lambda face: 0.0 if face.kind != "plane" else _FAR,
            )
        )
    for kind, numbers, axis in _shapes(selector, scale):
        tests.append(_shape_test(kind, numbers, axis, selector, scale))
    return tests


_Shape = tuple[str, dict[str, float], tuple[float, ...]]
"""Kind, its numbers by attribute of `CadFace`, and its axis or nothing."""


def _shapes(selector: Selector, scale: float) -> list[_Shape]:
    """What the keys cylinder, sphere, cone and torus ask for."""
    shapes: list[_Shape] = []
    if (cylinder := selector.cylinder) is not None and cylinder.point is None:
        axis = cylinder.direction if cylinder.axis is not None else ()
        shapes.append(("cylinder", {"radius": metres(cylinder.radius, scale)}, axis))
    if (sphere := selector.sphere) is not None and sphere.center is None:
        shapes.append(("sphere", {"radius": metres(sphere.radius, scale)}, ()))
    if (cone := selector.cone) is not None:
        shapes.append(("cone", {} if cone.angle is None else {"angle": cone.angle}, ()))
    if (torus := selector.torus) is not None:
        given = {"radius": torus.radius, "major": torus.major}
        numbers = {key: metres(value, scale) for key, value in given.items() if value is not None}
        shapes.append(("torus", numbers, ()))
    return shapes


def _shape_test(
    kind: str,
    numbers: Mapping[str, float],
    axis: tuple[float, ...],
    selector: Selector,
    scale: float,
) -> _Test:
    near = None if selector.tolerance is None else metres(selector.tolerance, scale)
    allowed = {
        key: _SAME * value if near is None or key == "angle" else near
        for key, value in numbers.items()
    }

    def off(face: CadFace) -> float:
        """Largest difference of the numbers, over what is allowed."""
        own = {key: getattr(face, key) for key in numbers}
        if face.kind != kind or None in own.values():
            return _FAR
        away = [abs(own[key] - value) / allowed[key] for key, value in numbers.items()]
        # A wrong axis counts as a radius that is off by itself.
        if axis and not (face.axis and abs(float(np.dot(axis, face.axis))) >= np.cos(_ALONG)):
            away.append(1.0 / _SAME)
        return max(away, default=0.0)

    key = f"{kind}.{next(iter(numbers))}" if numbers else kind
    return key, lambda face: off(face) <= 1.0, off


def _ranges(numbers: Iterable[int]) -> str:
    """Numbers as "1 to 5, 8"."""
    parts: list[list[int]] = []
    for number in sorted(numbers):
        if parts and number == parts[-1][-1] + 1:
            parts[-1] = [parts[-1][0], number]
        else:
            parts.append([number])
    return ", ".join(" to ".join(map(str, part)) for part in parts)
