"""Draws pictures: reads lines "a.npz<tab>...<tab>picture.png" and answers "drawn", or what failed.

Several files are drawn side by side.  A program of its own, started by `renderer.py`.
"""

from __future__ import annotations

import os
import sys
import warnings
from contextlib import suppress
from pathlib import Path

import numpy as np
import pyvista as pv
from PIL import Image
from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor
from vtkmodules.vtkRenderingCore import vtkActor2D, vtkPolyDataMapper2D

from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray
from dolfin_elastic.results.scene.colour_bar import ColourBar, colour_map
from dolfin_elastic.results.scene.edges import SHARP, silhouette
from dolfin_elastic.results.scene.labels import INK, curve_colour, labelled, shortened
from dolfin_elastic.results.scene.scene import (
    FILM,
    GREY,
    SIZE,
    Glyphs,
    Mark,
    Picture,
    load,
)

_GHOST = "#8a939c"
_MOST_NAMES, _LONGEST_NAME = 16, 16
_NO_VALUE, _LIMIT = "#c8c8c8", "#d1341f"
_VISIBLE = 2e-3
# Least length of the lines of a silhouette, deformed and not, over the body's diagonal.
_SHORT, _SHORT_OUTLINE = 0.6, 0.25
# Size of the line above the body, and how many letters of that size there is room for.
_HEADLINE, _LETTERS = 15, 85
# By how much the body is moved aside for what stands beside it.
_SHIFT = 0.12
# Share of the body's width right of which a text beside a point would run into the bar.
_BESIDE_BAR = 0.7
# Pixels between a point and the text beside it.
_ASIDE = 18
# Pixels between two of these texts.
_APART = 44
_AHEAD = 1e-3
"""Of lines before a plane body, and of obstacles behind it, over its diagonal."""
_FILM_LINE = 0.5
"""Width of a line of a film over that of a picture, which is drawn larger and made smaller."""
_BESIDE = 1.08
"""Room for obstacles over that for the body, up to what stands beside it."""
_FLAT = 1e-6
"""Difference of normals of one plane."""
_FLOOR, _SHADOW = 216, 120
"""Greys of a floor, and of the shadow where the body touches it."""
_FAINT = 0.25
"""Opacity of what is behind the body and has to be known of all the same."""


def triangulated(points: FloatArray, triangles: IntArray) -> pv.PolyData:
    """A surface of VTK."""
    return pv.PolyData(points, np.insert(triangles, 0, 3, axis=1).ravel())


def _add_body(plot: pv.Plotter, picture: Picture) -> pv.DataSetMapper:
    """Adds the body and its edges; returns the mapper of values to colours."""
    scene, moved = picture.scene, picture.moved
    mesh, flat = triangulated(moved, scene.triangles), scene.plane
    body = plot.add_mesh(
        mesh,
        **_colours(mesh, picture),
        smooth_shading=not flat,
        split_sharp_edges=not flat,
        feature_angle=SHARP,
        lighting=not flat,
        ambient=0.5,
        diffuse=0.52,
        specular=0.06,
        show_scalar_bar=False,
    )
    if picture.bar is not None and picture.bar.limit is not None:  # where it is reached
        limit = mesh.contour([picture.bar.limit], scalars="value")
        if limit.n_points:
            plot.add_mesh(limit, color=_LIMIT, line_width=6.0, lighting=False)
    _add_lines(plot, picture, moved, scene.edges, INK, 3.5)
    skin = scene.triangles if scene.skin is None else scene.triangles[scene.skin]
    back, size = picture.axes[2], scene.diagonal
    if not flat:
        least = _SHORT_OUTLINE * size
        _add_lines(plot, picture, moved, silhouette(moved, skin, back, least), INK, 3.0)
    if picture.outline and np.abs(moved - scene.points).max() > _VISIBLE * size:
        # Edges of the undeformed body; its surface would hide the deformed one or tint it.
        outline = scene.edges
        if not len(outline):
            outline = silhouette(scene.points, skin, back, _SHORT * size)
        _add_lines(plot, picture, scene.points, outline, _GHOST, 2.5)
    return body.mapper


