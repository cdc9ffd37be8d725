"""Every error of the package, drawn as a list.

ElasticError                      base: `except ElasticError` catches all of them
├── InputError          exit 2    what the user wrote is wrong: where, what, expected
│   ├── CaseError                 a key or value of the case file
│   ├── FormulaError              a formula ("0.1*x*t")
│   ├── UnitError                 a number with a unit ("10 MPa")
│   ├── MeshError                 a mesh file, a region or surface name, a geometry selector
│   └── RestartError              a folder of results without a usable checkpoint, or in use
├── SolveError          exit 3    the input is right, but no solution was found
│   ├── ConvergenceError          Newton or the load stepping gave up
│   └── StabilityError            explicit dynamics diverged, or its step exceeds the stable one
├── OutputError         exit 4    results cannot be written
│   └── DrawingError              no picture can be drawn here: no display, no VTK, or it fails
└── StoppedError        exit 130  the user has asked for the end of the run
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from dolfin_elastic.core.synonyms import meant


class ElasticError(Exception):
    """Base of all errors of this package."""

    exit_code = 1


class InputError(ElasticError, ValueError):
    """Something the user wrote is wrong.

    Args:
        what: What is wrong, in one sentence without a final stop.
        where: File and dotted key, for example ``beam.toml: materials.steel.nu``.
        others: What else is wrong in the same input.
    """

    exit_code = 2

    def __init__(
        self,
        what: str,
        *,
        where: str = "",
        expected: str = "",
        others: Sequence[InputError] = (),
    ) -> None:
        self.what, self.where, self.expected, self.others = what, where, expected, (*others,)
        super().__init__(str(self))

    @property
    def text(self) -> str:
        """The error in one line, without the others."""
        text = f"{self.where}: {self.what}" if self.where else self.what
        return f"{text}; {self.expected}" if self.expected else text

    @property
    def each(self) -> tuple[InputError, ...]:
        """This error alone, and the others, each alone."""
        if not self.others:
            return (self,)
        return _rebuild(type(self), self.what, self.where, self.expected, ()), *self.others

    def __str__(self) -> str:
        return "\n".join(one.text for one in self.each)

    def __reduce__(self) -> tuple[object, ...]:
        # Errors travel between ranks; the default would drop the keyword arguments.
        return _rebuild, (type(self), self.what, self.where, self.expected, self.others)

    def moved(self, place: Callable[[str], str]) -> InputError:
        """The same errors elsewhere: `place` gives the new place of each from its old one."""
        others = [one.moved(place) for one in self.others]
        return _rebuild(type(self), self.what, place(self.where), self.expected, others)

    def at(self, key: str) -> InputError:
        """The same errors with a table's key in front of the keys that they name."""
        return self.moved(lambda where: dotted(key, where))


def dotted(key: str, inner: str) -> str:
    """A key inside a table, or an index, behind the table's key; both may be empty."""
    return f"{key}{'.' if key and inner and not inner.startswith('[') else ''}{inner}"


def _rebuild(
    kind: type[InputError], what: str, where: str, expected: str, others: Sequence[InputError]
) -> InputError:
    return kind(what, where=where, expected=expected, others=others)


def joined(errors: Iterable[InputError]) -> InputError:
    """Several errors, at least one, as one that has the others with it; each text once."""
    first, *others = {one.text: one for error in errors for one in error.each}.values()
    return _rebuild(type(first), first.what, first.where, first.expected, others)


MOST_ERRORS = 50
"""Errors of one table or list that are told at once."""


@contextmanager
def all_errors() -> Iterator[Callable[[], AbstractContextManager[None]]]:
    """Makes contexts in which an `InputError` is put off: all are raised together at the end."""
    errors: list[InputError] = []

    @contextmanager
    def attempt() -> Iterator[None]:
        try:
            yield
        except InputError as error:
            errors.append(error)
            if len(errors) == MOST_ERRORS:
                raise joined(errors) from None

    with attempt():
        yield attempt
    if errors:
        raise joined(errors)


@contextmanager
def keyed(key: str) -> Iterator[None]:
    """Errors raised inside get a key in front of where they point."""
    try:
        yield
    except InputError as error:
        raise error.at(key) from None


class CaseError(InputError):
    """A key or value of the case file is wrong."""


class FormulaError(InputError):
    """A formula cannot be read or uses a name that does not exist."""


class UnitError(InputError):
    """A number's unit is unknown or measures something else."""


