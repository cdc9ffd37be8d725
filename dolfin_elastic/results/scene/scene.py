"""`Scene`: a body with its states, and what is drawn beside it; `Picture`: how it is seen.

Plain numbers, which the drawing process reads from files: MPI is not known here.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from textwrap import fill
from typing import Any, Literal

import numpy as np

from dolfin_elastic.core.shapes.triangles import whole
from dolfin_elastic.core.si_text import percent
from dolfin_elastic.core.types import AnyArray, BoolArray, FloatArray, IntArray
from dolfin_elastic.results.scene.colour_bar import ColourBar, make_colour_bar

SIZE, FILM = (1500, 1100), (1280, 720)
"""Pixels of a picture, and of a frame of a film."""
OBSTACLE, GREY = "#aab4be", "#c3c9d0"
"""Colours of obstacles, and of a body without others."""
_NO_EDGES = np.zeros((0, 2), dtype=np.int64)


@dataclass(frozen=True)
class Frame:
    """A deformed state, or a mode.

    Attributes:
        label: Its load, time or frequency.
        u: Displacements of the points [m], shape (n, 3).
        values: Name of a field to its values at the points [SI], shape (n,); NaN: there is none.
    """

    label: str
    u: FloatArray
    values: Mapping[str, FloatArray] = field(default_factory=dict)


@dataclass(frozen=True)
class Patch:
    """Triangles of one colour with one label.

    Attributes:
        names: Surfaces, regions or materials that they belong to.
        face: Number of their CAD face, or 0.
        colour: As matplotlib reads it.
    """

    names: tuple[str, ...]
    face: int = 0
    colour: str = ""


@dataclass(frozen=True)
class Glyphs:
    """Cones of a support, or arrows of a load, on the undeformed body.

    Attributes:
        key: What they belong to: "support 0", "load 1" ...
        label: What stands beside them.
        load: Of a load; otherwise of a support.
        places: [m], shape (n, 3).
        along: Unit vectors, of supports into the body, shape (n, 3).
        tails: Which of them begin at their place, shape (n,); the others end there.
        colour: As matplotlib reads it.
        inside: Of a load on the volume: drawn over the body.
    """

    key: str
    label: str
    load: bool
    places: FloatArray
    along: FloatArray
    tails: BoolArray
    colour: str = ""
    inside: bool = False

    def plain(self) -> dict[str, object]:
        """Lists and texts, for JSON; numbers of six digits."""
        lists = {name: _digits(getattr(self, name)) for name in ("places", "along")}
        return {**asdict(self), **lists, "tails": self.tails.tolist()}

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> Glyphs:
        """From `plain`."""
        coordinates, along = (
            np.array(row[k], dtype=float).reshape(-1, 3) for k in ("places", "along")
        )
        arrays = {
            "places": coordinates,
            "along": along,
            "tails": np.array(row["tails"], dtype=bool),
        }
        return cls(**{**row, **arrays})

    def length(self, size: float) -> float:
        """Of each [m].

        Args:
            size: Diagonal of the body [m].
        """
        return size * ((0.2 if self.inside else 0.11) if self.load else 0.035)

    def ends(self, size: float) -> FloatArray:
        """Begin and end of each [m], shape (n, 2, 3).

        Args:
            size: Diagonal of the body [m].
        """
        step = self.length(size) * self.along
        begin = np.where(self.tails[:, None], self.places, self.places - step)
        return np.stack([begin, begin + step], axis=1)


def _digits(rows: FloatArray) -> list[list[float]]:
    return [[float(f"{x:.6g}") for x in row] for row in rows]


@dataclass(frozen=True)
class Obstacle:
    """A rigid obstacle.

    Attributes:
        name: What stands beside it.
        points: Where they would be at rest [m], shape (n, 3).
        triangles: Shape (m, 3).
        shift: Its displacement [m], shape (3,).
        colour: As matplotlib reads it.
        turned: It turns: points are those of one state.
    """

    name: str
    points: FloatArray
    triangles: IntArray
    shift: FloatArray
    colour: str = OBSTACLE
    turned: bool = False


@dataclass(frozen=True)
class Curve:
    """A surface of a plane body.

    Attributes:
        label: Its name or number.
        named: It has a name.
        pieces: Three points along each of its facets [m], shape (n, 3, 3).
    """

    label: str
    named: bool
    pieces: FloatArray


@dataclass(frozen=True)
class Scene:
    """A body with its states, and what is beside it.

    Attributes:
        points: Undeformed [m], shape (n, 3); those of edges alone are among them.
        triangles: Numbers of points, counter-clockwise seen from outside, shape (m, 3).
        edges: Lines between pairs of points, see `sharp_edges`, shape (k, 2).
        frames: At least one.
        plane: The body is plane.
        nodes: Which points are nodes of the mesh, shape (n,); None: all.
        skin: Which triangles are no sections, shape (m,); None: all.
        patch: Number of each triangle's patch, shape (m,); None: there are no patches.
        patches: What they are.
        glyphs: Of supports and loads.
        obstacles: Of contacts.
        curves: Surfaces of a plane body.
    """

    points: FloatArray
    triangles: IntArray
    edges: IntArray = field(default_factory=_NO_EDGES.copy)
    frames: tuple[Frame, ...] = ()
    plane: bool = False
    nodes: BoolArray | None = None
    skin: BoolArray | None = None
    patch: IntArray | None = None
    patches: tuple[Patch, ...] = ()
    glyphs: tuple[Glyphs, ...] = ()
    obstacles: tuple[Obstacle, ...] = ()
    curves: tuple[Curve, ...] = ()

    @property
    def patches_of(self) -> IntArray:
        """Number of each triangle's patch, shape (m,)."""
        assert self.patch is not None
        return self.patch

    @property
    def diagonal(self) -> float:
        """Of the box around the undeformed body [m]."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0))) or 1.0


@dataclass(frozen=True)
class Reliable:
    """What to judge by where the largest value of a field is singular.

    Attributes:
        value: The largest value away from singular places [SI]; NaN: there is none.
        place: Of the undeformed body [m], shape (3,).
        error: Its estimated error in words; empty: it is not known.
    """

    value: float
    place: FloatArray
    error: str = ""

    @classmethod
    def of(cls, peak: object, other: object) -> Reliable | None:
        """From rows of the error in `summary.json`; None where the largest value is not singular.

        Args:
            peak: The largest value, see `Peak.as_json`.
            other: The same away from singular places; None: there is none.
        """
        if not isinstance(peak, Mapping) or not peak.get("singular"):
            return None
        if not isinstance(other, Mapping) or not isinstance(other.get("value"), int | float):
            return cls(np.nan, np.zeros(3))
        error = other.get("error")
        known = isinstance(error, int | float) and np.isfinite(error)
        text = f"± {percent(error)}" if known else ""
        return cls(float(other["value"]), whole(np.array(other["place"], dtype=float)), text)


@dataclass(frozen=True)
class Mark:
    """A marked value.

    Attributes:
        place: In the deformed body as it is drawn [m], shape (3,).
        text: Beside it.
    """

    place: FloatArray
    text: str


@dataclass(frozen=True)
class Picture:
    """How a scene is seen; its last frame is drawn.

    Attributes:
        scene: What is seen.
        view: One of `DIRECTIONS`.
        up: Axis that is up in it.
        behind: It is seen from the opposite side.
        title: Above the body.
        field: That of the colours; empty: those of the patches, else grey.
        unit: SI unit of the field.
        tensor: The norm of a tensor is shown.
        noise: Values below this are round-off.
        label: Above the names of the patches.
        legend: Names of patches, what they are for and their colours; where there is one, labels
            stand where they are seen.
        scale: Magnification of the displacement.
        outline: The undeformed edges are drawn.
        bare: Nothing stands beside the body.
        film: It is a frame of a film: of 16 to 9, and drawn fast.
        window: What the camera has to show, see `window`; None: all of the scene.
        bar: The colour bar, of pictures with a field.
        scaled: The largest value is 1: it is that of a mode.
        allowable: Stress up to which the colour bar and the body are marked [Pa]; 0: there is none.
        reliable: What to judge by; None: the largest value.
        marks: Marked values.
    """

    scene: Scene
    view: str = "isometric"
    up: str = "z"
    behind: bool = False
    title: str = ""
    field: str = ""
    unit: str = ""
    tensor: bool = False
    noise: float = 0.0
    label: str = ""
    legend: tuple[tuple[str, str, str], ...] | None = None
    scale: float = 1.0
    outline: bool = True
    bare: bool = False
    film: bool = False
    window: FloatArray | None = None
    bar: ColourBar | None = None
    scaled: bool = False
    allowable: float = 0.0
    reliable: Reliable | None = None
    marks: tuple[Mark, ...] = ()

    @property
    def frame(self) -> Frame:
        """The state that is drawn."""
        return self.scene.frames[-1]

    @property
    def moved(self) -> FloatArray:
        """Points where they are drawn [m], shape (n, 3)."""
        return self.scene.points + self.scale * self.frame.u

    @property
    def axes(self) -> FloatArray:
        """Unit vectors to the right, up and to the camera, rows."""
        back, right, top = axes_of(self.view, self.up)
        return np.stack([-right, top, -back] if self.behind else [right, top, back])

    @property
    def beside(self) -> bool:
        """Something stands beside the body: a colour bar, or names."""
        return not self.bare and self.legend is None

    @property
    def room(self) -> tuple[float, float]:
        """Shares of the picture's width and height that the body may fill."""
        across, upwards = (0.74, 0.8) if self.beside else (0.94, 0.94)
        less = 0.06 if self.scene.plane and self.scene.obstacles else 0.0
        return across - less, upwards - less

    @property
    def seen(self) -> FloatArray:
        """The window, or that around body and glyphs, see `window`."""
        if self.window is not None:
            return self.window
        ends = [one.ends(self.scene.diagonal).reshape(-1, 3) for one in self.scene.glyphs]
        every = np.vstack([self.scene.points, self.moved, *ends]) @ self.axes.T
        margin = 0.015 * self.scene.diagonal * bool(ends)  # of cones that are seen from the side
        return np.array([every.min(axis=0) - margin, every.max(axis=0) + margin])


