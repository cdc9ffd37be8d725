"""Draws bodies: reads lines "scene.npz<tab>picture.png" and writes "drawn" after each.

A program of its own, started by `draw.py`; it imports nothing of this package, hence no MPI.
Labels stand where they are seen: the patches are drawn once more, each in a colour of its own, and
the label of a patch is put where it is widest.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
import pyvista as pv
from scipy.ndimage import distance_transform_edt, find_objects
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

mpl.use("Agg")

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

Array = npt.NDArray[Any]

_SIZE = (1100, 980)
_INK, _BARE = "#303840", "#d3d8de"
_COLOURS = (
    "#8fb8de",
    "#f2a07b",
    "#a5d08c",
    "#e5c95f",
    "#b8a1d9",
    "#7fcdc4",
    "#e79bb6",
    "#c3b091",
    "#9fc3f0",
    "#cdd86f",
    "#d6a3e0",
    "#f0bd8a",
)
_DARK = ("#1f5fa8", "#b8541a", "#3c7a26", "#8f6c00", "#66449e", "#12756b", "#a63a68", "#6b5636")
_ARROW = 0.11
"""Length of arrows over the diagonal."""
_SYMBOLS = {"support": "#1b7837", "load": "#b2182b", "contact": "#5e3c99"}
_SHARP = np.cos(np.radians(35.0))
_SHORT = 0.25
"""Least length of connected sharp edges over the diagonal."""
_LEAST = 5.0
"""Half width in pixels of the visible part of a patch, from which it gets a label."""
_THIN = 2.5
"""The same for names: less is a rim."""
_LEGEND = {1: (2, 56), 2: (3, 78)}
"""Number of views to columns of the legend, and letters in each."""


@dataclass(frozen=True)
class Data:
    """A scene, as `draw.py` writes it."""

    words: dict[str, Any]
    points: Array
    triangles: Array
    patch: Array
    places: list[Array]
    directions: list[Array]
    normals: list[Array]
    curves: list[Array]
    obstacles: list[tuple[Array, Array]]

    @staticmethod
    def read(path: str) -> Data:
        """From a file; points that facets share are merged."""
        with np.load(path) as file:
            arrays = dict(file)
        words = json.loads(arrays["words"].tobytes().decode())
        x = arrays["points"]
        near = 1e-7 * max(float(np.linalg.norm(np.ptp(x, axis=0))), 1e-300)
        _, first, rows = np.unique(
            np.round(x / near), axis=0, return_index=True, return_inverse=True
        )
        count = range(len(words["symbols"]))
        return Data(
            words,
            x[first],
            rows.reshape(-1)[arrays["triangles"]],
            arrays["patch"],
            [arrays[f"places{i}"] for i in count],
            [arrays[f"directions{i}"] for i in count],
            [arrays[f"normals{i}"] for i in count],
            [arrays[f"curve{i}"] for i in range(len(words["curves"]))],
            [
                (arrays[f"obstacle_points{i}"], arrays[f"obstacle_triangles{i}"])
                for i in range(len(words["obstacles"]))
            ],
        )

    @property
    def diagonal(self) -> float:
        """Of the body's bounding box."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))

    def colours(self) -> list[str]:
        """The colour of each patch: of its first name, else of its face where nothing has names."""
        names = list(self.words["legend"])
        found = []
        for patch in self.words["patches"]:
            if patch["names"]:
                found.append(_COLOURS[names.index(patch["names"][0]) % len(_COLOURS)])
            elif patch["face"] and not names:
                found.append(_COLOURS[patch["face"] % len(_COLOURS)])
            else:
                found.append(_BARE)
        return found


@dataclass(frozen=True)
class Label:
    """A text at a place of a view in pixels, from its upper left corner."""

    text: str
    x: float
    y: float
    colour: str
    bold: bool


@dataclass(frozen=True)
class Flat:
    """What is drawn over a view.

    Attributes:
        labels: Texts.
        arrows: Both ends of arrows in pixels, shape (n, 2, 2).
    """

    labels: list[Label]
    arrows: Array


# --- in space ---


def _mesh(points: Array, triangles: Array) -> pv.PolyData:
    return pv.PolyData(points, np.insert(triangles, 0, 3, axis=1).ravel())


