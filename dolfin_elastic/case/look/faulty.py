"""A picture of a surface of triangles that encloses no body, with its faults."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dolfin_elastic.case.case import Case
from dolfin_elastic.core.errors import DrawingError, InputError, MeshError, joined
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.core.units import METRE, LengthUnit
from dolfin_elastic.mesh.formats.surfaces.complex import faults_of
from dolfin_elastic.mesh.formats.surfaces.options import is_surface
from dolfin_elastic.mesh.formats.surfaces.surface import Fault, Surface
from dolfin_elastic.mesh.read import stated_unit_of
from dolfin_elastic.results.scene import series
from dolfin_elastic.results.scene.edges import sharp_edges
from dolfin_elastic.results.scene.renderer import RENDERER
from dolfin_elastic.results.scene.scene import Frame, Mark, Patch, Picture, Scene

_SOUND = "#dcdcdc"
_FAULTY = ("#d62728", "#9467bd", "#ff7f0e", "#17becf", "#8c564b")
_SAME = 1e-6
"""Distance over the size of the surface, up to which a place is that of a triangle."""
_MARKS = 2
"""Faults of which the first place is marked: texts of more would cover each other."""


def draw_faults(path: Path, case: Case | None, picture: Path) -> InputError | None:
    """Draws the surface that a file or a case names, where it has faults. On one rank.

    Returns:
        All faults of it, with the picture; None where it has none, or is no surface.
    """
    scale = None if case is None else case.mesh.metres
    file = path if case is None else case.folder / (case.mesh.file or "")
    if not is_surface(file):
        return None
    try:
        surface, faults = faults_of(file)
        unit = stated_unit_of(file) or METRE if scale is None else LengthUnit.of(scale)
    except MeshError:
        return None
    if not faults:
        return None
    errors: list[InputError] = [fault.error(file.name, unit) for fault in faults]
    scene = _scene(surface, faults, unit.metres)
    marks = tuple(Mark(f.places[0] * unit.metres, f.what) for f in faults[:_MARKS])
    legend = tuple((f.what, "", _FAULTY[k % len(_FAULTY)]) for k, f in enumerate(faults))
    shown = [
        Picture(scene, "isometric", "z", title=file.name, legend=legend, marks=marks, behind=behind)
        for behind in (False, True)
    ]
    try:
        series.draw_pictures(scene, shown, picture)
    except DrawingError:
        return joined(errors)
    finally:
        RENDERER.release(scene)
    errors[0] = MeshError(
        errors[0].what,
        where=errors[0].where,
        expected=f"{errors[0].expected}; the picture with their places is {picture}",
    )
    return joined(errors)


def _scene(surface: Surface, faults: list[Fault], metres: float) -> Scene:
    points = surface.points * metres
    patch: IntArray = np.zeros(len(surface.triangles), dtype=np.int64)
    for k, fault in reversed(list(enumerate(faults, start=1))):
        patch[_triangles(surface, fault.places)] = k
    patches = [Patch((), 0, _SOUND)]
    patches += [Patch((), 0, _FAULTY[k % len(_FAULTY)]) for k in range(len(faults))]
    used, rows = np.unique(patch, return_inverse=True)
    edges = sharp_edges(points, surface.triangles, rows.reshape(-1), np.zeros(len(patch), bool))
    return Scene(
        points,
        surface.triangles,
        edges,
        (Frame("", np.zeros_like(points)),),
        patch=rows.reshape(-1),
        patches=tuple(patches[k] for k in used),
    )


def _triangles(surface: Surface, places: FloatArray) -> IntArray:
    """Triangles of which the middle, or that of a side, is one of some places."""
    from scipy.spatial import cKDTree

    corners = surface.corners
    middles = [corners.mean(axis=1), *(corners[:, k] + corners[:, k - 1] for k in range(3))]
    middles[1:] = [one / 2 for one in middles[1:]]
    tree = cKDTree(np.concatenate(middles))
    near = tree.query_ball_point(places, _SAME * surface.size)
    found = np.array([row for rows in near for row in rows], dtype=np.int64)
    return np.unique(found % len(corners))
