"""The scene of a finished run: its states, modes or failed state, with supports and loads."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.si_text import number, quantity
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.core.units import to_si
from dolfin_elastic.mesh.geometry.simplices import qualities, signed_volumes
from dolfin_elastic.report.scene import Marks, Scene, View, chosen_frames, node_values, surface_of
from dolfin_elastic.report.words import Table, part_names
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.finished.xdmf import Frame, read_frames, read_grid

if TYPE_CHECKING:
    import pyvista

_FAILED = "failed_state.xdmf"
_MOST_MODES = 12
_PUSHES = ("pressure", "cavity")


def drawn_frames(run: FinishedRun) -> list[tuple[str, Frame]]:
    """The states or modes that can be drawn, each with its label.

    Of a failed run the state that failed comes last.
    """
    modes = run.summary.get("modes") or []
    if modes:
        return list(_modes(run, modes[:_MOST_MODES]))
    found = [(_label(run, frame.t), frame) for frame in run.frames]
    if run.summary.get("status") == "failed":
        for frame in read_frames(run.folder / _FAILED)[-1:]:
            found.append(("the state that failed, not in equilibrium", frame))
    return found


def _modes(run: FinishedRun, modes: Sequence[Table]) -> Iterator[tuple[str, Frame]]:
    for row in modes:
        count = int(row.get("mode", 0))
        frames = read_frames(run.folder / f"mode_{count:02d}.xdmf")
        if not frames:
            continue
        value = row.get("load_factor") if row.get("kind") == "buckling" else row.get("frequency")
        unit = "" if row.get("kind") == "buckling" else "Hz"
        text = f", {quantity(float(value), unit)}" if isinstance(value, int | float) else ""
        yield f"mode {count}{text}", frames[0]


def _label(run: FinishedRun, t: float) -> str:
    return f"t = {quantity(t, 's')}" if run.moving else f"load factor {number(t)}"


def scene_of(run: FinishedRun, frames: Sequence[tuple[str, Frame]]) -> Scene | None:
    """The scene; None where nothing can be drawn.

    Args:
        frames: From `drawn_frames`.

    Raises:
        InputError: Files of the fields are missing or damaged.
    """
    if not frames:
        return None
    grid = read_grid(run.folder, frames[-1][1])
    nodes, triangles, edges, before = surface_of(grid)
    if not len(triangles):
        return None
    chosen = [frames[k] for k in chosen_frames(len(frames), len(nodes))]
    points = np.asarray(grid.points, dtype=np.float64)
    views = []
    for label, frame in chosen:
        shown = grid if frame is frames[-1][1] else read_grid(run.folder, frame)
        if np.array_equal(shown.points, points):  # else the run went on with other ranks
            views.append(_view(label, shown, nodes, _allowable(run.case)))
    dim = frames[-1][1].dim
    return Scene(
        points=points[nodes],
        triangles=triangles,
        edges=edges,
        views=tuple(views),
        plane=dim == 2,
        modes=bool(run.summary.get("modes")),
        of=before,
        marks=tuple(_marks(run, points[nodes])),
    )


def _allowable(case: Table) -> float | None:
    """The allowable stress [Pa], where all materials have the same one."""
    tables = case.get("materials")
    rows = [*tables.values()] if isinstance(tables, Mapping) else []
    given = [row.get("allowable") if isinstance(row, Mapping) else None for row in rows]
    if not given or any(value is None or value != given[0] for value in given):
        return None
    try:
        return to_si(given[0], "Pa")
    except InputError:  # a field of the mesh, or a formula
        return None


def _view(
    label: str, grid: pyvista.UnstructuredGrid, nodes: IntArray, allowable: float | None
) -> View:
    values = {name: v[nodes] for name, v in node_values(grid, allowable).items()}
    u = np.zeros((grid.n_points, 3))
    if "displacement" in grid.point_data:
        given = np.asarray(grid.point_data["displacement"], dtype=np.float64)
        u[:, : given.shape[1]] = given
    u = u[nodes]
    u[~np.isfinite(u)] = 0.0
    return View(label, u, {**values, "displacement": np.linalg.norm(u, axis=1)})


# --- supports and loads ---


def _marks(run: FinishedRun, points: FloatArray) -> Iterator[Marks]:
    """Arrows of what the run has noted places of."""
    parts = run.model.get("parts") or {}
    sums = run.model.get("loads") or []
    for k, row in enumerate(run.case.get("support") or []):
        rows = _places(parts, part_names(row))
        if len(rows):
            yield _held(f"support {k}", rows, points)
    for k, row in enumerate(run.case.get("load") or []):
        force = next(
            (s.get("force") for s in sums if str(s.get("load", "")).startswith(f"load[{k}]")), None
        )
        rows = _places(parts, part_names(row))
        if found := _acting(f"load {k}", row, rows, force, points):
            yield found


def _places(parts: Table, on: Sequence[str]) -> FloatArray:
    """Places, and for surfaces normals, shape (n, 6); normals of others are 0."""
    found = []
    for name in on:
        for row in (parts.get(name) or {}).get("places") or []:
            numbers = [float(value) for value in row]
            dim = 2 if len(numbers) in (2, 4) else 3
            x, normal = numbers[:dim], numbers[dim:]
            found.append([*x, *[0.0] * (3 - dim), *normal, *[0.0] * (3 - len(normal))])
    return np.array(found).reshape(-1, 6)


def _held(name: str, rows: FloatArray, points: FloatArray) -> Marks:
    """Wedges that point at the surface from outside."""
    inward = -rows[:, 3:]
    inward[~inward.any(axis=1)] = (0.0, 1.0, 0.0) if np.ptp(points[:, 2]) == 0 else (0.0, 0.0, 1.0)
    return Marks(name, False, _nearest(rows[:, :3], points), inward, (False,) * len(rows))


def _acting(
    name: str,
    table: Table,
    rows: FloatArray,
    force: Sequence[float] | None,
    points: FloatArray,
) -> Marks | None:
    """Arrows along a load; one in the middle of the body for a load on the whole of it."""
    along = np.zeros(3)
    if force is not None:
        along[: min(len(force), 3)] = force[:3]
    follows = str(table.get("kind")) in _PUSHES
    if follows and len(rows):
        pushes = _sign(table)
        return Marks(
            name,
            True,
            _nearest(rows[:, :3], points),
            -pushes * rows[:, 3:],
            (pushes < 0,) * len(rows),
        )
    if not along.any():
        return None
    if not len(rows) and "at" in table:
        return None
    if not len(rows):
        return Marks(name, True, np.array([-1]), along[None], (True,))
    directions = np.tile(along, (len(rows), 1))
    away = np.einsum("ij,ij->i", rows[:, 3:], directions) >= 0
    return Marks(
        name, True, _nearest(rows[:, :3], points), directions, tuple(bool(x) for x in away)
    )


def _sign(table: Table) -> float:
    """-1 of suction."""
    for key in ("value", "pressure"):
        text = str(table.get(key, "")).strip()
        if text.startswith("-"):
            return -1.0
    return 1.0


def _nearest(places: FloatArray, points: FloatArray) -> IntArray:
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(points).query(places)[1], dtype=np.int64)


# --- the mesh ---


def mesh_quality(
    run: FinishedRun, frames: Sequence[tuple[str, Frame]]
) -> tuple[FloatArray, FloatArray]:
    """Quality and volume (area in a plane) of the cells, shape (n,) each; see `qualities`.

    Args:
        frames: From `drawn_frames`; at least one.

    Raises:
        InputError: The mesh's file is missing or damaged.
    """
    from dolfin_elastic.results.finished.xdmf import damaged, read_array

    frame = frames[-1][1]
    cells, x = read_array(run.folder, frame.cells), read_array(run.folder, frame.points)
    corners = np.asarray(x[cells[:, : frame.dim + 1], : frame.dim], dtype=np.float64)
    if not math.isfinite(float(np.abs(corners).max(initial=0.0))):
        raise damaged("points of the mesh are not finite", str(Path(run.folder)))
    return qualities(corners), np.abs(signed_volumes(corners))