def _edges(data: Data) -> pv.PolyData:
    """Edges between faces or names, of the outline, and sharp ones where there are no faces."""
    t = data.triangles
    pairs = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(t)), 3)
    order = np.lexsort(pairs.T)
    pairs, owner = pairs[order], owner[order]
    same = (pairs[1:] == pairs[:-1]).all(axis=1)
    first = np.flatnonzero(same)
    x = data.points[t]
    n = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    n /= np.maximum(np.linalg.norm(n, axis=1), 1e-300)[:, None]
    here, there = owner[first], owner[first + 1]
    faces = np.array([patch["face"] for patch in data.words["patches"]])[data.patch]
    bent = np.abs(np.einsum("ij,ij->i", n[here], n[there])) < _SHARP
    known = (faces[here] > 0) & (faces[there] > 0)
    split = np.where(known, faces[here] != faces[there], False)
    split |= data.patch[here] != data.patch[there]
    turning = first[bent & ~known & ~split]
    split[np.isin(first, turning)] = _are_long(data, pairs[turning])
    single = np.ones(len(pairs), dtype=bool)
    single[first], single[first + 1] = False, False
    chosen = np.concatenate([pairs[first][split], pairs[single]])
    lines = np.insert(chosen, 0, 2, axis=1).ravel()
    return pv.PolyData(data.points, lines=lines if len(chosen) else None)


def _are_long(data: Data, pairs: Array) -> Array:
    """Whether connected edges are longer than those that rounded bodies have by chance."""
    size = len(data.points)
    ones = np.ones(len(pairs))
    joints = coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), shape=(size, size))
    chain = connected_components(joints, directed=False)[1][pairs[:, 0]]
    lengths = np.linalg.norm(data.points[pairs[:, 1]] - data.points[pairs[:, 0]], axis=1)
    long: Array = np.bincount(chain, lengths, minlength=1)[chain] >= _SHORT * data.diagonal
    return long


def _add_body(plot: pv.Plotter, data: Data) -> None:
    mesh = _mesh(data.points, data.triangles)
    rgb = np.array([pv.Color(c).int_rgb for c in data.colours()], dtype=np.uint8)
    mesh.cell_data["colour"] = rgb[data.patch]
    flat = bool(data.words["plane"])
    plot.add_mesh(
        mesh,
        scalars="colour",
        rgb=True,
        preference="cell",
        smooth_shading=not flat,
        split_sharp_edges=not flat,
        feature_angle=35.0,
        lighting=not flat,
        ambient=0.6,
        diffuse=0.48,
        specular=0.05,
        show_scalar_bar=False,
    )
    edges = _edges(data)
    if edges.n_lines:
        plot.add_mesh(edges, color=_INK, line_width=2.0, lighting=False, show_scalar_bar=False)


def _add_curves(plot: pv.Plotter, data: Data) -> None:
    for i, (one, pieces) in enumerate(zip(data.words["curves"], data.curves, strict=True)):
        if one["named"] and len(pieces):
            lines = np.arange(3 * len(pieces)).reshape(-1, 3)
            mesh = pv.PolyData(pieces.reshape(-1, 3), lines=np.insert(lines, 0, 3, axis=1).ravel())
            plot.add_mesh(
                mesh, color=_DARK[i % len(_DARK)], line_width=7.0, lighting=False, name=f"curve{i}"
            )


def _add_symbols(plot: pv.Plotter, data: Data) -> None:
    size = data.diagonal
    for i, symbol in enumerate(data.words["symbols"]):
        places, ahead, out = data.places[i], data.directions[i], data.normals[i]
        if not len(places):
            continue
        if symbol["kind"] == "load" and not out.any():
            continue  # inside of the body: drawn over it
        if symbol["kind"] == "load":
            long = _ARROW * size
            pushing = np.einsum("ij,ij->i", ahead, out) < -0.1
            # Forces along a surface are drawn a little above it.
            start = places + 0.01 * size * out - np.where(pushing, long, 0.0)[:, None] * ahead
            points, form = pv.PolyData(start), pv.Arrow(tip_length=0.3, tip_radius=0.09)
            points["ahead"], factor = ahead, long
        else:
            high = 0.035 * size
            form = pv.Cone(
                center=(0.5, 0, 0), direction=(-1, 0, 0), height=1.0, radius=0.35, resolution=24
            )
            points, factor = pv.PolyData(places), high
            points["ahead"] = out
        glyphs = points.glyph(orient="ahead", scale=False, factor=factor, geom=form)
        plot.add_mesh(glyphs, color=_SYMBOLS[symbol["kind"]], ambient=0.4, diffuse=0.7)


