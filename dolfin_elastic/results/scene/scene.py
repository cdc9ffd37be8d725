"""What the drawing process is told of one picture; plain numbers only.

A run and `plot`, which reads a finished one, make their pictures of the same parts: the colours of
the values, the camera, the mark at the largest value.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from textwrap import fill
from typing import Any, Literal, TypeAlias

import numpy as np

from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.results.scene.colour_bar import make_colour_bar

Scene: TypeAlias = dict[str, Any]
"""Arrays, texts and numbers of one picture by name, as `_draw.py` reads them from a file."""
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


def colours(
    values: FloatArray,
    spread: FloatArray,
    field: str,
    unit: str,
    *,
    noise: float = 0.0,
    ends: tuple[float, float] | None = None,
    tensor: bool = False,
) -> Scene:
    """Values with ticks and label of the colour bar.

    Args:
        values: Shown at the points [SI], shape (n,).
        spread: Values whose range the bar has, such as those of all pictures of a series.
        unit: Its SI unit.
        ends: Ends of the bar [SI] in place of those of the values.
    """
    small = field in SMALL_MATTERS
    if ends is None and small:
        ends = 0.0, SAFEST
    shown = spread if ends is None else np.array(ends)
    found = make_colour_bar(shown, unit, noise, exact=ends is not None)
    text = f"[{found.unit}]" if found.unit else ""
    if tensor:
        text = f"norm of the tensor\n{text}"
    if small and len(values) and np.nanmax(values) > found.ticks[-1]:
        text = f"{found.ticks[-1]:g} and more alike"
    return {
        "value": values / found.factor,
        "ticks": found.ticks,
        "reversed": small,
        "form": found.form,
        "label": f"{fill(label_of(field), _LINE)}\n{text}".strip(),
    }


def mark(points: FloatArray, data: Scene, *, small: bool) -> Scene:
    """Place and text of the mark at the largest value, or where small ones matter at the smallest.

    Args:
        points: Where the points are drawn, shape (n, 3).
        data: From `colours`; with `nodes`, shape (n,), only these points count: between them
            quadratic interpolation overshoots.
    """
    values = np.asarray(data["value"], dtype=float)
    if "nodes" in data:
        values = np.where(data["nodes"], values, np.nan)
    if not np.isfinite(values).any():
        return {}
    at = int(np.nanargmin(values) if small else np.nanargmax(values))
    if abs(values[at]) <= _NOTHING * np.abs(data["ticks"]).max():
        return {}
    unit = str(data["label"]).rpartition("[")[2].rstrip("]") if "[" in data["label"] else ""
    word = "min" if small else "max"
    return {"mark": points[at], "mark_text": f"{word} {values[at]:.4g} {unit}".strip()}


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


def camera(view: str, up: str, seen: FloatArray) -> Scene:
    """The camera's directions and what it has to show.

    Args:
        view: One of `DIRECTIONS`.
        up: Axis that is up.
        seen: From `window`.
    """
    back, right, top = axes_of(view, up)
    return {"back": back, "right": right, "up": top, "window": seen}
