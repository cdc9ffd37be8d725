"""The command `verify`: known results, and results on several numbers of ranks."""
# ruff: noqa: D301

from __future__ import annotations

import json as json_text
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import typer
from click.exceptions import Exit, UsageError

from dolfin_elastic.core.errors import CaseError
from dolfin_elastic.core.signals import launched_rank
from dolfin_elastic.core.startup.libraries import start

if TYPE_CHECKING:
    from dolfin_elastic.study.verify.compare import Difference

FAILED = 1
AGREEMENT = 1e-6
"""Share by which results of other ranks may differ: iterations stop at 1e-8 of the residual."""


def verify(
    full: Annotated[bool, typer.Option("--full", help="Also run the long cases.")] = False,
    ranks: Annotated[
        str,
        typer.Option("--ranks", metavar="N,N..", help="Numbers of ranks to compare (by mpirun)."),
    ] = "",
    case: Annotated[
        Path | None,
        typer.Option("--case", metavar="CASE", help="Compare the ranks on this case instead."),
    ] = None,
    tolerance: Annotated[
        float,
        typer.Option("--tolerance", help="Relative difference that ranks may have, with --case."),
    ] = AGREEMENT,
    speed: Annotated[
        bool, typer.Option("--speed", help="Time the kernels, beside the bound of memory.")
    ] = False,
    json: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Also write the table as JSON.")
    ] = None,
) -> None:
    """Compute cases with known results on this installation, and compare.

    \b
      dolfin-elastic verify                               longer the first time: it compiles
      dolfin-elastic verify --full --ranks 1,2
      mpirun -n 4 dolfin-elastic verify                   on these ranks
      dolfin-elastic verify --case my.toml --ranks 1,2,4  is my case the same on all of them?
      dolfin-elastic verify --speed                       how fast is it on this machine?

    Exit code 1: a result is off by more than its limit, or ranks differ.

    \f
    Raises:
        UsageError: Ranks are asked for within mpirun, or beside --speed.
        CaseError: There is no mpirun.
        OutputError: The table cannot be written.
    """
    counts = _counts(ranks or ("1,2" if case else ""))
    if counts and "OMPI_COMM_WORLD_SIZE" in os.environ:
        raise UsageError("--ranks and --case start mpirun themselves: leave mpirun out.")
    if max(counts, default=1) > 1 and shutil.which("mpirun") is None:
        raise CaseError(
            "there is no mpirun on the PATH",
            where="--ranks",
            expected="that of the MPI which mpi4py is built with (Debian: openmpi-bin)",
        )
    if case is not None:
        raise Exit(_compare(case, counts, tolerance, json))
    if speed:
        if full or counts:
            raise UsageError("--speed stands alone: for several ranks write mpirun before it.")
        _time_kernels(json)
        return
    rows = []
    for row in _started(counts, full=full) if counts else _here(full=full):
        rows.append(row)
        if launched_rank() == 0:
            if len(rows) == 1:
                _head()
            _show(row)
    if launched_rank() == 0:
        _end(rows)
    if json is not None:
        _write(json, rows)
    raise Exit(0 if all(row["passed"] for row in rows) else FAILED)


def _counts(text: str) -> list[int]:
    """Numbers of ranks as they stand on the command line."""
    if text and not re.fullmatch(r"[1-9]\d{0,4}(,[1-9]\d{0,4})*", text):
        raise UsageError(f"--ranks {text}: numbers with commas, for example 1,2,4")
    return [int(word) for word in text.split(",") if word]


def _here(*, full: bool) -> Iterator[dict[str, Any]]:
    """The suite on the ranks of this process. Collective."""
    start()
    from mpi4py import MPI

    from dolfin_elastic.cli.run import collect_garbage
    from dolfin_elastic.study.verify.suite import verify as suite

    collect_garbage()
    for outcome in suite(MPI.COMM_WORLD, full=full):
        yield outcome.row()


def _time_kernels(json: Path | None) -> None:
    """Times the kernels on the ranks of this process, and shows them. Collective."""
    start()
    from mpi4py import MPI

    from dolfin_elastic.study.verify.speed import speeds, triad

    comm = MPI.COMM_WORLD
    bandwidth = triad(comm)
    rows: list[dict[str, object]] = []
    if comm.rank == 0:
        ranks = f"{comm.size} rank{'s' * (comm.size > 1)}"
        print(f"memory: {bandwidth / 1e9:.3g} GB/s on {ranks}, of a = b + s c")
        print(f"{'elements':11}{'operation':18}{'time':>9}{'bound':>9}{'ratio':>8}  [ns] per")
    for speed in speeds(comm, bandwidth):
        rows.append(speed.row())
        if comm.rank == 0:
            numbers = f"{speed.nanoseconds:>9.3g}{speed.bound:>9.3g}"
            ratio = f"{speed.nanoseconds / speed.bound:>8.1f}"
            print(f"{speed.elements:11}{speed.what:18}{numbers}{ratio}  {speed.per}", flush=True)
    if comm.rank == 0:
        print("The bound is the time of the memory traffic alone. Other work slows both.")
    if json is not None:
        _write(json, [{"what": "memory", "bytes_per_second": bandwidth}, *rows])


