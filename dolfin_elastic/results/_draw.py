"""Draws one picture: ``python _draw.py surface.npz picture.png``.

A program of its own, started by `pictures.py`; it imports nothing of this package, so no MPI.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pyvista as pv

_INK, _GHOST = "#303840", "#9aa4ae"
_SIZE = (1500, 1100)
_DIRECTIONS = {
    "isometric": (1.0, -1.25, 0.85),
    "x": (1, 0, 0),
    "y": (0, 1, 0),
    "z": (0, 0, 1),
    "-x": (-1, 0, 0),
    "-y": (0, -1, 0),
    "-z": (0, 0, -1),
}
_SHARP = 35.0
_VISIBLE = 2e-3
_SHORT = 0.6
# Shares of the picture's width and height that the body may fill, left of the scalar bar.
_ROOM, _SHIFT = (0.74, 0.8), 0.12


def _surface(data: Any, *, deformed: bool) -> pv.PolyData:
    points = data["points"] + (float(data["scale"]) * data["u"] if deformed else 0.0)
    faces = np.insert(data["triangles"], 0, 3, axis=1)
    mesh = pv.PolyData(points, faces.ravel())
    mesh.point_data["value"] = data["value"]
    return mesh


def _edges(reference: pv.PolyData, points: Any) -> pv.PolyData:
    """Sharp edges of the undeformed body, carried to other places of its points."""
    reference = reference.copy()
    reference.point_data["number"] = np.arange(reference.n_points)
    edges = reference.extract_feature_edges(
        _SHARP, boundary_edges=True, non_manifold_edges=False, manifold_edges=False
    )
    if not edges.n_points:
        return edges
    edges = _long(edges, _SHORT * reference.length)
    if edges.n_points:
        edges.points = points[np.asarray(edges.point_data["number"])]
    return edges


def _long(edges: pv.PolyData, least: float) -> pv.PolyData:
    """Connected edges of some length: the scraps that a rounded body has are left out."""
    edges = edges.connectivity()
    chains = np.asarray(edges.cell_data["RegionId"])
    lengths = np.asarray(edges.compute_cell_sizes(area=False, volume=False)["Length"])
    kept = np.bincount(chains, lengths)[chains] >= least
    return edges.extract_cells(np.flatnonzero(kept)).extract_geometry()


def _add_body(plot: pv.Plotter, data: Any) -> Any:
    """Adds the body and its edges; returns what maps values to colours."""
    reference, deformed = _surface(data, deformed=False), _surface(data, deformed=True)
    flat = bool(data["plane"])
    body = plot.add_mesh(
        deformed,
        scalars="value",
        cmap="viridis",
        smooth_shading=not flat,
        split_sharp_edges=not flat,
        feature_angle=_SHARP,
        lighting=not flat,
        ambient=0.4,
        diffuse=0.62,
        specular=0.06,
        show_scalar_bar=False,
    )
    _add_lines(plot, _edges(reference, deformed.points), _INK, 3.5, 1.0)
    moved = np.abs(deformed.points - reference.points).max()
    if moved > _VISIBLE * reference.length:
        behind = [0.0, 0.0, -1e-3 * reference.length if flat else 0.0]
        plot.add_mesh(
            reference.translate(behind),
            color=_GHOST,
            opacity=0.1,
            lighting=False,
            show_scalar_bar=False,
        )
        _add_lines(plot, _edges(reference, reference.points), _GHOST, 3.0, 1.0)
    return body.mapper


def _add_lines(
    plot: pv.Plotter, lines: pv.PolyData, colour: str, width: float, opacity: float
) -> None:
    if lines.n_points:
        plot.add_mesh(
            lines,
            color=colour,
            line_width=width,
            opacity=opacity,
            lighting=False,
            show_scalar_bar=False,
        )


def _add_text(plot: pv.Plotter, data: Any, mapper: Any) -> None:
    plot.add_scalar_bar(
        mapper=mapper,
        title=str(data["label"]) + "\n",
        vertical=True,
        position_x=0.86,
        position_y=0.2,
        width=0.055,
        height=0.6,
        n_labels=6,
        fmt="%.3g",
        color=_INK,
        title_font_size=26,
        label_font_size=24,
    )
    if str(data["title"]):
        plot.add_text(
            str(data["title"]), position=(0.03, 0.93), viewport=True, color=_INK, font_size=15
        )
    if not bool(data["plane"]):
        plot.add_axes(color=_INK, line_width=2, viewport=(0, 0, 0.16, 0.2))


def _aim(plot: pv.Plotter, data: Any) -> None:
    direction = np.array(_DIRECTIONS[str(data["view"])], dtype=float)
    up = (0, 1, 0) if abs(direction[2]) == np.linalg.norm(direction) else (0, 0, 1)
    plot.view_vector(direction, viewup=up)
    plot.enable_parallel_projection()
    _fill(plot, data)
    plot.camera.SetWindowCenter(_SHIFT, 0.0)


def _fill(plot: pv.Plotter, data: Any) -> None:
    """Centres what is seen of the body and makes it as large as there is room."""
    ahead = np.array(plot.camera.direction)
    right = np.cross(ahead, plot.camera.up)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, ahead)])
    points = np.vstack([data["points"], data["points"] + float(data["scale"]) * data["u"]])
    seen = points @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    centre = np.array(plot.camera.focal_point)
    offset = ((low + high) / 2 - axes @ centre) @ axes
    plot.camera.focal_point = centre + offset
    plot.camera.position = np.array(plot.camera.position) + offset
    aspect = np.array([_SIZE[0] / _SIZE[1], 1.0])
    plot.camera.parallel_scale = float(((high - low) / 2 / aspect / _ROOM).max())
    plot.reset_camera_clipping_range()


def main(source: str, target: str) -> None:
    """Draws what is in the file `source` into the file `target`."""
    data = np.load(source)
    plot = pv.Plotter(off_screen=True, window_size=list(_SIZE))
    plot.set_background("#f2f4f6", top="#ffffff")
    plot.enable_anti_aliasing("ssaa")
    mapper = _add_body(plot, data)
    _add_text(plot, data, mapper)
    _aim(plot, data)
    plot.screenshot(target)
    plot.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