class MeshError(InputError):
    """A mesh, or a name or selector that refers to one, is wrong."""


class RestartError(InputError):
    """No checkpoint to restart from, one of another case or mesh, or a run still writes there."""


class SolveError(ElasticError):
    """The input is right, but no solution was found.

    Args:
        state: The `State` that was reached without being a solution, to be looked at.
        diagnosis: Why, where, and what to try, as data.
    """

    exit_code = 3

    def __init__(
        self,
        what: str,
        *,
        advice: str = "",
        state: object | None = None,
        diagnosis: Diagnosis | None = None,
    ) -> None:
        self.what, self.advice, self.state, self.diagnosis = what, advice, state, diagnosis
        super().__init__(what, advice)

    def __str__(self) -> str:
        return f"{self.what}\n  try: {self.advice}" if self.advice else self.what

    def __reduce__(self) -> tuple[object, ...]:
        return _rebuild_solve, (type(self), self.what, self.advice, self.diagnosis)


def _rebuild_solve(
    kind: type[SolveError], what: str, advice: str, diagnosis: Diagnosis | None
) -> SolveError:
    return kind(what, advice=advice, diagnosis=diagnosis)


@dataclass(frozen=True)
class BadCell:
    """A cell of an iterate that has not converged.

    Attributes:
        place: Its middle in the reference configuration [m].
        material: Name of its material.
        regions: Named regions it belongs to.
        jacobian: Its smallest det F.
        residual: Largest residual force at its free nodes [N].
    """

    place: tuple[float, ...]
    material: str
    regions: tuple[str, ...]
    jacobian: float
    residual: float


@dataclass(frozen=True)
class Diagnosis:
    """Why a solve failed: plain data, the same on every rank.

    Attributes:
        cause: One of "nan", "inverted", "rigid-motion", "obstacle", "edge", "sliding", "unstable",
            "linear-solver", "round-off", "stalled" and "iterations"; of implicit motion "energy",
            too; of explicit motion "nan", "inverted", "unbounded" and "step".
        text: One or two sentences with names, places and numbers, without a final stop.
        advice: What to try.
        place: Where the trouble is, in the reference configuration [m]; empty if nowhere.
        cells: The worst cells of the last iterate, or of the first place without a finite force, at
            most ten, the worst first.
    """

    cause: str
    text: str
    advice: str
    place: tuple[float, ...] = ()
    cells: tuple[BadCell, ...] = ()


class ConvergenceError(SolveError):
    """Newton's method or the load stepping gave up."""


class StabilityError(SolveError):
    """Explicit dynamics diverged, or its time step exceeds the stable one."""


class OutputError(ElasticError):
    """Results cannot be written."""

    exit_code = 4


class DrawingError(OutputError):
    """The drawing process cannot be started, has failed or does not answer."""


class StoppedError(ElasticError):
    """A signal, or a file "stop", has asked for the end of the run."""

    exit_code = 130


