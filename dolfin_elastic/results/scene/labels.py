"""Labels over pictures: they stand where they are seen, and do not cover each other.

A patch's label stands where the patch is widest in the picture, by the number of the patch in each
pixel.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from scipy.ndimage import distance_transform_edt, find_objects

mpl.use("Agg")

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray
from dolfin_elastic.results.scene.scene import SIZE, Picture

INK = "#303840"
_DARK = ("#1f5fa8", "#b8541a", "#3c7a26", "#8f6c00", "#66449e", "#12756b", "#a63a68", "#6b5636")
_CONTACT = "#5e3c99"
_LEAST = 5.0
"""Half width in pixels of the visible part of a patch, from which it gets a label."""
_THIN = 2.5
"""The same for names: less is a rim."""
_LEGEND = {1: (2, 56), 2: (3, 78)}
"""Number of views to columns of the legend, and letters in each."""
_LARGE, _LINE = 1.4, 42
"""Of letters over those of a page, and pixels of a line of the legend."""


@dataclass(frozen=True)
class Label:
    """A text at a place of a picture in pixels, from its upper left corner."""

    text: str
    x: float
    y: float
    colour: str
    bold: bool


def _on_screen(picture: Picture, x: FloatArray) -> FloatArray:
    """Pixels of places, from the upper left corner."""
    (low, high), axes = picture.seen, picture.axes[:2]
    per = 1 / ((high - low)[:2] / np.array(SIZE) / picture.room).max()
    away = x @ axes.T - (low + high)[:2] / 2
    return np.stack([SIZE[0] / 2 + per * away[..., 0], SIZE[1] / 2 - per * away[..., 1]])


def _patch_labels(picture: Picture, numbers: IntArray) -> Iterator[Label]:
    """Numbers of faces, and each name where most of it is seen."""
    patches = picture.scene.patches
    wide: dict[int, tuple[float, float, float]] = {}
    for i, part in enumerate(find_objects(numbers + 1)[: len(patches)]):
        if part is not None:
            away = distance_transform_edt(np.pad(numbers[part] == i, 1))
            row, column = divmod(int(away.argmax()), away.shape[1])
            at = float(part[1].start + column - 1), float(part[0].start + row - 1)
            wide[i] = float(away[row, column]), *at
    best: dict[str, int] = {}
    for i, (width, _, _) in wide.items():
        for name in patches[i].names:
            if name not in best or wide[best[name]][0] < width:
                best[name] = i
    for i, (width, x, y) in wide.items():
        names, face = [name for name in patches[i].names if best[name] == i], patches[i].face
        text = ", ".join(map(shortened, names)) + (f" ({face})" if names and face else "")
        if names and width >= _THIN:
            yield Label(text, x, y, "#000000", True)
        elif face and not names and width >= _LEAST:
            yield Label(str(face), x, y, INK, False)


def _curve_labels(picture: Picture) -> Iterator[Label]:
    """Names of curves and their numbers, in the middle of each."""
    for i, one in enumerate(picture.scene.curves):
        if len(one.pieces):
            middles = one.pieces[:, 1]
            away = np.linalg.norm(middles - middles.mean(axis=0), axis=1)
            x, y = _on_screen(picture, middles[int(away.argmin())])
            colour = curve_colour(i) if one.named else INK
            yield Label(shortened(one.label), float(x), float(y), colour, one.named)


def curve_colour(i: int) -> str:
    """Colour of a curve."""
    return _DARK[i % len(_DARK)]


def _glyph_labels(picture: Picture) -> Iterator[Label]:
    """Of loads, at the uppermost arrow's far end; and of obstacles."""
    scene = picture.scene
    for one in scene.glyphs:
        if one.load:
            ends = one.ends(1.1 * scene.diagonal)
            seen = _on_screen(picture, np.where(one.tails[:, None], ends[:, 1], ends[:, 0]))
            top = int(seen[1].argmin())
            yield Label(one.label, float(seen[0, top]), float(seen[1, top]), one.colour, True)
    for obstacle in scene.obstacles:
        x, y = _on_screen(picture, obstacle.points.mean(axis=0))
        inside = np.clip([x, y], [60, 30], [SIZE[0] - 60, SIZE[1] - 30])
        yield Label(obstacle.name, float(inside[0]), float(inside[1]), _CONTACT, True)