_PROGRAM = f"""
import sys
sys.path.append({str(Path(__file__).resolve().parents[3])!r})
from dolfin_elastic.cli.app import main
main()
"""
"""This program, of which nothing is looked for in the current folder."""


def _program(count: int) -> list[str]:
    """This program on so many ranks."""
    alone = [sys.executable, "-P", "-c", _PROGRAM]
    return alone if count == 1 else ["mpirun", "-n", str(count), *alone]


def _started(counts: Sequence[int], *, full: bool) -> Iterator[dict[str, Any]]:
    """The suite in processes of its own, for each number of ranks."""
    for count in counts:
        with TemporaryDirectory(prefix="dolfin_elastic-verify-") as folder:
            table = Path(folder) / "table.json"
            command = [*_program(count), "verify", "--json", str(table), *["--full"] * full]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if not table.exists():
                raise CaseError(
                    f"no results on {count} ranks (exit code {done.returncode})",
                    expected=f"what it said: {done.stderr.strip()[-500:] or 'nothing'}",
                )
            yield from json_text.loads(table.read_text(encoding="utf-8"))


def _head() -> None:
    print(
        f"{'case':15}{'ranks':>5}{'computed':>15}{'reference':>15}{'error':>10}{'limit':>9}"
        f"{'time':>8}"
    )


def _show(row: dict[str, Any]) -> None:
    computed = "none" if row["computed"] is None else f"{row['computed']:.7g}"
    error = "" if row["error"] is None else f"{row['error']:.1e}"
    line = f"{row['name']:15}{row['ranks']:>5}{computed:>15}{row['reference']:>15.7g}"
    mark = "" if row["passed"] else "  FAILED"
    print(f"{line}{error:>10}{row['limit']:>9.0e}{row['seconds']:>6.1f} s{mark}", flush=True)
    if row["message"]:
        print(f"    {row['message']}")


def _end(rows: Sequence[dict[str, Any]]) -> None:
    failed = [row["name"] for row in rows if not row["passed"]]
    time = sum(row["seconds"] for row in rows)
    if failed:
        print(f"{len(failed)} of {len(rows)} FAILED: {', '.join(failed)}")
    else:
        print(f"all {len(rows)} results are within their limits ({time:.0f} s)")


def _write(file: Path, table: object) -> None:
    """Writes a table as JSON. Collective."""
    start()
    from mpi4py import MPI

    from dolfin_elastic.core.parallel import on_root
    from dolfin_elastic.results.files import replace_text

    text = json_text.dumps(table, indent=1, ensure_ascii=False) + "\n"
    on_root(MPI.COMM_WORLD, lambda: replace_text(file, text))


def _compare(case: Path, counts: Sequence[int], tolerance: float, json: Path | None) -> int:
    """Runs a case on each number of ranks, and shows what differs most; the exit code."""
    from dolfin_elastic.study.verify.compare import compare

    if len(counts) < 2:
        raise UsageError("--case needs at least two numbers of ranks, for example --ranks 1,2")
    with TemporaryDirectory(prefix="dolfin_elastic-verify-") as scratch:
        folders = []
        for count in counts:
            folders.append(Path(scratch) / f"ranks_{count}")
            command = [*_program(count), "run", str(case), "--output", str(folders[-1]), "-q"]
            code = subprocess.run(command, check=False).returncode
            if code:
                print(f"on {count} ranks the run ended with code {code}", file=sys.stderr)
                return code
            print(f"{case} on {count} rank{'s' * (count > 1)}: done", flush=True)
        differences = compare(folders)
    _show_differences(differences, counts, tolerance)
    if json is not None:
        _write(
            json, [{"name": d.name, "values": [*d.values], "scale": d.scale} for d in differences]
        )
    return 0 if all(one.relative <= tolerance for one in differences) else FAILED


def _show_differences(
    differences: Sequence[Difference], counts: Sequence[int], tolerance: float
) -> None:
    print(f"{'number':32}" + "".join(f"{f'{n} ranks':>16}" for n in counts) + f"{'apart':>10}")
    worst = sorted(differences, key=lambda one: -one.relative)
    for one in worst[:20]:
        values = "".join(f"{value:>16.8g}" for value in one.values)
        mark = "" if one.relative <= tolerance else "  DIFFERS"
        print(f"{one.name[:31]:32}{values}{one.relative:>10.1e}{mark}")
    if len(worst) > 20:
        print(f"... and {len(worst) - 20} numbers that differ less")
    differ = sum(one.relative > tolerance for one in differences)
    if differ:
        print(f"{differ} of {len(differences)} numbers differ by more than {tolerance:g}")
    else:
        print(f"all {len(differences)} numbers agree to {tolerance:g}")
