"""The runs of a sweep as files: each has a folder with its results and a record, `row.json`.

A record says by a digest what was computed: the case with the values of the run, the contents of
the files that it names, the results that are told, and the version of the program.  Runs that a
folder has already are not computed again, in whatever order a later sweep has them.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Literal, cast

from dolfin_elastic.case.case import Case
from dolfin_elastic.core import __version__
from dolfin_elastic.core.files.links import refuse_links
from dolfin_elastic.core.files.regular import irregular, read_regular
from dolfin_elastic.core.petsc_options import PetscValue
from dolfin_elastic.results.files import make_folder, replace_text
from dolfin_elastic.study.sweep.settings import Values

Status = Literal["planned", "solved", "audit", "failed"]
RECORD = "row.json"
_MOST = 1 << 20
_CHUNK = 1 << 20


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
        seconds: That it took.
    """

    number: int
    values: Values
    folder: str
    digest: str
    status: Status = "planned"
    cause: str = ""
    numbers: Mapping[str, float] = field(default_factory=dict)
    errors: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def ended(self) -> bool:
        """It has been computed, well or not."""
        return self.status != "planned"


def digest_of(case: Case, told: Sequence[str], petsc: Mapping[str, PetscValue]) -> str:
    """What a run computes, as 32 hexadecimal digits. Not collective.

    Args:
        told: Results that are asked for; none: the usual ones.
        petsc: PETSc options that are not the case's own.
    """
    tables = case.to_dict()
    files = {name: _content(case.folder / name) for name in sorted(set(_texts(case.written)))}
    known = {name: content for name, content in files.items() if content}
    whole = [__version__, tables, known, list(told), dict(petsc)]
    return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()[:32]


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


def _content(path: Path) -> str:
    """Digest of a regular file's content; empty of anything else."""
    try:
        if not path.is_file():
            return ""
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return ""


def plan(folder: Path, rows: Sequence[tuple[Values, str]]) -> list[Row]:
    """The rows of a sweep, those that a folder has as they are; makes folders for the others.

    Not collective.

    Args:
        rows: Values and digest of each.

    Raises:
        OutputError: A folder or record cannot be written.
        InputError: The folder is a link.
    """
    refuse_links(folder)
    make_folder(folder)
    known = {row.digest: row for row in _records(folder)}
    used = {path.name for path in folder.iterdir()}
    width, free, result = max(3, len(str(len(rows)))), 0, list[Row]()
    for number, (values, digest) in enumerate(rows, 1):
        if (row := known.get(digest)) is None:
            while (name := f"{free + 1:0{width}}") in used:
                free += 1
            used.add(name)
            row = known[digest] = Row(number, values, name, digest)
            write(folder, row)
        result.append(replace(row, number=number, values=values))
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
    table = asdict(row)
    for name in ("numbers", "errors"):
        table[name] = {k: v if math.isfinite(v) else None for k, v in table[name].items()}
    replace_text(folder / row.folder / RECORD, json.dumps(table, indent=1) + "\n")


def _records(folder: Path) -> Iterator[Row]:
    for path in sorted(folder.glob(f"*/{RECORD}")):
        if not irregular(path.parent) and (row := _record(path)) is not None:
            yield row


def _record(path: Path) -> Row | None:
    """A record; None of what is none, or was written by somebody else."""
    try:
        table = json.loads(read_regular(path, _MOST))
        numbers, errors = (
            {str(k): math.nan if v is None else float(v) for k, v in table[name].items()}
            for name in ("numbers", "errors")
        )
        status = str(table["status"])
        if status not in ("planned", "solved", "audit", "failed"):
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
            seconds=float(table["seconds"]),
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