def shortened(name: str, most: int = 24) -> str:
    """A name of at most so many letters."""
    return name if len(name) <= most else name[: most - 1] + "\u2026"


def _plain(text: str) -> str:
    """Text with `$` escaped, which matplotlib would take for a formula."""
    return text.replace("$", r"\$")


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
            fontsize=_LARGE * (11 if label.bold else 9.5),
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
            x = float(np.clip(label.x + dx, half, SIZE[0] - half))
            y = float(np.clip(label.y + dy, 20, SIZE[1] - 20))
            text.set_position((x, y))
            box = text.get_window_extent(renderer).padded(3)
            if not any(box.overlaps(other) for other in taken):
                break
        taken.append(box)
        if abs(x - label.x) + abs(y - label.y) > 12:
            axes.plot([label.x, x], [label.y, y], color=label.colour, linewidth=0.8, zorder=1.5)


def _legend(picture: Picture) -> list[tuple[str, str, str]]:
    """Sign, colour and text of each line of the legend."""
    assert picture.legend is not None
    scene, rows = picture.scene, []
    for name, use, colour in picture.legend:
        rows.append(("\u25a0", colour, f"{name}: {use}" if use else name))
    supports = [one.colour for one in scene.glyphs if not one.load]
    rows += [("\u25b2", colour, "fixed by a support") for colour in supports[:1]]
    rows += [("\u279c", one.colour, one.label) for one in scene.glyphs if one.load]
    return rows + [("\u25cf", _CONTACT, one.name) for one in scene.obstacles]


def labelled(
    pictures: Sequence[Picture], images: Sequence[AnyArray], patches: Sequence[IntArray], file: Path
) -> None:
    """Writes pictures with labels, and a legend below.

    Args:
        images: Pixels of each, shape (height, width, 3).
        patches: Number of the patch in each pixel, -1 for none, shape (height, width).
        file: The PNG file.
    """
    rows = _legend(pictures[0])
    columns, letters = _LEGEND[len(pictures)]
    lines = -(-len(rows) // columns)
    wide, high = SIZE[0] * len(pictures), SIZE[1] + 100 + _LINE * lines
    figure = Figure(figsize=(wide / 100, high / 100), dpi=100, facecolor="white")
    canvas, foot = FigureCanvasAgg(figure), (14 + _LINE * lines) / high
    for i, (picture, image, numbers) in enumerate(zip(pictures, images, patches, strict=True)):
        axes = figure.add_axes((i / len(pictures), foot, 1 / len(pictures), SIZE[1] / high))
        axes.imshow(image, extent=(0, SIZE[0], SIZE[1], 0), interpolation="nearest")
        axes.set_xlim(0, SIZE[0])
        axes.set_ylim(SIZE[1], 0)
        axes.axis("off")
        labels = [*_patch_labels(picture, numbers), *_curve_labels(picture)]
        _write_labels(canvas, axes, [*labels, *_glyph_labels(picture)])

    def write(x: float, y: float, text: str, size: float, colour: str = INK) -> None:
        figure.text(x, y, _plain(text), fontsize=_LARGE * size, color=colour, va="center")

    write(0.015, 1 - 45 / high, pictures[0].title, 16)
    for i, (sign, colour, text) in enumerate(rows):
        x = 0.02 + (i // max(lines, 1)) / columns
        y = foot - (i % lines + 0.6) * _LINE / high
        write(x, y, sign, 14, colour)
        write(x + 35 / wide, y, shortened(text, letters), 12)
    figure.savefig(file, dpi=100)
