"""Pictures and films of a finished run, as it draws them itself."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.compat import surface_of
from dolfin_elastic.core.errors import InputError, nearest
from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.model.amplitude import CONSTANT, PROPORTIONAL
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.model.loads.forces import Gravity
from dolfin_elastic.results.derived.spectral import von_mises
from dolfin_elastic.results.fields import FIELDS
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.scene.clip import Clip, sections, whole_scene
from dolfin_elastic.results.scene.obstacles import Reach, obstacle_scene
from dolfin_elastic.results.scene.scene import Scene, Up, label_of, up_against, window
from dolfin_elastic.results.scene.series import Limits, Series, film_times

if TYPE_CHECKING:
    import pyvista

_NODES, _IDS = "nodes", "vtkOriginalPointIds"
_ROUND_OFF = 1e-12
"""Coordinates below this share of the body's length are 0."""
_SUBDIVISION = 2
"""Halvings of the faces of quadratic cells."""


@dataclass(frozen=True)
class Look:
    """How a finished run is drawn.

    Attributes:
        fields: Names of what is in its fields, seen side by side.
        view: See `scene.View`.
        scale: Magnification of the displacement.
        title: Text above the body; None: the case's title.
        limits: Ends of the colours.
        marks: The largest value is marked.
        obstacles: The rigid obstacles are drawn.
        clips: Planes that take away a part.
        up: Axis that is up; None: the one against which weight acts, else z.
        bare: Nothing stands beside the body: no title, no colour bar, no axes.
    """

    fields: Sequence[str]
    view: str = "isometric"
    scale: float = 1.0
    title: str | None = None
    limits: Limits = field(default_factory=Limits)
    marks: bool = True
    obstacles: bool = True
    clips: Sequence[Clip] = ()
    up: Up | None = None
    bare: bool = False


def check_field(run: FinishedRun, name: str, step: int = -1) -> str:
    """Checks that a step holds a field, and returns its name.

    Args:
        step: See `FinishedRun.frame`.

    Raises:
        InputError: It does not.
    """
    known = run.fields(step)
    if name not in known:
        more = f"; compute with [output] fields = [..., '{name}']" if name in FIELDS else ""
        raise InputError(
            f"there is no field '{name}'",
            where=str(run.folder),
            expected=(f"known: {', '.join(known)}" if more else nearest(name, known)) + more,
        )
    return name


def draw(run: FinishedRun, look: Look, file: Path, step: int = -1) -> None:
    """Draws one step.

    Args:
        file: The PNG file.
        step: See `FinishedRun.frame`.

    Raises:
        InputError: There is no such step or field, or nothing is left by the clip planes.
        OutputError: It cannot be drawn or written.
    """
    panels = _panels(run, look, step, Reach())
    series = Series(look.limits, marks=look.marks)
    try:
        series.add(0, panels)
        series.draw(0, panels, file)
    finally:
        series.close()


def film(run: FinishedRun, look: Look, file: Path, *, fps: float, speed: float) -> None:
    """Joins all steps to a film in even time.

    Args:
        file: The .mp4 or .gif file.
        speed: Time [s], in statics load, that passes in a second of the film.

    Raises:
        InputError: See `draw`.
        OutputError: See `draw`.
    """
    run.frame()  # there must be one
    with tempfile.TemporaryDirectory() as scratch:
        series = Series(look.limits, marks=look.marks, folder=Path(scratch) / "frames")
        try:
            reach = Reach()
            for step in range(len(run.steps)):
                panels = _panels(run, look, step, reach)
                series.add(step, [{**one, "outline": not run.moving} for one in panels])
            series.film(file, film_times(run.steps, speed), range(len(run.steps)), fps)
        finally:
            series.close()


def _panels(run: FinishedRun, look: Look, step: int, reach: Reach) -> list[Scene]:
    for name in look.fields:
        check_field(run, name, step)
    whole = run.grid(step)
    return [_panel(run, look, step, whole, name, reach) for name in look.fields]


def _panel(
    run: FinishedRun,
    look: Look,
    step: int,
    whole: pyvista.UnstructuredGrid,
    name: str,
    reach: Reach,
) -> Scene:
    frame = run.frame(step)
    grid = whole.copy(deep=False)
    if frame.arrays[name].centre == "cell":
        grid = grid.cell_data_to_point_data(pass_cell_data=True)
    view, up = ("z" if run.dim == 2 else look.view), look.up or _up(run)
    _check_planes(grid, look.clips)
    skin = _skin(grid)
    surface = _clipped(skin, grid, look.clips, view, up)
    points, triangles, u = _moving(surface)
    moved = points + look.scale * u
    reach.take(moved)
    return {
        "points": points,
        "triangles": triangles,
        "u": u,
        "scale": look.scale,
        "view": view,
        "up_axis": up,
        "window": window(np.vstack([points, moved]), view, up),
        "title": _headline(run, look, frame.t),
        "bare": look.bare,
        "plane": run.dim == 2,
        **whole_scene(*_moving(skin), look.clips, view, up),
        **_values(run, surface, name),
        **(_obstacles(run, reach, frame.t) if look.obstacles else {}),
    }


