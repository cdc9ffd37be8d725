"""Pictures of the deformed body and of modes, without a display.

The surface is gathered on rank 0 and drawn by another process (`renderer.py`): a fault of VTK,
even a crash, becomes an `OutputError`, of which a run warns.
"""

from __future__ import annotations

import logging
import math
import re
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic.core.errors import InputError, OutputError, nearest
from dolfin_elastic.core.parallel import agree, on_root
from dolfin_elastic.core.timing import stage
from dolfin_elastic.mesh.body import extent, span
from dolfin_elastic.problem.material_regions import shear_modulus
from dolfin_elastic.problem.state import Mode, State
from dolfin_elastic.results.fields import FIELDS
from dolfin_elastic.results.files import make_folder, writing
from dolfin_elastic.results.pictures.colour_bar import make_colour_bar, upper_end
from dolfin_elastic.results.pictures.drawn_field import DrawnField, with_ghosts
from dolfin_elastic.results.pictures.renderer import RENDERER
from dolfin_elastic.results.pictures.surface import Surface, gather_surface
from dolfin_elastic.results.writer import LastState, Numbers, StepInterval

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem

log = logging.getLogger("dolfin_elastic")

View = Literal["isometric", "x", "y", "z", "-x", "-y", "-z"]

_SLEEP = 0.02
"""Seconds between two looks for the end of the drawing."""
_LINE = 20
"""Letters in a line above the colour bar; longer ones would not fit."""
_SMALL_MATTER = ("safety_factor",)
"""Fields whose small values matter: drawn in bright colours, large ones all alike."""
_CATEGORIES = ("material", "region")
"""Fields of numbers that stand for names: drawn in distinct colours with a legend."""
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


@dataclass(frozen=True)
class Appearance:
    """How a picture shows the body.

    Attributes:
        scale: Magnification of the displacement.
        view: Axis along which the body is seen; plane bodies are always seen from the front.
        title: Text above the body, before load or time.
    """

    scale: float = 1.0
    view: View = "isometric"
    title: str = ""


