"""Results in one VTKHDF file that refers to no other, to be handed on.

Each array of the run is copied once, also a mesh and a field that several states have.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.errors import OutputError
from dolfin_elastic.core.types import AnyArray, IntArray
from dolfin_elastic.results.exports.moving import chosen
from dolfin_elastic.results.exports.settings import ExportSettings
from dolfin_elastic.results.files import drafted, need_space
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.finished.xdmf import Frame, read_array
from dolfin_elastic.results.writers.vtkhdf import ROOT, TYPES, describe

if TYPE_CHECKING:
    import h5py

_GROUPS = {"node": "PointData", "cell": "CellData"}


def write_vtkhdf(run: FinishedRun, settings: ExportSettings, file: Path) -> tuple[str, ...]:
    """Writes mesh and fields of nodes and elements in SI units, with t as time. Not collective.

    Returns:
        Nothing is left out.

    Raises:
        OutputError: It cannot be written.
    """
    import h5py

    frames = [run.frame(step) for step in chosen(run, settings.frames)]
    stored = {one for f in frames for one in (f.points, f.cells, *f.arrays.values())}
    need_space(file.parent, 8 * sum(int(np.prod(one.shape)) for one in stored))
    try:
        with drafted(file) as draft, h5py.File(draft, "w") as out:
            _fill(out.create_group(ROOT), run, frames)
    except RuntimeError as error:  # what h5py raises where closing fails
        raise OutputError(f"cannot write {file}: {error}") from error
    return ()


def _fill(root: h5py.Group, run: FinishedRun, frames: Sequence[Frame]) -> None:
    # A restart on another number of ranks has a mesh of its own.
    meshes = list(dict.fromkeys((one.points, one.cells) for one in frames))
    mesh = np.array([meshes.index((one.points, one.cells)) for one in frames], dtype=np.int64)
    kind, width = TYPES[frames[0].kind], frames[0].cells.shape[1]
    counts = [cells.shape[0] for _, cells in meshes]
    folder = run.folder
    starts = {
        "Points": _put(root, "Points", (read_array(folder, points) for points, _ in meshes)),
        "Connectivity": _put(
            root,
            "Connectivity",
            (read_array(folder, cells).astype(np.int64).ravel() for _, cells in meshes),
        ),
        "Types": _put(root, "Types", (np.full(n, kind, dtype=np.uint8) for n in counts)),
    }
    _put(root, "Offsets", (width * np.arange(n + 1, dtype=np.int64) for n in counts))
    describe(root, [one.t for one in frames], mesh, starts)
    for name, first in frames[0].arrays.items():
        group = _GROUPS[first.centre]
        arrays = [one.arrays[name] for one in frames]
        once = list(dict.fromkeys(arrays))
        values = (read_array(folder, one) for one in once)
        rows = _put(root.require_group(group), name, values)
        offsets = [rows[once.index(one)] for one in arrays]
        root["Steps"].require_group(f"{group}Offsets")[name] = np.array(offsets, dtype=np.int64)


def _put(group: h5py.Group, name: str, arrays: Iterable[AnyArray]) -> IntArray:
    """Writes arrays one behind the other; returns their first rows, and the number of all."""
    starts = [0]
    for values in arrays:
        plain = values[:, 0] if values.shape[1:] == (1,) else values
        starts.append(starts[-1] + len(plain))
        if name not in group:
            group.create_dataset(name, plain.shape, plain.dtype, maxshape=(None, *plain.shape[1:]))
        group[name].resize(starts[-1], axis=0)
        group[name][starts[-2] :] = plain
    return np.array(starts, dtype=np.int64)
