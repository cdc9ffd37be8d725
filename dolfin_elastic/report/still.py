"""Pictures of a scene by matplotlib: for paper, and where a viewer of mail runs no scripts.

They need no graphics card and no X server: triangles are projected here and drawn from back to
front.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.report.scene import Marks, Scene, Shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH, _HEIGHT, _DPI = 7.6, 4.7, 150
_GREY = np.array([0.74, 0.77, 0.80])
_EYE = np.array([0.62, -0.78, 0.5])
_INK = "#20262c"


def colour_table() -> AnyArray:
    """The colours of values, shape (256, 4), uint8: viridis without its darkest part."""
    from matplotlib import colormaps

    shades = colormaps["viridis"](np.linspace(0.16, 1.0, 256))
    return np.asarray(np.rint(255 * shades), dtype=np.uint8)


def picture(
    scene: Scene, shown: Shown | None, palette: Mapping[str, str], *, marks: bool = False
) -> str:
    """A picture as a data URL.

    Args:
        scene: What is drawn.
        shown: The field of the colours; None: grey.
        palette: Name of each support and load to its colour.
        marks: Supports and loads are drawn, on the undeformed body.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.figure import Figure

    view = scene.views[scene.last]
    x = scene.points if marks else scene.points + scene.scale * view.u
    across, up, toward = _camera(plane=scene.plane)
    flat = np.column_stack([x @ across, x @ up])
    depth = x @ toward
    figure = Figure(figsize=(_WIDTH, _HEIGHT))
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.01, 0.02, 0.98 if shown is None else 0.84, 0.96))
    colours = _colours(scene, x, toward, shown)
    rows = scene.triangles
    behind = np.argsort(depth[rows].mean(axis=1), kind="stable")
    faces = PolyCollection(
        list(flat[rows[behind]]),
        facecolors=colours[behind],
        edgecolors=colours[behind],
        linewidths=0.4,
    )
    axes.add_collection(faces)
    if len(scene.edges):
        lines = scene.edges[_visible(scene, x, toward)]
        axes.add_collection(LineCollection(list(flat[lines]), colors=_INK, linewidths=0.7))
    for group in scene.marks if marks else ():
        ends = _arrows(axes, group, scene, np.column_stack([across, up]), palette[group.name])
        axes.update_datalim(ends)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.margins(0.06)
    axes.axis("off")
    if shown is not None:
        _colour_bar(figure, shown)
    file = io.BytesIO()
    figure.savefig(file, dpi=_DPI, transparent=True, bbox_inches="tight", pad_inches=0.06)
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode("ascii")


def _camera(*, plane: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
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


def _colours(scene: Scene, x: FloatArray, toward: FloatArray, shown: Shown | None) -> FloatArray:
    light = toward + 0.35 * np.array([0.2, 0.1, 1.0])
    bright = 0.7 + 0.3 * np.abs(_normals(scene, x) @ (light / np.linalg.norm(light)))
    if scene.plane:
        bright = np.ones_like(bright)
    if shown is None:
        return np.asarray(np.clip(bright[:, None] * _GREY, 0, 1))
    values = scene.views[scene.last].values[shown.name][scene.triangles].mean(axis=1)
    shares = np.clip((values - shown.low) / ((shown.high - shown.low) or 1.0), 0, 1)
    table = colour_table()[:, :3] / 255
    picked = table[np.rint(255 * np.nan_to_num(shares)).astype(int)]
    picked[np.isnan(values)] = _GREY  # the field has no value there
    return np.asarray(np.clip(bright[:, None] * picked, 0, 1))


def _visible(scene: Scene, x: FloatArray, toward: FloatArray) -> AnyArray:
    """Whether each edge has a triangle beside it that faces the eye."""
    facing = _normals(scene, x) @ toward > -1e-9
    if scene.plane:
        return np.ones(len(scene.edges), dtype=bool)
    nodes = np.zeros(len(x), dtype=bool)
    sides = scene.triangles[facing]
    pairs = np.sort(np.concatenate([sides[:, [0, 1]], sides[:, [1, 2]], sides[:, [2, 0]]]), axis=1)
    nodes[sides] = True
    count = len(x)
    known = np.unique(pairs[:, 0] * count + pairs[:, 1])
    ends = np.sort(scene.edges, axis=1)
    return np.asarray(np.isin(ends[:, 0] * count + ends[:, 1], known))


def _arrows(axes: Axes, group: Marks, scene: Scene, project: FloatArray, colour: str) -> FloatArray:
    """Draws arrows; returns their ends in the picture, shape (n, 2)."""
    found = []
    length = (0.13 if group.load else 0.045) * scene.size * (2.2 if (group.nodes < 0).any() else 1)
    middle = (scene.points.min(axis=0) + scene.points.max(axis=0)) / 2
    for node, along, tail in zip(group.nodes, group.along, group.tails, strict=True):
        at = middle if node < 0 else scene.points[node]
        step = length * along / (np.linalg.norm(along) or 1.0)
        begin, end = (at, at + step) if tail else (at - step, at)
        axes.annotate(
            "",
            xy=tuple(end @ project),
            xytext=tuple(begin @ project),
            annotation_clip=False,
            arrowprops={
                "arrowstyle": f"-|>,head_width={0.22 if group.load else 0.16},head_length=0.4",
                "color": colour,
                "lw": 1.3 if group.load else 0.8,
                "shrinkA": 0,
                "shrinkB": 0,
            },
        )
        found += [begin @ project, end @ project]
    return np.array(found)


def _colour_bar(figure: Figure, shown: Shown) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize

    axes = figure.add_axes((0.875, 0.14, 0.02, 0.66))
    ends = Normalize(shown.low / shown.factor, shown.high / shown.factor)
    colours = ListedColormap(colour_table() / 255)
    bar = figure.colorbar(ScalarMappable(ends, colours), cax=axes)
    bar.ax.tick_params(labelsize=8, colors=_INK)
    bar.ax.set_title(f"{shown.title}\n[{shown.unit or '1'}]", fontsize=8, color=_INK)
