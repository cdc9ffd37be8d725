"""Pictures and films of a finished run, as it draws them itself."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.errors import InputError, nearest
from dolfin_elastic.core.shapes.rigid_mesh import Facets, RigidMesh
from dolfin_elastic.core.shapes.shapes import Shape
from dolfin_elastic.core.si_text import time_or_load
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.amplitude import CONSTANT, PROPORTIONAL
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.model.loads.forces import Gravity
from dolfin_elastic.results.derived.spectral import von_mises
from dolfin_elastic.results.fields import FIELDS
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.scene.appearance import (
    STATES,
    STATUS,
    Appearance,
    common_allowable,
    picture_of,
    status_of,
)
from dolfin_elastic.results.scene.clip import Clip
from dolfin_elastic.results.scene.obstacles import Reach
from dolfin_elastic.results.scene.scene import Picture, Reliable, Up, up_against
from dolfin_elastic.results.scene.series import Series, film_times
from dolfin_elastic.results.scene.surface import Surface, divided, outer_faces
from dolfin_elastic.results.verdict import ELSEWHERE

if TYPE_CHECKING:
    import pyvista

_ROUND_OFF = 1e-12
"""Coordinates below this share of the body's length are 0."""


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
        more = more if run.history else ""  # modes have one field
        raise InputError(
            f"there is no field '{name}'",
            where=str(run.folder),
            expected=(f"known: {', '.join(known)}" if more else nearest(name, known)) + more,
        )
    return name


def draw(
    run: FinishedRun, fields: Sequence[str], look: Appearance, file: Path, step: int = -1
) -> None:
    """Draws one step.

    Args:
        fields: Names of what is in its fields, seen side by side.
        look: Without a title it is the case's.
        file: The PNG file.
        step: See `FinishedRun.frame`.

    Raises:
        InputError: There is no such step or field, or nothing is left by the clip planes.
        OutputError: It cannot be drawn or written.
    """
    panels = _panels(run, fields, look, step, Reach())
    series = Series(look.limits, marks=look.marks)
    try:
        series.add(0, panels)
        series.draw(0, panels, file)
    finally:
        series.close()


