"""`-ts_monitor` and `-ts_view` of a TS that is solved from one yielded state to the next.

TS monitors the state that a solve begins with and the one that it ends with, and is viewed at the
end of each solve: with as many solves as states, each state would be printed twice and TS as often
as there are states.
"""

from __future__ import annotations

from petsc4py import PETSc

from dolfin_elastic.core.petsc_options import PetscValue
from dolfin_elastic.solvers.petsc.options import Options


class TSOutput:
    """Prints each step once, in PETSc's format, and TS at the end. Collective.

    Viewers other than ASCII ones, such as `draw`, stay with PETSc.

    Args:
        ts: Whose steps are printed; its options are set already, but for these two.
        options: Of which the user's `ts_monitor` and `ts_view` are taken.
    """

    def __init__(self, ts: PETSc.TS, options: Options) -> None:
        self._ts, self._options = ts, options
        self._view = options.take("ts_view")
        self._last: tuple[int, float] | None = None
        self._viewer: PETSc.Viewer | None = None
        self._owned = False
        words = _words(options.users.get("ts_monitor"))
        if "ts_monitor" not in options.users or words[0] not in ("", "ascii"):
            return
        options.take("ts_monitor")
        self._owned = words[1] != ""
        if self._owned:
            mode = "a" if words[3] == "append" else "w"
            self._viewer = PETSc.Viewer().createASCII(words[1], mode, comm=ts.comm)
        else:
            self._viewer = PETSc.Viewer.STDOUT(ts.comm)
        ts.setMonitor(self._print)

    def _print(self, ts: PETSc.TS, step: int, t: float, u: PETSc.Vec) -> None:
        if self._last == (step, t):
            return
        self._last = step, t
        assert self._viewer is not None
        h = float(ts.getTimeStep())
        self._viewer.printfASCII(f"{step} TS dt {_real(h)} time {_real(t)}\n")

    def finish(self) -> None:
        """Views TS, when the motion has come to its end."""
        if self._view:
            with self._options.in_force(**self._view):
                self._ts.viewFromOptions("-ts_view")

    def destroy(self) -> None:
        """Closes a file of its own."""
        if self._owned and self._viewer is not None:
            self._viewer.destroy()


def _words(value: PetscValue) -> list[str]:
    """Type, file, format and mode of a viewer, as PETSc's options spell it."""
    text = "" if value is None or value is True else str(value)
    return [*text.split(":"), "", "", ""][:4]


def _real(value: float) -> str:
    """As PETSc's %g, which puts a point behind whole numbers."""
    text = f"{value:g}"
    return text if set(text) & set(".en") else f"{text}."