_KINDS = {
    one.__name__: one
    for one in (
        *(Picture, ColourBar, Scene, Frame, Patch, Glyphs, Obstacle, Curve),
        *(Mark, Reliable),
    )
}


def save(path: Path, picture: Picture) -> None:
    """Writes a picture into a file, with numbers of half the length, which show no difference."""
    arrays: dict[str, AnyArray] = {}
    words = _written(picture, arrays)
    text = np.frombuffer(json.dumps(words).encode(), dtype=np.uint8)
    with path.open("wb") as file:
        np.savez(file, **{**arrays, "words": text})  # type: ignore[arg-type]


def load(path: Path) -> Picture:
    """Reads a picture that `save` has written."""
    with np.load(path) as file:
        arrays = dict(file)
    content = _read(json.loads(arrays["words"].tobytes()), arrays)
    assert isinstance(content, Picture)
    return content


def _written(value: Any, arrays: dict[str, AnyArray]) -> Any:
    if isinstance(value, np.ndarray):
        short = {"f": np.float32, "i": np.int32}.get(value.dtype.kind, value.dtype)
        arrays[f"array{len(arrays)}"] = value.astype(short)
        return {"array": f"array{len(arrays) - 1}"}
    if is_dataclass(value):
        rows = {one.name: _written(getattr(value, one.name), arrays) for one in fields(value)}
        return {"class": type(value).__name__, "fields": rows}
    if isinstance(value, Mapping):
        return {"pairs": [[key, _written(one, arrays)] for key, one in value.items()]}
    return [_written(one, arrays) for one in value] if isinstance(value, tuple) else value


