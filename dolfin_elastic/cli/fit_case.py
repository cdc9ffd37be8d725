"""`fit` of a whole case to what was measured: its tables, and its exit code."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dolfin_elastic.core.errors import CaseError, SolveError, UnitError, check_kept

if TYPE_CHECKING:
    from dolfin_elastic.case.case import Case
    from dolfin_elastic.study.identify.cells import FieldFound
    from dolfin_elastic.study.identify.identify import Identified
    from dolfin_elastic.study.least_squares.fitted import FittedConstant


@dataclass(frozen=True)
class CaseFit:
    """What both kinds of fits of a case are given.

    Attributes:
        file: The case file.
        measured: Files of what was measured.
        bounds: Key to "LOW:HIGH".
        weights: Name of a file to its weight.
        steps: Largest number of steps.
        output: Folder of the results; None: by the name of the case.
        force: Overwrite files of an earlier fit.
        json: Print JSON.
    """

    file: Path
    measured: Sequence[Path]
    bounds: Mapping[str, str]
    weights: Mapping[str, float]
    steps: int
    output: Path | None
    force: bool
    json: bool

    def _begun(self) -> tuple[Case, Path, Callable[[str], None]]:
        """The case, the folder of the results, and what takes lines on the way. Collective."""
        from dolfin_elastic.case.check.rest import read_case
        from dolfin_elastic.cli.run import begin
        from dolfin_elastic.core.parallel import on_root
        from dolfin_elastic.study.identify.written import files_of

        comm = begin(quiet=True)
        case = read_case(self.file, comm=comm)
        folder = self.output if self.output is not None else case.folder_beside("fitted")
        check_kept(folder, "--output")
        if not self.force:
            on_root(comm, lambda: refuse_earlier(files_of(case.name, folder)))
        visible = comm.rank == 0 and not self.json
        return case, folder, _line if visible else lambda _: None

    def find_values(self, vary: Sequence[str], of: Sequence[str], starts: int) -> None:
        """Fits values of the case, prints and writes them. Collective.

        Args:
            vary: And the others, see `identify`.

        Raises:
            InputError: Something that was given is wrong.
            SolveError: The search has not ended.
        """
        from mpi4py import MPI

        from dolfin_elastic.core.parallel import on_root
        from dolfin_elastic.study.identify.identify import identify

        case, folder, told = self._begun()
        found = identify(
            case,
            [*self.measured],
            vary,
            of=of,
            bounds=self.bounds,
            weights=self.weights,
            starts=starts,
            evaluations=self.steps,
            told=told,
        )
        on_root(MPI.COMM_WORLD, lambda: _show(found, folder, self.json))
        _check_ended(found.ended, found.why)

    def find_field(
        self,
        key: str,
        vary: Sequence[str],
        *,
        noise: str | None,
        smooth: float | None,
        penalty: str,
    ) -> None:
        """Finds a constant in each element, prints and writes it. Collective.

        Args:
            key: And the others, see `identify_field`.

        Raises:
            InputError: Something that was given is wrong.
            SolveError: The search has not ended.
        """
        from mpi4py import MPI

        from dolfin_elastic.core.parallel import on_root
        from dolfin_elastic.core.units import to_si
        from dolfin_elastic.study.identify.cells import identify_field
        from dolfin_elastic.study.identify.unknowns import read_unknowns
        from dolfin_elastic.study.identify.written_field import write_field

        if vary:
            raise CaseError(
                "a field is sought alone", where="--vary", expected="one of --vary and --field"
            )
        case, folder, told = self._begun()
        row = read_unknowns(case, [key], self.bounds)[0]
        limits = row.constant.low * row.size, row.constant.high * row.size
        try:
            scatter = None if noise is None else to_si(noise, "m")
        except UnitError as error:
            raise CaseError(error.what, where="--noise", expected=error.expected) from None
        found = identify_field(
            case,
            [*self.measured],
            key,
            noise=scatter,
            weight=smooth,
            penalty=penalty,
            bounds=limits,
            weights=self.weights,
            iterations=self.steps,
            told=told,
        )
        names = write_field(found, folder)
        text = _field_text(found)
        on_root(MPI.COMM_WORLD, lambda: _show_field(found, text, folder, names, self.json))
        _check_ended(found.ended, found.why)


def _check_ended(ended: bool, why: str) -> None:
    if not ended:
        raise SolveError(
            f"the fit has not ended: {why}; the best so far is written",
            advice="more --steps or --starts, --bounds, or fewer keys after --vary",
        )


def refuse_earlier(files: Iterable[Path]) -> None:
    """Before the search: what it would overwrite may be in use by a case. Not collective.

    Args:
        files: All that the fit would write, existing or not.

    Raises:
        CaseError: One of them exists.
    """
    for path in files:
        if path.exists():
            raise CaseError(
                "this file exists already",
                where=str(path),
                expected="--output with another folder, or --force to overwrite the earlier fit",
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
    from dolfin_elastic.core.si_text import percent
    from dolfin_elastic.study.least_squares.fitted import error_text

    show_rows(("value of", "found", INTERVAL), constant_rows(found.constants))
    show_rows(
        ("measured", "numbers", "r.m.s. error", "of the largest value"),
        (
            (
                one.measured.label,
                str(one.computed.size),
                error_text(one.rms, one.relative, one.unit),
                percent(one.relative),
            )
            for one in found.sets
        ),
    )


INTERVAL = "95 % interval"
_DIGITS = 2
"""Of half an interval, which is an estimate itself."""
_SHOWN = 1e-4
"""Half an interval over its value that is shown as a length, not only as a share."""


def show_rows(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Prints a table; its numbers are at the right, names and intervals at the left."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from dolfin_elastic.cli.console import console

    table = Table(heads[0], box=SIMPLE_HEAD, pad_edge=False)
    for head in heads[1:]:
        table.add_column(head, justify="left" if head.startswith(INTERVAL) else "right")
    for row in rows:
        table.add_row(*row)
    console().print(table)


def constant_rows(constants: Iterable[FittedConstant]) -> Iterator[Sequence[str]]:
    """Name, value and interval of constants."""
    from dolfin_elastic.core.si_text import quantity

    for row in constants:
        yield row.name, quantity(row.value, row.unit), _interval_text(row)


def _interval_text(row: FittedConstant) -> str:
    from dolfin_elastic.core.si_text import number, percent, scaled_unit

    if row.held:
        return row.held
    if row.bound:
        return "at its bound"
    if not math.isfinite(row.half):
        return "not known"
    part = percent(row.half / abs(row.value)) if row.value else ""
    if row.half < _SHOWN * abs(row.value):  # in none of the digits of the value
        return f"+- {part}"
    factor, unit = scaled_unit(row.half, row.unit)
    half = f"+- {number(row.half / factor, _DIGITS)} {unit}".rstrip()
    return f"{half} ({part})" if part else half


def _field_text(found: FieldFound) -> dict[str, object]:
    """A field as plain values, for scripts. Collective."""
    import numpy as np

    from dolfin_elastic.core.parallel import largest, smallest

    inside, comm = found.values[found.chosen], found.problem.body.comm
    return {
        "ended": found.ended,
        "why": found.why,
        "runs": found.runs,
        "key": found.key,
        "unit": found.unit,
        "smallest": smallest(comm, float(inside.min(initial=np.inf))),
        "largest": largest(comm, float(inside.max(initial=-np.inf))),
        "weight": found.weight,
        "penalty": {"kind": found.penalty[0], "value": found.penalty[1]},
        "rms": found.rms,
        "notes": list(found.notes),
    }


def _show_field(
    found: FieldFound,
    text: Mapping[str, object],
    folder: Path,
    names: Sequence[str],
    json: bool,
) -> None:
    """Prints a field that was found. Not collective."""
    from dolfin_elastic.cli.console import console
    from dolfin_elastic.cli.console_materials import as_json
    from dolfin_elastic.core.si_text import quantity

    if json:
        print(as_json(text))
        return
    screen = console()
    low, high = (quantity(float(str(text[end])), found.unit) for end in ("smallest", "largest"))
    screen.print(f"{found.key}: {low} to {high}, {found.why}", highlight=False)
    rms = quantity(found.rms, "m")
    screen.print(f"r.m.s. error {rms}, weight {found.weight:.2g} of the jumps", highlight=False)
    for line in found.notes:
        screen.tell(line)
    screen.print(f"written: {folder}: {', '.join(names)}")


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
