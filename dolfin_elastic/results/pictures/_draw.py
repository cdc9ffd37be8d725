"""Draws pictures: reads lines "a.npz<tab>...<tab>picture.png" and writes "drawn" after each.

Several files are drawn side by side.

A program of its own, started by `renderer.py`; it imports nothing of this package, hence no MPI.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pyvista as pv
from matplotlib import colormaps
from matplotlib.colors import ListedColormap
from PIL import Image
from vtkmodules.vtkRenderingCore import vtkActor2D, vtkPolyDataMapper2D

_INK, _GHOST = "#303840", "#8a939c"
_NAMED = ("#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377", "#bbbbbb", "#ee8866")
_MOST_NAMES, _LONGEST_NAME = 16, 16
_SIZE = (1500, 1100)
_TURBO = (0.12, 0.9)
"""Part of the colour map: its ends are nearly black."""
_OBSTACLE, _NO_VALUE = "#aab4be", "#c8c8c8"
_SHARP = 35.0
_VISIBLE = 2e-3
_SHORT = 0.6
# Size of the line above the body, and how many letters of that size there is room for.
_HEADLINE, _LETTERS = 15, 85
# Shares of the picture's width and height that the body may fill, left of the scalar bar.
_ROOM, _SHIFT = (0.74, 0.8), 0.12
# The same where nothing stands beside it.
_BARE = (0.94, 0.94)
# Share of the body's width right of which a text beside a point would run into the bar.
_BESIDE_BAR = 0.7

Arrays: TypeAlias = Mapping[str, npt.NDArray[Any]]
"""Points, triangles, values and texts of a picture, as `pictures.Painter` writes them."""


def _surface(data: Arrays, *, deformed: bool) -> pv.PolyData:
    points = data["points"] + (float(data["scale"]) * data["u"] if deformed else 0.0)
    faces = np.insert(data["triangles"], 0, 3, axis=1)
    mesh = pv.PolyData(points, faces.ravel())
    if "names" not in data:
        mesh.point_data["value"] = data["value"]
    return mesh


def _edges(reference: pv.PolyData, points: pv.pyvista_ndarray) -> pv.PolyData:
    """Sharp edges of the undeformed body, drawn at other positions of its points."""
    reference = reference.copy()
    reference.point_data["number"] = np.arange(reference.n_points)
    edges = reference.extract_feature_edges(
        _SHARP, boundary_edges=True, non_manifold_edges=False, manifold_edges=False
    )
    if not edges.n_points:
        return edges
    edges = _without_short(edges, _SHORT * reference.length)
    if edges.n_points:
        edges.points = points[np.asarray(edges.point_data["number"])]
    return edges


def _without_short(edges: pv.PolyData, least: float) -> pv.PolyData:
    """Connected edges of at least this length: rounded bodies have short ones by chance."""
    edges = edges.connectivity()
    chains = np.asarray(edges.cell_data["RegionId"])
    lengths = np.asarray(edges.compute_cell_sizes(area=False, volume=False)["Length"])
    long = np.bincount(chains, lengths)[chains] >= least
    return edges.extract_cells(np.flatnonzero(long)).extract_geometry()


def _add_body(plot: pv.Plotter, data: Arrays) -> pv.DataSetMapper:
    """Adds the body and its edges; returns the mapper of values to colours."""
    reference, deformed = _surface(data, deformed=False), _surface(data, deformed=True)
    flat = bool(data["plane"])
    named = "names" in data
    body = plot.add_mesh(
        deformed,
        **(_by_name(deformed, data["value"]) if named else _by_value(data)),
        smooth_shading=not flat,
        split_sharp_edges=not flat,
        feature_angle=_SHARP,
        lighting=not flat,
        ambient=0.5,
        diffuse=0.52,
        specular=0.06,
        show_scalar_bar=False,
    )
    _add_lines(plot, _edges(reference, deformed.points), _INK, 3.5)
    if not flat:
        plot.add_silhouette(deformed, color=_INK, line_width=3.0, decimate=None)
    moved = np.abs(deformed.points - reference.points).max()
    if moved > _VISIBLE * reference.length and bool(data.get("outline", True)):
        _add_outline(plot, reference)
    return body.mapper


def _add_outline(plot: pv.Plotter, reference: pv.PolyData) -> None:
    """Edges of the undeformed body; its surface would hide the deformed one or tint it."""
    edges = _edges(reference, reference.points)
    if edges.n_points:
        _add_lines(plot, edges, _GHOST, 2.5)
    else:  # a rounded body
        plot.add_silhouette(reference, color=_GHOST, line_width=2.5, decimate=None)


def colour_map(*, warm_first: bool = False) -> ListedColormap:
    """Blue, green, yellow, red, none of them dark, so that edges and shades are seen on all.

    Args:
        warm_first: Small values are red.
    """
    shades = colormaps["turbo"](np.linspace(*_TURBO, 256))
    return ListedColormap(shades[::-1] if warm_first else shades)


def _by_value(data: Arrays) -> dict[str, object]:
    ticks = data["ticks"]
    colours = colour_map(warm_first=bool(data["reversed"]))
    return {
        "scalars": "value",
        "cmap": colours,
        "clim": [ticks[0], ticks[-1]],
        "nan_color": _NO_VALUE,
    }


def _by_name(mesh: pv.PolyData, numbers: npt.NDArray[np.int64]) -> dict[str, object]:
    colours = np.array([pv.Color(c).int_rgb for c in _NAMED], dtype=np.uint8)
    mesh.cell_data["colour"] = colours[np.asarray(numbers) % len(_NAMED)]
    return {"scalars": "colour", "rgb": True, "preference": "cell"}


def _add_lines(plot: pv.Plotter, lines: pv.PolyData, colour: str, width: float) -> None:
    if lines.n_points:
        plot.add_mesh(
            lines,
            color=colour,
            line_width=width,
            lighting=False,
            show_scalar_bar=False,
        )


def _add_text(plot: pv.Plotter, data: Arrays, mapper: pv.DataSetMapper) -> None:
    if _bare(data):
        return
    if "names" in data:
        _add_legend(plot, data)
    else:
        _add_bar(plot, data, mapper)
    headline = _plain(str(data["title"]))
    size = min(_HEADLINE, int(_HEADLINE * _LETTERS / max(len(headline), 1)))
    plot.add_text(headline, position=(0.03, 0.93), viewport=True, color=_INK, font_size=size)
    if not bool(data["plane"]):
        plot.add_axes(color=_INK, line_width=2, viewport=(0, 0, 0.16, 0.2))


def _bare(data: Arrays) -> bool:
    """Nothing stands beside the body."""
    return bool(data.get("bare", False))


def _plain(text: str) -> str:
    """Text with `$` escaped, which VTK would take for a formula."""
    return text.replace("$", "\\$")


def _add_bar(plot: pv.Plotter, data: Arrays, mapper: pv.DataSetMapper) -> None:
    bar = plot.add_scalar_bar(
        mapper=mapper,
        title=str(data["label"]) + "\n",
        vertical=True,
        position_x=0.86,
        position_y=0.2,
        width=0.055,
        height=0.6,
        n_labels=len(data["ticks"]),
        fmt=str(data["form"]),
        color=_INK,
        title_font_size=26,
        label_font_size=24,
    )
    bar.SetUseCustomLabels(True)
    bar.SetCustomLabels(pv.convert_array(np.asarray(data["ticks"], dtype=float)))


def _add_legend(plot: pv.Plotter, data: Arrays) -> None:
    """A legend of the names of visible cells with their colours."""
    top, left = 0.74, 0.84
    plot.add_text(
        str(data["label"]), position=(left, top + 0.05), viewport=True, color=_INK, font_size=13
    )
    numbers = np.unique(data["value"])
    for row, number in enumerate(numbers[:_MOST_NAMES]):
        name = str(data["names"][number])
        if len(name) > _LONGEST_NAME:
            name = name[: _LONGEST_NAME - 1] + "\u2026"
        height = top - 0.04 * row
        _add_square(plot, (left, height + 0.004), _NAMED[number % len(_NAMED)])
        plot.add_text(
            _plain(name), position=(left + 0.025, height), viewport=True, color=_INK, font_size=11
        )
    if len(numbers) > _MOST_NAMES:
        text = f"and {len(numbers) - _MOST_NAMES} more"
        height = top - 0.04 * _MOST_NAMES
        plot.add_text(text, position=(left, height), viewport=True, color=_INK, font_size=11)


def _add_square(plot: pv.Plotter, corner: tuple[float, float], colour: str) -> None:
    x, y = corner[0] * _SIZE[0], corner[1] * _SIZE[1]
    square = pv.Rectangle([(x, y, 0.0), (x + 22, y, 0.0), (x + 22, y + 22, 0.0)])
    mapper = vtkPolyDataMapper2D()
    mapper.SetInputData(square)
    actor = vtkActor2D()
    actor.SetMapper(mapper)
    actor.GetProperty().SetColor(pv.Color(colour).float_rgb)
    plot.renderer.AddActor2D(actor)


def _aim(plot: pv.Plotter, data: Arrays) -> None:
    """Centres what is to be seen and scales it to the room left of the colour bar."""
    axes = np.stack([data["right"], data["up"], data["back"]])
    low, high = data["window"]
    centre = (low + high) / 2 @ axes
    depth = float(np.linalg.norm(high - low)) or 1.0
    plot.camera.focal_point = centre
    plot.camera.position = centre + 2 * depth * data["back"]
    plot.camera.up = data["up"]
    plot.enable_parallel_projection()
    aspect = np.array([_SIZE[0] / _SIZE[1], 1.0])
    room, shift = (_BARE, 0.0) if _bare(data) else (_ROOM, _SHIFT)
    plot.camera.parallel_scale = float(((high - low)[:2] / 2 / aspect / room).max()) or 1.0
    plot.camera.SetWindowCenter(shift, 0.0)
    plot.reset_camera_clipping_range()


def _add_obstacles(plot: pv.Plotter, data: Arrays) -> None:
    """Rigid obstacles, in grey that lets the body be seen."""
    if "obstacle_points" not in data or not len(data["obstacle_points"]):
        return
    faces = np.insert(data["obstacle_triangles"], 0, 3, axis=1)
    mesh = pv.PolyData(data["obstacle_points"], faces.ravel())
    if bool(data["plane"]):
        _add_lines(plot, mesh.extract_feature_edges(boundary_edges=True), _GHOST, 4.0)
        return
    # Seen from behind, as a plate from above, an obstacle would hide the body: edges only.
    plot.add_mesh(mesh, color=_OBSTACLE, opacity=0.5, culling="back", show_scalar_bar=False)
    _add_lines(plot, mesh.extract_feature_edges(_SHARP, boundary_edges=True), _GHOST, 2.0)


def _add_mark(plot: pv.Plotter, data: Arrays) -> None:
    """A point at the largest value, and the value beside it, and whether the body hides it."""
    if "mark" not in data:
        return
    # In front of all, where a parallel projection shows it at the same place.
    depth = float(np.linalg.norm(data["window"][1] - data["window"][0]))
    begin, end = (data["mark"] + ahead * depth * data["back"] for ahead in (1e-3, 2.0))
    hits, _ = _surface(data, deformed=True).ray_trace(begin, end)
    text = _plain(str(data["mark_text"])) + (", behind" if len(hits) else "")
    across = (data["mark"] @ data["right"] - data["window"][0][0]) / np.ptp(data["window"][:, 0])
    left = bool(across > _BESIDE_BAR)
    for size, colour, ahead in ((20, "white", 0.9), (13, _INK, 0.95)):
        place = pv.PolyData((data["mark"] + ahead * depth * data["back"])[None].astype(float))
        plot.add_mesh(
            place, color=colour, point_size=size, render_points_as_spheres=True, lighting=False
        )
    plot.add_point_labels(
        place,
        [text + "  " if left else "  " + text],
        justification_horizontal="right" if left else "left",
        font_size=24,
        bold=False,
        text_color=_INK,
        show_points=False,
        always_visible=True,
        shape=None,
    )


def draw(plot: pv.Plotter, sources: Sequence[str], target: str) -> None:
    """Draws one picture.

    Args:
        plot: The window.
        sources: Files of arrays, as `pictures.Painter` writes them, drawn side by side.
        target: The PNG file.
    """
    panels = [_panel(plot, source) for source in sources]
    Image.fromarray(np.hstack(panels)).save(target)


def _panel(plot: pv.Plotter, source: str) -> npt.NDArray[np.uint8]:
    with np.load(source) as file:
        data = dict(file)
    plot.suppress_rendering = True  # until the scene is complete
    plot.clear()
    plot.enable_lightkit()
    _aim(plot, data)  # before the silhouette, which depends on the camera
    mapper = _add_body(plot, data)
    _add_obstacles(plot, data)
    _add_mark(plot, data)
    _add_text(plot, data, mapper)
    _aim(plot, data)
    plot.suppress_rendering = False
    plot.render()
    return np.asarray(plot.screenshot(return_img=True))


def plotter() -> pv.Plotter:
    """One window for all pictures: a new one would compile its shaders again."""
    plot = pv.Plotter(off_screen=True, window_size=list(_SIZE))
    plot.set_background("#f2f4f6", top="#ffffff")
    plot.enable_anti_aliasing("ssaa")
    return plot


def main() -> None:
    """Draws until its input ends."""
    # What libraries print goes to stderr: stdout carries the answers only.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    plot = plotter()
    for line in sys.stdin:
        *sources, target = line.rstrip("\n").split("\t")
        draw(plot, sources, target)
        with suppress(BrokenPipeError):
            print("drawn", file=answers, flush=True)
    plot.close()


if __name__ == "__main__":
    main()
