"""Pictures of the deformed body and of modes, without a display.

The surface is gathered on rank 0 and drawn by another process (`renderer.py`): a fault of VTK,
even a crash, becomes an `OutputError`, of which a run warns.
"""

from __future__ import annotations

import logging
import math
import re
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic.core.errors import InputError, OutputError
from dolfin_elastic.core.ghosts import with_ghosts
from dolfin_elastic.core.parallel import agree, on_root
from dolfin_elastic.core.shapes.shapes import Shape
from dolfin_elastic.core.si_text import time_or_load
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray
from dolfin_elastic.mesh.body import extent, span
from dolfin_elastic.mesh.geometry.simplices import dofs_on_facets
from dolfin_elastic.model.loads.forces import Gravity
from dolfin_elastic.problem.material_regions import shear_modulus
from dolfin_elastic.problem.state import Mode, State, plain
from dolfin_elastic.results.fields import check_field_names, field_table, laws_of, table_of
from dolfin_elastic.results.files import make_folder, writing
from dolfin_elastic.results.recovery.error import ERROR, ErrorEstimate
from dolfin_elastic.results.recovery.peaks import peaks_of
from dolfin_elastic.results.scene.appearance import (
    DEFAULT,
    STATES,
    STATUS,
    Appearance,
    common_allowable,
    picture_of,
    status_of,
)
from dolfin_elastic.results.scene.drawn_field import DrawnField
from dolfin_elastic.results.scene.obstacles import Reach
from dolfin_elastic.results.scene.renderer import RENDERER
from dolfin_elastic.results.scene.scene import Picture, Reliable, View, up_against
from dolfin_elastic.results.scene.series import FILMS, Series, film_times
from dolfin_elastic.results.scene.surface import gather_cells, gather_surface
from dolfin_elastic.results.writer import LastState, Numbers, StepInterval

if TYPE_CHECKING:
    from dolfin_elastic.mesh.body import Body
    from dolfin_elastic.model.materials.law import Law
    from dolfin_elastic.problem.problem import Problem

log = logging.getLogger("dolfin_elastic")

_STATICS = 0.2
"""Share of the load that a second of a film shows, if the user does not say."""
_PEAKS = {
    "von_mises": ("largest", "elsewhere"),
    "safety_factor": ("safety", "safety_elsewhere"),
}
"""Fields whose largest values may be singular, and their attributes in `Peaks`."""
_NOT_DRAWN = "rank"
_SLEEP = 0.02
"""Seconds between two looks for the end of the drawing."""


@dataclass(frozen=True)
class Film:
    """How states become a film.

    Attributes:
        fps: Frames a second.
        speed: Time [s], in statics load, that passes in a second of the film; None: 1, in statics
            0.2.
    """

    fps: float = 30.0
    speed: float | None = None

    def speed_of(self, state: State) -> float:
        """The speed for a run with such states."""
        return self.speed or (1.0 if state.timed else _STATICS)


def check_drawable(name: str, body: Body, laws: Iterable[Law] = ()) -> str:
    """Checks that a picture of a body can show a field, and returns its name. Local.

    Args:
        laws: Of the materials, for what they remember.

    Raises:
        InputError: There is no such field, or it is that of the ranks.
    """
    laws = tuple(laws)
    check_field_names([name], body, laws)
    if name == _NOT_DRAWN:
        known = ", ".join(other for other in field_table(body, laws) if other != name)
        raise InputError(f"a picture cannot show '{name}'", expected=f"one of {known}")
    return name


