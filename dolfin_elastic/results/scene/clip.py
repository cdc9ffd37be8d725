"""Planes that take away a part of a drawn body, and the sections that are seen then.

Rank 0 alone; what is cut is the surface, and the cells that the planes run through.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.compat import surface_of
from dolfin_elastic.core.startup.elsewhere import elsewhere
from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.results.scene.scene import Scene, axes_of
from dolfin_elastic.results.scene.surface import Surface

if TYPE_CHECKING:
    import pyvista

_ASIDE = 1e-6
"""Distance of a section from where it is asked for, over the body's length."""
_SLIVER = 1e-5
"""Distance of points of a section that are one, over the body's length."""
_OF_CELLS, _NODES = "of_cells", "nodes"
_WHOLE = 1 - 1e-9


@dataclass(frozen=True)
class Clip:
    """A plane that takes away what lies beyond it.

    Attributes:
        axis: Number of the axis.
        at: Coordinate of the plane in the undeformed body [m].
        above: What is above it goes, or what is below; None: what is nearer to the camera.
    """

    axis: int
    at: float
    above: bool | None = None

    def takes_above(self, view: str, up: str = "z") -> bool:
        """Whether what is above it goes.

        Args:
            view: See `scene.View`.
            up: Axis that is up.
        """
        return bool(axes_of(view, up)[0][self.axis] >= 0) if self.above is None else self.above


def sections(
    surface: pyvista.PolyData,
    cells: pyvista.DataSet,
    clips: Sequence[Clip],
    view: str,
    up: str = "z",
) -> pyvista.PolyData:
    """What planes leave of a surface, with the sections; of triangles, without any if all goes.

    Args:
        cells: Those that the planes cut, or all of them.
        view: See `scene.View`.
        up: Axis that is up.
    """
    parts = [surface]
    planes = _planes(surface.length, clips, view, up)
    for normal, origin, _ in planes:
        parts.append(cells.slice(normal, origin=origin).triangulate() if cells.n_cells else cells)
    for i, (normal, origin, above) in enumerate(planes):
        for j, part in enumerate(parts):
            if j != i + 1 and part.n_cells:
                left = part.clip(normal=normal, origin=origin, invert=above)
                parts[j] = surface_of(left).triangulate()
    parts = [_without_slivers(part, _SLIVER * surface.length) for part in parts if part.n_cells]
    first, *others = [part for part in parts if part.n_cells] or [surface.__class__()]
    return first.append_polydata(*others) if others else first


def _planes(
    length: float, clips: Sequence[Clip], view: str, up: str
) -> list[tuple[FloatArray, FloatArray, bool]]:
    """Normal and a point of each plane, and whether what is above it goes."""
    # Nodes that lie in the plane would give sections without an area.
    aside = _ASIDE * length
    return [
        (np.eye(3)[c.axis], (c.at + aside) * np.eye(3)[c.axis], c.takes_above(view, up))
        for c in clips
    ]


def whole_scene(
    points: FloatArray,
    triangles: AnyArray,
    u: FloatArray,
    clips: Sequence[Clip],
    view: str,
    up: str = "z",
) -> Scene:
    """What the drawing process is told of a body before it is cut.

    Its edges are found on the whole surface, and the rims of sections where the planes cut that:
    triangles of sections have corners and gaps by chance, which are no edges of the body.

    Args:
        points: Of the whole surface [m], shape (n, 3).
        triangles: Of it, shape (m, 3).
        u: Displacement of its points [m], shape (n, 3).
        view: See `scene.View`.
        up: Axis that is up.
    """
    if not clips:
        return {}
    length = float(np.linalg.norm(np.ptp(points, axis=0)))
    normals, origins, above = zip(*_planes(length, clips, view, up), strict=True)
    return {
        "whole_points": points,
        "whole_triangles": triangles,
        "whole_u": u,
        "plane_normals": np.array(normals),
        "plane_origins": np.array(origins),
        "plane_above": np.array(above),
    }


def _without_slivers(part: pyvista.PolyData, size: float) -> pyvista.PolyData:
    """A part without triangles of no width, of which points so close are made one.

    A plane that runs by a node or an edge cuts the cells around it in triangles whose normals are
    round-off, more so where the body is deformed: they would darken what is shaded beside them, and
    be outlined as if the surface turned there.

    Args:
        size: Distance of points that are one, and least height of a triangle [m].
    """
    part = part.clean(tolerance=size, absolute=True, lines_to_points=False, polys_to_lines=False)
    if not part.n_cells:
        return part
    a, b, c = np.moveaxis(part.points[part.faces.reshape(-1, 4)[:, 1:]].astype(float), 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.max([np.linalg.norm(side, axis=1) for side in (b - a, c - b, a - c)], axis=0)
    wide = area > size * longest
    return part if wide.all() else surface_of(part.extract_cells(np.flatnonzero(wide)))


def clipped(
    surface: Surface, cells: Surface | None, clips: Sequence[Clip], view: str, up: str = "z"
) -> Surface:
    """A gathered surface as planes leave it.

    Args:
        surface: From `gather_surface`.
        cells: From `gather_cells`; None of a plane body, which has no sections.
        view: See `scene.View`.
        up: Axis that is up.
    """
    with elsewhere():
        import pyvista as pv

    skin = pv.PolyData(surface.points, np.insert(surface.triangles, 0, 3, axis=1).ravel())
    _attach(skin, surface)
    inside = pv.UnstructuredGrid()
    if cells is not None and len(cells.triangles):
        nodes = cells.triangles.shape[1]
        kind = pv.CellType.TETRA if nodes == 4 else pv.CellType.QUADRATIC_TETRA
        rows = np.insert(cells.triangles, 0, nodes, axis=1).ravel()
        inside = pv.UnstructuredGrid(rows, np.full(len(cells.triangles), kind), cells.points)
        _attach(inside, cells)
    left = sections(skin, inside, clips, view, up)
    if not left.n_cells:
        none = np.zeros((0, 3))
        return Surface(none.astype(np.int64), none, dict.fromkeys(surface.values, none))
    return Surface(
        left.faces.reshape(-1, 4)[:, 1:].astype(np.int64),
        np.asarray(left.points, dtype=float),
        {k: _columns(left.point_data[k]) for k in surface.values},
        None if surface.of_cells is None else np.asarray(left.cell_data[_OF_CELLS]),
        np.asarray(left.point_data[_NODES]) > _WHOLE,
    )


def _attach(data: pyvista.DataSet, surface: Surface) -> None:
    for name, values in surface.values.items():
        data.point_data[name] = values
    nodes = np.ones(data.n_points) if surface.nodes is None else surface.nodes.astype(float)
    data.point_data[_NODES] = nodes
    if surface.of_cells is not None:
        data.cell_data[_OF_CELLS] = surface.of_cells


def _columns(values: AnyArray) -> AnyArray:
    found = np.asarray(values, dtype=float)
    return found[:, None] if found.ndim == 1 else found