def film(
    run: FinishedRun,
    fields: Sequence[str],
    look: Appearance,
    file: Path,
    *,
    fps: float,
    speed: float,
) -> None:
    """Joins all steps to a film in even time.

    Args:
        fields: See `draw`.
        look: See `draw`.
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
            reach, look = Reach(), replace(look, film=True)
            for step in range(len(run.steps)):
                series.add(step, _panels(run, fields, look, step, reach))
            series.film(file, film_times(run.steps, speed), range(len(run.steps)), fps)
        finally:
            series.close()


def _panels(
    run: FinishedRun, fields: Sequence[str], look: Appearance, step: int, reach: Reach
) -> list[Picture]:
    for name in fields:
        check_field(run, name, step)
    grid = run.grid(step)
    _check_planes(grid, look.clips)
    return [_panel(run, look, step, grid, name, reach) for name in fields]


def _panel(
    run: FinishedRun,
    look: Appearance,
    step: int,
    grid: pyvista.UnstructuredGrid,
    name: str,
    reach: Reach,
) -> Picture:
    x, (cells,) = np.asarray(grid.points, dtype=float), grid.cells_dict.values()
    names = list(run.case.get("materials") or {}) if name == "material" else []
    names = list(STATES) if name == STATUS else names
    at_cells = run.frame(step).arrays[name].centre == "cell"
    whole = grid.cell_data_to_point_data(pass_cell_data=True) if at_cells else grid
    u = np.zeros_like(x)
    if "displacement" in grid.point_data:
        u = np.asarray(grid.point_data["displacement"], dtype=float)
    values = {"u": u}
    tensor = name == "von_mises" and "cauchy_stress" in grid.point_data
    if not names:
        result = np.asarray(whole.point_data["cauchy_stress" if tensor else name], dtype=float)
        values["value"] = result.reshape(len(result), -1)
    faces, of = outer_faces(cells.astype(np.int64), x)
    numbers = on_faces = None
    if name == STATUS:
        status = np.asarray(grid.point_data[name]).ravel()
        numbers = status_of(status[cells[:, : run.dim + 1]], run.dim)
        on_faces = status_of(status[faces[:, :3]], run.dim)
    elif names:
        numbers = np.asarray(grid.cell_data[name]).astype(np.int64)
        on_faces = numbers[of]
    surface = divided(
        Surface(faces, x, values, on_faces),
        () if not (names or at_cells) and (tensor or values["value"].shape[1] > 1) else ("value",),
    )
    last = step in (-1, len(run.steps) - 1)
    left = picture_of(
        surface,
        Surface(cells, x, values, numbers) if run.dim == 3 else None,
        replace(look, up=look.up or up_of(run)),
        reach,
        name,
        plane=run.dim == 2,
        title=_headline(run, look, run.frame(step).t),
        shown=lambda rows: shown({name: rows, **({"cauchy_stress": rows} if tensor else {})}, name),
        names=names,
        obstacles=obstacles_of(run, run.frame(step).t),
        outline=not (look.film and run.moving),
        noise=round_off_of(run, name) if last else 0.0,
        allowable=allowable_of(run.case),
        reliable=reliable_of(run, name) if last else None,
    )
    if not len(left.scene.triangles):
        ends = enumerate(_ends(grid))
        sides = (f"{'xyz'[i]} = {low:.4g} to {high:.4g}" for i, (low, high) in ends)
        raise InputError(
            "nothing of the body is left",
            where="--clip",
            expected=f"planes that leave a part of it, {', '.join(sides)} m",
        )
    return left


def allowable_of(case: Mapping[str, object]) -> float:
    """See `common_allowable`."""
    tables = case.get("materials")
    rows = [*tables.values()] if isinstance(tables, Mapping) else []
    return common_allowable([r.get("allowable") if isinstance(r, Mapping) else None for r in rows])


def reliable_of(run: FinishedRun, name: str) -> Reliable | None:
    """What to judge by in the last state, where the largest value of a field is singular."""
    error, other = run.summary.get("error"), ELSEWHERE.get(name, "")
    return Reliable.of(error.get(name), error.get(other)) if isinstance(error, Mapping) else None


def round_off_of(run: FinishedRun, name: str) -> float:
    """Stress [Pa] below which all of the last state is round-off; 0: it has one that counts."""
    peak = run.summary.get("extremes", {}).get("von_mises", {})
    left = name == "von_mises" and run.summary.get("unloaded")
    return 2 * float(peak.get("value") or 0.0) if left else 0.0


def up_of(run: FinishedRun) -> Up:
    """The axis that is up in pictures of a run, see `up_against`; in a plane z."""
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


def _headline(run: FinishedRun, look: Appearance, t: float) -> str:
    title = look.title or str(run.case.get("title", ""))
    place = time_or_load(t, timed=run.timed)
    scale = f"deformation \u00d7 {look.scale:g}"
    return "   |   ".join(filter(None, (title, place, scale)))


def obstacles_of(run: FinishedRun, t: float) -> list[tuple[str, Shape, FloatArray]]:
    """What stands beside each obstacle, its shape in metres, and its displacement [m].

    Args:
        t: Time [s], or load parameter.
    """
    default = CONSTANT if run.moving else PROPORTIONAL
    contacts = {
        f"contact[{i}]": Contact(**row).in_metres(run.metres)
        for i, row in enumerate(run.case.get("contact", []))
        if not {"between", "self", "all"} & row.keys()
    }
    drawn = run.model.get("obstacles") or {}

    def shift(one: Contact) -> FloatArray:
        moved = run.history.get(f"obstacle_displacement_{one.label}")
        if moved is None:
            return np.array(one.displacement_at(t, default, run.dim))
        return np.asarray(np.interp(t, run.history["t"], moved) * one.way(run.dim))

    result = []
    for key, one in contacts.items():
        shape = one.obstacle
        if isinstance(shape, RigidMesh):
            if key not in drawn:
                continue
            shape = shape.with_facets(Facets.read(drawn[key]))
        pose = one.pose_at(t, default, run.dim)
        result.append((one.label, one.turned(shape, pose), shift(one)))
    return result