def _read(value: Any, arrays: Mapping[str, AnyArray]) -> Any:
    if isinstance(value, list):
        return tuple(_read(one, arrays) for one in value)
    if not isinstance(value, dict):
        return value
    if "array" in value:
        result = arrays[value["array"]]
        return result.astype({"f": np.float64, "i": np.int64}.get(result.dtype.kind, result.dtype))
    if "pairs" in value:
        return {key: _read(one, arrays) for key, one in value["pairs"]}
    return _KINDS[value["class"]](**{k: _read(v, arrays) for k, v in value["fields"].items()})


View = Literal["isometric", "x", "y", "z", "-x", "-y", "-z"]
Up = Literal["x", "y", "z"]
AXES: tuple[Up, Up, Up] = ("x", "y", "z")

DIRECTIONS: dict[str, tuple[float, float, float]] = {
    "isometric": (1.0, -1.25, 0.85),
    "x": (1, 0, 0),
    "y": (0, 1, 0),
    "z": (0, 0, 1),
    "-x": (-1, 0, 0),
    "-y": (0, -1, 0),
    "-z": (0, 0, -1),
}
"""View to the direction from the body to the camera, where z is up."""
_SLANTED: dict[str, tuple[float, float, float]] = {
    "x": (0.85, 1.0, -1.25),
    "y": (1.0, 0.85, 1.25),
    "z": DIRECTIONS["isometric"],
}
"""Axis that is up to the direction of the isometric view."""
_BESIDE = {"x": (0.0, 1.0, 0.0), "y": (0.0, 0.0, -1.0), "z": (0.0, 1.0, 0.0)}
"""Axis that is up to what is up in a picture from above or below."""
SAFEST = 5.0
"""Safety factor above which all of them have one colour, that of no danger."""
SMALL_MATTERS = ("safety_factor",)
"""Fields whose small values matter: drawn in warm colours, large ones all alike."""
_NOTHING = 1e-9
"""Largest values below this share of the colour bar's are not marked: round-off of rest."""
_SAME = 1e-5
"""Distance over the size of the body below which a point is the one that is meant: files of scenes
have numbers of seven digits."""
_LINE = 20
"""Letters in a line above the colour bar; longer ones would not fit."""
_LABELS = {
    "von_mises": "von Mises stress",
    "von_mises_nodal": "von Mises stress",
    "von_mises_cell": "von Mises stress",
    "cauchy_stress": "Cauchy stress",
    "cauchy_stress_cell": "Cauchy stress",
    "pressure_cell": "pressure",
    "error": "estimated error of the stress",
    "first_piola": "first Piola stress",
    "green_strain": "Green strain",
    "jacobian": "det F",
    "young_modulus": "Young's modulus",
}


