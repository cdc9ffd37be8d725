"""Runs the cases of `SUITE` and compares their results with the references."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any

from mpi4py import MPI

from dolfin_elastic.case.case import read_case
from dolfin_elastic.case.run import run
from dolfin_elastic.case.verify.cases import SUITE, Verification
from dolfin_elastic.core.errors import ElasticError
from dolfin_elastic.core.parallel import on_root


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
        full: Those that take longer, too.
    """
    for one in SUITE:
        if full or not one.full:
            yield outcome(one, comm)


def outcome(one: Verification, comm: MPI.Comm) -> Outcome:
    """Runs one case in a folder of its own, which is removed. Collective.

    Args:
        one: The case.
        comm: The ranks that share it.
    """
    begin, value, message = time.monotonic(), None, ""
    with _folder(one, comm) as folder, _silent():
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
    return one.value(json.loads((results / "summary.json").read_text(encoding="utf-8")))


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


@contextmanager
def _silent() -> Iterator[None]:
    """Without the log of the runs."""
    log = logging.getLogger("dolfin_elastic")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(level)
