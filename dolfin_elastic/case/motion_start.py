"""The state that a motion starts from: of the results of a run, or fields of the mesh's file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.compat import interpolation_points
from dolfin_elastic.core.errors import InputError, nearest
from dolfin_elastic.core.parallel import agree, on_root, total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import extent
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.results.finished.xdmf import Frame, read_array, read_frames

if TYPE_CHECKING:
    from dolfin_elastic.solvers.dynamics.settings import MotionStart

NEAR = 1e-6
"""Distance of a node from a point of the results over the body's length, where they are the same.

Meshes are read and generated with at least seven digits."""
_CHUNK = 1 << 18
"""Points of the results that a rank reads at a time."""
_FILE = "dynamics.start.file"


def read_start(start: MotionStart, folder: Path, problem: Problem) -> tuple[FloatArray, FloatArray]:
    """Displacement [m] and velocity [m/s] of all local nodes, unrolled. Collective.

    Args:
        start: Where they are.
        folder: That of the case file.

    Raises:
        InputError: There is no such file, step or field, or the mesh is another one.
    """
    if start.file is not None:
        return _of_results(start, folder / start.file, problem)
    names = {"displacement": start.displacement, "velocity": start.velocity}
    u, v = (_of_mesh(problem, name, f"dynamics.start.{key}") for key, name in names.items())
    return u, v


def _of_mesh(problem: Problem, name: str | None, where: str) -> FloatArray:
    """A vector field of the mesh's file, in its unit of length; zero without a name."""
    V, body = problem.V, problem.body
    out = np.zeros((len(problem.places), body.dim))
    if name is None:
        return out.reshape(-1)
    if name not in body.fields:
        known = nearest(name, body.fields) if body.fields else "the mesh has none"
        raise InputError(f"the mesh has no field '{name}'", where=where, expected=known)
    field = body.fields[name]
    if field.columns < body.dim:
        raise InputError(
            f"'{name}' has {field.columns} numbers a {field.centre}",
            where=where,
            expected=f"a vector with {body.dim} components",
        )
    cells = np.arange(len(V.dofmap.list), dtype=np.int32)
    values = field.at(body.mesh, cells, interpolation_points(V.element))
    out[V.dofmap.list] = values[..., : body.dim] * body.unit.metres
    return out.reshape(-1)


def _of_results(start: MotionStart, path: Path, problem: Problem) -> tuple[FloatArray, FloatArray]:
    """The state of a step; nodes and points of the results are matched by their coordinates.

    Every rank looks through all points, some at a time.
    """
    comm, dim = problem.body.comm, problem.body.dim
    frame, folder = on_root(comm, lambda: _frame(path, start.step))
    places, error = np.asarray(problem.places), None
    values = np.full((2, len(places), dim), np.nan)
    try:
        _fill(values, places, folder, frame, NEAR * max(extent(problem.body)))
    except InputError as caught:
        error = caught
    agree(comm, error)
    own = problem.V.dofmap.index_map.size_local
    counts = [int(np.count_nonzero(np.isnan(values[0, :own, 0]))), own]
    missing, nodes = (int(total(comm, count)) for count in counts)
    if missing:
        raise InputError(
            f"{missing} of the {nodes} nodes of this mesh are at none of the "
            f"{frame.points.shape[0]} points of '{path}'",
            where=_FILE,
            expected="results on this mesh, with quadratic elements where it has them; of nodes "
            "with the same coordinates, as those of parts that are not joined, each needs its own",
        )
    u, v = (one.reshape(-1) for one in values)
    return u, v


def _frame(path: Path, step: int | str) -> tuple[Frame, Path]:
    """The step of the results, and their folder. On rank 0."""
    file = path / "results.xdmf" if path.is_dir() else path
    if not file.is_file():
        raise InputError(
            f"there is no file '{file}'", where=_FILE, expected="the folder of the results of a run"
        )
    frames = {frame.number: frame for frame in read_frames(file)}
    if step != "last" and step not in frames:
        raise InputError(
            f"'{file}' has no step {step}",
            where="dynamics.start.step",
            expected=f'"last", or one of {", ".join(map(str, list(frames)[:20]))}',
        )
    frame = frames.get(max(frames, default=0) if step == "last" else int(step))
    if frame is None or "displacement" not in frame.arrays:
        raise InputError(
            f"'{file}' has no displacement",
            where=_FILE,
            expected="results of a run whose output.fields has it",
        )
    return frame, file.parent


def _fill(values: FloatArray, places: FloatArray, folder: Path, frame: Frame, near: float) -> None:
    """Puts displacement and velocity at the nodes that have a point; zero without a velocity.

    Args:
        values: Shape (2, nodes, dim).
        places: Of the nodes, shape (nodes, 3).
        near: Distance up to which a node and a point are the same [m].

    Raises:
        InputError: An array is missing or damaged.
    """
    from scipy.spatial import cKDTree  # slow to import

    if not len(places):
        return
    tree, dim, count = cKDTree(places), values.shape[2], frame.points.shape[0]
    for first in range(0, count, _CHUNK):
        rows = first, min(first + _CHUNK, count)
        distance, node = tree.query(read_array(folder, frame.points, *rows))
        here = np.flatnonzero(distance <= near)
        for values_of, name in zip(values, ("displacement", "velocity"), strict=True):
            known = frame.arrays.get(name)
            values_of[node[here]] = (
                read_array(folder, known, *rows)[here, :dim] if known is not None else 0.0
            )