def picture(
    problem: Problem,
    state: State,
    file: Path | str,
    *,
    field: str = "von_mises",
    scale: float = 1.0,
    view: View = "isometric",
    title: str = "",
) -> None:
    """Draws the deformed body, coloured by a field, over its undeformed edges. Collective.

    Args:
        file: The PNG file.
        field: Name of `field_table`; of vectors and tensors the norm is shown; values of cells are
            averaged at the nodes, but for materials and regions.
        view: Axis along which the body is seen; plane bodies are always seen from the front.
        title: Text above the body, before load or time.

    Raises:
        InputError: The field cannot be shown.
        OutputError: The picture cannot be drawn or written.
    """
    painter = Painter(problem, (field,))
    try:
        painter.paint(state, Path(file), Appearance(scale, view, title))
    finally:
        painter.close()


class PictureWriter:
    """Draws pictures during a run, or of its last step, or a film.  All of it is collective.

    A new run removes the pictures of an earlier one with the same names.  Pictures of a series are
    drawn again at the end, where later states need a wider range of colours or more room.

    Args:
        path: The PNG file, or a film.
        every: Steps between drawn states, see `StepInterval`; the last state is always drawn.  The
            step's number is added to the file's name.  None: only the last state, without number;
            of a film as many as it needs.
        fields: See `picture`; several are seen side by side.
        saved: Its restart state: pictures of later steps are removed.
        appearance: Of all pictures.
    """

    def __init__(
        self,
        problem: Problem,
        path: Path,
        *,
        every: int | None = None,
        fields: Sequence[str] = ("von_mises",),
        saved: Numbers | None = None,
        appearance: Appearance = DEFAULT,
        film: Film = Film(),
    ) -> None:
        self.path, self._appearance = path, appearance
        self._film = film if path.suffix in FILMS else None
        self._every = (
            None if every is None else StepInterval(every, -1 if saved is None else saved["taken"])
        )
        self._last_drawn = -1 if saved is None else int(saved["drawn"])
        self._times: dict[int, float] = {
            int(step): t for step, t in (saved or {}).get("times", {}).items()
        }
        self._last_state = LastState()
        with stage("output"):
            alone = every is None and self._film is None
            folder = None if alone else path.with_name(f".{path.stem}_frames")
            self._series = Series(appearance.limits, marks=appearance.marks, folder=folder)
            for name in fields:  # before anything is removed
                check_drawable(name, problem.body, laws_of(problem))
            on_root(problem.body.comm, self._clear)
            self._painter = Painter(problem, fields)

    def _clear(self) -> None:
        make_folder(self.path.parent)
        with writing(self.path):
            for file in picture_files(self.path):
                if file == self.path or _number(self.path, file) > self._last_drawn:
                    file.unlink()
            self._series.forget_after(self._last_drawn)

    def restart_state(self) -> Numbers:
        """See `Writer`."""
        return {
            "drawn": self._last_drawn,
            "taken": -1 if self._every is None else self._every.taken,
            "times": {str(step): t for step, t in self._times.items()},
        }

    def write(self, state: State) -> None:
        """Draws the state if it is due; else copies it, for it may be the last one."""
        with stage("output"):
            if self._due(state):
                self._last_state.forget()
                self._paint(state)
            else:
                self._last_state.copy(state)

    def _due(self, state: State) -> bool:
        if self._film is None or self._every is not None:
            return self._every is not None and self._every.takes(state.step)
        # Half a frame: of states that come more often most would not be seen.
        t = plain(state.t) / self._film.speed_of(state)
        return not self._times or abs(t - [*self._times.values()][-1]) >= 0.5 / self._film.fps

    def _paint(self, state: State) -> None:
        name = f"{self.path.stem}_{state.step:06d}{self.path.suffix}"
        file = self.path if self._every is None else self.path.with_name(name)
        if self._film is None:
            self._painter.paint_or_warn(state, file, self._appearance, self._series)
        else:
            self._painter.keep(state, self._appearance, self._series)
            self._times[state.step] = plain(state.t) / self._film.speed_of(state)
        self._last_drawn = state.step

    def close(self, status: str = "completed", error: object = None) -> None:
        """See `Writer`; draws the last converged step, if it has not been drawn."""
        try:
            with stage("output"):
                if self._last_state.state:
                    self._paint(self._last_state.state)
                self._painter.or_warn(self._finish)
        finally:
            self._series.close(keep=status == "stopped")
            self._painter.close()

    def _finish(self) -> None:
        if self._film is None:
            self._series.redraw()
        elif self._times:
            numbers = [n for n in self._series.numbers() if n in self._times]
            times = film_times([self._times[n] for n in numbers], 1.0)
            self._series.film(self.path, times, numbers, self._film.fps)


