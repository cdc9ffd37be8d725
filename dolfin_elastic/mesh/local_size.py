"""`LocalSize`: smaller cells at surfaces, in regions, spheres and boxes.

    [mesh]
    refine = [{on = "fillet", size = "0.8 mm"}, {box = [[0, 0, 0], [5, 5, 5]], size = 1}]

Of a CAD file Gmsh makes them so; the cells of a finished mesh are divided (`refine/local.py`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
from pydantic import model_validator

from dolfin_elastic.core.errors import InputError, MeshError, nearest
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.shapes.box import Box
from dolfin_elastic.core.shapes.directions import vector_of
from dolfin_elastic.core.shapes.shapes import Point, Sphere
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import LengthUnit, Size, metres
from dolfin_elastic.mesh.criteria import BoundingBox, fulfilled, place_criteria
from dolfin_elastic.mesh.faces import CadFaces, chosen_faces
from dolfin_elastic.mesh.selectors import Selector

if TYPE_CHECKING:
    from dolfin_elastic.mesh.formats.cad.faces import CadFace
    from dolfin_elastic.mesh.formats.cad.sizes import LocalField

_ANGLE = 20.0
MOST_CELLS = 5e7
"""Cells beyond which a mesh is not refined: a size in another unit was meant."""
CELLS_A_SECOND = 2e4
"""Cells with sizes that differ that Gmsh makes in a second, at most: 3000 on one core were seen."""
_GRADED = {2: 2.5, 3: 1.25}
"""Layers with as many cells as those with which the size grows from a face to that of the body.

That is the integral of h^(d-1)/(h + 0.4 r)^d over the distance r, with `_GROWTH` of `cad/sizes.py`.
"""


class LocalSize(Record):
    """A size of cells somewhere.

    Attributes:
        on: Name of a surface or region, or several.
        sphere: All within it.
        box: Two opposite corners; all between them.
        size: Of the cells there.
    """

    on: str | list[str] | None = None
    sphere: Sphere | None = None
    box: tuple[Point, Point] | None = None
    size: Size

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        given = [key for key in ("on", "sphere", "box") if getattr(self, key)]
        if len(given) != 1:
            raise InputError(
                f"{' and '.join(given)} given together" if given else "no position is given",
                expected="expected exactly one of on, sphere, box",
            )
        if self.sphere is not None:
            self.sphere.check_placed("sphere")
        return self

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of its surfaces and regions."""
        return () if self.on is None else (self.on,) if isinstance(self.on, str) else (*self.on,)

    def shape(self, scale: float, dim: int, where: str) -> Sphere | Box:
        """Its sphere or box, in metres, where `where` is the key of this size. See `point_of`."""
        if self.sphere is not None:
            return self.sphere.selecting(scale, dim, f"{where}.sphere")
        assert self.box is not None
        return Box.between(self.box, scale, dim, f"{where}.box")

    def place(self) -> str:
        """The place in words."""
        if self.parts:
            return " and ".join(f"'{name}'" for name in self.parts)
        return "the sphere" if self.sphere is not None else "the box"

    def words(self, unit: LengthUnit) -> str:
        """Size and place in words."""
        return f"{metres(self.size, unit.metres) / unit.metres:.4g} {unit.name} at {self.place()}"


