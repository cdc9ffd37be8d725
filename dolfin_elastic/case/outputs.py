"""Opening the files of a run, and closing them with how it ended."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dolfin_elastic.core.errors import ElasticError, OutputError, SolveError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.files import writing
from dolfin_elastic.results.outputs import Modes, Output, Xdmf
from dolfin_elastic.results.writer import Writer
from dolfin_elastic.results.writers.modes import clear as clear_modes
from dolfin_elastic.results.writers.xdmf import remove

log = logging.getLogger("dolfin_elastic")
_FAILED = "failed_state.xdmf"


@contextmanager
def opened(
    files: Sequence[Output],
    problem: Problem,
    folder: Path,
    kept: Sequence[Mapping[str, Any]] | None = None,
) -> Iterator[list[Writer]]:
    """Opens files and closes them with how it ended: completed, failed or stopped.

    Args:
        files: What is written.
        problem: The problem that is solved.
        folder: Of the results.
        kept: What their writers said at the checkpoint that the run goes on from.
    """
    writers: list[Writer] = []
    ending: tuple[str, object] = ("completed", None)
    try:
        for index, file in enumerate(files):
            writers.append(
                file.open(problem, folder)
                if kept is None
                else file.reopen(problem, folder, kept[index])
            )
        on_root(problem.body.comm, lambda: _remove_others(folder, files))
        yield writers
    except ElasticError as error:
        ending = ("failed", error)
        if isinstance(error, SolveError) and isinstance(error.state, State):
            try:
                _write_failed(problem, folder, error.state)
                error.add_note(f"the state that failed is in {folder / _FAILED}")
            except OutputError as second:
                log.warning("%s", second)
        raise
    except GeneratorExit:
        ending = ("stopped", "on request")
        raise
    except BaseException:
        writers.clear()  # perhaps on this rank alone: closing together would wait for ever
        raise
    finally:
        _close(writers, ending)


def _remove_others(folder: Path, files: Sequence[Output]) -> None:
    """Removes what an older run has left that this one has no name for. Not collective."""
    remove(folder / _FAILED)
    kinds = {type(file) for file in files}
    if Xdmf not in kinds:
        remove(folder / "results.xdmf")
        with writing(folder):
            (folder / "history.csv").unlink(missing_ok=True)
    if Modes not in kinds:
        clear_modes(folder)


def _close(writers: Iterable[Writer], ending: tuple[str, object]) -> None:
    """Closes all; a file that cannot be closed does not keep the others open, nor hide a cause."""
    fault: OutputError | None = None
    for writer in writers:
        try:
            writer.close(*ending)
        except OutputError as error:
            fault = fault or error
            log.warning("%s", error)
    if fault is not None and ending[0] == "completed":
        raise fault


def _write_failed(problem: Problem, folder: Path, state: State) -> None:
    """The state that is no solution, in a file of its own. Collective."""
    fields = ["displacement", "jacobian", "von_mises"]
    fields += ["residual"] * (state.v is None) + ["energy_density"] * problem.has_energy
    writer = Xdmf(file=_FAILED, fields=tuple(fields)).open(problem, folder)
    writer.write(state)
    writer.close("failed", None)
