"""`Moving`: a surface in some states of a finished run, with the colours of a field.

It is made from the files of the run, by one process: a run that was killed, or goes on, can be
exported, too.  The whole mesh is read once, to find its surface or what a fine one is bound to.
Then one state is in memory at a time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray
from dolfin_elastic.results.fields import field_in_file
from dolfin_elastic.results.finished.draw import check_field, shown, up_of
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.finished.xdmf import Frame, read_array
from dolfin_elastic.results.scene.colour_bar import colour_map
from dolfin_elastic.results.scene.scene import SMALL_MATTERS, Up
from dolfin_elastic.results.scene.surface import outer_faces

if TYPE_CHECKING:
    from dolfin_elastic.results.exports.settings import ExportSettings

_QUARTERS = [[0, 5, 4], [5, 1, 3], [4, 3, 2], [3, 4, 5]]
"""Triangles between the nodes of a face of `outer_faces`."""
_UNKNOWN = (0.7, 0.7, 0.7)
"""Colour where a field has no value."""
FRAMES_A_SECOND = 24.0


@dataclass(frozen=True)
class Binding:
    """Points that follow a body: what they take of its nodes.

    Attributes:
        triangles: Between the points, shape (m, 3).
        points: At rest [m], shape (n, 3).
        nodes: Of the body, for each point, shape (n, k).
        weights: Of the displacements of these, shape (n, k).
        smooth: Of their fields, which are not continued beyond the body, shape (n, k).
        note: How well they fit; empty: exactly.
    """

    triangles: IntArray
    points: FloatArray
    nodes: IntArray
    weights: FloatArray
    smooth: FloatArray
    note: str = ""


@dataclass(frozen=True)
class Shown:
    """A state of a surface.

    Attributes:
        places: Of its points [m], shape (n, 3).
        colours: Red, green, blue from 0 to 1, as screens take them (sRGB), shape (n, 3).
        values: Of the field [SI], of vectors and tensors the norm, shape (n,).
    """

    places: FloatArray
    colours: FloatArray
    values: FloatArray


class Moving:
    """A surface in some states of a run.  Not collective.

    Args:
        surface: What moves; None: the body's own surface, at its nodes.

    Attributes:
        field: Name of the field that colours it.

    Raises:
        InputError: The run holds no such field or no displacement, or no states.
    """

    def __init__(
        self, run: FinishedRun, settings: ExportSettings, surface: Binding | None = None
    ) -> None:
        self.run, self._settings = run, settings
        self._chosen = chosen(run, settings.frames)
        check_field(run, "displacement")
        known = run.fields()
        self.field = settings.field or ("von_mises" if "von_mises" in known else "displacement")
        for step in self._chosen:
            check_field(run, self.field, step)
        self.body = own_surface(run) if surface is None else surface

    def __len__(self) -> int:
        """Number of states."""
        return len(self._chosen)

    @property
    def up(self) -> Up:
        """The axis against which weight acts; in a plane y."""
        return "y" if self.run.dim == 2 else up_of(self.run)

    @property
    def times(self) -> list[float]:
        """When each state is seen [s]: in motion at its time, else 24 a second."""
        fps = self._settings.fps
        if fps is None and self.run.timed:
            t = [self.run.steps[step] for step in self._chosen]
            return [each - t[0] for each in t]
        return [k / (fps or FRAMES_A_SECOND) for k in range(len(self))]

    @cached_property
    def ends(self) -> tuple[float, float]:
        """Values of the first and the last colour [SI]."""
        if self._settings.limits is not None:
            return self._settings.limits
        low, high = np.inf, -np.inf
        for step in self._chosen:
            values = self._values(step)
            finite = values[np.isfinite(values)]
            low, high = min(low, finite.min(initial=np.inf)), max(high, finite.max(initial=-np.inf))
        return (float(low), float(high)) if low <= high else (0.0, 1.0)

    @property
    def unit(self) -> str:
        """Of the field."""
        return field_in_file(self.field).unit

    def states(self) -> Iterator[Shown]:
        """The states, one after the other."""
        body, scale = self.body, self._settings.scale
        for step in self._chosen:
            u = nodal(self.run, step, "displacement")[body.nodes]
            places = body.points + scale * np.einsum("nk,nkj->nj", body.weights, u)
            values = self._values(step)
            yield Shown(places, self._colours(values), values)

    def _values(self, step: int) -> FloatArray:
        # Between nodes a von Mises stress follows from the tensor, see `shown`.
        single = self.body.nodes.shape[1] == 1
        tensor = self.field == "von_mises" and "cauchy_stress" in self.run.fields(step)
        name = "cauchy_stress" if tensor and not single else self.field
        rows = nodal(self.run, step, name)[self.body.nodes]
        return shown({name: np.einsum("nk,nkj->nj", self.body.smooth, rows)}, self.field)

    def _colours(self, values: FloatArray) -> FloatArray:
        low, high = self.ends
        among = (values - low) / (high - low) if high > low else np.zeros_like(values)
        shades = np.array(colour_map(warm_first=self.field in SMALL_MATTERS).colors)
        at = np.linspace(0.0, 1.0, len(shades))
        colours = np.column_stack([np.interp(among, at, shades[:, i]) for i in range(3)])
        return np.where(np.isfinite(values)[:, None], colours, _UNKNOWN)


def chosen(run: FinishedRun, frames: int | None) -> list[int]:
    """Indices of the states that are exported: so many evenly over the run, the last among them.

    Args:
        frames: None: all.

    Raises:
        InputError: There are no states.
    """
    run.frame()
    count = len(run.steps)
    if frames is None or frames >= count:
        return list(range(count))
    return [round(x) for x in np.linspace(count - 1, 0, frames)][::-1]


def linear_light(colours: FloatArray) -> FloatArray:
    """Colours of screens (sRGB) as amounts of light, which glTF and USD hold.

    Source: IEC 61966-2-1 (1999).
    """
    bright = ((colours + 0.055) / 1.055) ** 2.4
    return np.where(colours <= 0.04045, colours / 12.92, bright)


# --- the body ---


def mesh_of(run: FinishedRun) -> tuple[FloatArray, IntArray]:
    """Places of the nodes [m], shape (n, 3), and nodes of the cells in VTK's order."""
    frame = run.frame(0)
    points = read_array(run.folder, frame.points).astype(np.float64)
    return points, read_array(run.folder, frame.cells).astype(np.int64)