def _colours(mesh: pv.PolyData, picture: Picture) -> dict[str, object]:
    scene, bar = picture.scene, picture.bar
    if bar is not None:
        mesh.point_data["value"] = picture.frame.values[picture.field] / bar.factor
        return {
            "scalars": "value",
            "cmap": colour_map(warm_first=bar.reversed),
            "clim": [bar.ticks[0], bar.ticks[-1]],
            "nan_color": _NO_VALUE,
        }
    if scene.patch is None:
        return {"color": GREY}
    colours = np.array([pv.Color(p.colour).int_rgb for p in scene.patches], dtype=np.uint8)
    mesh.cell_data["colour"] = colours[scene.patch]
    return {"scalars": "colour", "rgb": True, "preference": "cell"}


def _add_lines(
    plot: pv.Plotter, picture: Picture, x: FloatArray, pairs: IntArray, colour: str, width: float
) -> None:
    if len(pairs):
        x = x + _AHEAD * picture.scene.plane * picture.scene.diagonal * picture.axes[2]
        lines = pv.PolyData(x, lines=np.insert(pairs, 0, 2, axis=1).ravel())
        _draw_lines(plot, picture, lines, colour, width)


def _draw_lines(
    plot: pv.Plotter, picture: Picture, lines: pv.PolyData, colour: str, width: float
) -> None:
    wide = width * (_FILM_LINE if picture.film else 1.0)
    plot.add_mesh(lines, color=colour, line_width=wide, lighting=False, show_scalar_bar=False)


def _add_glyphs(plot: pv.Plotter, picture: Picture, glyphs: Glyphs) -> None:
    """Cones or arrows, and once more faintly in front of all: what is behind has to be known."""
    low, high = picture.seen
    # Where a parallel projection shows them at the same place.
    ahead = float(np.linalg.norm(high - low)) * picture.axes[2]
    size = picture.scene.diagonal
    begin, long = glyphs.ends(size)[:, 0], glyphs.length(size)
    form = pv.Arrow(tip_length=0.3, tip_radius=0.09, tip_resolution=24, shaft_radius=0.03)
    if not glyphs.load:
        form = pv.Cone(center=(0.5, 0, 0), direction=(1, 0, 0), radius=0.35, resolution=24)
    for shift, opacity in ((ahead, 1.0 if glyphs.inside else _FAINT), (0 * ahead, 1.0)):
        points = pv.PolyData(begin + shift)
        points["along"] = glyphs.along
        drawn = points.glyph(orient="along", scale=False, factor=long, geom=form)
        plot.add_mesh(drawn, color=glyphs.colour, ambient=0.4, diffuse=0.7, opacity=opacity)


def _add_text(plot: pv.Plotter, picture: Picture, mapper: pv.DataSetMapper) -> None:
    if picture.bar is not None:
        drawn = _add_bar(plot, picture.bar, mapper)
        if picture.bar.limit is not None:
            plot.render_window.Render()  # which lays the bar out
            _add_limit(plot, picture.bar, drawn)
    elif picture.scene.patch is not None:
        _add_legend(plot, picture)
    headline = _plain(picture.title)
    size = min(_HEADLINE, int(_HEADLINE * _LETTERS / max(len(headline), 1)))
    if headline:
        plot.add_text(headline, position=(0.03, 0.93), viewport=True, color=INK, font_size=size)


def _plain(text: str) -> str:
    """Text with `$` escaped, which VTK would take for a formula."""
    return text.replace("$", "\\$")


def _add_bar(plot: pv.Plotter, bar: ColourBar, mapper: pv.DataSetMapper) -> vtkScalarBarActor:
    drawn = plot.add_scalar_bar(
        mapper=mapper,
        title=bar.label + "\n",
        vertical=True,
        position_x=0.86,
        position_y=0.2,
        width=0.055,
        height=0.6,
        n_labels=len(bar.labels),
        fmt=bar.form if bar.labels == bar.ticks else "%.4g",
        color=INK,
        title_font_size=26,
        label_font_size=24,
    )
    drawn.SetUseCustomLabels(True)
    drawn.SetCustomLabels(pv.convert_array(np.asarray(bar.labels, dtype=float)))
    return drawn


def _add_limit(plot: pv.Plotter, bar: ColourBar, drawn: vtkScalarBarActor) -> None:
    """A line across a bar that has been laid out."""
    assert bar.limit is not None
    rect = [0, 0, 0, 0]
    drawn.GetScalarBarRect(rect, plot.renderer)
    (x, y, wide, high), (first, *_, last) = rect, bar.ticks
    at = y + high * (bar.limit - first) / (last - first)
    left, right, half = x - 12.0, x + wide, 3.0
    _add_rectangle(plot, (left, at - half), (right, at + half), _LIMIT)