def label_of(field: str) -> str:
    """Name of a field for people."""
    return _LABELS.get(field, field.replace("_", " "))


def bar_of(
    values: FloatArray,
    spread: FloatArray,
    field: str,
    unit: str,
    *,
    noise: float = 0.0,
    ends: tuple[float, float] | None = None,
    tensor: bool = False,
    note: str = "",
    cut: bool = False,
    limit: float = 0.0,
) -> ColourBar:
    """The colour bar of some values.

    Args:
        values: Shown at the points [SI], shape (n,).
        spread: Values whose range the bar has, such as those of all pictures of a series.
        unit: Its SI unit.
        ends: Ends of the bar [SI] in place of those of the values.
        note: Last line above it; empty: none.
        cut: Values above its end are singular, which is told if there are any.
        limit: Value that is marked [SI]; 0: none.
    """
    small = field in SMALL_MATTERS
    if ends is None and small:
        ends = 0.0, SAFEST
    shown = spread if ends is None else np.array(ends)
    result = make_colour_bar(shown, unit, noise, exact=ends is not None)
    text = f"[{result.unit}]" if result.unit else ""
    if tensor:
        text = f"norm of the tensor\n{text}"
    if small and len(values) and np.nanmax(values) / result.factor > result.ticks[-1]:
        text = f"{result.ticks[-1]:g} and more alike"
    limit = 1.0 if small else limit / result.factor
    within = bool(limit) and result.ticks[0] < limit < result.ticks[-1]
    shown_limit = limit if within else None
    if limit and not small:
        text += f"\n{'allowable' if shown_limit is None else 'red: allowable'} {limit:.4g}"
    if cut and not small and np.nanmax(values) / result.factor > result.ticks[-1]:
        text += "\nmore where singular"
    label = "\n".join(filter(None, (fill(label_of(field), _LINE), text, note)))
    return replace(result, label=label, reversed=small, limit=shown_limit)