def why_no_file(path: str | Path, most: int) -> str:
    """Why something cannot be read as a file, before it is opened; empty where it can, or is none.

    A pipe would be waited for without an end, and a device has no end.

    Args:
        path: The file.
        most: Bytes that it may have.
    """
    try:
        status = os.stat(path)
    except FileNotFoundError:
        return ""
    except ValueError:
        return "a name cannot contain the character NUL"
    except OSError as error:
        return f"it cannot be read: {os.strerror(error.errno or 0).lower()}"
    if stat.S_ISREG(status.st_mode):
        return f"it has {status.st_size} bytes, more than {most}" if status.st_size > most else ""
    kinds = {stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket", stat.S_IFDIR: "a folder"}
    return f"this is {kinds.get(stat.S_IFMT(status.st_mode), 'a device')}, not a file"


OF_MATERIAL = " (material)"
"""Ends the name of a material's region where the mesh has a region of that name."""

SHOWN = "DOLFIN_ELASTIC_SHOWN"
"""Variable in which docker/run says which folders of the machine a command sees, between colons."""


_OF_ITS_OWN = ("/", "/tmp", "/var/tmp", "/home", "/root", "/mnt", "/media", "/srv", "/opt")
"""Folders that are there inside, but are not the machine's."""


def not_shown(path: str | Path) -> str:
    """Hint at a missing file that may be there, outside what docker/run shows.

    Args:
        path: The file.

    Returns:
        What to write; empty where docker/run has not started the program, or shows that folder.
    """
    shown = [Path(folder) for folder in os.environ.get(SHOWN, "").split(":") if folder]
    whole = Path(os.path.realpath(path))
    if not shown or any(whole.is_relative_to(folder) for folder in shown):
        return ""
    made_inside = whole.parent.is_dir() and os.access(whole.parent, os.W_OK)
    if made_inside and str(whole.parent) not in _OF_ITS_OWN:
        return ""
    return (
        f"docker/run does not show this folder, only {', '.join(map(str, shown))}; write "
        f"DOLFIN_ELASTIC_BIND={whole.parent} in front of the command"
    )


def check_kept(folder: Path, where: str) -> None:
    """Refuses a folder of results that docker/run would throw away at the end of the command.

    Whoever works in a folder that docker/run does not show, such as /tmp, keeps nothing anyway.

    Args:
        folder: Of the results, which need not exist.

    Raises:
        CaseError: It is a folder inside, and the current folder is one of the machine.
    """
    shown = [Path(one) for one in os.environ.get(SHOWN, "").split(":") if one]

    def seen(path: str | Path) -> bool:
        whole = Path(os.path.realpath(path))
        return any(whole.is_relative_to(one) for one in shown)

    if shown and not seen(folder) and seen(os.curdir):
        there = Path(os.path.realpath(folder))
        raise CaseError(
            f"docker/run would not keep {there}: nothing of it is on the machine",
            where=where,
            expected=f"a folder in {os.path.realpath(os.curdir)}, or make {there} and write "
            f"DOLFIN_ELASTIC_BIND={there} in front of the command",
        )


_ALIKE = 0.6
"""Likeness from which on a name may be the one that is meant: "tip" and "top"."""
_OTHER_INITIAL = 0.75
"""The same where the first letters differ, which is a rare slip: "eft" and "left", but not "where"
and "sphere"."""


def _alike(name: str, known: Sequence[str]) -> list[str]:
    """Known names that mean the word, else at most three similar ones, the most similar first."""
    if means := meant(name, known):
        return means
    initial = name[:1].casefold()
    first = [one for one in known if one[:1].casefold() == initial]
    other = get_close_matches(name, [one for one in known if one not in first], 3, _OTHER_INITIAL)
    return get_close_matches(name, [*get_close_matches(name, first, 3, _ALIKE), *other], 3, _ALIKE)


def nearest(name: str, known: Iterable[str]) -> str:
    """Hint at an unknown name: the known one of its meaning, or a similar one, or all.

    Returns:
        For example ``did you mean 'left'?`` or ``known: left, right``.
    """
    names = sorted(known)
    match = _alike(name, names)
    if match:
        return f"did you mean '{match[0]}'?"
    return f"known: {', '.join(names)}" if names else "there are none"


def nearest_first(name: str, known: Iterable[str], advice: str = "") -> str:
    """Hint at an unknown name among few: which one may be meant, and all of them.

    Args:
        known: The names that exist, which are listed in their order.
        advice: What to write for this word, which is no name, with names in quotation marks.

    Returns:
        For example ``did you mean 'roller'? known: roller, normal, spring``; those that may be
        meant stand first.
    """
    names = list(known)
    quoted = [one for one in names if f'"{one}"' in advice]
    near = quoted or _alike(name, names)
    hint = f"{advice}; " if advice else f"did you mean '{near[0]}'? " if near else ""
    return f"{hint}known: {', '.join(dict.fromkeys((*near, *names)))}"


_SAME_FILE = 0.65
"""Likeness from which on a file may be the one that is missing: "tow" and "two", not "bar"."""
_FILES = 8
"""Files that are listed at most."""


def nearest_file(name: str | Path, known: Iterable[str | Path]) -> str:
    """Hint at a missing file or folder: the most similar one, or else those that are there.

    Folders, suffixes and the ending of folders of results are not compared: what shares them is
    no more alike for it.

    Args:
        known: The files that are there, at least one.

    Returns:
        For example ``did you mean 'beam.toml'?`` or ``known: beam.toml, plate.toml``.
    """
    files = sorted(map(str, known))
    stems = {_stem(file): file for file in reversed(files)}
    match = get_close_matches(_stem(name), stems, n=1, cutoff=_SAME_FILE)
    if match:
        return f"did you mean '{stems[match[0]]}'?"
    more = len(files) - _FILES
    return f"known: {', '.join(files[:_FILES])}" + (f" and {more} more" if more > 0 else "")


def _stem(file: str | Path) -> str:
    return Path(file).stem.casefold().removesuffix("_results")