def _add_legend(plot: pv.Plotter, picture: Picture) -> None:
    """A legend of the names of visible cells with their colours."""
    top, left, scene = 0.74, 0.84, picture.scene
    plot.add_text(
        picture.label, position=(left, top + 0.05), viewport=True, color=INK, font_size=13
    )
    patches = [scene.patches[i] for i in np.unique(scene.patches_of)]
    for row, patch in enumerate(patches[:_MOST_NAMES]):
        name = shortened(patch.names[0], _LONGEST_NAME)
        height = top - 0.04 * row
        _add_square(plot, (left, height + 0.004), patch.colour)
        plot.add_text(
            _plain(name), position=(left + 0.025, height), viewport=True, color=INK, font_size=11
        )
    if len(patches) > _MOST_NAMES:
        text = f"and {len(patches) - _MOST_NAMES} more"
        height = top - 0.04 * _MOST_NAMES
        plot.add_text(text, position=(left, height), viewport=True, color=INK, font_size=11)


def _add_square(plot: pv.Plotter, corner: tuple[float, float], colour: str) -> None:
    x, y = (share * size for share, size in zip(corner, plot.window_size, strict=True))
    _add_rectangle(plot, (x, y), (x + 22, y + 22), colour)


def _add_rectangle(
    plot: pv.Plotter, low: tuple[float, float], high: tuple[float, float], colour: str
) -> None:
    """A rectangle between two corners [pixels]."""
    corners = [(*low, 0.0), (high[0], low[1], 0.0), (*high, 0.0)]
    mapper = vtkPolyDataMapper2D()
    mapper.SetInputData(pv.Rectangle(corners))
    actor = vtkActor2D()
    actor.SetMapper(mapper)
    actor.GetProperty().SetColor(pv.Color(colour).float_rgb)
    plot.renderer.AddActor2D(actor)


def _aim(plot: pv.Plotter, picture: Picture) -> None:
    """Centres what is to be seen and scales it to the room left of the colour bar."""
    (low, high), axes = picture.seen, picture.axes
    centre = (low + high) / 2 @ axes
    depth = float(np.linalg.norm(high - low)) or 1.0
    plot.camera.focal_point = centre
    plot.camera.position = centre + 2 * depth * axes[2]
    plot.camera.up = axes[1]
    plot.enable_parallel_projection()
    aspect = np.array([plot.window_size[0] / plot.window_size[1], 1.0])
    plot.camera.parallel_scale = float(((high - low)[:2] / 2 / aspect / picture.room).max()) or 1.0
    plot.camera.SetWindowCenter(_SHIFT if picture.beside else 0.0, 0.0)
    plot.reset_camera_clipping_range()


def _add_obstacles(plot: pv.Plotter, picture: Picture) -> None:
    """Rigid obstacles, in grey that lets the body be seen, or behind a plane one."""
    plane, (right, up, back) = picture.scene.plane, picture.axes
    (low, high), half = picture.seen, plot.camera.parallel_scale
    room = half * np.array(picture.room) * [plot.window_size[0] / plot.window_size[1], 1.0]
    for obstacle in picture.scene.obstacles:
        mesh = triangulated(obstacle.points + obstacle.shift, obstacle.triangles)
        if picture.film and not plane and _seen_floor(mesh, picture):
            _add_floor(plot, picture, mesh)
            continue
        rims = mesh.extract_feature_edges(SHARP, boundary_edges=True)
        parts = [mesh, rims]
        for axis, middle, size in zip((right, up), (low + high) / 2, room, strict=False):
            if picture.beside:  # bar and headline are to be read
                end = (middle + _BESIDE * size) * axis
                parts = [one.clip(axis, end) if one.n_points else one for one in parts]
        mesh, rims = (one.translate(-_AHEAD * picture.scene.diagonal * back) for one in parts)
        # Seen from behind, as a plate from above, an obstacle would hide the body: edges only.
        if mesh.n_points:
            culling = {} if plane else {"culling": "back"}
            plot.add_mesh(mesh, color=obstacle.colour, opacity=0.5, lighting=not plane, **culling)
        if rims.n_points:
            _draw_lines(plot, picture, rims, _GHOST, 3.0 if plane else 2.0)


