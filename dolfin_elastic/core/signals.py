"""Signals and a file by which a user ends a run, or asks for a checkpoint."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, ClassVar

from dolfin_elastic.core.errors import StoppedError

if TYPE_CHECKING:
    from mpi4py import MPI

INTERRUPTED = StoppedError.exit_code
"""Exit code of a run that was stopped."""

STOP_FILE = "stop"
"""File in the folder of results that ends a run there."""

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGUSR2, signal.SIGHUP)
"""Signals that end a run; SIGHUP, of a terminal that is closed, unless nohup ignores it."""

SAME_SIGNAL = 0.5
"""Signals closer than this [s] count as one: a launcher forwards what the group got already."""

LOOK = 1.0
"""Seconds from one look for the file to the next."""

LAST = 3
"""Signals after which the process ends at once, wherever it is."""


class Stop:
    """Records signals and a file "stop", which end the run as soon as all ranks can agree on it.

    While it exists, `raise_if_asked` and `raise_if_agreed` ask it.  The second signal changes
    nothing but the message; the third ends the process at once, with the last checkpoint on disk.

    Args:
        folder: Folder of the results, where a file called "stop" may appear.
        last_words: Called before the process ends at once.
        around: The folder around it, of several analyses, where the file may appear, too.
    """

    _first_words: ClassVar[str] = "\nstopping with a checkpoint of the last complete step"

    def __init__(
        self,
        folder: Path,
        last_words: Callable[[], object] = lambda: None,
        *,
        around: Path | None = None,
    ) -> None:
        self.asked, self._checkpoint, self._file = False, False, folder / STOP_FILE
        folders = [folder, around or folder]
        self._folders = [one.absolute() for one in folders]  # cffi compiles in one of its own
        self._since, self._signals, self._looked = 0.0, 0, 0.0
        self._interruptible = self._agreed = self._noticed = False
        self._last: Callable[[], object] = lambda: None
        self._last_words = last_words
        self._listen()

    def _listen(self) -> None:
        _handle(ENDING, self._request_stop)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)  # see `ignore_more`
        signal.signal(signal.SIGUSR1, self._request_checkpoint)
        _current.append(self)

    def _file_is_there(self) -> bool:
        return any((one / STOP_FILE).exists() for one in self._folders)

    def _request_stop(self, number: int, frame: FrameType | None) -> None:
        if self._noticed:
            self._noticed = False
            self._interrupt()
            return
        now = time.monotonic()
        if self._signals and now - self._since < SAME_SIGNAL:
            return
        self.asked, self._since, self._signals = True, now, self._signals + 1
        if self._signals >= LAST:
            with suppress(Exception):
                self._last_words()
            os._exit(INTERRUPTED)
        if launched_rank() == 0:
            _tell(self._first_words if self._signals == 1 else _SECOND_WORDS)
        self._interrupt()

    def _interrupt(self) -> None:
        if self._interruptible:
            self._interruptible = False
            self._last()
            raise StoppedError(_WORDS)

    def _request_checkpoint(self, number: int, frame: FrameType | None) -> None:
        self._checkpoint = True

    def wants_checkpoint(self) -> bool:
        """Whether this rank got SIGUSR1 since the last call. Not collective."""
        wanted, self._checkpoint = self._checkpoint, False
        return wanted

    def asked_here(self) -> bool:
        """Whether this rank got a signal to stop, or sees the file. Not collective."""
        now = time.monotonic()
        if not self.asked and now - self._looked > LOOK:
            self._looked = now
            self.asked = self._file_is_there()
        return self.asked and not self._agreed

    def agreed(self, comm: MPI.Comm) -> bool:
        """Whether any rank got a signal to stop, or the file exists; same on all. Collective."""
        from mpi4py import MPI

        if self._agreed:
            return True
        if comm.rank == 0 and self._file_is_there():
            self.asked = True
            _tell(f"stopping: there was a file {self._file}")
            self._remove_file()  # or the next run would stop at once
        self._agreed = bool(comm.allreduce(int(self.asked), op=MPI.MAX))
        return self._agreed

    def acknowledge(self) -> None:
        """From now on the run ends in order, and nothing interrupts that.

        All ranks have agreed on it: the file, if it was one, has served.
        """
        self.asked = self._agreed = True
        if launched_rank() == 0 and self._file_is_there():
            self._remove_file()

    def _remove_file(self) -> None:
        for folder in self._folders:
            remove_stop_file(folder)

    @contextmanager
    def interruptible(self, last: Callable[[], object]) -> Iterator[None]:
        """See the function."""
        if self.asked and not self._agreed:
            raise StoppedError(_WORDS)
        if self._agreed:
            yield
            return
        end = threading.Event()
        watch = threading.Thread(target=self._watch, args=(end,), daemon=True)
        watch.start()  # a handler that raised in here would leave half a thread
        try:
            self._last, self._interruptible = last, True
            if self.asked:
                self._interrupt()
            yield
        finally:
            self._interruptible = False
            end.set()
            watch.join()
            self._interruptible = self._noticed = False  # it may have raised them meanwhile

    def _watch(self, end: threading.Event) -> None:
        """Interrupts the main thread, by a signal, where there is a file "stop".

        And again where it goes on: an exception may be lost where it is raised, in a handler of the
        log or as an object is freed.
        """
        main, raised = threading.main_thread().ident, False
        while not end.wait(LOOK):
            if self.asked and not raised:
                raised = True  # by the signal; what ends now has until the next look
            elif self.asked or self._file_is_there():
                if not self.asked and launched_rank() == 0:
                    _tell(f"stopping: there is a file {self._file}")
                self.asked = raised = self._noticed = self._interruptible = True
                signal.pthread_kill(main or 0, signal.SIGUSR2)


class PythonStop(Stop):
    """Ctrl-C in a program of the user's, while one of its loops over states computes.

    The first one ends the loop where all ranks can agree on it, as `Stop` does; the second raises
    KeyboardInterrupt at once.  It records signals inside `listening` only: in the body of the loop
    Python's own handler raises.
    """

    _first_words: ClassVar[str] = "\nstopping after what is being solved; Ctrl-C again: at once"

    def __init__(self) -> None:
        super().__init__(Path())

    @classmethod
    def where_nobody_listens(cls, comm: MPI.Comm) -> PythonStop | None:
        """One for a loop over states; None where a command or the user's program has handlers.

        Collective.

        Args:
            comm: The ranks of the loop.
        """
        from mpi4py import MPI

        here = threading.current_thread() is threading.main_thread()
        free = here and not _current and _raises_at_once()
        return cls() if comm.allreduce(int(free), op=MPI.MIN) else None

    def _listen(self) -> None:
        """Nothing yet: see `listening`."""

    def _file_is_there(self) -> bool:
        return False

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Records Ctrl-C inside.  The handlers of before are there again afterwards."""
        raised_at_once = _raises_at_once()  # the body of the loop may have set a handler
        if raised_at_once:
            signal.signal(signal.SIGINT, self._request_stop)
        _current.append(self)
        try:
            yield
        finally:
            _current.remove(self)
            if raised_at_once:
                signal.signal(signal.SIGINT, signal.default_int_handler)

    def _request_stop(self, number: int, frame: FrameType | None) -> None:
        if self._signals and time.monotonic() - self._since >= SAME_SIGNAL:
            signal.default_int_handler(number, frame)
        super()._request_stop(number, frame)


