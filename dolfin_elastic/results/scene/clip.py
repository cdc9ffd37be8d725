"""Planes that take away a part of a drawn body, and the sections that are seen then.

Rank 0 alone; what is cut is the surface, and the cells that the planes run through.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.compat import surface_of
from dolfin_elastic.core.startup.elsewhere import elsewhere
from dolfin_elastic.core.types import AnyArray, BoolArray, FloatArray, IntArray
from dolfin_elastic.results.scene.edges import sharp_edges, sides
from dolfin_elastic.results.scene.scene import axes_of
from dolfin_elastic.results.scene.surface import Surface

if TYPE_CHECKING:
    import pyvista

_ASIDE = 1e-6
"""Distance of a section from where it is asked for, over the body's length."""
_SLIVER = 1e-5
"""Distance of points of a section that are one, over the body's length."""
_IN_PLANE = 1e-5
"""Distance from a clip plane of what lies in it, over the body's length."""
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


def clipped(
    surface: Surface, cells: Surface | None, clips: Sequence[Clip], view: str, up: str = "z"
) -> Surface:
    """A surface as planes leave it, with its sections and edges; without triangles if all goes.

    Edges are found on the whole surface, and the rims of sections where the planes cut that:
    triangles of sections have corners and gaps by chance, which are no edges of the body.

    Args:
        surface: Its values have the displacement "u".
        cells: Those that the planes cut, or all, as `gather_cells` gives them; None of a plane
            body, which has no sections.
        view: See `scene.View`.
        up: Axis that is up.
    """
    edges = sharp_edges(surface.points, surface.triangles)
    if not clips:
        return replace(surface, edges=edges)
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
    planes, length = _planes(skin.length, clips, view, up), skin.length
    cuts = [
        inside.slice(n, origin=x).triangulate() if inside.n_cells else inside for n, x, _ in planes
    ]
    parts = [surface_of(one).triangulate() for one in _left([skin, *cuts], planes) if one.n_cells]
    parts = [_without_slivers(part, _SLIVER * length) for part in parts]
    first, *others = [part for part in parts if part.n_cells] or [pv.PolyData()]
    left = first.append_polydata(*others) if others else first
    if not left.n_cells:
        none = np.zeros((0, 3))
        return Surface(none.astype(np.int64), none, dict.fromkeys(surface.values, none))
    x, t = np.asarray(left.points, dtype=float), left.faces.reshape(-1, 4)[:, 1:].astype(np.int64)
    in_plane = np.array([np.abs((x - at) @ n) < _IN_PLANE * length for n, at, _ in planes])
    lines = skin.copy()
    lines.faces, lines.lines = np.empty(0, dtype=int), np.insert(edges, 0, 2, axis=1).ravel()
    rims = _left([lines, *(skin.slice(n, origin=at) for n, at, _ in planes)], planes)
    rims = [rim.extract_geometry() for rim in rims if rim.n_cells]
    starts = len(x) + np.cumsum([0, *(rim.n_points for rim in rims)])
    pairs = [rim.lines.reshape(-1, 3)[:, 1:] + at for rim, at in zip(rims, starts, strict=False)]
    drawn = [left, *rims]
    return Surface(
        t,
        np.concatenate([np.asarray(one.points, dtype=float) for one in drawn]),
        {k: np.concatenate([_columns(one.point_data[k]) for one in drawn]) for k in surface.values},
        None if surface.of_cells is None else np.asarray(left.cell_data[_OF_CELLS]),
        np.concatenate(
            [np.asarray(left.point_data[_NODES]) > _WHOLE, np.zeros(int(starts[-1]) - len(x), bool)]
        ),
        np.concatenate([_meetings(t, in_plane), *pairs]).astype(np.int64),
        np.asarray(~in_plane[:, t].all(axis=2).any(axis=0)),
    )


def _left(
    parts: Sequence[pyvista.DataSet], planes: Sequence[tuple[FloatArray, FloatArray, bool]]
) -> list[pyvista.DataSet]:
    """What planes leave of a surface, and of what lies in each of them."""
    result = list(parts)
    for i, (normal, origin, above) in enumerate(planes):
        for j, part in enumerate(result):
            if j != i + 1 and part.n_cells:
                result[j] = part.clip(normal=normal, origin=origin, invert=above)
    return result


def _meetings(t: IntArray, in_plane: BoolArray) -> IntArray:
    """Lines along which sections meet, as pairs of points."""
    rows: list[IntArray] = [np.zeros((0, 2), dtype=np.int64)]
    for i in range(len(in_plane) - 1):
        pairs = sides(t[in_plane[i][t].all(axis=1)])[0]
        rows.append(pairs[in_plane[i + 1 :][:, pairs].all(axis=2).any(axis=0)])
    return np.concatenate(rows)


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


def _attach(data: pyvista.DataSet, surface: Surface) -> None:
    for name, values in surface.values.items():
        data.point_data[name] = values
    nodes = np.ones(data.n_points) if surface.nodes is None else surface.nodes.astype(float)
    data.point_data[_NODES] = nodes
    if surface.of_cells is not None:
        data.cell_data[_OF_CELLS] = surface.of_cells


def _columns(values: AnyArray) -> AnyArray:
    result = np.asarray(values, dtype=float)
    return result[:, None] if result.ndim == 1 else result
