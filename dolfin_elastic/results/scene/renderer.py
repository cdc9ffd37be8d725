"""The process that draws pictures (`draw.py`), and the X display it draws on.

Starting both takes far longer than drawing: they are shared by all pictures of the program.  They
end by themselves if the program dies: the process when its input ends, the display when its last
client has gone.
"""

from __future__ import annotations

import atexit
import logging
import os
import select
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from ctypes.util import find_library
from pathlib import Path
from shutil import which
from typing import IO, cast

from dolfin_elastic.core.errors import DrawingError, OutputError
from dolfin_elastic.core.startup.elsewhere import EMPTY

_PROGRAM = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parents[3])!r})
from dolfin_elastic.core.startup.libraries import stay_without
stay_without()
from dolfin_elastic.results.scene.draw import main
main()
"""
log = logging.getLogger("dolfin_elastic")

_START = 30
"""Seconds that the display may take to start."""
_TIMEOUT = 300
"""Seconds that one picture may take."""


class Renderer:
    """The drawing process with its display.  Not collective: on rank 0."""

    def __init__(self) -> None:
        self._display, environment = _display()
        self._output = cast(IO[str], tempfile.TemporaryFile("w+", encoding="utf-8"))  # noqa: SIM115
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _PROGRAM],
            env=environment,
            cwd=EMPTY,  # matplotlib would read a matplotlibrc of the current folder
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._output,
            text=True,
            start_new_session=True,  # Ctrl-C is for the run, which wants its last picture
        )

    def draw(self, data: Sequence[Path], drawn: Path) -> None:
        """Draws one picture.

        Args:
            data: Files of pictures, see `scene.save`; several are drawn side by side.
            drawn: The PNG file.

        Raises:
            DrawingError: The process failed, with the last line of its output; it is of no use.
            OutputError: The picture cannot be written.
        """
        into, back = self._process.stdin, self._process.stdout
        assert into is not None
        assert back is not None
        try:
            into.write("\t".join(str(file.absolute()) for file in (*data, drawn)) + "\n")
            into.flush()
        except BrokenPipeError:
            raise self._fault() from None
        if not select.select([back], [], [], _TIMEOUT)[0]:
            raise DrawingError(f"drawing a picture took longer than {_TIMEOUT} s")
        if not (answer := back.readline().strip()):
            raise self._fault()
        if answer != "drawn":
            raise OutputError(f"cannot write a picture: {answer}")

    def _fault(self) -> DrawingError:
        code = self._process.wait()
        self._output.seek(0)
        text = (self._output.read().strip().splitlines() or [f"exit code {code}"])[-1]
        return DrawingError(f"cannot draw a picture: {text}; pyvista and Xvfb are needed")

    def close(self) -> None:
        """Ends the process and the display."""
        for process in (self._process, self._display):
            if process is not None:
                process.terminate()
                process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._output):
            if stream is not None:
                _close_quietly(stream)


class SharedRenderer:
    """The one renderer of this program: started at the first picture, ended with its last user."""

    def __init__(self) -> None:
        self._renderer: Renderer | None = None
        self._users: set[int] = set()

    def draw(self, user: object, data: Sequence[Path], drawn: Path) -> None:
        """Draws one picture; the renderer runs until all its users have called `release`.

        Args:
            user: Who draws, compared by identity.
            data: See `Renderer.draw`.
            drawn: The PNG file.

        Raises:
            OutputError: See `Renderer.draw`; the next picture starts a new renderer.
        """
        self._users.add(id(user))
        if self._renderer is None:
            self._renderer = Renderer()
        try:
            self._renderer.draw(data, drawn)
        except DrawingError:
            self._end()
            raise

    def hold(self, user: object) -> None:
        """Takes a user who will draw: the renderer does not end before its `release`."""
        self._users.add(id(user))

    def release(self, user: object) -> None:
        """Takes back a user, who has drawn its last picture."""
        self._users.discard(id(user))
        if not self._users:
            self._end()

    def _end(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


def _close_quietly(stream: IO[str]) -> None:
    with suppress(BrokenPipeError):  # unwritten input of a process that has died
        stream.close()


def _display() -> tuple[subprocess.Popen[bytes] | None, dict[str, str]]:
    """A virtual display, for windows would appear on a real one, and the child's environment.

    None is needed where VTK draws into memory, with OSMesa or EGL.
    """
    # With an MPI rank's variables the child might try to join the run.
    local = {k: v for k, v in os.environ.items() if not k.startswith(("OMPI_", "PMIX_", "PMI_"))}
    if window := _window_in_memory():
        log.debug("pictures are drawn by VTK's %s, without a display", window)
        local.pop("DISPLAY", None)
        return None, {**local, "VTK_DEFAULT_OPENGL_WINDOW": window}
    if not which("Xvfb"):
        log.debug("pictures are drawn on the display %s", local.get("DISPLAY", "that is not there"))
        return None, local
    server, number = _start_xvfb()
    log.debug("pictures are drawn on a virtual display, Xvfb :%d", number)
    return server, {**local, "DISPLAY": f":{number}"}


def _window_in_memory() -> str:
    """The class with which VTK draws without a display; empty where it has none."""
    from vtkmodules.vtkCommonCore import vtkVersion

    version = vtkVersion.GetVTKMajorVersion(), vtkVersion.GetVTKMinorVersion()
    if version < (9, 4):
        return ""
    # Mesa has no OSMesa from 25.1 on; VTK without it dies.
    if find_library("OSMesa"):
        return "vtkOSOpenGLRenderWindow"
    return "vtkEGLRenderWindow" if find_library("EGL") else ""


def _start_xvfb() -> tuple[subprocess.Popen[bytes], int]:
    """Starts a server, which chooses a free display number.

    Raises:
        DrawingError: It ends, or has no display after half a minute.
    """
    read, write = os.pipe()
    size = ["-screen", "0", "1600x1200x24"]
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), *size, "-nolisten", "tcp", "-terminate"],
        pass_fds=[write],
        cwd=EMPTY,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    os.close(write)
    with os.fdopen(read) as answer:
        ready = select.select([answer], [], [], _START)[0]
        number = answer.readline().strip() if ready else ""
    if not number:
        server.kill()
        server.wait()
        why = "has ended" if ready else f"has no display after {_START} s"
        raise DrawingError(f"cannot draw a picture: Xvfb {why}")
    return server, int(number)


RENDERER = SharedRenderer()
atexit.register(RENDERER._end)
