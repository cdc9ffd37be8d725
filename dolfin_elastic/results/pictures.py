"""Pictures of the deformed body, without a display.

The surface goes to rank 0, which has it drawn by another process (`_draw.py`): what VTK does wrong
there, down to a crash, becomes an error message here and not the end of the run.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from shutil import which
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt
from dolfinx import la
from mpi4py import MPI

from dolfin_elastic.errors import InputError, OutputError
from dolfin_elastic.parallel import agree, on_root
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.fields import FIELDS, known
from dolfin_elastic.results.files import make_folder, writing
from dolfin_elastic.results.grid import Grid, to_nodes
from dolfin_elastic.results.surface import Surface, gather
from dolfin_elastic.results.writer import Kept
from dolfin_elastic.state import State
from dolfin_elastic.timing import stage

if TYPE_CHECKING:
    from dolfin_elastic.problem import Problem

Array = npt.NDArray[Any]
View = Literal["isometric", "x", "y", "z", "-x", "-y", "-z"]

_TIMEOUT = 300
_NAP = 0.02
_PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"))


def drawable(name: str) -> str:
    """The name of a field, if a picture can show it.

    Raises:
        InputError: There is no such field, or it is one of numbers without order.
    """
    (name,) = known([name])
    if FIELDS[name].fixed and FIELDS[name].formula is None:
        raise InputError(f"a picture cannot show '{name}'", expected="for example von_mises")
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
        field: Name from `FIELDS`; of vectors and tensors the length is shown; values of cells are
            averaged at the nodes.
        scale: Magnification of the displacement.
        view: Along which axis it is looked at; plane bodies are always seen from the front.
        title: A line above the body.

    Raises:
        InputError: The field cannot be shown.
        OutputError: The picture cannot be drawn or written.
    """
    _Painter(problem, field).paint(state, Path(file), scale=scale, view=view, title=title)


class PictureWriter:
    """Draws pictures during a run, or of its last step.  All of it is collective.

    Args:
        problem: The problem that is solved.
        path: The PNG file.
        every: Each n-th step, with the step's number in the file's name; None: the last only.
        field: See `picture`.
        options: `scale`, `view` and `title` of `picture`.
    """

    def __init__(
        self,
        problem: Problem,
        path: Path,
        *,
        every: int | None = None,
        field: str = "von_mises",
        **options: Any,
    ) -> None:
        self.path, self.every, self.options = path, every, options
        self._kept = Kept()
        with stage("output"):
            on_root(problem.body.comm, lambda: make_folder(path.parent))
            self._painter = _Painter(problem, field)

    def write(self, state: State) -> None:
        """Draws the step, or keeps it for the end."""
        with stage("output"):
            if self.every is None:
                self._kept.keep(state)
            elif state.step % self.every == 0:
                name = f"{self.path.stem}_{state.step:04d}{self.path.suffix}"
                self._painter.paint(state, self.path.with_name(name), **self.options)

    def close(self, status: str = "completed", error: object = None) -> None:
        """Draws the last converged step, if that was asked for."""
        if self._kept.state:
            with stage("output"):
                self._painter.paint(self._kept.state, self.path, **self.options)


