"""Smaller cells in places: Gmsh's fields of sizes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.mesh.formats.cad.shapes import diagonal

LocalField = Mapping[str, Any]
"""A place and the size there: see `set_sizes`."""
_GROWTH = 0.4
"""Growth of the size per length, away from a place: each cell is about 1.4 times the one before."""
_MOST_SAMPLES = 200
"""Along the diagonal, where distances from faces are measured."""


def set_sizes(
    gmsh: ModuleType, dim: int, local: Sequence[LocalField], *, whole: float, name: str
) -> None:
    """Lets the mesh that follows have smaller cells in places. Local.

    Source: Gmsh's reference manual, "Specifying mesh element sizes" and "Mesh size fields".

    Args:
        gmsh: Gmsh with a model.
        dim: Of the body.
        local: For each place its `size`, and `faces` or `bodies` (numbers), `sphere` (centre and
            radius) or `box` (smallest, then largest coordinates), in units of the model.
        whole: Size of all other cells, in units of the model.
        name: Of the file.

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
        found = field.add("Threshold")
        numbers = {"InField": distance, "SizeMin": size, "SizeMax": whole}
        # The first two layers have the size; distances are exact to half of the samples' spacing.
        numbers |= {"DistMin": 2 * size, "DistMax": 2 * size + reach}
    elif bodies := one.get("bodies"):
        found = field.add("Constant")
        field.setNumbers(found, "VolumesList" if dim == 3 else "SurfacesList", bodies)
        numbers = {"VIn": size, "VOut": whole, "IncludeBoundary": 1}
    elif sphere := one.get("sphere"):
        found = field.add("Ball")
        numbers = dict(zip(("XCenter", "YCenter", "ZCenter", "Radius"), sphere, strict=True))
        numbers |= {"VIn": size, "VOut": whole, "Thickness": reach}
    else:
        found = field.add("Box")
        keys = ("XMin", "YMin", "ZMin", "XMax", "YMax", "ZMax")
        numbers = dict(zip(keys, one["box"], strict=True))
        numbers |= {"VIn": size, "VOut": whole, "Thickness": reach}
    for key, value in numbers.items():
        field.setNumber(found, key, value)
    return int(found)