def _seen_floor(mesh: pv.PolyData, picture: Picture) -> bool:
    """Whether all triangles have one normal, to the camera: a plane without an end in films."""
    normals = np.asarray(mesh.face_normals)
    flat = bool(np.abs(normals - normals[0]).max() < _FLAT)
    return flat and bool(normals[0] @ picture.axes[2] > 0)  # from behind it would hide the body


def _add_floor(plot: pv.Plotter, picture: Picture, mesh: pv.PolyData) -> None:
    """A floor that fades into the background, with the body's shadow, dark where it touches."""
    points, size = picture.moved, picture.scene.diagonal
    normal, on = np.asarray(mesh.face_normals)[0], np.asarray(mesh.points)[0]
    gap = (points - on) @ normal
    foot = points - gap[:, None] * normal
    middle = foot.mean(axis=0)
    radii = size * np.array([1e-3, 1.2, 3.0])
    floor = pv.Disc(center=middle, inner=0.0, outer=radii[-1], normal=normal, r_res=24, c_res=72)
    far = np.linalg.norm(np.asarray(floor.points) - middle, axis=1)
    alpha = 255 * np.interp(far, radii[1:], [1.0, 0.0])
    grey = np.full((len(far), 3), _FLOOR)
    plot.add_mesh(
        floor, scalars=np.column_stack([grey, alpha]).astype(np.uint8), rgb=True, lighting=False
    )
    dark = np.interp(gap, [0.0, 0.4 * size], [_SHADOW, _FLOOR])
    # Of two points above each other the lower one makes the shade: it is lifted a little more.
    lifted = foot + 1e-3 * size * normal - 1e-4 * np.maximum(gap, 0.0)[:, None] * normal
    shadow = triangulated(lifted, picture.scene.triangles)
    shades = np.repeat(dark[:, None], 3, axis=1).astype(np.uint8)
    plot.add_mesh(shadow, scalars=shades, rgb=True, lighting=False)


def _add_marks(plot: pv.Plotter, picture: Picture) -> None:
    """Marks, of which the texts of two at about one height stand above each other."""
    heights = [mark.place @ picture.axes[1] for mark in picture.marks]
    pixel = 2 * plot.camera.parallel_scale / plot.window_size[1]
    for mark, height in zip(picture.marks, heights, strict=True):
        other = sum(heights) - height if len(heights) == 2 else -np.inf
        lift = max(0.0, _APART - abs(height - other) / pixel) / 2
        first = height > other or (height == other and mark is picture.marks[0])
        _add_mark(plot, picture, mark, lift if first else -lift)


def _add_mark(plot: pv.Plotter, picture: Picture, mark: Mark, lift: float) -> None:
    """A point at a value, the value beside it, and whether the body hides it.

    Args:
        lift: How far the text stands above the point [pixels].
    """
    # In front of all, where a parallel projection shows it at the same place.
    (low, high), (right, up, back) = picture.seen, picture.axes
    depth = float(np.linalg.norm(high - low))
    begin, end = (mark.place + ahead * depth * back for ahead in (1e-3, 2.0))
    hits, _ = triangulated(picture.moved, picture.scene.triangles).ray_trace(begin, end)
    text = _plain(mark.text) + (", behind" if len(hits) else "")
    left = bool((mark.place @ right - low[0]) / (high[0] - low[0]) > _BESIDE_BAR)
    for size, colour, ahead in ((20, "white", 0.9), (13, INK, 0.95)):
        place = (mark.place + ahead * depth * back)[None].astype(float)
        plot.add_mesh(
            pv.PolyData(place),
            color=colour,
            point_size=size,
            render_points_as_spheres=True,
            lighting=False,
        )
    pixel = 2 * plot.camera.parallel_scale / plot.window_size[1]
    beside = place[0] + pixel * ((-1 if left else 1) * _ASIDE * right + lift * up)
    label = plot.add_text(f" {text} ", position=(0.0, 0.0), color=INK, font_size=12)
    label.GetPositionCoordinate().SetCoordinateSystemToWorld()
    label.GetPositionCoordinate().SetValue(*beside)
    form = label.GetTextProperty()
    form.SetVerticalJustificationToCentered()
    if left:
        form.SetJustificationToRight()
    form.SetBackgroundColor(1.0, 1.0, 1.0)  # dark colours of the body would hide the letters
    form.SetBackgroundOpacity(0.85)


