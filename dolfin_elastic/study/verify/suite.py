"""Small cases whose results are known, in closed form or from publications: `cases/*.toml`.

Each holds a case file as users write it; its result is read from the `summary.json` of a run.
"""

from __future__ import annotations

import json
import logging
import time
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any

from mpi4py import MPI

from dolfin_elastic.case.case import read_case
from dolfin_elastic.case.run import run
from dolfin_elastic.core.errors import ElasticError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.study.quiet import quietly


@dataclass(frozen=True)
class Verification:
    """A case and what its result must be.

    Attributes:
        name: In one word.
        what: What is computed, and what is compared.
        source: Where the reference is from.
        case: The case file.
        value: Keys of the result in the summary, joined by dots.
        reference: What it must be.
        limit: Largest relative error: what the mesh, the steps or round-off allow.
        unit: Of the result.
        files: Name to text of what the case reads.
        full: It belongs to `verify --full` only.
    """

    name: str
    what: str
    source: str
    case: str
    value: str
    reference: float
    limit: float
    unit: str
    files: Mapping[str, str] = field(default_factory=dict)
    full: bool = False


SUITE = tuple(
    Verification(path.stem.partition("-")[2], **tomllib.loads(path.read_text(encoding="utf-8")))
    for path in sorted(Path(__file__).with_name("cases").glob("*.toml"))
)
"""All of them, in the order in which they run."""


@dataclass(frozen=True)
class Outcome:
    """What became of one case.

    Attributes:
        name: Of the case.
        what: What is compared.
        source: Of the reference.
        unit: Of the result.
        reference: What it must be.
        limit: Largest relative error.
        ranks: On how many ranks it ran.
        seconds: How long it took, compiling included.
        computed: The result; None where there is none.
        message: Why there is none.
    """

    name: str
    what: str
    source: str
    unit: str
    reference: float
    limit: float
    ranks: int
    seconds: float
    computed: float | None
    message: str = ""

    @property
    def error(self) -> float | None:
        """Relative error."""
        return None if self.computed is None else abs(self.computed / self.reference - 1)

    @property
    def passed(self) -> bool:
        """The error is within its limit."""
        return self.error is not None and self.error <= self.limit

    def row(self) -> dict[str, Any]:
        """As data of JSON."""
        return {**asdict(self), "error": self.error, "passed": self.passed}


def verify(comm: MPI.Comm = MPI.COMM_WORLD, *, full: bool = False) -> Iterator[Outcome]:
    """Runs all cases, one after the other. Collective.

    Args:
        comm: The ranks that share each case.
    """
    for one in SUITE:
        if full or not one.full:
            yield outcome(one, comm)


def outcome(one: Verification, comm: MPI.Comm) -> Outcome:
    """Runs one case in a folder of its own, which is removed. Collective.

    Args:
        comm: The ranks that share it.
    """
    begin, value, message = time.monotonic(), None, ""
    with _folder(one, comm) as folder, quietly(logging.CRITICAL):
        try:
            for _ in run(read_case(folder / "case.toml", comm=comm), output=folder / "results"):
                pass
            value = on_root(comm, lambda: _read(one, folder / "results"))
        except ElasticError as error:
            message = str(error)
    return Outcome(
        name=one.name,
        what=one.what,
        source=one.source,
        unit=one.unit,
        reference=one.reference,
        limit=one.limit,
        ranks=comm.size,
        seconds=round(time.monotonic() - begin, 2),
        computed=value,
        message=message,
    )


def _read(one: Verification, results: Path) -> float:
    content = json.loads((results / "summary.json").read_text(encoding="utf-8"))
    for key in one.value.split("."):
        content = content[int(key) if isinstance(content, list) else key]
    return float(content)


@contextmanager
def _folder(one: Verification, comm: MPI.Comm) -> Iterator[Path]:
    """A folder with the files of a case, as all ranks know it."""

    def make() -> Path:
        folder = Path(mkdtemp(prefix="dolfin_elastic-verify-"))
        for name, text in {**one.files, "case.toml": one.case}.items():
            (folder / name).write_text(text, encoding="utf-8")
        return folder

    folder = on_root(comm, make)
    try:
        yield folder
    finally:
        comm.barrier()
        on_root(comm, lambda: rmtree(folder, ignore_errors=True))
