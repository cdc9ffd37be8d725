"""`as_modes`: modes of a finished run in the place of its states."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.results.finished.findings import modes_of
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.finished.xdmf import Frame, damaged, read_frames


def as_modes(run: FinishedRun, mode: int | None) -> FinishedRun:
    """The run with its modes as `frames`, which hold the displacement of the animations.

    Args:
        mode: Number of the mode whose period is shown; 0: all modes, each at its largest
            displacement, with its frequency [Hz] or load factor as t; None: these where the run
            holds no steps, else the run as it is.

    Raises:
        InputError: There is no such mode, or its file is missing.
    """
    rows = modes_of(run)
    if mode is None and (run.frames or not rows):
        return run
    if not rows or (mode and mode not in [row.number for row in rows]):
        raise InputError(
            f"it holds no mode {mode or 'at all'}",
            where=str(run.folder),
            expected=f"1 to {len(rows)}, or 0 for all"
            if rows
            else "the results of [modal] or [buckling]",
        )
    result = copy(run)
    result.history, result.modal = {}, not mode
    if mode:
        result.frames = _frames(run, mode)
    else:
        values = [0.0 if row.value is None else row.value.value for row in rows]
        result.frames = [
            replace(_frames(run, row.number)[0], number=row.number, t=t)
            for row, t in zip(rows, values, strict=True)
        ]
    return result


def _frames(run: FinishedRun, mode: int) -> list[Frame]:
    path = run.folder / f"mode_{mode:02d}.xdmf"
    if frames := read_frames(path):
        return frames
    raise damaged("there is no such file", str(path))