class _Painter:
    """A field of a problem, ready to be drawn again and again."""

    def __init__(self, problem: Problem, field: str) -> None:
        self.comm, self.field = problem.body.comm, drawable(field)
        self.dim = problem.body.dim
        self._evaluate = Evaluator(problem, [field])

    def paint(
        self,
        state: State,
        file: Path,
        *,
        scale: float = 1.0,
        view: View = "isometric",
        title: str = "",
    ) -> None:
        values = self._at_local_nodes(self._evaluate(state)[self.field])
        grid = self._evaluate.grid
        u = state.u.x.array.reshape(-1, self.dim)
        surface = gather(grid, {"u": np.pad(u, ((0, 0), (0, 3 - self.dim))), "value": values})
        settings = {
            "scale": scale,
            "view": "z" if self.dim == 2 else view,
            "title": title,
            "plane": self.dim == 2,
        }
        _on_root_alone(self.comm, lambda: self._draw(surface, file, settings))

    def _at_local_nodes(self, values: Array) -> Array:
        grid, field = self._evaluate.grid, FIELDS[self.field]
        if field.columns > 1:
            values = np.linalg.norm(values, axis=1, keepdims=True)
        return to_nodes(grid.V, values) if field.centre == "cell" else _with_ghosts(grid, values)

    def _draw(self, surface: Surface | None, file: Path, settings: Mapping[str, Any]) -> None:
        assert surface is not None
        factor, unit = _prefix(
            float(np.abs(surface.values["value"]).max()), FIELDS[self.field].unit
        )
        label = self.field.replace("_", " ").replace("von mises", "von Mises stress")
        with writing(file), tempfile.TemporaryDirectory() as scratch:
            data = Path(scratch) / "surface.npz"
            np.savez(
                data,
                points=surface.points,
                triangles=surface.triangles,
                u=surface.values["u"],
                value=surface.values["value"][:, 0] / factor,
                label=f"{label} [{unit}]" if unit else label,
                **settings,
            )
            drawn = Path(scratch) / "picture.png"
            _run(data, drawn)
            draft = file.with_name(f".{file.name}.part")
            draft.write_bytes(drawn.read_bytes())
            draft.replace(file)


def _on_root_alone(comm: MPI.Comm, action: Callable[[], None]) -> None:
    """`on_root` for long work: the other ranks sleep, and leave it their processors. Collective."""
    error: Exception | None = None
    if comm.rank == 0:
        try:
            action()
        except Exception as caught:  # told to all ranks just below
            error = caught
    done = comm.Ibarrier()
    while not done.Test():
        time.sleep(_NAP)
    agree(comm, error)


def _with_ghosts(grid: Grid, values: Array) -> Array:
    """Values of the owned nodes, completed by those of the ghosts. Collective."""
    work = la.vector(grid.V.dofmap.index_map, 1)
    work.array[: len(values)] = values[:, 0]
    work.scatter_forward()
    return work.array[:, None].copy()


def _prefix(largest: float, unit: str) -> tuple[float, str]:
    """A factor and a unit with which the largest value reads well."""
    if unit not in ("Pa", "J/m^3", "m", "N") or not largest:
        return 1.0, unit
    factor, prefix = next(((f, p) for f, p in _PREFIXES if largest >= f), _PREFIXES[-1])
    return factor, prefix + unit


def _run(data: Path, drawn: Path) -> None:
    """Lets the other process draw.

    Raises:
        OutputError: It could not, with the last thing it said.
    """
    script = Path(__file__).with_name("_draw.py")
    with _display() as environment:
        try:
            done = subprocess.run(
                [sys.executable, "-P", str(script), str(data), str(drawn)],
                env=environment,
                capture_output=True,
                text=True,
                timeout=_TIMEOUT,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise OutputError(f"drawing a picture took longer than {_TIMEOUT} s") from None
    if done.returncode or not drawn.exists():
        said = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        raise OutputError(f"cannot draw a picture: {said}; pyvista and Xvfb are needed")


@contextmanager
def _display() -> Iterator[dict[str, str]]:
    """An environment with a display: one of our own, for a real one would flash windows."""
    # A child that believes to be an MPI rank may try to join the run.
    mine = {k: v for k, v in os.environ.items() if not k.startswith(("OMPI_", "PMIX_", "PMI_"))}
    if not which("Xvfb"):
        yield mine
        return
    server, number = _start_xvfb()
    try:
        yield {**mine, "DISPLAY": f":{number}"}
    finally:
        server.terminate()
        server.wait()


def _start_xvfb() -> tuple[subprocess.Popen[bytes], int]:
    """Starts a server on a display number that it finds free itself."""
    read, write = os.pipe()
    server = subprocess.Popen(
        [
            "Xvfb",
            "-displayfd",
            str(write),
            "-screen",
            "0",
            "1600x1200x24",
            "-nolisten",
            "tcp",
            "-terminate",
        ],
        pass_fds=[write],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    with os.fdopen(read) as answer:
        number = answer.readline().strip()
    if not number:
        server.wait()
        raise OutputError("cannot draw a picture: Xvfb did not start")
    return server, int(number)
