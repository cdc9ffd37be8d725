"""Pictures of one body in several states: one range of colours, one camera, and films of them.

What is drawn is kept in files in a hidden folder beside the pictures until the run ends, for the
range of the colours and the room that the body takes are known only then.  Rank 0 alone.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import OutputError, RestartError
from dolfin_elastic.core.files.regular import fresh
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.results.files import writing
from dolfin_elastic.results.scene.renderer import RENDERER
from dolfin_elastic.results.scene.scene import (
    SMALL_MATTERS,
    Obstacle,
    Picture,
    bar_of,
    joined_windows,
    load,
    marked,
    save,
)

FILMS = (".mp4", ".gif")
"""Suffixes of films."""
_EVEN = 1e-6
"""Difference of times that is round-off, over the time of a frame."""
_TIMEOUT = 600
"""Seconds that encoding a film may take."""


@dataclass(frozen=True)
class Limits:
    """Ends of the colour bar.

    Attributes:
        ends: Both of them [SI], or percentiles; None: those of all values.
        share: They are percentiles.
    """

    ends: tuple[float, float] | None = None
    share: bool = False


@dataclass(frozen=True)
class _Drawn:
    """What a picture showed of the whole series: if it changes, the picture is drawn again."""

    ends: tuple[tuple[float, float] | None, ...]
    window: tuple[float, ...]


class Series:
    """Draws the pictures of one output.

    Args:
        folder: Where scenes are kept; None: of one picture none are.
    """

    def __init__(self, limits: Limits, *, marks: bool, folder: Path | None = None) -> None:
        self._limits, self._marks, self._folder = limits, marks, folder
        self._ends: list[tuple[float, float] | None] = []
        self._windows: list[FloatArray] = []
        self._drawn: dict[Path, tuple[int, _Drawn]] = {}
        self._floor: Sequence[Obstacle] = ()

    def add(self, number: int, panels: Sequence[Picture]) -> None:
        """Keeps what one picture shows.

        Args:
            panels: What is seen side by side.

        Raises:
            OutputError: Nothing of the body is seen, or it cannot be kept.
        """
        if not all(len(panel.scene.triangles) for panel in panels):
            raise OutputError("the clip planes leave nothing of the body")
        self._take(panels)
        if self._folder is not None:
            with writing(self._folder):
                self._folder.mkdir(parents=True, exist_ok=True)
                for i, panel in enumerate(panels):
                    save(fresh(self._folder / f"{number:08d}_{i}.npz"), panel)

    def numbers(self) -> list[int]:
        """Steps whose scenes are kept, in their order."""
        folder = self._folder
        if folder is None or not folder.is_dir():
            return []
        return sorted({int(path.name[:8]) for path in folder.glob("????????_?.npz")})

    def forget_after(self, step: int) -> None:
        """Removes the scenes of later steps, and takes up those of earlier ones.

        Raises:
            RestartError: One of these is damaged, or of a version that describes them otherwise.
        """
        for number in self.numbers():
            files = self._files(number)
            if number > step:
                for file in files:
                    file.unlink()
                continue
            try:
                self._take([load(file) for file in files])
            except Exception as error:  # whatever numpy, JSON or a class make of another version's
                raise RestartError(
                    f"this is no scene as this version of the program keeps them ({error!r})",
                    where=str(files[0]),
                    expected="go on with the version that has written it, or remove "
                    f"{self._folder}: pictures and films then show what follows the checkpoint",
                ) from error

    def _take(self, panels: Sequence[Picture]) -> None:
        """Widens range, camera and floor to what a picture shows."""
        self._windows.append(joined_windows([panel.seen for panel in panels]))
        result = [_ends(panel, self._limits) for panel in panels]
        before = self._ends or [None] * len(result)
        self._ends = [_wider(a, b) for a, b in zip(before, result, strict=True)]
        floor = panels[0].scene.obstacles
        if _size(floor) >= _size(self._floor):
            self._floor = floor

    def _files(self, number: int) -> list[Path]:
        assert self._folder is not None
        return sorted(self._folder.glob(f"{number:08d}_?.npz"))

    def draw(self, number: int, panels: Sequence[Picture], file: Path) -> None:
        """Draws a picture with the range and the camera of all scenes so far.

        Args:
            panels: See `add`.
            file: The PNG file.

        Raises:
            OutputError: It cannot be drawn or written.
        """
        draw_pictures(self, [self._finished(panel, i) for i, panel in enumerate(panels)], file)
        self._drawn[file] = number, self._present()

    def _present(self) -> _Drawn:
        window = joined_windows(self._windows)
        return _Drawn(tuple(self._ends), tuple(window.ravel().tolist()))

    def _finished(self, panel: Picture, index: int) -> Picture:
        window, own = joined_windows(self._windows), panel.scene.obstacles
        if own:
            pairs = zip(self._floor, own, strict=True)
            moved = (b if b.turned else replace(a, shift=b.shift) for a, b in pairs)
            panel = replace(panel, scene=replace(panel.scene, obstacles=tuple(moved)))
        return finished(panel, self._ends[index], self._limits, window, marks=self._marks)

    def redraw(self) -> None:
        """Draws again the pictures that later states have made too narrow."""
        now = self._present() if self._windows else None
        for file, (number, before) in self._drawn.items():
            if before != now and (files := self._files(number)) and file.exists():
                self.draw(number, [load(one) for one in files], file)

    def film(self, file: Path, times: Sequence[float], numbers: Sequence[int], fps: float) -> None:
        """Draws all kept scenes and joins them to a film in even time.

        Args:
            file: The .mp4 or .gif file.
            times: Time of each scene in the film [s], ascending.

        Raises:
            OutputError: It cannot be drawn or written.
        """
        if not len(times):
            raise OutputError(f"cannot make {file}: no state of it is left to be drawn")
        with writing(file), tempfile.TemporaryDirectory() as scratch:
            chosen = frames_at(times, fps)
            drawn: dict[int, Path] = {}
            for frame, index in enumerate(chosen):
                if index not in drawn:
                    drawn[index] = Path(scratch) / f"drawn_{index:08d}.png"
                    panels = [load(one) for one in self._files(numbers[index])]
                    self.draw(numbers[index], panels, drawn[index])
                (Path(scratch) / f"frame_{frame:08d}.png").symlink_to(drawn[index])
            encode(Path(scratch) / "frame_%08d.png", file, fps)

    def close(self, *, keep: bool = False) -> None:
        """Ends the drawing.

        Args:
            keep: The run may go on: its scenes stay.
        """
        RENDERER.release(self)
        if not keep and self._folder is not None and self._folder.is_dir():
            shutil.rmtree(self._folder, ignore_errors=True)


def film_times(states: Sequence[float], speed: float) -> list[float]:
    """Time of each state in a film [s], the first one 0.

    Along a path whose load falls the film goes on, too.

    Args:
        states: Their times [s], in statics load parameters.
        speed: What of these passes in a second of the film.
    """
    steps = np.abs(np.diff(np.array(states, dtype=float))) / speed
    return [0.0, *(float(t) for t in np.cumsum(steps))]


def frames_at(times: Sequence[float], fps: float) -> list[int]:
    """Index of the scene that each frame of a film shows: the one whose time is nearest.

    Args:
        times: Of the scenes in the film [s], ascending, the first one 0.
    """
    known = np.array(times)
    count = round(float(known[-1] - known[0]) * fps) + 1
    wanted = known[0] + np.arange(count) / fps
    after = np.clip(np.searchsorted(known, wanted), 1, max(len(known) - 1, 1))
    if len(known) == 1:
        return [0] * count
    nearer = wanted - known[after - 1] <= known[after] - wanted + _EVEN / fps
    return [int(i) for i in np.where(nearer, after - 1, after)]


def encode(frames: Path, file: Path, fps: float) -> None:
    """Joins pictures to a film by ffmpeg.

    Args:
        frames: Pattern of the names of PNG files.
        file: The .mp4 or .gif file.

    Raises:
        OutputError: There is no ffmpeg, or it has failed.
    """
    program = shutil.which("ffmpeg")
    if program is None:
        raise OutputError("cannot make a film: ffmpeg is not installed (Debian: ffmpeg)")
    draft = file.with_name(f".{file.stem}.part{file.suffix}")
    kinds = {
        ".mp4": ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-c:v", "libx264", "-pix_fmt", "yuv420p"],
        ".gif": ["-vf", "scale=900:-1:flags=lanczos,split[a][b];[a]palettegen[p];[b][p]paletteuse"],
    }
    command = [program, "-v", "error", "-y", "-framerate", f"{fps:g}", "-i", str(frames)]
    with writing(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        fresh(draft)
        try:
            done = subprocess.run(
                [*command, *kinds[file.suffix], str(draft.absolute())],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                timeout=_TIMEOUT,
                check=False,
            )
        except subprocess.TimeoutExpired:
            draft.unlink(missing_ok=True)
            raise OutputError(
                f"cannot make a film: ffmpeg has not ended within {_TIMEOUT} s"
            ) from None
        if done.returncode:
            text = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
            raise OutputError(f"cannot make a film: ffmpeg: {text}")
        draft.replace(file)


def finished(
    picture: Picture,
    ends: tuple[float, float] | None,
    limits: Limits,
    window: FloatArray,
    *,
    marks: bool,
) -> Picture:
    """A picture with its colour bar and camera.

    Args:
        ends: Smallest and largest value that the bar has to show [SI].
        window: What the camera has to show, see `scene.window`.
    """
    picture = replace(picture, window=window)
    if not picture.field:
        return picture
    bar = bar_of(
        picture.frame.values[picture.field],
        np.array(ends if ends is not None else (np.nan, np.nan)),
        picture.field,
        picture.unit,
        noise=picture.noise,
        ends=ends if limits.ends is not None else None,
        tensor=picture.tensor,
        note="scaled to 1" if picture.scaled else "",
        cut=picture.reliable is not None and limits.ends is None,
        limit=picture.allowable,
    )
    picture = replace(picture, bar=bar)
    return marked(picture) if marks else picture


def draw_pictures(user: object, pictures: Sequence[Picture], file: Path) -> None:
    """Draws pictures side by side.

    Args:
        user: Who draws, see `SharedRenderer`.
        file: The PNG file.

    Raises:
        DrawingError: There is nothing that draws.
        OutputError: It cannot be written.
    """
    with writing(file), tempfile.TemporaryDirectory() as scratch:
        data = [Path(scratch) / f"{i}.npz" for i in range(len(pictures))]
        drawn = Path(scratch) / "picture.png"
        for path, picture in zip(data, pictures, strict=True):
            save(path, picture)
        RENDERER.draw(user, data, drawn)
        file.parent.mkdir(parents=True, exist_ok=True)
        draft = file.with_name(f".{file.name}.part")
        fresh(draft).write_bytes(drawn.read_bytes())
        draft.replace(file)


def _ends(picture: Picture, limits: Limits) -> tuple[float, float] | None:
    """Smallest and largest value that the colour bar has to show; None where there is none."""
    if not picture.field:
        return None
    values = picture.frame.values[picture.field]
    values = values[np.isfinite(values)]
    if limits.ends is not None and not limits.share:
        return limits.ends
    if picture.scaled:  # between nodes quadratic interpolation overshoots
        return 0.0, 1.0
    if not len(values):
        return None
    low, high = np.percentile(values, limits.ends if limits.ends is not None else (0, 100))
    if limits.ends is None and picture.reliable is not None and picture.field not in SMALL_MATTERS:
        high = np.fmin(high, picture.reliable.value)  # a singular value has no limit
    return float(low), float(high)


def _size(obstacles: Sequence[Obstacle]) -> float:
    if not obstacles:
        return 0.0
    return float(np.ptp(np.concatenate([one.points for one in obstacles]), axis=0).sum())


def _wider(
    a: tuple[float, float] | None, b: tuple[float, float] | None
) -> tuple[float, float] | None:
    if a is None or b is None:
        return a or b
    return min(a[0], b[0]), max(a[1], b[1])