def check_drawable(name: str) -> str:
    """Checks that a picture can show a field, and returns its name.

    Raises:
        InputError: There is no such field, or it is the same in all states and has no names.
    """
    allowed = [
        name for name, row in FIELDS.items() if name in _CATEGORIES or row.formula or not row.fixed
    ]
    if name not in FIELDS:
        raise InputError(f"there is no field '{name}'", expected=nearest(name, allowed))
    if name not in allowed:
        raise InputError(f"a picture cannot show '{name}'", expected=f"one of {', '.join(allowed)}")
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
        problem: The problem that was solved.
        state: What is shown.
        file: The PNG file.
        field: Name from `FIELDS`; of vectors and tensors the norm is shown; values of cells are
            averaged at the nodes, but for materials and regions.
        scale: Magnification of the displacement.
        view: Axis along which the body is seen; plane bodies are always seen from the front.
        title: Text above the body, before load or time.

    Raises:
        InputError: The field cannot be shown.
        OutputError: The picture cannot be drawn or written.
    """
    painter = Painter(problem, field)
    try:
        painter.paint(state, Path(file), Appearance(scale, view, title))
    finally:
        painter.close()


class PictureWriter:
    """Draws pictures during a run, or of its last step.  All of it is collective.

    A new run removes the pictures of an earlier one with the same names.

    Args:
        problem: The problem that is solved.
        path: The PNG file.
        every: Steps between drawn states, see `StepInterval`; the last state is always drawn.  The
            step's number is added to the file's name.  None: only the last state, without number.
        field: See `picture`.
        saved: Its restart state: pictures of later steps are removed.
        appearance: Of all pictures.
    """

    def __init__(
        self,
        problem: Problem,
        path: Path,
        *,
        every: int | None = None,
        field: str = "von_mises",
        saved: Numbers | None = None,
        appearance: Appearance = Appearance(),
    ) -> None:
        self.path, self._appearance = path, appearance
        self._every = (
            None if every is None else StepInterval(every, -1 if saved is None else saved["taken"])
        )
        self._last_drawn = -1 if saved is None else int(saved["drawn"])
        self._last_state = LastState()
        with stage("output"):
            on_root(problem.body.comm, self._clear)
            self._painter = Painter(problem, field)

    def _clear(self) -> None:
        make_folder(self.path.parent)
        with writing(self.path):
            for file in picture_files(self.path):
                if file == self.path or _number(self.path, file) > self._last_drawn:
                    file.unlink()

    def restart_state(self) -> Numbers:
        """See `Writer`."""
        return {
            "drawn": self._last_drawn,
            "taken": -1 if self._every is None else self._every.taken,
        }

    def write(self, state: State) -> None:
        """Draws the state if it is due; else copies it, for it may be the last one."""
        with stage("output"):
            if self._every is None or not self._every.takes(state.step):
                self._last_state.copy(state)
            else:
                self._last_state.forget()
                self._paint(state)

    def _paint(self, state: State) -> None:
        name = f"{self.path.stem}_{state.step:04d}{self.path.suffix}"
        file = self.path if self._every is None else self.path.with_name(name)
        self._painter.paint_or_warn(state, file, self._appearance)
        self._last_drawn = state.step

    def close(self, status: str = "completed", error: object = None) -> None:
        """See `Writer`; draws the last converged step, if it has not been drawn."""
        try:
            if self._last_state.state:
                with stage("output"):
                    self._paint(self._last_state.state)
        finally:
            self._painter.close()


class ModePictureWriter:
    """Draws each mode, coloured by its displacement.  All of it is collective.

    Args:
        problem: The problem that is solved.
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
        appearance: Appearance = Appearance(),
    ) -> None:
        self.path, self._appearance = path, appearance
        self._u, self._w = fem.Function(problem.V), fem.Function(problem.W)
        self._size = amplitude * max(extent(problem.body))
        with stage("output"):
            on_root(problem.body.comm, self._clear)
            self._painter = Painter(problem, "displacement")

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
            file = self.path.with_name(f"{self.path.stem}_{mode.number:04d}{self.path.suffix}")
            title = "   |   ".join(filter(None, (self._appearance.title, _mode_title(mode))))
            self._painter.paint_or_warn(state, file, replace(self._appearance, title=title))

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
    found = [(number, p) for p in path.parent.iterdir() if (number := _number(path, p)) >= 0]
    return [*([path] if path.is_file() else []), *(p for _, p in sorted(found))]


def _number(path: Path, file: Path) -> int:
    """Number of the step in a picture's name; -1 if the file is no picture of this output.

    Args:
        path: The PNG file of the output, without number.
        file: Any file in its folder.
    """
    stem, suffix = re.escape(path.stem), re.escape(path.suffix)
    found = re.fullmatch(rf"{stem}_(\d{{4,}}){suffix}", file.name)
    return int(found[1]) if found else -1