def _add_obstacles(plot: pv.Plotter, data: Data) -> None:
    for points, triangles in data.obstacles:
        plot.add_mesh(_mesh(points, triangles), color=_SYMBOLS["contact"], opacity=0.18)


def _plotter(data: Data, view: Sequence[float]) -> pv.Plotter:
    plot = pv.Plotter(off_screen=True, window_size=list(_SIZE))
    plot.set_background("#ffffff")
    return plot


def _aim(plot: pv.Plotter, data: Data, view: Sequence[float]) -> None:
    """The whole body and its symbols fill the picture."""
    ahead = np.array(view) / np.linalg.norm(view)
    plot.view_vector(ahead, viewup=data.words["up"])
    plot.enable_parallel_projection()
    right, up = _axes(plot)
    places = [p for p in data.places if len(p)]
    seen = np.concatenate([data.points, *places]) @ np.stack([right, up]).T
    low, high = seen.min(axis=0), seen.max(axis=0)
    centre = np.array(plot.camera.focal_point)
    shift = ((low + high) / 2 - np.array([right @ centre, up @ centre])) @ np.stack([right, up])
    plot.camera.focal_point = centre + shift
    plot.camera.position = np.array(plot.camera.position) + shift
    half = (high - low) / 2 + (0.1 if data.words["symbols"] else 0.02) * data.diagonal
    aspect = _SIZE[0] / _SIZE[1]
    plot.camera.parallel_scale = 1.06 * float(max(half[0] / aspect, half[1]))
    plot.reset_camera_clipping_range()


def _axes(plot: pv.Plotter) -> tuple[Array, Array]:
    ahead = np.array(plot.camera.direction)
    right = np.cross(ahead, plot.camera.up)
    right /= np.linalg.norm(right)
    return right, np.cross(right, ahead)


def _on_screen(plot: pv.Plotter, x: Array) -> Array:
    """Pixels of places, from the upper left corner."""
    right, up = _axes(plot)
    arm = x - np.array(plot.camera.focal_point)
    per = _SIZE[1] / (2 * plot.camera.parallel_scale)
    return np.array([_SIZE[0] / 2 + per * (arm @ right), _SIZE[1] / 2 - per * (arm @ up)])


# --- in the plane ---


def _shaded(data: Data, view: Sequence[float]) -> tuple[Array, Flat]:
    """A view, and what is drawn over it."""
    plot = _plotter(data, view)
    plot.enable_anti_aliasing("ssaa")
    plot.enable_lightkit()
    _add_body(plot, data)
    _add_curves(plot, data)
    _add_symbols(plot, data)
    _aim(plot, data, view)  # obstacles may be endless
    _add_obstacles(plot, data)
    plot.add_axes(color=_INK, line_width=2, viewport=(0, 0, 0.14, 0.16))
    plot.reset_camera_clipping_range()
    image = np.asarray(plot.screenshot(return_img=True))
    labels = [
        *_patch_labels(data, _numbers(data, view)),
        *_curve_labels(plot, data),
        *_symbol_labels(plot, data),
    ]
    ends = [
        np.stack([_on_screen(plot, x), _on_screen(plot, x + _ARROW * data.diagonal * n)])
        for symbol, places, ahead, out in zip(
            data.words["symbols"], data.places, data.directions, data.normals, strict=True
        )
        if symbol["kind"] == "load" and not out.any()
        for x, n in zip(places, ahead, strict=True)
    ]
    plot.close()
    return image, Flat(labels, np.array(ends).reshape(-1, 2, 2))


