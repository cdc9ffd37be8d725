"""The runs of a sweep as files: each has a folder with its results and a record, `row.json`.

A record says by a digest what was computed: the case with the values of the run, the contents of
the files that it names, the results that are told, and the version of the program.  Runs that a
folder has already are not computed again, in whatever order a later sweep has them.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Literal, cast, get_args

from dolfin_elastic.case.case import Case
from dolfin_elastic.core import __version__
from dolfin_elastic.core.files.links import refuse_links
from dolfin_elastic.core.files.regular import irregular, read_regular
from dolfin_elastic.core.petsc_options import PetscValue
from dolfin_elastic.results.files import json_data, make_folder, replace_text
from dolfin_elastic.study.sweep.settings import Values

Status = Literal["planned", "solved", "audit", "failed"]
RECORD = "row.json"
_MOST = 1 << 20
_LARGEST = 1 << 40
"""Bytes of a file."""
_HEAD = 1 << 22
"""Bytes of a file in which names of others are looked for."""
_NAMING = (".xdmf", ".geo", ".inp", ".bdf", ".dat", ".nas", ".toml")
"""Endings of files that may name others."""
_WORD = re.compile(rb"[\w.\-/]+\.[A-Za-z]\w*")


@dataclass(frozen=True)
class Row:
    """One run.

    Attributes:
        number: 1, 2, ...
        values: Dotted keys to their values.
        folder: Name of its folder in that of the sweep.
        digest: Of what it computes.
        status: "planned": it has not ended; "audit": its audit fails, it is not to be relied on.
        cause: Why it failed; empty otherwise.
        numbers: Name of a result to its value, SI units; nan where it is not known.
        errors: Name to the estimated relative error of the mesh, where that is known.
        remarks: Name to what is to be known of a result, such as where it was looked for.
        seconds: That it took.
        formulation: From `formulation_of`; empty where it is not known.
    """

    number: int
    values: Values
    folder: str
    digest: str
    status: Status = "planned"
    cause: str = ""
    numbers: Mapping[str, float] = field(default_factory=dict)
    errors: Mapping[str, float] = field(default_factory=dict)
    remarks: Mapping[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    formulation: str = ""

    @property
    def ended(self) -> bool:
        """It has been computed, well or not."""
        return self.status != "planned"


def digest_of(
    case: Case, told: Sequence[str], petsc: Mapping[str, PetscValue], contents: Contents
) -> str:
    """What a run computes, as 32 hexadecimal digits. Not collective.

    Args:
        told: Results that are asked for; none: the usual ones.
        petsc: PETSc options that are not the case's own.
        contents: Of files, which cases of one sweep share.
    """
    tables = case.to_dict()
    files = {name: contents.of(case.folder / name) for name in sorted(set(_texts(case.written)))}
    known = {name: content for name, content in files.items() if content}
    whole = [__version__, tables, known, list(told), dict(petsc)]
    return hashlib.sha256(json.dumps(whole, sort_keys=True, default=repr).encode()).hexdigest()[:32]


def _texts(value: object) -> Iterator[str]:
    """All texts in tables, of which some are names of files."""
    if isinstance(value, Mapping):
        for inner in value.values():
            yield from _texts(inner)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _texts(inner)
    elif isinstance(value, str) and 0 < len(value) <= 255 and "\0" not in value:
        yield value


class Contents:
    """Digests of files with those that they name, each read once.

    A mesh in XDMF has its arrays in HDF5, a script of Gmsh merges CAD files, and a motion begins at
    the results in a folder.
    """

    def __init__(self) -> None:
        self._known = dict[Path, str]()

    def of(self, path: Path) -> str:
        """Of a file or folder; empty of anything else. Not collective."""
        try:
            path = path.resolve()
            if path not in self._known:
                self._known[path] = ""  # of files that name each other
                self._known[path] = self._folder(path) if path.is_dir() else self._file(path)
        except (OSError, ValueError, RuntimeError):
            return ""
        return self._known[path]

    def _file(self, path: Path) -> str:
        # A text may name a file of the kernel, which has no size, or one without an end.
        if not path.is_file() or not 0 < path.stat().st_size < _LARGEST:
            return ""
        with path.open("rb") as file:
            own = hashlib.file_digest(file, "sha256").hexdigest()
            file.seek(0)
            head = file.read(_HEAD) if path.suffix.lower() in _NAMING else b""
        words = {word.decode() for word in _WORD.findall(head)}
        inner = [self.of(path.parent / word) for word in sorted(words) if word != path.name]
        return " ".join([own, *filter(None, inner)])

    def _folder(self, path: Path) -> str:
        """Of results: a folder that a text names by chance, such as "left", has none."""
        if not (path / "summary.json").is_file():
            return ""
        return " ".join(self.of(file) for file in sorted(path.rglob("*.*")) if file.is_file())


def known(folder: Path) -> dict[str, Row]:
    """Digest to row of all records in a folder. Not collective."""
    return {
        row.digest: row
        for path in sorted(folder.glob(f"*/{RECORD}"))
        if not irregular(path.parent) and (row := _record(path)) is not None
    }


def plan(
    folder: Path,
    rows: Sequence[tuple[Values, str]],
    known: Mapping[str, Row],
    retry: Callable[[Row], bool] = lambda row: False,
) -> list[Row]:
    """The rows of a sweep, those that a folder has as they are; makes folders for the others.

    Not collective.

    Args:
        rows: Values and digest of each.
        known: From `known`.
        retry: Which rows that have failed become planned again, in their folders.

    Raises:
        OutputError: A folder or record cannot be written.
        InputError: The folder is a link.
    """
    refuse_links(folder)
    make_folder(folder)
    rest = dict(known)
    used = {path.name for path in folder.iterdir()}
    width, free, result = max(3, len(str(len(rows)))), 0, list[Row]()
    for number, (values, digest) in enumerate(rows, 1):
        if (row := rest.get(digest)) is None:
            while (name := f"{free + 1:0{width}}") in used:
                free += 1
            used.add(name)
            row = rest[digest] = Row(number, values, name, digest)
            write(folder, row)
        row = replace(row, number=number, values=values)
        if row.status == "failed" and retry(row):
            row = rest[digest] = Row(number, values, row.folder, digest)
            write(folder, row)
        result.append(row)
    return result


def read(folder: Path, row: Row) -> Row:
    """A row as its record has it now. Not collective."""
    found = _record(folder / row.folder / RECORD)
    if found is None or found.digest != row.digest:
        return row
    return replace(found, number=row.number, values=row.values)


def write(folder: Path, row: Row) -> None:
    """Writes the record of a row, whole or not at all. Not collective.

    Raises:
        OutputError: It cannot be written.
    """
    refuse_links(folder / row.folder)
    make_folder(folder / row.folder)
    text = json.dumps(json_data(asdict(row)), indent=1, default=repr)
    replace_text(folder / row.folder / RECORD, text + "\n")


def _record(path: Path) -> Row | None:
    """A record; None of what is none, or was written by somebody else."""
    try:
        table = json.loads(read_regular(path, _MOST))
        numbers, errors = (
            {str(k): math.nan if v is None else float(v) for k, v in table[name].items()}
            for name in ("numbers", "errors")
        )
        status = str(table["status"])
        if status not in get_args(Status):
            return None
        return Row(
            number=int(table["number"]),
            values=dict(table["values"]),
            folder=path.parent.name,
            digest=str(table["digest"]),
            status=cast(Status, status),
            cause=str(table["cause"]),
            numbers=numbers,
            errors=errors,
            remarks={str(k): str(v) for k, v in table["remarks"].items()},
            seconds=float(table["seconds"]),
            formulation=str(table.get("formulation", "")),
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
