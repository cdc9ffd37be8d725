"""Draws pictures: reads lines "a.npz<tab>...<tab>picture.png" and answers "drawn", or what failed.

Several files are drawn side by side.

A program of its own, started by `renderer.py`; it imports nothing of this package, hence no MPI.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pyvista as pv
from matplotlib import colormaps
from matplotlib.colors import ListedColormap
from PIL import Image
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
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
# Least length of connected edges, and of the lines of a silhouette, over the body's diagonal.
_SHORT, _SHORT_OUTLINE = 0.6, 0.25
# Edges are chance whose smooth pieces are shorter than this share of the diagonal, with such bends
# [degrees] between them, where the surface turns less than so many degrees at them.
_JAGGED, _BEND, _BLUNT = 0.1, 40.0, 60.0
_TURN = "turn"
# Distance from a clip plane of what lies in it, over the body's diagonal.
_IN_PLANE = 1e-5
# Size of the line above the body, and how many letters of that size there is room for.
_HEADLINE, _LETTERS = 15, 85
# Shares of the picture's width and height that the body may fill, left of the scalar bar.
_ROOM, _SHIFT = (0.74, 0.8), 0.12
# The same where nothing stands beside it.
_BARE = (0.94, 0.94)
# Share of the body's width right of which a text beside a point would run into the bar.
_BESIDE_BAR = 0.7
# Pixels between a point and the text beside it.
_ASIDE = 18

Array: TypeAlias = npt.NDArray[Any]
Arrays: TypeAlias = Mapping[str, Array]
"""Points, triangles, values and texts of a picture, as `pictures.Painter` writes them."""


def _triangulated(points: Array, triangles: Array) -> pv.PolyData:
    return pv.PolyData(points, np.insert(triangles, 0, 3, axis=1).ravel())


def _segments(points: Array, pairs: Array) -> pv.PolyData:
    """Lines between pairs of points; nothing without pairs."""
    if not len(pairs):
        return pv.PolyData()
    return pv.PolyData(points, lines=np.insert(pairs, 0, 2, axis=1).ravel())


def _chosen(edges: pv.PolyData, which: npt.NDArray[np.bool_]) -> pv.PolyData:
    return edges.extract_cells(np.flatnonzero(which)).extract_geometry()


def _normals(x: Array, t: Array) -> Array:
    """Normals of triangles, twice as long as their areas."""
    return np.cross(x[t[:, 1]] - x[t[:, 0]], x[t[:, 2]] - x[t[:, 0]])


def _unit(vectors: Array) -> Array:
    lengths = np.linalg.norm(vectors, axis=1)
    return np.asarray(vectors / np.maximum(lengths, np.finfo(float).tiny)[:, None])


def _surface(data: Arrays, *, deformed: bool) -> pv.PolyData:
    points = data["points"] + (float(data["scale"]) * data["u"] if deformed else 0.0)
    mesh = _triangulated(points, data["triangles"])
    if "names" not in data:
        mesh.point_data["value"] = data["value"]
    return mesh


def _lines(data: Arrays) -> pv.PolyData:
    """Sharp edges of the undeformed body, as clip planes leave them, and the rims of sections.

    The point data "u" is their displacement.
    """
    cut = "whole_points" in data
    body = _whole(data) if cut else _surface(data, deformed=False)
    if not cut:
        body.point_data["u"] = data["u"]
    edges = _sharp_edges(body)
    if not cut:
        return edges
    planes = _planes(data)
    parts = [edges, *(body.slice(normal, origin=origin) for normal, origin, _ in planes)]
    for i, (normal, origin, above) in enumerate(planes):
        for j, part in enumerate(parts):
            if j != i + 1 and part.n_cells:
                parts[j] = part.clip(normal, origin=origin, invert=above).extract_geometry()
    return _joined([*parts, _meetings(data)])


def _sharp_edges(body: pv.PolyData) -> pv.PolyData:
    """Edges where a surface ends or turns, with its point data, but none of a rounded body."""
    x, t = np.asarray(body.points, dtype=float), body.faces.reshape(-1, 4)[:, 1:]
    normals = _unit(_normals(x, t))
    sides, owner = _sides(t)
    same = (sides[1:] == sides[:-1]).all(axis=1)
    single = ~(np.append(same, False) | np.append(False, same))
    first = np.flatnonzero(same)
    cosine = np.einsum("ij,ij->i", normals[owner[first]], normals[owner[first + 1]])
    turns = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    sharp = turns > _SHARP
    edges = _segments(x, np.concatenate([sides[first[sharp]], sides[single]]))
    if not edges.n_cells:
        return edges
    edges.point_data["u"] = body.point_data["u"]
    edges.cell_data[_TURN] = np.concatenate([turns[sharp], np.full(single.sum(), 180.0)])
    edges = _without_short(edges, _SHORT * body.length)
    return _without_jagged(edges, _JAGGED * body.length) if edges.n_cells else edges


def _sides(t: Array) -> tuple[Array, Array]:
    """Sides of triangles as sorted pairs of points, equal ones in a row, and their triangles."""
    sides = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
    order = np.lexsort(sides.T)
    return sides[order], order % len(t)


def _without_jagged(edges: pv.PolyData, least: float) -> pv.PolyData:
    """Connected edges but for zigzags: those of coarse faces of a bend turn little, and often.

    Args:
        edges: From `_without_short`, with the angle by which the surface turns at each.
        least: Mean length of the straight or smooth pieces that zigzags stay below [m].
    """
    ends = edges.lines.reshape(-1, 3)[:, 1:]
    x = np.asarray(edges.points, dtype=float)
    ahead = x[ends[:, 1]] - x[ends[:, 0]]
    lengths = np.linalg.norm(ahead, axis=1)
    # At each point where two edges meet: are they one smooth line?
    points, of = ends.ravel(), np.repeat(np.arange(len(ends)), 2)
    outward = _unit(np.stack([ahead, -ahead], axis=1).reshape(-1, 3))
    order = np.argsort(points, kind="stable")
    _, start, count = np.unique(points[order], return_index=True, return_counts=True)
    one, other = order[start[count == 2]], order[start[count == 2] + 1]
    smooth = np.einsum("ij,ij->i", outward[one], outward[other]) < -np.cos(np.radians(_BEND))
    joint = coo_matrix(
        (np.ones(smooth.sum()), (of[one[smooth]], of[other[smooth]])), shape=(len(ends),) * 2
    )
    piece = connected_components(joint, directed=False)[1]
    piece_length = np.bincount(piece, lengths)[piece]
    chain = np.asarray(edges.cell_data["RegionId"])
    whole = np.bincount(chain, lengths)
    mean_length = np.bincount(chain, lengths * piece_length) / np.maximum(whole, 1e-300)
    turn = np.asarray(edges.cell_data[_TURN])
    mean_turn = np.bincount(chain, lengths * turn) / np.maximum(whole, 1e-300)
    kept = (mean_length >= least) | (mean_turn >= _BLUNT)
    return _chosen(edges, kept[chain])


def _whole(data: Arrays) -> pv.PolyData:
    """The surface of the undeformed body before it is cut."""
    body = _triangulated(np.asarray(data["whole_points"], dtype=float), data["whole_triangles"])
    body.point_data["u"] = data["whole_u"]
    return body


def _planes(data: Arrays) -> list[tuple[Array, Array, bool]]:
    """Normal and a point of each clip plane, and whether what is above it goes."""
    if "plane_normals" not in data:
        return []
    rows = zip(data["plane_normals"], data["plane_origins"], data["plane_above"], strict=True)
    return [(normal, origin, bool(above)) for normal, origin, above in rows]


def _in_planes(data: Arrays) -> npt.NDArray[np.bool_]:
    """Whether each point lies in each plane, shape (planes, points)."""
    x = np.asarray(data["points"], dtype=float)
    near = _IN_PLANE * float(np.linalg.norm(np.ptp(np.asarray(data["whole_points"]), axis=0)))
    return np.array([np.abs((x - at) @ n) < near for n, at, _ in _planes(data)])


def _meetings(data: Arrays) -> pv.PolyData:
    """Lines along which sections meet."""
    inside, t = _in_planes(data), np.asarray(data["triangles"])
    rows: list[Array] = [np.zeros((0, 2), dtype=np.int64)]
    for i in range(len(inside) - 1):
        sides, _ = _sides(t[inside[i][t].all(axis=1)])
        rows.append(sides[inside[i + 1 :][:, sides].all(axis=2).any(axis=0)])
    lines = _segments(np.asarray(data["points"], dtype=float), np.concatenate(rows))
    if lines.n_cells:
        lines.point_data["u"] = data["u"]
    return lines


def _joined(parts: Sequence[pv.PolyData]) -> pv.PolyData:
    some = [part for part in parts if part.n_cells]
    return some[0].append_polydata(*some[1:]) if len(some) > 1 else [*some, pv.PolyData()][0]


def _moved(lines: pv.PolyData, factor: float) -> pv.PolyData:
    """Lines at other positions of their points."""
    lines = lines.copy()
    if lines.n_points:
        lines.points = np.asarray(lines.points) + factor * np.asarray(lines.point_data["u"])
    return lines


def _silhouette(data: Arrays, least: float, *, deformed: bool) -> pv.PolyData:
    """Edges of the skin between faces that are seen from in front and from behind.

    Sections have none: their rims are drawn.  Where the surface is seen at a grazing angle, single
    flat faces turn away by chance; the short lines around them are left out.

    Args:
        least: Length of the shortest line, over the body's diagonal.
        deformed: Of the deformed body, not of the undeformed one.
    """
    mesh, t = _surface(data, deformed=deformed), np.asarray(data["triangles"])
    if "whole_points" in data:
        t = t[~_in_planes(data)[:, t].all(axis=2).any(axis=0)]
    x = np.asarray(mesh.points, dtype=float)
    ahead = _normals(x, t) @ data["back"] > 0
    sides, owner = _sides(t)
    turning = (sides[1:] == sides[:-1]).all(axis=1) & (ahead[owner[1:]] != ahead[owner[:-1]])
    lines = _segments(x, sides[1:][turning])
    return _without_short(lines, least * mesh.length) if lines.n_cells else lines


def _without_short(edges: pv.PolyData, least: float) -> pv.PolyData:
    """Connected edges of at least this length: rounded bodies have short ones by chance."""
    edges = edges.connectivity()
    chains = np.asarray(edges.cell_data["RegionId"])
    lengths = np.asarray(edges.compute_cell_sizes(area=False, volume=False)["Length"])
    long = np.bincount(chains, lengths)[chains] >= least
    return _chosen(edges, long)


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
    lines = _lines(data)
    _add_lines(plot, _moved(lines, float(data["scale"])), _INK, 3.5)
    if not flat:
        _add_lines(plot, _silhouette(data, _SHORT_OUTLINE, deformed=True), _INK, 3.0)
    moved = np.abs(deformed.points - reference.points).max()
    if moved > _VISIBLE * reference.length and bool(data.get("outline", True)):
        # Edges of the undeformed body; its surface would hide the deformed one or tint it.
        rounded = not lines.n_points
        outline = _silhouette(data, _SHORT, deformed=False) if rounded else lines
        _add_lines(plot, outline, _GHOST, 2.5)
    return body.mapper


def colour_map(*, warm_first: bool = False) -> ListedColormap:
    """Blue, green, yellow, red, none of them dark, so that edges and shades are seen on all."""
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
    mesh = _triangulated(data["obstacle_points"], data["obstacle_triangles"])
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
        place = (data["mark"] + ahead * depth * data["back"])[None].astype(float)
        plot.add_mesh(
            pv.PolyData(place),
            color=colour,
            point_size=size,
            render_points_as_spheres=True,
            lighting=False,
        )
    pixel = 2 * plot.camera.parallel_scale / _SIZE[1]
    beside = place[0] + (-1 if left else 1) * _ASIDE * pixel * data["right"]
    label = plot.add_text(f" {text} ", position=(0.0, 0.0), color=_INK, font_size=12)
    label.GetPositionCoordinate().SetCoordinateSystemToWorld()
    label.GetPositionCoordinate().SetValue(*beside)
    form = label.GetTextProperty()
    form.SetVerticalJustificationToCentered()
    if left:
        form.SetJustificationToRight()
    form.SetBackgroundColor(1.0, 1.0, 1.0)  # dark colours of the body would hide the letters
    form.SetBackgroundOpacity(0.85)


def draw(plot: pv.Plotter, sources: Sequence[str], target: str) -> None:
    """Draws one picture.

    Args:
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
    _aim(plot, data)  # before the mark, whose text stands so many pixels beside it
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
    # Of what newer versions deprecate: where drawing fails, its last line is what users are told.
    warnings.simplefilter("ignore")
    plot = plotter()
    for line in sys.stdin:
        *sources, target = line.rstrip("\n").split("\t")
        answer = "drawn"
        try:
            draw(plot, sources, target)
        except OSError as error:
            answer = str(error)
        with suppress(BrokenPipeError):
            print(answer, file=answers, flush=True)
    plot.close()


if __name__ == "__main__":
    main()
