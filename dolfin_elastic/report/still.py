"""Pictures of a scene by matplotlib: for paper, and where a viewer of mail runs no scripts.

They need no graphics card and no X server: what the body hides is found here (`depth.py`).  Their
colours are those of the pictures of a run.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.startup.elsewhere import plain_matplotlib
from dolfin_elastic.core.types import AnyArray, BoolArray, FloatArray
from dolfin_elastic.report.depth import Window, look
from dolfin_elastic.report.scene import Marks, Scene, Shown
from dolfin_elastic.results.scene.scene import SMALL_MATTERS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH, _HEIGHT, _DPI = 6.6, 4.7, 150
"""Inches of the room for the body, and pixels per inch."""
_BAR, _LEAST = 1.4, 2.2
"""Inches of the colour bar with its labels, and of the smallest side of a picture."""
_FINER = 2
"""Pixels that are computed along each side of a pixel of the picture."""
_MARGIN = 0.06
_GREY = np.array([0.74, 0.77, 0.80])
_EYE = np.array([0.62, -0.78, 0.5])
_INK = "#20262c"
_DEPTH = 3e-3
"""By how much of the body's size a surface may be nearer than a line that is seen on it."""
_LINE = 20
"""Letters in a line above the colour bar."""
_FAINT = 0.25
"""Opacity of what is behind the body and has to be known of all the same."""


def colour_table(*, warm_first: bool = False) -> AnyArray:
    """The colours of values as in the pictures of a run, shape (256, 4), uint8."""
    from dolfin_elastic.results.scene._draw import colour_map

    shades = colour_map(warm_first=warm_first)(np.arange(256))
    return np.asarray(np.rint(255 * shades), dtype=np.uint8)


class Camera:
    """Looks at a scene once, for pictures of several fields.

    Args:
        palette: Name of each support and load to its colour.
        marks: Supports and loads are drawn, on the undeformed body.

    Attributes:
        scene: As given.
        flat: Places of the nodes in the picture [m], shape (nodes, 2).
    """

    def __init__(self, scene: Scene, palette: Mapping[str, str], *, marks: bool = False) -> None:
        self.scene, self._palette = scene, palette
        self._groups = scene.marks if marks else ()
        view = scene.views[scene.last]
        self._x = scene.points if marks else scene.points + scene.scale * view.u
        across, up, self._toward = _directions(plane=scene.plane)
        self._project = np.column_stack([across, up])
        self.flat, self._depth = self._x @ self._project, self._x @ self._toward
        self._arrows = [_arrows(group, scene) for group in self._groups]
        ends = ((arrows @ self._project).reshape(-1, 2) for arrows in self._arrows)
        window = _window(np.concatenate([self.flat, *ends]))
        self._seen = look(self.flat, self._depth, scene.triangles, window)

    @plain_matplotlib()
    def picture(self, shown: Shown | None = None) -> str:
        """A picture as a data URL.

        Args:
            shown: The field of the colours; None: grey.
        """
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.collections import LineCollection
        from matplotlib.figure import Figure

        window = self._seen.window
        rows, columns = window.shape
        wide, high = columns / (_DPI * _FINER), rows / (_DPI * _FINER)
        whole = wide if shown is None else wide + _BAR
        figure = Figure(figsize=(whole, high))
        FigureCanvasAgg(figure)
        axes = figure.add_axes((0.0, 0.0, wide / whole, 1.0))
        axes.axis("off")
        left, low = map(float, window.low)
        extent = (left, left + window.pixel * columns, low, low + window.pixel * rows)
        axes.imshow(
            _coarser(self._image(shown)), extent=extent, origin="lower", interpolation="none"
        )
        axes.set(xlim=extent[:2], ylim=extent[2:])
        if len(self.scene.edges):
            lines, seen = self.lines()
            axes.add_collection(
                LineCollection(list(lines[seen]), colors=_INK, linewidths=0.7, capstyle="round")
            )
        for group, arrows in zip(self._groups, self._arrows, strict=True):
            self._add_arrows(axes, group, arrows)
        if shown is not None:
            _colour_bar(figure, shown, wide / whole)
        file = io.BytesIO()
        figure.savefig(file, dpi=_DPI, transparent=True)  # the body as large beside any bar
        return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode("ascii")

    def lines(self) -> tuple[FloatArray, BoolArray]:
        """Pieces of the edges in the picture, and which are seen, shapes (n, 2, 2) and (n,)."""
        edges = self.scene.edges
        return self._seen.pieces(self.flat[edges], self._depth[edges], _DEPTH * self.scene.size)

    def _image(self, shown: Shown | None) -> FloatArray:
        """Colours of all pixels with their opacity, shape (rows, columns, 4)."""
        scene, seen = self.scene, self._seen
        which, shares = seen.weights(self.flat, scene.triangles)
        found = np.zeros((*seen.window.shape, 4))
        colours = np.tile(_GREY, (len(which), 1))
        if shown is not None:
            values = scene.views[scene.last].values[shown.name][scene.triangles[which]]
            colours = _colours((shares * values).sum(axis=1), shown)
        bright = _brightness(scene, self._x, self._toward)[which, None]
        found[seen.triangle >= 0] = np.column_stack(
            [np.clip(bright * colours, 0, 1), np.ones(len(which))]
        )
        return found

    def _add_arrows(self, axes: Axes, group: Marks, arrows: FloatArray) -> None:
        """Draws arrows, those behind the body faintly: a reader has to know of them."""
        flat, depth = arrows @ self._project, arrows @ self._toward
        seen = self._seen.sees(flat.mean(axis=1), depth.mean(axis=1), _DEPTH * self.scene.size)
        seen |= group.nodes < 0  # that of a load on the whole body begins inside
        for (begin, end), clear in zip(flat, seen, strict=True):
            axes.annotate(
                "",
                xy=tuple(end),
                xytext=tuple(begin),
                annotation_clip=False,
                arrowprops={
                    "arrowstyle": f"-|>,head_width={0.22 if group.load else 0.16},head_length=0.4",
                    "color": self._palette[group.name],
                    "alpha": 1.0 if clear else _FAINT,
                    "lw": 1.3 if group.load else 0.8,
                    "shrinkA": 0,
                    "shrinkB": 0,
                },
            )