class ModePictureWriter:
    """Draws each mode, coloured by its displacement.  All of it is collective.

    Args:
        path: The PNG file; the mode's number goes into its name.
        amplitude: Largest displacement in the picture, over the body's longest side.
        appearance: Of all pictures; the mode's number follows the title.
    """

    def __init__(
        self,
        problem: Problem,
        path: Path,
        *,
        amplitude: float,
        appearance: Appearance = DEFAULT,
    ) -> None:
        self.path, self._appearance = path, appearance
        self._u, self._w = fem.Function(problem.V), fem.Function(problem.W)
        self._size = amplitude * max(extent(problem.body))
        with stage("output"):
            on_root(problem.body.comm, self._clear)
            self._painter = Painter(problem, ("displacement",))

    def _clear(self) -> None:
        make_folder(self.path.parent)
        with writing(self.path):
            for file in picture_files(self.path):
                file.unlink()

    def write(self, state: State) -> None:
        """Passes over a state: it is no mode."""

    def write_mode(self, mode: Mode) -> None:
        """Draws one mode, added to the displacement of its base state."""
        with stage("output"):
            self._u.x.array[:] = mode.base.x.array + self._size * mode.u.x.array
            state = State(mode.number, 0.0, self._u, w=self._w, load_factor=float("nan"))
            # Colours show the mode alone, whose largest displacement is 1.
            shape = replace(state, u=mode.u)
            file = self.path.with_name(f"{self.path.stem}_{mode.number:04d}{self.path.suffix}")
            title = "   |   ".join(filter(None, (self._appearance.title, _mode_title(mode))))
            look = replace(self._appearance, title=title)
            self._painter.paint_or_warn(state, file, look, shape=shape)

    def restart_state(self) -> Numbers:
        """See `Writer`; runs of modes have no checkpoints."""
        return {}

    def close(self, status: str = "completed", error: object = None) -> None:
        """See `Writer`; ends the drawing."""
        self._painter.close()


def _mode_title(mode: Mode) -> str:
    if mode.kind == "buckling":
        return f"mode {mode.number}: load factor {mode.load_factor:.5g}"
    return f"mode {mode.number}: {mode.name or f'{mode.frequency:.5g} Hz'}"


def picture_files(path: Path) -> list[Path]:
    """Existing pictures of an output with this file, in the order of steps. Not collective."""
    result = [(number, p) for p in path.parent.iterdir() if (number := _number(path, p)) >= 0]
    return [*([path] if path.is_file() else []), *(p for _, p in sorted(result))]


def _number(path: Path, file: Path) -> int:
    """Number of the step in a picture's name; -1 if the file is no picture of this output.

    Args:
        path: The PNG file of the output, without number.
        file: Any file in its folder.
    """
    stem, suffix = re.escape(path.stem), re.escape(path.suffix)
    match = re.fullmatch(rf"{stem}_(\d{{4,}}){suffix}", file.name)
    return int(match[1]) if match else -1


