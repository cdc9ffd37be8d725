"""`fit` of a whole case to what was measured: its tables, and its exit code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dolfin_elastic.core.errors import CaseError, SolveError, check_kept

if TYPE_CHECKING:
    from dolfin_elastic.study.identify.identify import Identified


def fit_case(
    file: Path,
    measured: Sequence[Path],
    vary: Sequence[str],
    *,
    of: Sequence[str],
    bounds: Mapping[str, object],
    weights: Mapping[str, float],
    starts: int,
    steps: int,
    output: Path | None,
    json: bool,
) -> None:
    """Fits values of a case, prints and writes them. Collective.

    Args:
        file: The case file.
        starts: And the others, see `identify`.

    Raises:
        InputError: Something that was given is wrong.
        SolveError: The search has not ended.
    """
    from dolfin_elastic.case.check.rest import read_case
    from dolfin_elastic.cli.run import begin
    from dolfin_elastic.core.parallel import on_root
    from dolfin_elastic.study.identify.identify import identify
    from dolfin_elastic.study.identify.written import default_folder

    comm = begin(quiet=True)
    case = read_case(file, comm=comm)
    folder = output if output is not None else default_folder(case)
    check_kept(folder, "--output")
    visible = comm.rank == 0 and not json
    found = identify(
        case,
        [*measured],
        vary,
        of=of,
        bounds=bounds,
        weights=weights,
        starts=starts,
        evaluations=steps,
        comm=comm,
        told=_line if visible else lambda _: None,
    )
    on_root(comm, lambda: _show(found, folder, json))
    if not found.ended:
        raise SolveError(
            f"the fit has not ended: {found.why}; the best so far is written",
            advice="more --steps or --starts, --bounds, or fewer keys after --vary",
        )


def check_of_case(given: Sequence[str], measured: Sequence[Path]) -> None:
    """Refuses options of the fit of a material beside those of a case.

    Args:
        given: Those of a material that are given.

    Raises:
        InputError: There are some, or nothing was measured.
    """
    if given:
        raise CaseError(
            "this belongs to the fit of a material, and --measured, --of and --vary to that of a "
            "whole case",
            where=f"--{given[0]}",
            expected="one of both",
        )
    if not measured:
        raise CaseError("nothing was measured", expected="for example --measured curve.csv")


def _line(text: str) -> None:
    from dolfin_elastic.cli.console import TYPED

    print(text.translate(TYPED), flush=True)


def _show(found: Identified, folder: Path, json: bool) -> None:
    """Prints and writes a fit. Not collective."""
    from dolfin_elastic.cli.console import console
    from dolfin_elastic.cli.console_materials import as_json
    from dolfin_elastic.study.identify.written import write_identified

    files = write_identified(found, folder)
    if json:
        print(as_json(_plain(found)))
        return
    screen = console()
    _tables(found)
    for line in (*found.unknown, *found.notes):
        screen.tell(line)
    screen.print(f"written: {folder}: {', '.join(f.name for f in files)}")


def _tables(found: Identified) -> None:
    """Prints values and errors."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from dolfin_elastic.cli.console import console
    from dolfin_elastic.cli.console_fit import interval_text
    from dolfin_elastic.core.si_text import percent, quantity
    from dolfin_elastic.study.identify.identify import error_text

    table = Table("value of", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("found", justify="right")
    table.add_column("95 % interval", justify="left")
    for row in found.constants:
        table.add_row(row.name, quantity(row.value, row.unit), interval_text(row))
    console().print(table)
    table = Table("measured", box=SIMPLE_HEAD, pad_edge=False)
    for head in ("numbers", "r.m.s. error", "of the largest value"):
        table.add_column(head, justify="right")
    for one in found.sets:
        count = str(one.computed.size)
        table.add_row(one.measured.label, count, error_text(one), percent(one.relative))
    console().print(table)


def _plain(found: Identified) -> dict[str, object]:
    """A fit as plain values, for scripts."""
    return {
        "ended": found.ended,
        "why": found.why,
        "runs": found.runs,
        "values": {
            row.name: {"value": row.value, "unit": row.unit, "interval": list(row.interval)}
            for row in found.constants
        },
        "correlation": {
            "names": [row.name for row in found.constants],
            "matrix": found.correlation.tolist(),
        },
        "measured": [
            {
                "name": one.measured.label,
                "rms": one.rms,
                "relative": one.relative,
                "computed": one.computed.tolist(),
            }
            for one in found.sets
        ],
        "unknown": list(found.unknown),
        "notes": list(found.notes),
    }