def _window(drawn: FloatArray) -> Window:
    """The window around what is drawn, which leaves no side of a picture empty."""
    low, top = drawn.min(axis=0), drawn.max(axis=0)
    sides = (1 + 2 * _MARGIN) * (top - low)
    finest = _DPI * _FINER
    pixel = float((sides / (np.array([_WIDTH, _HEIGHT]) * finest)).max()) or 1.0
    columns, rows = np.maximum(np.ceil(sides / pixel), _LEAST * finest).astype(int) // _FINER
    shape = (int(rows) * _FINER, int(columns) * _FINER)
    return Window((low + top) / 2 - pixel * np.array(shape[::-1]) / 2, pixel, shape)


def _coarser(image: FloatArray) -> FloatArray:
    """Means of the finer pixels, of colours by opacity."""
    rows, columns = image.shape[0] // _FINER, image.shape[1] // _FINER
    parts = image[: rows * _FINER, : columns * _FINER].reshape(rows, _FINER, columns, _FINER, 4)
    opacity = parts[..., 3].mean(axis=(1, 3))
    colours = (parts[..., :3] * parts[..., 3:]).mean(axis=(1, 3))
    return np.concatenate(
        [colours / np.where(opacity > 0, opacity, 1.0)[..., None], opacity[..., None]], axis=-1
    )


def _directions(*, plane: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Directions to the right, upwards and towards the eye."""
    if plane:
        return np.eye(3)[0], np.eye(3)[1], np.eye(3)[2]
    toward = _EYE / np.linalg.norm(_EYE)
    across = np.cross([0.0, 0.0, 1.0], toward)
    across /= np.linalg.norm(across)
    return across, np.asarray(np.cross(toward, across)), toward


def _normals(scene: Scene, x: FloatArray) -> FloatArray:
    corners = x[scene.triangles]
    found = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(found, axis=1, keepdims=True)
    return np.asarray(found / np.where(lengths > 0, lengths, 1.0))


def _brightness(scene: Scene, x: FloatArray, toward: FloatArray) -> FloatArray:
    """Of each triangle, shape (triangles,)."""
    if scene.plane:
        return np.ones(len(scene.triangles))
    light = toward + 0.35 * np.array([0.2, 0.1, 1.0])
    return np.asarray(0.7 + 0.3 * np.abs(_normals(scene, x) @ (light / np.linalg.norm(light))))


def _colours(values: FloatArray, shown: Shown) -> FloatArray:
    """Colours of some values [SI], grey where there is none, shape (n, 3)."""
    shares = np.clip((values - shown.low) / ((shown.high - shown.low) or 1.0), 0, 1)
    table = colour_table(warm_first=shown.name in SMALL_MATTERS)[:, :3] / 255
    picked = table[np.rint(255 * np.nan_to_num(shares)).astype(int)]
    picked[np.isnan(values)] = _GREY
    return np.asarray(picked)


def _arrows(group: Marks, scene: Scene) -> FloatArray:
    """Begin and end of each arrow in space, shape (n, 2, 3)."""
    length = (0.13 if group.load else 0.045) * scene.size * (2.2 if (group.nodes < 0).any() else 1)
    middle = (scene.points.min(axis=0) + scene.points.max(axis=0)) / 2
    found = []
    for node, along, tail in zip(group.nodes, group.along, group.tails, strict=True):
        at = middle if node < 0 else scene.points[node]
        step = length * along / (np.linalg.norm(along) or 1.0)
        found.append((at, at + step) if tail else (at - step, at))
    return np.array(found).reshape(-1, 2, 3)


def _colour_bar(figure: Figure, shown: Shown, left: float) -> None:
    """Adds the bar to the right of a share of the figure's width."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize

    axes = figure.add_axes((left + 0.38 * (1 - left), 0.14, 0.11 * (1 - left), 0.66))
    ends = Normalize(shown.low / shown.factor, shown.high / shown.factor)
    colours = ListedColormap(colour_table(warm_first=shown.name in SMALL_MATTERS) / 255)
    bar = figure.colorbar(ScalarMappable(ends, colours), cax=axes)
    bar.ax.tick_params(labelsize=8, colors=_INK)
    unit = f"\n[{shown.unit}]" if shown.unit else ""
    bar.ax.set_title(fill(shown.title, _LINE) + unit, fontsize=8, color=_INK)