class Painter:
    """Draws states coloured by fields; compiles once.  All of it is collective but `close`.

    Args:
        fields: Names of `field_table`, seen side by side.

    Raises:
        InputError: A picture cannot show a field.
    """

    def __init__(self, problem: Problem, fields: Sequence[str]) -> None:
        self.problem, self.comm, self.dim = problem, problem.body.comm, problem.body.dim
        self._failed, self._reach = False, Reach()
        weights = [g.acceleration(self.dim) for g in problem.loads if isinstance(g, Gravity)]
        self._up = up_against(weights) if self.dim == 3 else "z"
        laws, table = laws_of(problem), table_of(problem)
        names = [check_drawable(n, problem.body, laws) for n in fields]
        self._noise = {
            name: 0.0 if table[name].of_body else _round_off(problem, table[name].unit)
            for name in names
        }
        given = [part.law.allowable for part in problem.regions]
        known = [float(a.value) if isinstance(a, fem.Constant) else None for a in given]
        self._allowable = common_allowable(known)
        self._drawn = [DrawnField(problem, name) for name in names]
        RENDERER.hold(self)

    def close(self) -> None:
        """Ends the drawing: the renderer stops when nobody else needs it. Not collective."""
        RENDERER.release(self)

    def paint_or_warn(
        self,
        state: State,
        file: Path,
        appearance: Appearance,
        series: Series | None = None,
        *,
        shape: State | None = None,
    ) -> None:
        """Draws a state, or warns once if that cannot be done: results do not depend on pictures.

        Collective.

        Args:
            state: See `paint`.
            file: The same.
            appearance: The same.
            series: The same.
            shape: A mode, whose values are the colours.
        """
        panels = self.panels(state, appearance, shape)
        self.or_warn(lambda: self._paint(state.step, panels, file, appearance, series))

    def or_warn(self, action: Callable[[], None]) -> None:
        """Draws on rank 0, or warns once if that cannot be done. Collective."""
        try:
            _on_root_alone(self.comm, action)
        except OutputError as error:
            log.log(
                logging.DEBUG if self._failed else logging.WARNING, "%s; the run goes on", error
            )
            self._failed = True

    def paint(self, state: State, file: Path, appearance: Appearance) -> None:
        """Draws a state. Collective.

        Args:
            file: The PNG file.

        Raises:
            OutputError: The picture cannot be drawn or written.
        """
        panels = self.panels(state, appearance)
        _on_root_alone(self.comm, lambda: self._paint(0, panels, file, appearance, None))

    def keep(self, state: State, appearance: Appearance, series: Series) -> None:
        """Keeps what a frame of a film shows, or warns once. Collective.

        Args:
            series: Where it is kept.
        """
        panels = self.panels(state, appearance)
        self.or_warn(lambda: series.add(state.step, panels))

    def _paint(
        self,
        number: int,
        panels: Sequence[Picture],
        file: Path,
        appearance: Appearance,
        series: Series | None,
    ) -> None:
        whole = series or Series(appearance.limits, marks=appearance.marks)
        whole.add(number, panels)
        try:
            whole.draw(number, panels, file)
        finally:
            if series is None:
                whole.close()

    def panels(
        self, state: State, appearance: Appearance, shape: State | None = None
    ) -> list[Picture]:
        """A picture of each field on rank 0, none elsewhere. Collective.

        Args:
            shape: See `paint_or_warn`.
        """
        every = [self._panel(drawn, state, appearance, shape) for drawn in self._drawn]
        return [panel for panel in every if panel is not None]

    def _panel(
        self, drawn: DrawnField, state: State, appearance: Appearance, shape: State | None
    ) -> Picture | None:
        grid = drawn.grid
        u = state.u.x.array.reshape(-1, self.dim)
        fields, of_cells = {"u": np.pad(u, ((0, 0), (0, 3 - self.dim)))}, None
        names, of_faces = self._names(drawn.name), None
        if drawn.name == STATUS:
            status = drawn.at_nodes(state)[:, 0]
            of_cells = status_of(status[grid.V.dofmap.list[:, : self.dim + 1]], self.dim)
            if self.dim == 3:
                of_faces = partial(_status_of_facets, grid.V, status)
        elif names:
            cells = grid.mesh.topology.index_map(grid.mesh.topology.dim)
            of_cells = with_ghosts(cells, drawn.values(state))[:, 0].astype(np.int64)
            of_cells += drawn.name == "region"  # -1: none
        else:
            fields["value"] = drawn.at_nodes(shape or state)
        linear, reliable = ("value",) if drawn.linear else (), self._reliable(drawn.name, state)
        surface, cut = (
            gather_surface(grid, fields, of_cells, linear=linear, of_faces=of_faces),
            None,
        )
        if appearance.clips and self.dim == 3:
            planes = [(clip.axis, clip.at) for clip in appearance.clips]
            cut = gather_cells(grid, fields, planes, of_cells)
        if surface is None:
            return None
        moving = appearance.film and state.v is not None
        picture = picture_of(
            surface,
            cut,
            replace(appearance, up=appearance.up or self._up),
            self._reach,
            drawn.name,
            plane=self.dim == 2,
            title=_headline(state, appearance),
            shown=drawn.shown,
            names=names,
            noise=self._noise[drawn.name],
            obstacles=self._obstacles(),
            outline=not moving,
            allowable=self._allowable,
            reliable=reliable,
        )
        return picture if shape is None else replace(picture, unit="", noise=0.0, scaled=True)

    def _reliable(self, name: str, state: State) -> Reliable | None:
        """What to judge by in a state whose error is known. Collective."""
        estimate = state.derived.get(ERROR)
        if name not in _PEAKS or not isinstance(estimate, ErrorEstimate):
            return None
        peaks = peaks_of(self.problem, state, estimate)
        pair = [getattr(peaks, attribute) for attribute in _PEAKS[name]]
        return Reliable.of(*(None if peak is None else peak.as_json() for peak in pair))

    def _obstacles(self) -> list[tuple[str, Shape, FloatArray]]:
        return [
            (
                pair.label,
                pair.contact.turned(pair.contact.obstacle, pair.pose.now),
                np.asarray(pair.shift.value),
            )
            for pair in self.problem.contact_pairs
            if pair.contact.between is None
        ]

    def _names(self, field: str) -> list[str]:
        """Names that the numbers of a field stand for; none if they stand for themselves."""
        if field == "material":
            return [part.name for part in self.problem.regions]
        if field == STATUS:
            return list(STATES)
        return ["no region", *sorted(self.problem.body.regions)] if field == "region" else []


