"""From the triangles of a file to the `Plc` that is filled: regions, patches and their names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.formats.surfaces.filling.bodies import region_volumes
from dolfin_elastic.mesh.formats.surfaces.filling.plc import OUTSIDE, Plc
from dolfin_elastic.mesh.formats.surfaces.mend import (
    Mended,
    mend,
    volume_as_it_stood,
    with_outlook,
)
from dolfin_elastic.mesh.formats.surfaces.nesting import containing
from dolfin_elastic.mesh.formats.surfaces.patches import ANGLE, MOST, patches
from dolfin_elastic.mesh.formats.surfaces.readers.read import read_soup
from dolfin_elastic.mesh.formats.surfaces.surface import (
    Fault,
    Surface,
    find_faults,
    turned_outwards,
)
from dolfin_elastic.mesh.formats.surfaces.topology import oriented

_SAME = 1e-9
"""Change of a volume, relative, that is round-off."""


@dataclass(frozen=True)
class Complex:
    """What is to be filled.

    Attributes:
        plc: The surface.
        notes, information: For the user.
    """

    plc: Plc
    notes: Sequence[str]
    information: Sequence[str]


def read_complex(
    path: Path, *, unit: LengthUnit, repair: bool = False, angle: float | None = None
) -> Complex:
    """Reads a closed surface of triangles. Local: one rank reads.

    Args:
        unit: Unit of its lengths, for messages.
        repair: Mends what is wrong, and notes that.
        angle: Between the normals of triangles, from which on an edge divides patches [degrees].

    Raises:
        MeshError: It is damaged, or the first fault of the surface, with its place.
    """
    surface, information = Surface.of(read_soup(path), path.name)
    angle = ANGLE if angle is None else angle
    notes: list[str] = []
    if repair:
        mended = mend(surface, path.name, unit)
        made = complex_of(mended.surface, angle)
        if mended.steps:
            before = volume_as_it_stood(surface)
            notes.append(_mended(mended, before, float(region_volumes(made.plc).sum()), unit))
    else:
        if faults := find_faults(surface):
            raise with_outlook(surface, faults, path.name)[0].error(path.name, unit)
        made = complex_of(turned_outwards(surface), angle)
    return replace(
        made,
        notes=[*notes, *made.notes],
        information=[*information, *made.information],
    )


def _mended(mended: Mended, before: float, after: float, unit: LengthUnit) -> str:
    """What mending has done to the body, whose volume it has changed."""
    change = (after - before) / after
    moved = (
        f"moved it by up to {unit.length(mended.distance * unit.metres)}"
        if mended.distance
        else "not moved it"
    )
    volume = f"changed the volume by {100 * change:+.2g} %" if abs(change) > _SAME else ""
    done = " and ".join(filter(None, (volume, moved)))
    return f"the surface has been mended: {', '.join(mended.steps)}; that has {done}"


def faults_of(path: Path) -> tuple[Surface, list[Fault]]:
    """The surface of a file, and all that is wrong with it. Local.

    Raises:
        MeshError: The file is damaged, or has no surface of a body.
    """
    surface, _ = Surface.of(read_soup(path), path.name)
    return surface, with_outlook(surface, find_faults(surface, all_of_them=True), path.name)


def complex_of(surface: Surface, angle: float) -> Complex:
    """Regions and patches of a closed surface whose shells face outwards. Local."""
    regions, region_names = _regions(surface)
    # The normal points out of the material: of the wall of a cavity, into the cavity.
    hollow = regions[:, 0] == OUTSIDE
    triangles = np.where(hollow[:, None], surface.triangles[:, ::-1], surface.triangles)
    regions = np.where(hollow[:, None], regions[:, ::-1], regions)
    used, rows = np.unique(triangles, return_inverse=True)
    points, triangles = surface.points[used], rows.reshape(-1, 3)
    _, label = np.unique(np.column_stack([regions, surface.groups]), axis=0, return_inverse=True)
    patch = patches(points, triangles, label.reshape(-1), angle)
    names, groups = _patch_names(patch, surface.groups, surface.names)
    information = [_count(len(triangles), region_names, names)]
    return Complex(
        Plc(points, triangles, regions, patch, region_names, names, groups), [], information
    )


def _count(triangles: int, regions: Sequence[str], names: Sequence[str]) -> str:
    bodies = f"{len(regions)} {'body' if len(regions) == 1 else 'bodies'}"
    unnamed = sum(not name for name in names)
    rest = (
        f", of which the {MOST} largest have names; a larger angle makes fewer" if unnamed else ""
    )
    patches = f"{len(names)} {'patch' if len(names) == 1 else 'patches'}"
    return f"{triangles} triangles, {bodies}, {patches} between sharp edges{rest}"


def _patch_names(
    patch: IntArray, groups: IntArray, names: Sequence[str]
) -> tuple[list[str], dict[str, list[int]]]:
    """Names of patches, and patches of each group that has several."""
    count = int(patch.max()) + 1
    group = np.zeros(count, dtype=np.int64)
    group[patch] = groups
    number = np.bincount(group, minlength=len(names))
    taken = set(names)
    result: list[str] = []
    numbers = iter(range(1, 2 * count + len(names) + 1))
    for k in range(count):
        name = names[group[k]]
        if name and number[group[k]] == 1:
            result.append(name)
        elif k >= MOST:
            result.append("")
        else:
            result.append(next(text for n in numbers if (text := f"patch {n}") not in taken))
    several = {
        names[g]: [int(k) for k in np.flatnonzero(group == g)]
        for g in np.flatnonzero(number > 1)
        if names[g]
    }
    return result, several


def _regions(surface: Surface) -> tuple[IntArray, list[str]]:
    """Regions behind and in front of each triangle, shape (m, 2), and their names.

    Shells of one solid that lie within an odd number of its others bound cavities; one within the
    material of another solid is embedded there.
    """
    shell, _ = oriented(surface.edges)
    count = int(shell.max()) + 1
    first = np.unique(shell, return_index=True)[1]
    solid = surface.solids[first]
    within = containing(surface.corners, shell, np.ones(count, dtype=bool))
    names: list[str] = []
    inside = np.full(count, OUTSIDE)
    for k in range(count):
        if (solid[within[k]] == solid[k]).sum() % 2 == 0:
            inside[k] = len(names)
            names.append(_name(surface, shell == k, int(first[k])))
    outside = np.full(count, OUTSIDE)
    for k in range(count):
        if len(within[k]):
            parent = max(within[k], key=lambda one: len(within[one]))
            outside[k] = inside[parent]
    return np.stack([inside[shell], outside[shell]], axis=1), names


def _name(surface: Surface, of: FloatArray, first: int) -> str:
    """Of a body: that of its solid, or of the group that its shell is."""
    if name := surface.solid_names[surface.solids[first]]:
        return name
    group = surface.groups[first]
    whole = bool((surface.groups[of] == group).all())
    return surface.names[group] if whole else ""