def _panel(plot: pv.Plotter, picture: Picture) -> AnyArray:
    """Pixels of a picture, shape (height, width, 3)."""
    plot.suppress_rendering = True  # until the scene is complete
    plot.clear()
    plot.hide_axes()  # those of an earlier picture are no actors, and stay
    plot.enable_lightkit()
    _aim(plot, picture)  # before the mark, whose text stands so many pixels beside it
    mapper = _add_body(plot, picture)
    for i, curve in enumerate(picture.scene.curves):
        if curve.named:
            ends = np.arange(3 * len(curve.pieces)).reshape(-1, 3)[:, [0, 1, 1, 2]].reshape(-1, 2)
            _add_lines(plot, picture, curve.pieces.reshape(-1, 3), ends, curve_colour(i), 7.0)
    for glyphs in picture.scene.glyphs:
        _add_glyphs(plot, picture, glyphs)
    _add_obstacles(plot, picture)
    _add_marks(plot, picture)
    if picture.beside:
        _add_text(plot, picture, mapper)
    if not picture.bare and not picture.scene.plane:
        plot.add_axes(color=INK, line_width=2, viewport=(0, 0, 0.16, 0.2))
    _aim(plot, picture)
    plot.suppress_rendering = False
    plot.render()
    return np.asarray(plot.screenshot(return_img=True))


def _patches(plot: pv.Plotter, picture: Picture) -> IntArray:
    """Number of the patch that each pixel shows, -1 for none, shape (height, width)."""
    plot.clear()
    scene = picture.scene
    mesh, number = triangulated(picture.moved, scene.triangles), scene.patches_of + 1
    codes = np.stack([number % 64 * 4 + 2, number // 64 % 64 * 4 + 2, number // 4096 * 4 + 2])
    mesh.cell_data["colour"] = codes.T.astype(np.uint8)
    plot.add_mesh(
        mesh, scalars="colour", rgb=True, preference="cell", lighting=False, show_scalar_bar=False
    )
    _aim(plot, picture)
    plot.render()
    image = np.asarray(plot.screenshot(return_img=True)).astype(np.int64)
    low = image // 4
    result = low[..., 0] + 64 * low[..., 1] + 4096 * low[..., 2]
    return np.where(image.sum(axis=2) == 0, -1, result - 1)


class Drawing:
    """One window for all pictures: a new one would compile its shaders again."""

    def __init__(self) -> None:
        self._plots: dict[bool, pv.Plotter] = {}
        self._codes: pv.Plotter | None = None

    def _plot(self, *, film: bool) -> pv.Plotter:
        if film not in self._plots:
            plot = pv.Plotter(off_screen=True, window_size=list(FILM if film else SIZE))
            plot.set_background("#f2f4f6", top="#ffffff")
            # Nobody sees four times the pixels of a frame that stands for a thirtieth of a second.
            plot.enable_anti_aliasing("fxaa" if film else "ssaa")
            self._plots[film] = plot
        return self._plots[film]

    def draw(self, pictures: list[Picture], target: Path) -> None:
        """Draws pictures side by side into a PNG file."""
        film = pictures[0].film
        images = [_panel(self._plot(film=film), one) for one in pictures]
        if pictures[0].legend is None:
            Image.fromarray(np.hstack(images)).save(target, compress_level=0 if film else 6)
            return
        if self._codes is None:
            self._codes = pv.Plotter(off_screen=True, window_size=list(SIZE))
            self._codes.disable_anti_aliasing()
            self._codes.render_window.SetMultiSamples(0)
            self._codes.set_background("#000000")
        codes = [_patches(self._codes, one) for one in pictures]
        labelled(pictures, images, codes, target)


def main() -> None:
    """Draws until its input ends."""
    # What libraries print goes to stderr: stdout carries the answers only.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    # Of what newer versions deprecate: where drawing fails, its last line is what users are told.
    warnings.simplefilter("ignore")
    drawing = Drawing()
    for line in sys.stdin:
        *sources, target = map(Path, line.rstrip("\n").split("\t"))
        answer = "drawn"
        try:
            drawing.draw([load(source) for source in sources], target)
        except OSError as error:
            answer = str(error)
        with suppress(BrokenPipeError):
            print(answer, file=answers, flush=True)