def _raises_at_once() -> bool:
    """Whether Ctrl-C raises KeyboardInterrupt wherever Python is, as it does by default."""
    return signal.getsignal(signal.SIGINT) is signal.default_int_handler


_WORDS = "stopped on request"
_SECOND_WORDS = (
    "\nstopping once the linear solver or the writing of files has ended; once more: at once, and "
    "only the last checkpoint is left"
)
_current: list[Stop] = []
"""The last one is asked; empty in a program of the user's but in its loops over states."""


def _tell(text: str) -> None:
    # Not `print`: it is not reentrant, and the signal may have interrupted one.
    with suppress(OSError):  # the terminal may be closed
        os.write(2, f"{text}\n".encode())


@contextmanager
def interruptible(last: Callable[[], object] = lambda: None) -> Iterator[None]:
    """Makes a signal to stop, or a file "stop", raise at once inside.

    For work of this rank alone, not for MPI.

    Args:
        last: Called before it raises, with what was being done still in place.

    Raises:
        StoppedError: One came, or had come before.
    """
    if not _current:
        yield
        return
    with _current[-1].interruptible(last):
        yield


def raise_if_asked() -> None:
    """Ends what this rank does alone, where the run shall stop. Not collective.

    Raises:
        StoppedError: This rank got a signal, or sees the file "stop".
    """
    if _current and _current[-1].asked_here():
        raise StoppedError(_WORDS)


def acknowledge() -> None:
    """Lets a run that is being stopped end in order: it may compile what closes its files."""
    if _current:
        _current[-1].acknowledge()


def ignore_more() -> None:
    """Ignores further signals to stop once a stopped run has ended; Python would die of them.

    The interpreter forgets its handlers while it ends, and a signal would change the exit code.
    """
    if _current and _current[-1].asked:
        _handle(ENDING, signal.SIG_IGN)
        # PETSc gives SIGTERM its default again while it ends.
        signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)


def _handle(
    numbers: Iterable[signal.Signals], handler: Callable[[int, FrameType | None], Any] | int
) -> None:
    """Sets a handler for signals; SIGHUP stays ignored where nohup has told so."""
    for number in numbers:
        ignored = number == signal.SIGHUP and signal.getsignal(number) == signal.SIG_IGN
        # Ignored anew: PETSc has put a handler of its own there, which ends the process.
        signal.signal(number, signal.SIG_IGN if ignored else handler)


def interrupt_on_request() -> None:
    """Lets SIGTERM and SIGHUP end this process as Ctrl-C does, so that temporary files go.

    For commands without results, once PETSc has started; `Stop` does it where there are any.
    """
    _handle((signal.SIGTERM, signal.SIGHUP), signal.default_int_handler)


def watched() -> bool:
    """Whether anything can ask for the end of the run."""
    return bool(_current)


def stop_agreed(comm: MPI.Comm) -> bool:
    """Whether the run shall stop, the same on all ranks; once true, it stays so. Collective."""
    return bool(_current) and _current[-1].agreed(comm)


def raise_if_agreed(comm: MPI.Comm) -> None:
    """Ends what all ranks do, where the run shall stop. Collective.

    Args:
        comm: The ranks of the run.

    Raises:
        StoppedError: Any rank got a signal, or the file "stop" exists; on all ranks.
    """
    if stop_agreed(comm):
        raise StoppedError(_WORDS)


def remove_stop_file(folder: Path) -> None:
    """Removes the file "stop" from a folder of results.

    It has stopped a run, or was to stop one that ended before.
    """
    with suppress(OSError):  # another user's file may not be removable
        (folder / STOP_FILE).unlink(missing_ok=True)


_RANKS = ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK", "SLURM_PROCID")
"""Variables in which launchers say what rank a process is."""


def launched() -> bool:
    """Whether a launcher has started this process."""
    return any(os.environ.get(name, "").isdigit() for name in _RANKS)


def launched_rank() -> int:
    """Rank of this process as its launcher says, without starting MPI; 0 without a launcher."""
    return next((int(os.environ[name]) for name in _RANKS if os.environ.get(name, "").isdigit()), 0)