def _beyond(value: float, known: float, *, small: bool) -> bool:
    """Whether a value exceeds the one to judge by, which a clip plane may have left."""
    return not (value >= known * (1 - _SAME) if small else value <= known * (1 + _SAME))


def nearest(scene: Scene, place: FloatArray) -> int:
    """Number of the point at a place; -1: there is none.

    Args:
        place: Of the undeformed body [m], shape (3,).
    """
    away = np.linalg.norm(scene.points - place, axis=1)
    near = int(np.argmin(away))
    return near if away[near] <= _SAME * scene.diagonal else -1


def marked(picture: Picture) -> Picture:
    """A picture with a mark at the largest value, or where small ones matter at the smallest.

    Of nodes only: between them quadratic interpolation overshoots.  Where that value is singular it
    is said, and the one to judge by is marked, too.
    """
    bar, nodes = picture.bar, picture.scene.nodes
    assert bar is not None
    values = picture.frame.values[picture.field] / bar.factor
    if nodes is not None:
        values = np.where(nodes, values, np.nan)
    if not np.isfinite(values).any():
        return picture
    at = int(np.nanargmin(values) if bar.reversed else np.nanargmax(values))
    if abs(values[at]) <= max(_NOTHING * np.abs(bar.ticks).max(), picture.noise / bar.factor):
        return picture
    text = f"{'min' if bar.reversed else 'max'} {values[at]:.4g} {bar.unit}".strip()
    marks, known = [Mark(picture.moved[at], text)], picture.reliable
    if known is not None and _beyond(values[at] * bar.factor, known.value, small=bar.reversed):
        marks = [Mark(picture.moved[at], f"{text}: singular")]
        near = nearest(picture.scene, known.place)
        if np.isfinite(known.value) and near >= 0:
            text = f"{known.value / bar.factor:.4g} {bar.unit} {known.error}".strip()
            marks.append(Mark(picture.moved[near], " ".join(text.split())))
    return replace(picture, marks=tuple(marks))


def up_against(weights: Iterable[Sequence[object]]) -> Up:
    """The axis against which weight acts, z if there is none.

    Args:
        weights: Accelerations, each a number or a formula a component.
    """
    for weight in weights:
        along = [i for i, value in enumerate(weight) if value != 0]
        if len(along) == 1 and isinstance(value := weight[along[0]], int | float) and value < 0:
            return AXES[along[0]]
    return "z"


def axes_of(view: str, up: str = "z") -> tuple[FloatArray, FloatArray, FloatArray]:
    """Unit vectors to the camera, to the right and up in a picture.

    Args:
        view: One of `DIRECTIONS`.
        up: Axis that is up in it: x, y or z.
    """
    back = np.array(_SLANTED[up] if view == "isometric" else DIRECTIONS[view], dtype=float)
    back /= np.linalg.norm(back)
    pole = np.eye(3)["xyz".index(up)]
    if abs(back @ pole) > 1 - 1e-9:
        pole = np.array(_BESIDE[up])
    right = np.cross(pole, back)
    right /= np.linalg.norm(right)
    return back, right, np.cross(back, right)


def window(points: FloatArray, view: str, up: str = "z") -> FloatArray:
    """Lowest and highest coordinates of points along the picture's axes and its depth.

    Args:
        points: Shape (n, 3).
        view: One of `DIRECTIONS`.
        up: Axis that is up.

    Returns:
        Shape (2, 3): right, up, towards the camera.
    """
    back, right, top = axes_of(view, up)
    seen = points @ np.stack([right, top, back]).T
    return np.array([seen.min(axis=0), seen.max(axis=0)])


def joined_windows(windows: Sequence[AnyArray]) -> FloatArray:
    """The smallest window that contains all of these."""
    every = np.array(windows)
    return np.array([every[:, 0].min(axis=0), every[:, 1].max(axis=0)])
