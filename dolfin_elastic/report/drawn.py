"""The scene of a finished run: its states, modes or failed state, and what is beside them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.shapes.triangles import whole
from dolfin_elastic.core.si_text import number, quantity
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.geometry.simplices import qualities, signed_volumes
from dolfin_elastic.report.scene import Viewed, chosen_frames, node_values, surface_of
from dolfin_elastic.report.words import loads_act
from dolfin_elastic.results.finished.draw import allowable_of, obstacles_of, reliable_of
from dolfin_elastic.results.finished.findings import ModeRow, modes_of
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.finished.xdmf import Frame, damaged, read_array, read_frames, read_grid
from dolfin_elastic.results.scene.edges import sharp_edges
from dolfin_elastic.results.scene.obstacles import Reach, obstacles_beside
from dolfin_elastic.results.scene.scene import Frame as State
from dolfin_elastic.results.scene.scene import Glyphs, Reliable, Scene
from dolfin_elastic.results.verdict import ELSEWHERE

if TYPE_CHECKING:
    import pyvista

_FAILED = "failed_state.xdmf"
_MOST_MODES = 12


def drawn_frames(run: FinishedRun) -> list[tuple[str, Frame]]:
    """The states or modes that can be drawn, each with its label.

    Of a failed run the state that failed comes last.
    """
    modes = modes_of(run)[:_MOST_MODES]
    if modes:
        return list(_modes(run, modes))
    result = [(_label(run, frame.t), frame) for frame in run.frames]
    if run.summary.get("status") == "failed":
        for frame in read_frames(run.folder / _FAILED)[-1:]:
            result.append(("the state that failed, not in equilibrium", frame))
    return result


def _modes(run: FinishedRun, modes: Sequence[ModeRow]) -> Iterator[tuple[str, Frame]]:
    for row in modes:
        text = f", {row.value.text}" if row.value is not None else ""
        for frame in read_frames(run.folder / f"mode_{row.number:02d}.xdmf")[:1]:
            yield f"mode {row.number}{text}", frame


def _label(run: FinishedRun, t: float) -> str:
    return f"t = {quantity(t, 's')}" if run.timed else f"load factor {number(t)}"


def scene_of(run: FinishedRun, frames: Sequence[tuple[str, Frame]]) -> Viewed | None:
    """The scene; None where nothing can be drawn.

    Args:
        frames: From `drawn_frames`.

    Raises:
        InputError: Files of the fields are missing or damaged.
    """
    if not frames:
        return None
    grid = read_grid(run.folder, frames[-1][1])
    nodes, triangles, before = surface_of(grid)
    if not len(triangles):
        return None
    chosen = [frames[k] for k in chosen_frames(len(frames), len(nodes))]
    points, shown, times = np.asarray(grid.points, dtype=np.float64), [], list[float]()
    for label, frame in chosen:
        one = grid if frame is frames[-1][1] else read_grid(run.folder, frame)
        if np.array_equal(one.points, points):  # else the run went on with other ranks
            shown.append(_frame(label, one, nodes, allowable_of(run.case)))
            times.append(frame.t)
    glyphs = [Glyphs.of(row) for row in run.model.get("glyphs") or ()]
    scene = Scene(
        points[nodes],
        triangles,
        sharp_edges(points[nodes], triangles),
        tuple(shown),
        frames[-1][1].dim == 2,
        glyphs=tuple(one for one in glyphs if loads_act(run.case) or not one.load),
    )
    judged: dict[str, Reliable] = {}
    if run.frames and frames[-1][1] is run.frames[-1]:  # no mode, and not the state that failed
        rows = {name: reliable_of(run, name) for name in ELSEWHERE}
        judged = {name: known for name, known in rows.items() if known is not None}
    modes = bool(run.summary.get("modes"))
    viewed = Viewed(scene, modes, before, allowable_of(run.case), judged)
    return viewed if modes else _beside_obstacles(run, viewed, times)


def _beside_obstacles(run: FinishedRun, viewed: Viewed, times: Sequence[float]) -> Viewed:
    """A scene with its obstacles.

    Each is as far from the nearest point of the body as it is, however magnified that one moves.

    Args:
        times: Of the frames, in the unit of the obstacles' motion: [s], or load parameters.
    """
    x, scale, reach = viewed.scene.points, viewed.scale, Reach()
    reach.take(x)
    frames: list[list[FloatArray]] = []
    for t, frame in zip(times, viewed.scene.frames, strict=True):
        reach.take(x + scale * frame.u)
        frames.append([])
        for _, shape, shift in obstacles_of(run, t):
            places = (x + frame.u)[:, : run.dim] - shift
            near = int(np.argmin(shape.gaps(places)[0]))
            frames[-1].append(np.stack([whole(shift), frame.u[near]]))
    ways = tuple(np.nan_to_num(np.array(way)) for way in zip(*frames, strict=True))
    shifts = (way[-1, 0] + (scale - 1) * way[-1, 1] for way in ways)
    rows = [
        (name, shape, shift[: run.dim])
        for (name, shape, _), shift in zip(obstacles_of(run, times[-1]), shifts, strict=True)
    ]
    scene = replace(viewed.scene, obstacles=obstacles_beside(rows, reach, run.dim))
    return replace(viewed, scene=scene, ways=ways)


def _frame(label: str, grid: pyvista.UnstructuredGrid, nodes: IntArray, allowable: float) -> State:
    values = {name: v[nodes] for name, v in node_values(grid, allowable).items()}
    u = np.zeros((grid.n_points, 3))
    if "displacement" in grid.point_data:
        given = np.asarray(grid.point_data["displacement"], dtype=np.float64)
        u[:, : given.shape[1]] = given
    u = u[nodes]
    u[~np.isfinite(u)] = 0.0
    return State(label, u, {**values, "displacement": np.linalg.norm(u, axis=1)})


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
    frame = frames[-1][1]
    cells, x = read_array(run.folder, frame.cells), read_array(run.folder, frame.points)
    corners = np.asarray(x[cells[:, : frame.dim + 1], : frame.dim], dtype=np.float64)
    if not math.isfinite(float(np.abs(corners).max(initial=0.0))):
        raise damaged("points of the mesh are not finite", str(Path(run.folder)))
    return qualities(corners), np.abs(signed_volumes(corners))