def _numbers(data: Data, view: Sequence[float]) -> Array:
    """Number of the patch that each pixel shows, -1 for none."""
    plot = _plotter(data, view)
    plot.disable_anti_aliasing()
    plot.render_window.SetMultiSamples(0)
    plot.set_background("#000000")
    mesh, number = _mesh(data.points, data.triangles), data.patch + 1
    codes = np.stack([number % 64 * 4 + 2, number // 64 % 64 * 4 + 2, number // 4096 * 4 + 2])
    mesh.cell_data["colour"] = codes.T.astype(np.uint8)
    plot.add_mesh(
        mesh, scalars="colour", rgb=True, preference="cell", lighting=False, show_scalar_bar=False
    )
    _aim(plot, data, view)
    image = np.asarray(plot.screenshot(return_img=True)).astype(np.int64)
    plot.close()
    low = image // 4
    found = low[..., 0] + 64 * low[..., 1] + 4096 * low[..., 2]
    return np.where(image.sum(axis=2) == 0, -1, found - 1)


def _patch_labels(data: Data, numbers: Array) -> Iterator[Label]:
    """Numbers of faces, and each name where most of it is seen."""
    patches = data.words["patches"]
    wide: dict[int, tuple[float, float, float]] = {}
    for i, part in enumerate(find_objects(numbers + 1)[: len(patches)]):
        if part is not None:
            away = distance_transform_edt(np.pad(numbers[part] == i, 1))
            row, column = divmod(int(away.argmax()), away.shape[1])
            at = float(part[1].start + column - 1), float(part[0].start + row - 1)
            wide[i] = float(away[row, column]), *at
    best: dict[str, int] = {}
    for i, (width, _, _) in wide.items():
        for name in patches[i]["names"]:
            if name not in best or wide[best[name]][0] < width:
                best[name] = i
    for i, (width, x, y) in wide.items():
        names = [name for name in patches[i]["names"] if best[name] == i]
        face = patches[i]["face"]
        text = ", ".join(map(_short, names)) + (f" ({face})" if names and face else "")
        if names and width >= _THIN:
            yield Label(text, x, y, "#000000", True)
        elif face and not names and width >= _LEAST:
            yield Label(str(face), x, y, _INK, False)


def _curve_labels(plot: pv.Plotter, data: Data) -> Iterator[Label]:
    """Names of curves and their numbers, in the middle of each."""
    for i, (one, pieces) in enumerate(zip(data.words["curves"], data.curves, strict=True)):
        if len(pieces):
            middles = pieces[:, 1]
            away = np.linalg.norm(middles - middles.mean(axis=0), axis=1)
            x, y = _on_screen(plot, middles[int(away.argmin())])
            colour = _DARK[i % len(_DARK)] if one["named"] else _INK
            yield Label(_short(one["label"]), float(x), float(y), colour, bool(one["named"]))


def _symbol_labels(plot: pv.Plotter, data: Data) -> Iterator[Label]:
    for i, symbol in enumerate(data.words["symbols"]):
        if symbol["kind"] == "load" and len(data.places[i]):
            tail = data.places[i] - 1.2 * _ARROW * data.diagonal * data.directions[i]
            pushing = np.einsum("ij,ij->i", data.directions[i], data.normals[i]) < -0.1
            ends = np.where(pushing[:, None], tail, 2 * data.places[i] - tail)
            seen = _on_screen(plot, ends)
            top = int(seen[1].argmin())
            x, y = float(seen[0, top]), float(seen[1, top])
            yield Label(symbol["label"], x, y, _SYMBOLS["load"], True)
    for label, (points, _) in zip(data.words["obstacles"], data.obstacles, strict=True):
        x, y = _on_screen(plot, points.mean(axis=0))
        inside = np.clip([x, y], [60, 30], [_SIZE[0] - 60, _SIZE[1] - 30])
        yield Label(label, float(inside[0]), float(inside[1]), _SYMBOLS["contact"], True)


def _short(name: str) -> str:
    return name if len(name) <= 24 else name[:23] + "\u2026"


def _plain(text: str) -> str:
    """Text with `$` escaped, which matplotlib would take for a formula."""
    return text.replace("$", r"\$")


def _write_arrows(axes: Axes, ends: Array) -> None:
    for start, end in ends:
        form = {
            "arrowstyle": "-|>",
            "linewidth": 4,
            "mutation_scale": 26,
            "color": _SYMBOLS["load"],
        }
        axes.annotate("", xy=end, xytext=start, arrowprops=form)


def _write_labels(canvas: FigureCanvasAgg, axes: Axes, labels: Sequence[Label]) -> None:
    """Labels that do not cover each other: one that would moves away, with a line to its place."""
    renderer = canvas.get_renderer()
    taken: list[Bbox] = []
    turns = [(0.0, 0.0)] + [
        (r * np.cos(a), r * np.sin(a))
        for r in range(24, 240, 18)
        for a in np.linspace(0, 2 * np.pi, 12, endpoint=False) + np.pi / 2
    ]
    for label in sorted(labels, key=lambda one: not one.bold):
        text = axes.text(
            label.x,
            label.y,
            _plain(label.text),
            ha="center",
            va="center",
            color=label.colour,
            fontsize=11 if label.bold else 9.5,
            fontweight="bold" if label.bold else "normal",
            bbox={
                "boxstyle": "round,pad=0.18",
                "facecolor": "white",
                "alpha": 0.82 if label.bold else 0.6,
                "linewidth": 0,
            },
        )
        half = text.get_window_extent(renderer).width / 2 + 8
        for dx, dy in turns:
            x = float(np.clip(label.x + dx, half, _SIZE[0] - half))
            y = float(np.clip(label.y + dy, 20, _SIZE[1] - 20))
            text.set_position((x, y))
            box = text.get_window_extent(renderer).padded(3)
            if not any(box.overlaps(other) for other in taken):
                break
        taken.append(box)
        if abs(x - label.x) + abs(y - label.y) > 12:
            axes.plot([label.x, x], [label.y, y], color=label.colour, linewidth=0.8, zorder=1.5)


def _legend(data: Data) -> list[tuple[str, str, str]]:
    """Marker, colour and text of each line of the legend."""
    rows = []
    for i, (name, use) in enumerate(data.words["legend"].items()):
        text = f"{name}: {use}" if use else name
        rows.append(("s", _COLOURS[i % len(_COLOURS)], text))
    used = {symbol["kind"] for symbol in data.words["symbols"]}
    if "support" in used:
        rows.append(("v", _SYMBOLS["support"], "held by a support"))
    rows += [
        (r"$\rightarrow$", _SYMBOLS["load"], symbol["label"])
        for symbol in data.words["symbols"]
        if symbol["kind"] == "load"
    ]
    rows += [("o", _SYMBOLS["contact"], label) for label in data.words["obstacles"]]
    return rows


def draw(source: str, target: str) -> None:
    """Draws one picture.

    Args:
        source: File of arrays, as `draw.py` writes it.
        target: The PNG file.
    """
    data = Data.read(source)
    views = data.words["views"]
    drawn = [_shaded(data, view) for view in views]
    rows = _legend(data)
    columns, letters = _LEGEND[len(views)]
    lines = -(-len(rows) // columns)
    wide, high = _SIZE[0] * len(views), _SIZE[1] + 70 + 30 * lines
    figure = Figure(figsize=(wide / 100, high / 100), dpi=100, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    foot = (10 + 30 * lines) / high
    for i, (image, flat) in enumerate(drawn):
        axes = figure.add_axes((i / len(views), foot, 1 / len(views), _SIZE[1] / high))
        axes.imshow(image, extent=(0, _SIZE[0], _SIZE[1], 0), interpolation="nearest")
        axes.set_xlim(0, _SIZE[0])
        axes.set_ylim(_SIZE[1], 0)
        axes.axis("off")
        _write_arrows(axes, flat.arrows)
        _write_labels(canvas, axes, flat.labels)
    figure.text(
        0.015, 1 - 32 / high, _plain(data.words["title"]), fontsize=16, color=_INK, va="center"
    )
    for i, (marker, colour, text) in enumerate(rows):
        x = 0.02 + (i // max(lines, 1)) / columns
        y = foot - (i % lines + 0.6) * 30 / high
        figure.text(x, y, "\u25a0" if marker == "s" else "", color=colour, fontsize=16, va="center")
        if marker != "s":
            sign = {"v": "\u25b2", "o": "\u25cf"}.get(marker, "\u279c")
            figure.text(x, y, sign, color=colour, fontsize=14, va="center")
        cut = text if len(text) <= letters else text[: letters - 1] + "\u2026"
        figure.text(x + 25 / wide, y, _plain(cut), color=_INK, fontsize=12, va="center")
    figure.savefig(target, dpi=100)


def main() -> None:
    """Draws until its input ends."""
    # What libraries print goes to stderr: stdout carries the answers only.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    # The display ends with its last window: this one stays until all is drawn.
    first = pv.Plotter(off_screen=True, window_size=[16, 16])
    first.show(auto_close=False)
    for line in sys.stdin:
        answer = "drawn"
        try:
            draw(*line.rstrip("\n").split("\t"))
        except OSError as error:
            answer = str(error)
        with suppress(BrokenPipeError):
            print(answer, file=answers, flush=True)
    first.close()


if __name__ == "__main__":
    main()
