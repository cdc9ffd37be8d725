"""`Appearance`: how pictures of results show the body, and the picture of a surface with values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.shapes.shapes import Shape
from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.core.units import to_si
from dolfin_elastic.results.fields import FIELDS
from dolfin_elastic.results.scene.clip import Clip, clipped
from dolfin_elastic.results.scene.obstacles import Reach, obstacles_beside
from dolfin_elastic.results.scene.scene import (
    Frame,
    Patch,
    Picture,
    Reliable,
    Scene,
    Up,
    View,
    label_of,
)
from dolfin_elastic.results.scene.series import Limits
from dolfin_elastic.results.scene.surface import Surface

CATEGORIES = ("material", "region")
"""Fields of numbers that stand for names: drawn in distinct colours with a legend."""
STATUS = "contact_status"
"""A field of nodes whose numbers stand for `STATES`: faces have that of their nodes."""
STATES = ("open", "sticks", "slides")
_COLOURS = {STATUS: ("#cccccc", "#4477aa", "#ee6677")}
_NAMED = ("#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377", "#bbbbbb", "#ee8866")


@dataclass(frozen=True)
class Appearance:
    """How a picture shows the body.

    Attributes:
        scale: Magnification of the displacement.
        view: Axis along which the body is seen; plane bodies are always seen from the front.
        title: Text above the body, before load or time.
        limits: Ends of the colours.
        marks: The largest value is marked, of safety factors the smallest.
        obstacles: The rigid obstacles of contacts are drawn, too.
        up: Axis that is up; None: the one against which weight acts, else z.
        clips: Planes that take away a part.
        film: They are frames of a film: of a motion without the undeformed body.
        bare: Nothing stands beside the body: no title, no colour bar, no axes.
    """

    scale: float = 1.0
    view: View = "isometric"
    title: str = ""
    limits: Limits = field(default_factory=Limits)
    marks: bool = True
    obstacles: bool = True
    up: Up | None = None
    clips: Sequence[Clip] = ()
    film: bool = False
    bare: bool = False


DEFAULT = Appearance()


def picture_of(
    surface: Surface,
    cells: Surface | None,
    look: Appearance,
    reach: Reach,
    name: str,
    *,
    plane: bool,
    title: str,
    shown: Callable[[FloatArray], FloatArray],
    names: Sequence[str] = (),
    noise: float = 0.0,
    obstacles: Sequence[tuple[str, Shape, FloatArray]] = (),
    outline: bool = True,
    allowable: float = 0.0,
    reliable: Reliable | None = None,
) -> Picture:
    """The picture of a surface, as clip planes leave it.

    Args:
        surface: Its values are the displacement "u" and components "value"; where its numbers
            stand for names these are `of_cells`.
        cells: Those that the planes cut, or all; None of a plane body.
        reach: Of the body in all states so far.
        shown: Components at points to what is shown, shape (n, 1).
        obstacles: See `obstacles_beside`.
        allowable: See `common_allowable`.
        reliable: See `Picture`.
    """
    view, up = "z" if plane else look.view, look.up or "z"
    left = clipped(surface, cells, look.clips, view, up)
    u = left.values["u"]
    if len(left.points):  # else `Series.add` refuses it
        reach.take(left.points + look.scale * u)
    colours = _COLOURS.get(name, _NAMED)
    scene = Scene(
        left.points,
        left.triangles,
        left.edges,
        (Frame("", u, {} if names else {name: shown(left.values["value"]).ravel()}),),
        plane,
        left.nodes,
        left.skin,
        left.of_cells if names else None,
        tuple(Patch((n,), colour=colours[i % len(colours)]) for i, n in enumerate(names)),
        obstacles=obstacles_beside(obstacles, reach, 2 if plane else 3) if look.obstacles else (),
    )
    known = FIELDS.get(name)
    return Picture(
        scene,
        view,
        up,
        title=title,
        field="" if names else name,
        unit=known.unit if known else "",
        tensor=bool(known and known.shape == "tensor"),
        noise=noise,
        label=label_of(name),
        scale=look.scale,
        outline=outline,
        bare=look.bare,
        film=look.film,
        allowable=allowable if name.startswith("von_mises") else 0.0,
        reliable=reliable,
    )


def status_of(corners: AnyArray, dim: int) -> AnyArray:
    """Status of faces or cells, `STATES`: open unless all corners of one face touch.

    Args:
        corners: Status at their corners, shape (n, corners).
        dim: Corners of a face: 2 in a plane, 3 in space.
    """
    touching = np.sort(corners, axis=1)[:, -dim:]
    return np.asarray(np.where(touching[:, 0] == 0, 0, touching[:, -1]).astype(np.int64))


def common_allowable(values: Sequence[object]) -> float:
    """The allowable stress of all materials [Pa]; 0 where they have none, or not the same one.

    Args:
        values: Of each material, as a case or a law has it.
    """
    if not values or any(value != values[0] for value in values):
        return 0.0
    try:
        return float(to_si(values[0], "Pa"))
    except (InputError, TypeError, ValueError):  # none, a field of the mesh, or a formula
        return 0.0