def _status_of_facets(V: fem.FunctionSpace, status: AnyArray, facets: IndexArray) -> AnyArray:
    """See `status_of`."""
    return status_of(status[dofs_on_facets(V, facets)[:, :3]], 3)


def _headline(state: State, appearance: Appearance) -> str:
    """Title, load or time, and magnification, each if there is one."""
    place = time_or_load(state.t if state.timed else state.load_factor, timed=state.timed)
    if math.isnan(state.load_factor):  # a mode, which the title names
        place = ""
    scale = appearance.scale
    larger = "" if math.isnan(state.load_factor) else f"deformation \u00d7 {scale:g}"
    return "   |   ".join(filter(None, (appearance.title, place, larger)))


def _round_off(problem: Problem, unit: str) -> float:
    """Values below this are round-off, in the unit of a field. Collective.

    Stresses and strains follow from differences of displacements, which cancel leading digits.
    """
    stiff = min(shear_modulus(part.typical) for part in problem.regions)
    scales = {
        "Pa": 1e-9 * stiff,
        "J/m^3": 1e-14 * stiff,
        "": 1e-9,
        "m": 1e-14 * span(problem.body),
        "N": 1e-14 * stiff * span(problem.body) ** 2,
    }
    return scales.get(unit, 0.0)


def _on_root_alone(comm: MPI.Comm, action: Callable[[], None]) -> None:
    """`on_root` for long work: the other ranks sleep, which frees their cores. Collective."""
    error: Exception | None = None
    if comm.rank == 0:
        try:
            action()
        except Exception as caught:  # raised on all ranks below
            error = caught
    done = comm.Ibarrier()
    while not done.Test():
        time.sleep(_SLEEP)
    agree(comm, error)
