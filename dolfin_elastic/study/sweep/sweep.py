"""`sweep`: computes a case again and again with other values, and tells what comes of it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from os import PathLike
from pathlib import Path

from mpi4py import MPI

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.rest import read_body
from dolfin_elastic.case.run import CaseRun, InTurn
from dolfin_elastic.core.errors import InputError, SolveError, nearest
from dolfin_elastic.core.lease import Lease
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.petsc_options import PetscOptions, PetscValue
from dolfin_elastic.core.together import loop_together
from dolfin_elastic.core.units import number_and_unit
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.problem.material_regions import formulation_of
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.recovery.error import ErrorEstimator
from dolfin_elastic.results.recovery.peaks import Peak
from dolfin_elastic.study.sweep import rows as files
from dolfin_elastic.study.sweep.numbers import NO_RESULT, Known, known_of, may_have
from dolfin_elastic.study.sweep.rows import Row, Status
from dolfin_elastic.study.sweep.settings import Design, design, read_setting, with_means
from dolfin_elastic.study.sweep.table import Results, write_table
from dolfin_elastic.study.wanted import SAME, Wanted, WantedNumber

_OF_MESH = ("mesh", "surfaces", "regions", "edges", "points", "contact")
"""Tables of a case that decide on its mesh and the names on it."""
_CLAIM = "row.lock"


@dataclass(frozen=True)
class Sweep:
    """The runs of a sweep: what is to be computed, and where.

    Attributes:
        case: Without the values that vary.
        design: The values of each run.
        told: Results that are asked for, as they were written; none: those by which a part is
            judged.
        folder: Of all that is written; each run has a folder in it.
        cases: Of each run its case.
        rows: Of each run its record, as it was before this sweep.
        petsc: PETSc options that win over the case's own.
        bodies: The mesh that was read last.
        comm: The ranks that compute one run together.
    """

    case: Case
    design: Design
    told: Mapping[str, Wanted]
    folder: Path
    cases: tuple[Case, ...]
    rows: tuple[Row, ...]
    petsc: dict[str, PetscValue]
    bodies: _Bodies
    comm: MPI.Comm
    _ended: dict[int, Row] = field(default_factory=dict)

    def results(self) -> Results:
        """The table as the records have it now, those of other processes, too. Collective."""
        rows = on_root(self.comm, lambda: [self._now(row) for row in self.rows])
        return self._table(rows)

    def so_far(self) -> Results:
        """The table of what has ended here or before, without a look at records. Not collective.

        Records would be read again after every row: of n rows n^2/2 times.
        """
        return self._table([self._ended.get(row.number, row) for row in self.rows])

    def _table(self, rows: Sequence[Row]) -> Results:
        return Results(self.case.file, self.folder, self.design, tuple(rows))

    def _now(self, row: Row) -> Row:
        """A row as its record is now: what has ended does not change."""
        now = self._ended.get(row.number, row)
        if not now.ended:
            now = files.read(self.folder, row)
            if now.ended:
                self._ended[row.number] = now
        return now

    def run(self, only: int | None = None) -> Generator[Row, None, None]:
        """Computes the rows that have not ended and that nobody else computes.  Collective.

        Rows of one mesh follow one another.

        Args:
            only: Number of the one row to compute; all by default.

        Yields:
            Each row that has ended here; those that had ended before are in `results`.

        Raises:
            InputError: A run has no result of a name that is asked for, and none can have it.
            OutputError: Results cannot be written.
            StoppedError: A signal has asked for the end; the rows before it are complete.
        """
        yield from loop_together(self.comm, self._run(only))

    def _run(self, only: int | None) -> Generator[Row, None, None]:
        keys = {row.number: self.bodies.key(case) for row, case in self._both()}
        order = {key: n for n, key in enumerate(dict.fromkeys(keys.values()))}
        for row, case in sorted(self._both(), key=lambda both: order[keys[both[0].number]]):
            if only is not None and row.number != only:
                continue
            if (ended := self._claimed(row, case)) is not None:
                yield ended

    def _claimed(self, row: Row, case: Case) -> Row | None:
        """A row that ends here; None of one that has ended or that another process computes."""
        claim = Lease(self.folder / row.folder / _CLAIM)
        if not on_root(self.comm, partial(claim.acquire, 0.0)):
            return None
        with closing(claim):
            known = on_root(self.comm, partial(self._now, row))
            if known.ended:
                return None
            ended = self._solve(known, case)
            on_root(self.comm, partial(files.write, self.folder, ended))
        self._ended[row.number] = ended
        return ended

    def _may_have(self, text: str, name: str) -> bool:
        """Whether some run has a result, or may have it by what its case says. Collective.

        A field on a part exists by materials and tables: alike where only numbers vary.
        """

        def on_this_rank() -> bool:
            ended = (*self._ended.values(), *self.rows)
            if any(one in row.numbers for row in ended for one in (text, name)):
                return True
            if self.told[text].part or self.told[text].reduction:
                values = (value for row in self.rows for value in row.values.values())
                return not all(number_and_unit(value) for value in values)
            return any(may_have(case, name) for case in self.cases)

        return on_root(self.comm, on_this_rank)

    def _both(self) -> Iterator[tuple[Row, Case]]:
        return zip(self.rows, self.cases, strict=True)

    def _solve(self, row: Row, case: Case) -> Row:
        """One run. Collective."""
        begin, told = time.monotonic(), _Told(self.told, self.cases, self._may_have)
        status: Status = "solved"
        cause, known, numbers = "", Known(), dict[str, float]()
        try:
            body = self.bodies.body_of(case, told)
            folder = self.folder / row.folder
            runs = InTurn(case.analyses(), folder, dict(self.petsc), self.comm, body=body)
            with closing(runs):
                for one in runs:
                    with runs.trying(one):
                        told.follow(one)
            if runs.errors:
                raise next(iter(runs.errors.values()))
            known = on_root(self.comm, lambda: known_of([one.folder for one in runs.runs]))
        except (InputError, SolveError) as error:
            status, cause = "failed", str(error)
        else:
            numbers = told.numbers(known)
            known = told.judged(known)
        if known.failure:
            status, cause = "audit", f"audit: {known.failure}"
        return replace(
            row,
            status=status,
            cause=cause,
            numbers=numbers,
            errors={name: known.errors[name] for name in numbers if name in known.errors},
            remarks={name: known.remarks[name] for name in numbers if name in known.remarks},
            seconds=round(time.monotonic() - begin, 3),
            formulation=told.formulation,
        )


class _Told:
    """The results of one run that are asked for.

    Args:
        wanted: By their names as they were written; none: the usual ones.
        cases: Of all runs.
        elsewhere: Whether another run may have a result, by its text and name; collective.

    Attributes:
        formulation: Of the run, see `formulation_of`; empty before.
    """

    def __init__(
        self,
        wanted: Mapping[str, Wanted],
        cases: Sequence[Case],
        elsewhere: Callable[[str, str], bool] = lambda text, name: False,
    ) -> None:
        self._wanted, self._cases, self._elsewhere = wanted, cases, elsewhere
        self._measured, self._absent = dict[str, float](), dict[str, InputError]()
        self._errors, self._remarks = dict[str, float](), dict[str, str]()
        self.formulation = ""

    def check(self, body: Body) -> None:
        """Checks names of parts before anything is computed. Not collective."""
        probes = dict.fromkeys(name for case in self._cases for name in case.output.probes)
        supports = dict.fromkeys(one.label for case in self._cases for one in case.support)
        for wanted in self._wanted.values():
            wanted.check(body, [*probes], [*supports])

    def follow(self, run: CaseRun) -> None:
        """Runs an analysis to its end, and measures fields in its last state. Collective."""
        with closing(run.states()) as results:
            for result in results:
                if isinstance(result, State) and result.done >= 1.0:
                    self._measure(result, run.problem)
        assert run.problem is not None
        self.formulation = formulation_of(run.problem.regions)

    def _measure(self, state: State, problem: Problem | None) -> None:
        assert problem is not None
        for name, wanted in self._wanted.items():
            if not (wanted.part or wanted.reduction):
                continue
            try:
                number = WantedNumber(wanted, problem)
                measured, _ = number(state)
            except InputError as error:  # a field of another material, for example
                self._absent[name] = error
                continue
            self._measured.setdefault(name, measured.value)
            if wanted.is_stress and state.v is None:
                self._judge(name, number.peak(measured, ErrorEstimator(problem)(state)))

    def _judge(self, name: str, peak: Peak | None) -> None:
        """The error of a largest stress, or why it is not known."""
        if peak is None:
            return
        self._errors[name] = peak.error
        if peak.singular:
            self._remarks[name] = f"singular at {peak.singular}: it grows with every refinement"
            self._errors[name] = math.nan
        elif peak.unresolved:
            self._remarks[name] = f"its error is not known: {peak.unresolved}"

    def numbers(self, known: Known) -> dict[str, float]:
        """What is told, of all that is known.

        What only other runs have is nan, with a remark.

        Raises:
            InputError: The run has no such result, and none of the sweep can have it.
        """
        every = {**known.numbers, **self._measured}
        if not self._wanted:
            return {name: every[name] for name in known.usual}
        result = {}
        for text, wanted in self._wanted.items():
            name = text if text in every else SAME.get(text, wanted.name)
            if text not in self._measured and text in self._absent:
                name = text
            if name not in every:
                error = self._absent.get(text) or InputError(
                    f"there is no result '{text}'", where="--tell", expected=nearest(name, every)
                )
                if not self._elsewhere(text, name):
                    raise error
                why = f": {error.what}" if text in self._absent else ""
                self._remarks[name] = f"{NO_RESULT}{why}"
            result[text if text in self._measured else name] = every.get(name, math.nan)
        return result

    def judged(self, known: Known) -> Known:
        """What is known, with errors of and remarks on what was measured."""
        errors, remarks = {**known.errors, **self._errors}, {**known.remarks, **self._remarks}
        return replace(known, errors=errors, remarks=remarks)


class _Bodies:
    """The mesh of the last case, for the next one that has the same."""

    def __init__(self, comm: MPI.Comm) -> None:
        self._comm, self._last = comm, dict[str, Body]()

    def key(self, case: Case) -> str:
        """Equal of cases with one mesh."""
        tables = case.to_dict()
        names = tables if case.fields else _OF_MESH
        return repr([case.curved, *((name, tables.get(name)) for name in names)])

    def body_of(self, case: Case, told: _Told) -> Body:
        """The mesh of a case. Collective."""
        if (key := self.key(case)) not in self._last:
            self._last.clear()
            self._last[key] = read_body(case, self._comm)
            told.check(self._last[key])
        return self._last[key]


def planned(
    case: Case,
    plan: Design,
    *,
    output: str | PathLike[str] | None = None,
    tell: Sequence[str] = (),
    petsc: PetscOptions | None = None,
    retry: Callable[[Row], bool] = lambda row: False,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> Sweep:
    """A sweep whose every case is right; makes the folders of its runs.  Collective.

    Args:
        case: From `read_case`, or made in Python.
        plan: The values of each run.
        output: Folder of all results; by default that of `run` with "_sweep" at its end.
        tell: Results, as `converge --until` takes them, columns of history.csv, "frequency_1", ...;
            by default extremes, first modes and probes.
        petsc: PETSc options that win over the case's own.
        retry: Which rows that have failed are to be computed again.
        comm: The ranks that compute one run together.

    Raises:
        InputError: A key, a value or a result is wrong; nothing has been written.
        OutputError: The folder cannot be written.
    """
    told = {name: Wanted.read(name, "--tell") for name in tell}
    cases = tuple(case.changed(values) for values in plan.rows)
    folder = Path(output) if output is not None else case.folder_beside("sweep")
    options, bodies, contents = dict(petsc or {}), _Bodies(comm), files.Contents()

    def found() -> tuple[list[str], dict[str, Row]]:
        digests = [files.digest_of(one, list(told), options, contents) for one in cases]
        return digests, files.known(folder)

    digests, known = on_root(comm, found)
    new = next(
        (one for one, digest in zip(cases, digests, strict=True) if digest not in known), None
    )
    if new is not None:  # what is wrong with all of them is said of the first, before any folder
        new.make_problem(bodies.body_of(new, _Told(told, cases)))
    pairs = list(zip(plan.rows, digests, strict=True))
    rows = on_root(comm, lambda: files.plan(folder, pairs, known, retry))
    return Sweep(case, plan, told, folder, cases, tuple(rows), options, bodies, comm)


def sweep(
    case: Case,
    values: Mapping[str, object],
    *,
    output: str | PathLike[str] | None = None,
    tell: Sequence[str] = (),
    together: bool = False,
    samples: int | None = None,
    sobol: int | None = None,
    seed: int = 0,
    petsc: PetscOptions | None = None,
    retry: bool = False,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> Results:
    """Computes a case with other values, and writes the table of all runs.  Collective.

        table = sweep(case, {"materials.steel.E": ["200 GPa", "210 GPa"], "mesh.size": "2 mm,1 mm"})
        table.frame()                       # pandas, where it is there

    Args:
        case: From `read_case`, or made in Python.
        values: Dotted keys to lists, to texts with commas, or to distributions, see `settings`.
        output: See `planned`, as for `tell`, `petsc` and `comm`.
        together: See `design`, as for `samples`, `sobol` and `seed`.
        retry: Compute again what has failed before.

    Raises:
        InputError: A key, a value or a result is wrong; nothing has been written.
        OutputError: Results cannot be written.
        SolveError: No run has a solution; the table has the causes.
        StoppedError: A signal has asked for the end; the rows before it are complete.
    """
    settings = with_means(case, [read_setting(key, value) for key, value in values.items()])
    plan = design(settings, together=together, samples=samples, sobol=sobol, seed=seed)
    sweeping = planned(
        case, plan, output=output, tell=tell, petsc=petsc, retry=lambda _: retry, comm=comm
    )
    try:
        for _ in sweeping.run():
            pass
    finally:
        results = sweeping.results()
        on_root(comm, partial(write_table, results, plot=True))
    results.check()
    return results
