"""Sizes of elements in Gmsh: fields of smaller ones in places, and the default by curvature."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.formats.cad.faces import face_curvature
from dolfin_elastic.mesh.formats.cad.shapes import Lengths, diagonal

LocalField = Mapping[str, Any]
"""A place and the size there: see `set_sizes`."""
_GROWTH = 0.4
"""Growth of the size per length, away from a place: each cell is about 1.4 times the one before."""
_MOST_SAMPLES = 200
"""Along the diagonal, where distances from faces are measured."""

ROUND = 12
"""Elements round a whole circle: three on a quarter, as a fillet is.

With quadratic elements the largest stresses of four parts (a flange, a bracket, a shaft's shoulder
and a plate with a hole) were then within their estimated errors; with 8 they were off by up to 1.7
times that, with none by 3.1 times.
"""
_LARGEST, _SMALLEST = 1 / 10, 1 / 200
"""Sizes over the diagonal of the body."""
_MOST_CELLS = 300_000
_LAYERS = 20.0
"""Cells of a solid for each square of the size on a curved face: two triangles, and those around
and behind them while the size grows; 13 to 25 in the parts above."""
_STEP = 1.1
"""Factor by which the smallest size is raised until there are few enough cells."""
_PLAIN = ("Plane", "Line")


def set_sizes(
    gmsh: ModuleType, dim: int, local: Sequence[LocalField], *, whole: float, name: str
) -> None:
    """Lets the mesh that follows have smaller cells in places. Local.

    Source: Gmsh's reference manual, "Specifying mesh element sizes" and "Mesh size fields".

    Args:
        local: For each place its `size`, and `faces` or `bodies` (numbers), `sphere` (centre and
            radius) or `box` (smallest, then largest coordinates), in units of the model.
        whole: Size of all other cells, in units of the model.

    Raises:
        MeshError: The file has fields of its own.
    """
    field = gmsh.model.mesh.field
    if len(field.list()):
        raise MeshError(
            "the file has mesh size fields of its own, which mesh.refine would replace",
            where=name,
            expected="add the sizes to the fields of the .geo file",
        )
    fields = [_field(gmsh, dim, one, max(whole, float(one["size"]))) for one in local]
    least = field.add("Min")
    field.setNumbers(least, "FieldsList", fields)
    field.setAsBackgroundMesh(least)
    smallest = min(float(one["size"]) for one in local)
    before = gmsh.option.getNumber("Mesh.MeshSizeMin")
    gmsh.option.setNumber("Mesh.MeshSizeMin", min(before, smallest))


def _field(gmsh: ModuleType, dim: int, one: LocalField, whole: float) -> int:
    """The field of one place."""
    field, size = gmsh.model.mesh.field, float(one["size"])
    reach = (whole - size) / _GROWTH
    if faces := one.get("faces"):
        distance = field.add("Distance")
        field.setNumbers(distance, "SurfacesList" if dim == 3 else "CurvesList", faces)
        samples = min(math.ceil(2 * diagonal(gmsh) / size), _MOST_SAMPLES if dim == 3 else 10**5)
        field.setNumber(distance, "Sampling", samples)
        number = field.add("Threshold")
        numbers = {"InField": distance, "SizeMin": size, "SizeMax": whole}
        # The first two layers have the size; distances are exact to half of the samples' spacing.
        numbers |= {"DistMin": 2 * size, "DistMax": 2 * size + reach}
    elif bodies := one.get("bodies"):
        number = field.add("Constant")
        field.setNumbers(number, "VolumesList" if dim == 3 else "SurfacesList", bodies)
        numbers = {"VIn": size, "VOut": whole, "IncludeBoundary": 1}
    elif sphere := one.get("sphere"):
        number = field.add("Ball")
        numbers = dict(zip(("XCenter", "YCenter", "ZCenter", "Radius"), sphere, strict=True))
        numbers |= {"VIn": size, "VOut": whole, "Thickness": reach}
    else:
        number = field.add("Box")
        keys = ("XMin", "YMin", "ZMin", "XMax", "YMax", "ZMax")
        numbers = dict(zip(keys, one["box"], strict=True))
        numbers |= {"VIn": size, "VOut": whole, "Thickness": reach}
    for key, value in numbers.items():
        field.setNumber(number, key, value)
    return int(number)


# --- the default ---


@dataclass(frozen=True)
class DefaultSize:
    """The sizes between which the elements follow curved faces, in units of the model.

    Attributes:
        smallest: The smallest one; that of all others where the body has no curved faces.
        largest: The largest one.
        missed: Radius of the sharpest face that has fewer elements; None: there is none.
        raised: The smallest size is larger than usual, for there would be too many elements.
    """

    smallest: float
    largest: float
    missed: float | None = None
    raised: bool = False

    def text(self, lengths: Lengths) -> str:
        """The sizes in words: "default size, 1.2 mm to 12 mm, 12 elements round a circle"."""
        if self.smallest == self.largest:
            return f"default size, a tenth of the diagonal ({lengths.text(self.largest, 1)})"
        low, high = lengths.text(self.smallest, 1), lengths.text(self.largest, 1)
        return f"default size, {low} to {high}: {ROUND} elements round a circle"

    def notes(self, lengths: Lengths) -> list[str]:
        """What is doubtful about faces that are too sharp."""
        if self.missed is None:
            return []
        radius = self.smallest * ROUND / (2 * np.pi)
        size = lengths.text(2 * np.pi * self.missed / ROUND, 1)
        why = f"the smallest default size is {lengths.text(self.smallest, 1)}"
        if self.raised:
            why += f", or there would be more than {_MOST_CELLS} elements"
        return [
            f"curved faces of a radius below {lengths.text(radius, 1)} have fewer than {ROUND} "
            f"elements round a circle (the smallest radius is {lengths.text(self.missed, 1)}), "
            f"for {why}: a peak of stress on them is not resolved; mesh.refine with "
            f'size = "{size}" on those that matter resolves it'
        ]


def set_default_size(gmsh: ModuleType, dim: int) -> DefaultSize:
    """Lets the mesh that follows have sizes by curvature. Local.

    Source: Gmsh's reference manual, "Specifying mesh element sizes".

    Args:
        gmsh: Gmsh with a model for which nobody gives sizes.
    """
    faces = gmsh.model.getEntities(dim - 1)
    largest, smallest = _LARGEST * diagonal(gmsh), _SMALLEST * diagonal(gmsh)
    if all(gmsh.model.getType(*face) in _PLAIN for face in faces):
        return DefaultSize(largest, largest)
    curved = [f for f in faces if gmsh.model.getType(*f) not in _PLAIN] if dim == 3 else []
    areas, radii = _measured(gmsh, curved)
    while _cells(areas, radii, smallest, largest) > _MOST_CELLS and smallest * _STEP < largest:
        smallest *= _STEP
    sharp = radii[2 * np.pi * radii / ROUND < smallest]
    options = {
        "MeshSizeFromCurvature": ROUND,
        "MeshSizeMin": smallest,
        "MeshSizeMax": largest,
    }
    for name, value in options.items():
        gmsh.option.setNumber(f"Mesh.{name}", value)
    return DefaultSize(
        smallest,
        largest,
        float(sharp.min()) if len(sharp) else None,
        raised=smallest > _SMALLEST * diagonal(gmsh),
    )


def _measured(gmsh: ModuleType, faces: Sequence[tuple[int, int]]) -> tuple[FloatArray, FloatArray]:
    """Areas, and radii of the largest curvature, of the faces for which Gmsh knows both."""
    result = []
    for dim, tag in faces:
        curvature = face_curvature(gmsh, tag)
        try:
            area = float(gmsh.model.occ.getMass(dim, tag))
        except Exception:  # Gmsh's own error: a face of its own kernel
            continue
        if curvature > 0:
            result.append((area, 1 / curvature))
    areas, radii = np.array(result).reshape(-1, 2).T
    return areas, radii


def _cells(areas: FloatArray, radii: FloatArray, smallest: float, largest: float) -> float:
    """About how many cells the faces need."""
    size = np.clip(2 * np.pi * radii / ROUND, smallest, largest)
    return float(_LAYERS * (areas / size**2).sum())