class Painter:
    """Draws states coloured by one field; compiles once.  All of it is collective but `close`.

    Args:
        problem: The problem that is solved.
        field: Name from `FIELDS`.

    Raises:
        InputError: A picture cannot show the field.
    """

    def __init__(self, problem: Problem, field: str) -> None:
        self.problem, self.comm, self.field = problem, problem.body.comm, check_drawable(field)
        self.dim = problem.body.dim
        self._failed = False
        self._noise = _round_off(problem, FIELDS[field].unit)
        self._drawn = DrawnField(problem, field)

    def close(self) -> None:
        """Ends the drawing: the renderer stops when nobody else needs it. Not collective."""
        RENDERER.release(self)

    def paint_or_warn(self, state: State, file: Path, appearance: Appearance) -> None:
        """Draws a state, or warns once if that cannot be done: results do not depend on pictures.

        Collective.

        Args:
            state: See `paint`.
            file: The same.
            appearance: The same.
        """
        try:
            self.paint(state, file, appearance)
        except OutputError as error:
            log.log(
                logging.DEBUG if self._failed else logging.WARNING, "%s; the run goes on", error
            )
            self._failed = True

    def paint(self, state: State, file: Path, appearance: Appearance) -> None:
        """Draws a state. Collective.

        Args:
            state: What is shown.
            file: The PNG file.
            appearance: How it is shown.

        Raises:
            OutputError: The picture cannot be drawn or written.
        """
        grid = self._drawn.grid
        u = state.u.x.array.reshape(-1, self.dim)
        fields, of_cells = {"u": np.pad(u, ((0, 0), (0, 3 - self.dim)))}, None
        if self.field in _CATEGORIES:
            cells = grid.mesh.topology.index_map(grid.mesh.topology.dim)
            of_cells = with_ghosts(cells, self._drawn.values(state))[:, 0].astype(np.int64)
        else:
            fields["value"] = self._drawn.at_nodes(state)
        linear = ("value",) if self._drawn.linear else ()
        surface = gather_surface(grid, fields, of_cells, linear=linear)
        if surface is not None and "value" in fields:
            surface.values["value"] = self._drawn.shown(surface.values["value"])
        settings = {
            "scale": appearance.scale,
            "view": "z" if self.dim == 2 else appearance.view,
            "title": _headline(state, appearance),
            "plane": self.dim == 2,
        }
        _on_root_alone(self.comm, lambda: self._draw(surface, file, settings))

    def _draw(self, surface: Surface | None, file: Path, settings: Mapping[str, Any]) -> None:
        assert surface is not None
        with writing(file), tempfile.TemporaryDirectory() as scratch:
            data, drawn = Path(scratch) / "surface.npz", Path(scratch) / "picture.png"
            np.savez(
                data,
                points=surface.points,
                triangles=surface.triangles,
                u=surface.values["u"],
                **self._colour_data(surface),
                **settings,
            )
            RENDERER.draw(self, data, drawn)
            draft = file.with_name(f".{file.name}.part")
            draft.write_bytes(drawn.read_bytes())
            draft.replace(file)

    def _colour_data(self, surface: Surface) -> dict[str, Any]:
        """Input of the drawing: values with ticks and label of the colour bar, or with names."""
        field, label = FIELDS[self.field], _LABELS.get(self.field, self.field.replace("_", " "))
        if surface.of_cells is not None:
            first, names = self._names()
            return {"value": surface.of_cells - first, "names": names, "label": label}
        values = surface.values["value"][:, 0]
        small = self.field in _SMALL_MATTER
        shown = np.minimum(values, upper_end(values)) if small else values
        found = make_colour_bar(shown, field.unit, self._noise)
        unit = f"[{found.unit}]" if found.unit else ""
        if field.shape == "tensor":
            unit = f"norm of the tensor\n{unit}"
        if small and values.max() > found.ticks[-1]:
            unit = f"{found.ticks[-1]:g} and more alike"
        return {
            "value": values / found.factor,
            "ticks": found.ticks,
            "reversed": small,
            "form": found.form,
            "label": f"{fill(label, _LINE)}\n{unit}".strip(),
        }

    def _names(self) -> tuple[int, list[str]]:
        """Number of the first name of a field of names, and all names."""
        if self.field == "material":
            return 0, [part.name for part in self.problem.regions]
        return -1, ["no region", *sorted(self.problem.body.regions)]


def _headline(state: State, appearance: Appearance) -> str:
    """Title, load or time, and magnification, each if there is one."""
    moving = state.v is not None
    place = f"t = {state.t:.4g} s" if moving else f"load {100 * state.load_factor:.4g} %"
    if math.isnan(state.load_factor):  # a mode, which the title names
        place = ""
    scale = appearance.scale
    larger = "" if scale == 1.0 else f"displacements \u00d7 {scale:g}"
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