def _moving(surface: pyvista.PolyData) -> tuple[FloatArray, AnyArray, FloatArray]:
    """Points, triangles and the displacement of the points."""
    points = np.asarray(surface.points, dtype=float)
    u = np.zeros_like(points)
    if "displacement" in surface.point_data:
        u = np.asarray(surface.point_data["displacement"], dtype=float)
    return points, surface.faces.reshape(-1, 4)[:, 1:].astype(np.int64), u


def _up(run: FinishedRun) -> Up:
    if run.dim == 2:
        return "z"
    rows = [dict(row) for row in run.case.get("load", []) if row.get("kind") == "gravity"]
    return up_against(Gravity(**row).acceleration(run.dim) for row in rows)


def _ends(grid: pyvista.DataSet) -> FloatArray:
    """Lowest and highest coordinate along each axis [m], shape (3, 2)."""
    ends = np.array(grid.bounds, dtype=np.float64).reshape(3, 2)
    ends[np.abs(ends) < _ROUND_OFF * grid.length] = 0.0
    return ends


def _check_planes(grid: pyvista.DataSet, clips: Sequence[Clip]) -> None:
    ends = _ends(grid)
    for clip in clips:
        axis, (low, high) = "xyz"[clip.axis], ends[clip.axis]
        if low == high:
            raise InputError(
                f"the body is plane, it has no {axis}", where="--clip", expected="x or y"
            )
        if not low < clip.at < high:
            raise InputError(
                f"the plane {axis} = {clip.at:.4g} m misses the body",
                where="--clip",
                expected=f"between {low:.4g} and {high:.4g} m",
            )


def _skin(grid: pyvista.UnstructuredGrid) -> pyvista.PolyData:
    """The surface of the whole body, of triangles."""
    surface = surface_of(grid, nonlinear_subdivision=_SUBDIVISION, pass_pointid=True)
    surface.point_data[_NODES] = (surface.point_data[_IDS] >= 0).astype(float)
    return surface.triangulate()


def _clipped(
    skin: pyvista.PolyData,
    grid: pyvista.UnstructuredGrid,
    clips: Sequence[Clip],
    view: str,
    up: str,
) -> pyvista.PolyData:
    """The surface of what the clip planes leave, of triangles."""
    whole = grid.copy(deep=False)
    whole.point_data[_NODES] = np.ones(grid.n_points)
    left = sections(skin, whole, clips, view, up)
    if not left.n_cells:
        ends = enumerate(_ends(grid))
        sides = (f"{'xyz'[i]} = {low:.4g} to {high:.4g}" for i, (low, high) in ends)
        raise InputError(
            "nothing of the body is left",
            where="--clip",
            expected=f"planes that leave a part of it, {', '.join(sides)} m",
        )
    return left


def _values(run: FinishedRun, surface: pyvista.PolyData, name: str) -> Scene:
    field = FIELDS.get(name)
    if name == "material" and run.case.get("materials"):
        numbers = np.asarray(surface.cell_data[name]).astype(np.int64)
        return {"value": numbers, "names": list(run.case["materials"]), "label": label_of(name)}
    return {
        "value": shown(surface.point_data, name),
        "nodes": np.asarray(surface.point_data[_NODES]) > 1 - 1e-9,
        "field": name,
        "unit": field.unit if field else "",
        "noise": 0.0,
        "tensor": bool(field and field.shape == "tensor"),
    }


def shown(data: Mapping[str, FloatArray], name: str) -> FloatArray:
    """The value that is shown at points, shape (n,): of vectors and tensors the norm.

    The von Mises stress follows from the interpolated Cauchy stress, where the run has written
    that: between tension and compression it falls to zero.

    Args:
        data: Name of a field to its values at the points.
    """
    if name == "von_mises" and "cauchy_stress" in data:
        return von_mises(np.asarray(data["cauchy_stress"], dtype=float))[:, 0]
    values = np.asarray(data[name], dtype=float)
    return values if values.ndim == 1 else np.asarray(np.linalg.norm(values, axis=1))


def _headline(run: FinishedRun, look: Look, t: float) -> str:
    title = look.title if look.title is not None else str(run.case.get("title", ""))
    place = f"t = {t:.4g} s" if run.moving else f"load {100 * t:.4g} %"
    scale = f"deformation \u00d7 {look.scale:g}"
    return "   |   ".join(filter(None, (title, place, scale)))


def _obstacles(run: FinishedRun, reach: Reach, t: float) -> Scene:
    default = CONSTANT if run.moving else PROPORTIONAL
    pairs = []
    for row in run.case.get("contact", []):
        contact = Contact(**row).in_metres(run.metres)
        shift = np.array(contact.displacement_at(t, default, run.dim))
        pairs.append((contact.obstacle, shift))
    return obstacle_scene(pairs, reach, run.dim)