@dataclass(frozen=True)
class CadSizes:
    """Local sizes for a CAD file.

    Attributes:
        sizes: They.
        surfaces: Name to selectors, from which surfaces follow before there is a mesh.
    """

    sizes: Sequence[LocalSize] = ()
    surfaces: Mapping[str, Sequence[Selector]] | None = None

    def information(self, unit: LengthUnit) -> list[str]:
        """The sizes in words, if there are any."""
        words = [one.words(unit) for one in self.sizes]
        return [f"smaller elements: {', '.join(words)}"] if words else []

    def for_gmsh(
        self,
        faces: CadFaces,
        bodies: Mapping[str, Sequence[int]],
        model: float,
        seconds: float = math.inf,
    ) -> list[LocalField]:
        """The places as `formats/cad/sizes.py` takes them. Local.

        Args:
            bodies: Name of a body to its numbers.
            model: Metres per unit of length of Gmsh's model.
            seconds: Time that Gmsh may take [s].

        Raises:
            MeshError: A name does not exist, or stands for no whole faces; or there would be more
                cells than Gmsh can make.
        """
        unit = faces.unit.metres
        result: list[LocalField] = []
        for index, one in enumerate(self.sizes):
            try:
                places = self._places(one, faces, bodies, model)
            except MeshError as error:
                raise error.at(f"mesh.refine[{index}]") from None
            size = metres(one.size, unit) / model
            result += [{**place, "size": size} for place in places]
            for place in places:
                where = f"mesh.refine[{index}].size"
                _check_count(_count(place, size, faces, model), seconds, faces, where)
        return result

    def _places(
        self, one: LocalSize, faces: CadFaces, bodies: Mapping[str, Sequence[int]], model: float
    ) -> list[LocalField]:
        unit = faces.unit.metres

        def point(values: Sequence[float | str]) -> list[float]:
            return [*(metres(value, unit) / model for value in values), 0.0][:3]

        if one.sphere is not None:
            assert one.sphere.center is not None
            return [
                {"sphere": [*point(one.sphere.center), metres(one.sphere.radius, unit) / model]}
            ]
        if one.box is not None:
            a, b = (point(corner) for corner in one.box)
            corners = [*map(min, a, b), *map(max, a, b)]
            # A plane body has no thickness.
            return [
                {"box": corners if faces.dim == 3 else [*corners[:2], -1e9, *corners[3:5], 1e9]}
            ]
        places: list[LocalField] = []
        for name in one.parts:
            named = self._faces(name, faces)
            if named:
                places.append({"faces": sorted(named)})
            elif name in bodies:
                places.append({"bodies": list(bodies[name])})
            else:
                known = {*(self.surfaces or {}), *bodies, *_names(faces.faces.values())}
                raise MeshError(
                    f"there is no surface or region '{name}'",
                    where="on",
                    expected=f"{nearest(name, known)}; {faces.alike(name)}",
                )
        return places

    def _faces(self, name: str, faces: CadFaces) -> set[int]:
        """Faces that a surface consists of; empty: there is no such surface."""
        selectors = (self.surfaces or {}).get(name)
        if selectors is None:
            named = {n for n, face in faces.faces.items() if name in face.names}
            return named or set(faces.named(name))
        result: set[int] = set()
        for selector in selectors:
            result |= self._selected(name, selector, faces)
        return result

    def _selected(self, name: str, selector: Selector, faces: CadFaces) -> set[int]:
        unit = faces.unit.metres
        chosen = chosen_faces(faces, selector, unit) if selector.by_face else set(faces.faces)
        if selector.of is not None:
            chosen &= self._searched(name, selector.of, faces)
        every = _samples(faces)[:, : faces.dim]
        low, high = every.min(axis=0, initial=np.inf), every.max(axis=0, initial=-np.inf)
        space = BoundingBox(low, high, unit)
        chosen = {n for n in chosen if _fits(faces.faces[n], selector, space)}
        if not chosen:
            raise MeshError(
                f"the surface '{name}' is not a complete face of the CAD file, of which the size "
                "must be "
                "known before it is meshed",
                where="on",
                expected="give its faces in [surfaces], or a sphere or box here",
            )
        return chosen

    def _searched(self, name: str, of: str, faces: CadFaces) -> set[int]:
        """Faces of the part in which a surface is searched: one before it, or of the file."""
        every = list((self.surfaces or {}).items())
        before = dict(every[: [key for key, _ in every].index(name)])
        result = CadSizes(surfaces=before)._faces(of, faces)
        if not result:
            advice = nearest(of, {*before, *_names(faces.faces.values())})
            raise MeshError(
                f"the surface '{name}' is of '{of}', but no surface of that name stands before it",
                where="on",
                expected="; ".join(filter(None, (advice, faces.alike(of)))),
            )
        return result


NO_SIZES = CadSizes()
"""The same size everywhere."""


def _count(place: LocalField, size: float, faces: CadFaces, model: float) -> float:
    """About how many cells of a size there will be: one of edge h fills about h^3/8 (h^2/2).

    Args:
        place: As `CadSizes.for_gmsh` returns it; bodies count as nothing, and are left to Gmsh's
            limit of time.
        size: In units of the model, as the place.
        model: Metres per unit.
    """
    d = faces.dim
    if "faces" in place:
        areas = [faces.faces[number].area or 0.0 for number in place["faces"]]
        amount = (2.0 + _GRADED[d]) * size * sum(areas) / model ** (d - 1)  # two layers
    elif "sphere" in place:
        amount = Sphere(radius=place["sphere"][3]).volume(d)
    elif "box" in place:
        amount = Box(*np.split(np.array(place["box"]), 2)).volume(d)
    else:
        return 0.0
    if len(every := _samples(faces) / model):
        amount = min(amount, float(np.prod(np.ptp(every, axis=0)[:d])))
    return amount / size**d * (8 if d == 3 else 2)


def _check_count(count: float, seconds: float, faces: CadFaces, where: str) -> None:
    """Refuses more cells than Gmsh can make, in all or in its time [s]."""
    most = min(MOST_CELLS, CELLS_A_SECOND * seconds)
    if count <= most:
        return
    takes = f", for which Gmsh has {seconds:g} s (mesh.time_limit)" if most < MOST_CELLS else ""
    raise MeshError(
        f"there would be about {count:.2g} elements of this size",
        where=where,
        expected=f"at most {most:.2g}{takes}; lengths without a unit are in {faces.unit.name}",
    )


def _samples(faces: CadFaces) -> FloatArray:
    """Samples of all faces, shape (n, 3)."""
    return np.array([x for face in faces.faces.values() for x in face.samples]).reshape(-1, 3)


def _names(faces: Iterable[CadFace]) -> set[str]:
    return {name for face in faces for name in face.names}


def _fits(face: CadFace, selector: Selector, space: BoundingBox) -> bool:
    """Whether a whole face lies where a selector says, as far as its samples tell."""
    dim = len(space.low)
    x = np.array(face.samples).reshape(-1, 3)[:, :dim]
    tests = place_criteria(selector, space, x[:, None])
    if not len(x):  # nobody knows where it lies
        return not tests and selector.normal is None
    if not fulfilled(tests, len(x)).all():
        return False
    if selector.normal is None:
        return True
    n: FloatArray = np.array(face.normals).reshape(-1, 3)[:, :dim]
    n = n[np.linalg.norm(n, axis=1) > 0.5]
    wanted = np.array(vector_of(selector.normal)[:dim])
    cosine = n @ (wanted / np.linalg.norm(wanted))
    limit = np.cos(np.radians(selector.angle or _ANGLE))
    return len(n) > 0 and bool((cosine >= limit).all())
