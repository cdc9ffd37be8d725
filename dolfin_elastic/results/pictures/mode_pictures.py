"""Pictures of modes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from dolfinx import fem

from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.timing import stage
from dolfin_elastic.mesh.body import extent
from dolfin_elastic.problem.state import Mode, State
from dolfin_elastic.results.files import make_folder, writing
from dolfin_elastic.results.pictures.pictures import Painter, own_files
from dolfin_elastic.results.writer import Numbers

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem


class ModePictureWriter:
    """Draws each mode, coloured by its displacement.  All of it is collective.

    Args:
        problem: The problem that is solved.
        path: The PNG file; the mode's number goes into its name.
        amplitude: Largest displacement, over the body's longest side.
        title: Stands above the body, before the mode.
        options: `scale` and `view` of `pictures.picture`.
    """

    def __init__(
        self, problem: Problem, path: Path, *, amplitude: float, title: str, **options: Any
    ) -> None:
        self.path, self.title, self.options = path, title, options
        self._u, self._w = fem.Function(problem.V), fem.Function(problem.W)
        self._size = amplitude * max(extent(problem.body))
        with stage("output"):
            on_root(problem.body.comm, self._clear)
            self._painter = Painter(problem, "displacement")

    def _clear(self) -> None:
        make_folder(self.path.parent)
        with writing(self.path):
            for file in own_files(self.path):
                file.unlink()

    def write(self, state: State) -> None:
        """Takes no notice of what is no mode."""

    def write_mode(self, mode: Mode) -> None:
        """Draws one mode about the state that it belongs to."""
        with stage("output"):
            self._u.x.array[:] = mode.base.x.array + self._size * mode.u.x.array
            state = State(mode.number, 0.0, self._u, w=self._w, load_factor=float("nan"))
            file = self.path.with_name(f"{self.path.stem}_{mode.number:04d}{self.path.suffix}")
            title = "   |   ".join(filter(None, (self.title, _told(mode))))
            self._painter.paint(state, file, title=title, **self.options)

    def restart_state(self) -> Numbers:
        """See `Writer`; runs of modes have no checkpoints."""
        return {}

    def close(self, status: str = "completed", error: object = None) -> None:
        """There is nothing more to draw."""
        self._painter.close()


def _told(mode: Mode) -> str:
    if mode.kind == "buckling":
        return f"mode {mode.number}: load factor {mode.load_factor:.5g}"
    return f"mode {mode.number}: {mode.name or f'{mode.frequency:.5g} Hz'}"