def own_surface(run: FinishedRun) -> Binding:
    """The outer faces of a body, of a plane one all cells; of quadratic cells four parts each."""
    points, cells = mesh_of(run)
    faces, _ = outer_faces(cells, points)
    if faces.shape[1] == 6:
        faces = faces[:, _QUARTERS].reshape(-1, 3)
    used, rows = np.unique(faces, return_inverse=True)
    one = np.ones((len(used), 1))
    return Binding(rows.reshape(-1, 3), points[used], used[:, None], one, one)


def nodal(run: FinishedRun, step: int, name: str) -> FloatArray:
    """Values of a field at the nodes, numbered as in the first state, shape (n, columns).

    Values of cells are averaged over the cells of a node.
    """
    frame, first = run.frame(step), run.frame(0)
    stored = frame.arrays[name]
    values = read_array(run.folder, stored).astype(np.float64)
    if stored.centre == "cell":
        cells = read_array(run.folder, frame.cells)
        count = frame.points.shape[0]
        share = np.bincount(cells.ravel(), minlength=count)[:, None]
        sums = [
            np.bincount(cells.ravel(), np.repeat(column, cells.shape[1]), count)
            for column in values.T
        ]
        values = np.column_stack(sums) / np.maximum(share, 1)
    if frame.points != first.points:
        values = values[_numbers_in(run, frame)]
    return values


def _numbers_in(run: FinishedRun, frame: Frame) -> IntArray:
    """Numbers that the nodes of the first state have in another one.

    A run that goes on on another number of ranks numbers them anew.

    Raises:
        InputError: They are not told apart by their places.
    """
    from scipy.spatial import cKDTree

    places = [read_array(run.folder, one.points) for one in (run.frame(0), frame)]
    off, numbers = cKDTree(places[1]).query(places[0])
    far = 1e-9 * np.ptp(places[0], axis=0).max()
    if len(places[0]) != len(places[1]) or off.max() > far or len(np.unique(numbers)) < len(off):
        raise InputError(
            f"the nodes of t = {frame.t:g} have other numbers than those of the first state",
            where=str(run.folder),
            expected="a run that was not restarted on another number of ranks",
        )
    return np.asarray(numbers, dtype=np.int64)


def numbered(file: Path, count: int) -> Sequence[Path]:
    """Names of the files of a series; of a single state the name itself."""
    if count == 1:
        return [file]
    digits = max(4, len(str(count - 1)))
    return [file.with_name(f"{file.stem}_{k:0{digits}d}{file.suffix}") for k in range(count)]


def as_single(values: AnyArray) -> AnyArray:
    """Numbers of four bytes, the lowest first."""
    return np.ascontiguousarray(values, dtype="<f4")
