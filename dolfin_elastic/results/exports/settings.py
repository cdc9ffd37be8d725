"""`ExportSettings`: how a finished run is exported, whatever the format."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class ExportSettings:
    """How a finished run is exported.

    Attributes:
        field: Name of the field that colours a surface; None: the von Mises stress, or where the
            run has none the displacement.
        frames: Number of states, evenly over the run; None: all.
        scale: Magnification of the displacement.
        fps: States a second; None: in motion the times of the run, else 24.
        limits: Values of the first and the last colour [SI]; None: the smallest and the largest.
        skin: A surface that follows the body in place of the body's own; None: its own.
        mode: Number of the mode that is shown; 0: all of them, one state each; None: the states of
            the run, or all modes where it has none.
    """

    field: str | None = None
    frames: int | None = None
    scale: float = 1.0
    fps: float | None = None
    limits: tuple[float, float] | None = None
    skin: Path | None = None
    mode: int | None = None
