"""A run: case, body, problem, solver, results; from the start or from a checkpoint."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from itertools import chain, islice
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from mpi4py import MPI

from dolfin_elastic.case.case import Case, locate_errors
from dolfin_elastic.case.check.consistency import check
from dolfin_elastic.case.check.formulas import check_poles
from dolfin_elastic.case.check.initial_state import (
    contact_notes,
    mesh_notes,
    tie_notes,
    untied_notes,
)
from dolfin_elastic.case.check.integrals import Integrals
from dolfin_elastic.case.check.loads import LoadSum, load_sums, stress_notes
from dolfin_elastic.case.check.mesh_quality import bending_notes, section_notes, shape_notes
from dolfin_elastic.case.check.plausibility import unit_information
from dolfin_elastic.case.check.rest import read_body
from dolfin_elastic.case.model_record import model_record
from dolfin_elastic.case.restart import Unfinished, describe_run, unfinished, written_tables
from dolfin_elastic.case.run_checkpoints import RunCheckpoints
from dolfin_elastic.case.tables import check_name_of_folder
from dolfin_elastic.core import timing
from dolfin_elastic.core.errors import (
    CaseError,
    ElasticError,
    InputError,
    OutputError,
    SolveError,
    StoppedError,
)
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.petsc_options import PetscOptions, PetscValue, chooses_solvers
from dolfin_elastic.core.signals import acknowledge, remove_stop_file
from dolfin_elastic.core.together import end_all_if_alone, loop_together
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import (
    Mode,
    RestartableSolver,
    State,
    restoring,
)
from dolfin_elastic.results.checkpoint.checkpoints import Checkpoints
from dolfin_elastic.results.checkpoint.lock import FolderLease
from dolfin_elastic.results.exports.output import Export
from dolfin_elastic.results.outputs import FORMATS, History, Modes, Summary, Xdmf
from dolfin_elastic.results.writer import ModeWriter, Output, Writer
from dolfin_elastic.results.writers.modes import clear as clear_modes
from dolfin_elastic.results.writers.summary import SummaryWriter, mark_stopped
from dolfin_elastic.solvers.petsc.c_api import give_back

if TYPE_CHECKING:
    from dolfin_elastic.case.analysis import Solver
    from dolfin_elastic.solvers.eigen.preload import PreloadedAnalysis
    from dolfin_elastic.solvers.statics.load_stepping import InitialGuess

log = logging.getLogger("dolfin_elastic")
States = Generator[State | Mode, None, None]
_FAILED = "failed_state.xdmf"


def run(
    case: Case,
    *,
    output: str | PathLike[str] | None = None,
    petsc: PetscOptions | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    asked: Callable[[], bool] | None = None,
) -> States:
    """Solves a case and yields its states and modes after they are written.  Collective.

    Closing the generator between two states writes a checkpoint.  Of a case with several analyses
    it yields those of one after the other; `case.analyses()` has each as a case of its own.

    Args:
        case: From `read_case`, or made in Python.
        output: Folder of the results; by default what the case says.  In it several analyses have
            a folder each.
        petsc: PETSc options that win over the case's own.
        comm: The ranks that work together.
        asked: Called after each state on each rank; if it is true on one, a checkpoint is written.

    Raises:
        InputError: The case is wrong, or a run is still going in that folder; nothing has been
            written.
        SolveError: No solution was found; the results so far are complete, and those of the other
            analyses.
        OutputError: Results cannot be written.
    """
    if isinstance(output, str):
        try:
            check_name_of_folder(output)
        except InputError as error:
            raise error.at("output") from None
    folder = Path(output) if output is not None else case.results_folder()
    yield from _all(InTurn(case.analyses(), folder, dict(petsc or {}), comm), asked)


def _options_before(folder: Unfinished) -> PetscOptions:
    """PETSc options of the first run, but those that could write files or load code.

    The folder may come from anybody: these are the user's to give again.
    """
    before: PetscOptions = folder.found.content["petsc"]
    kept = {name: value for name, value in before.items() if chooses_solvers(name, value)}
    if left := sorted(before.keys() - kept.keys()):
        log.warning(
            "PETSc options of the first run are left out, give them again: -%s", ", -".join(left)
        )
    return kept


def restart(
    folder: str | PathLike[str] | Unfinished,
    *,
    case: Case | None = None,
    petsc: PetscOptions | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    asked: Callable[[], bool] | None = None,
) -> States:
    """Continues a run from its last checkpoint, on any number of ranks.  Collective.

    Results after that checkpoint are cut off and written again.  The first state that is yielded
    is that of the step after it.

    Args:
        folder: Of the results; or what `unfinished` has found there.
        case: See `unfinished`.
        petsc: PETSc options that win over those of the first run.
        comm: The ranks that work together.
        asked: See `run`.

    Raises:
        RestartError: There is no checkpoint, case or mesh have changed, or a run is still going in
            the folder.
        InputError: The mesh is gone, or the case is wrong.
        SolveError: No solution was found; the results so far are complete.
        OutputError: Results cannot be written.
    """
    if not isinstance(folder, Unfinished):
        folder = unfinished(folder, case=case, comm=comm)
        log.info("%s", folder.message())
    yield from _all(InTurn.going_on(folder, petsc or {}), asked)


def _all(runs: InTurn, asked: Callable[[], bool] | None) -> States:
    """States and modes of several analyses, one after the other; see `run`."""
    with closing(runs):
        for one in runs:
            with runs.trying(one):
                yield from one.states(asked=asked)
    if runs.errors:
        raise next(iter(runs.errors.values()))


class InTurn:
    """The analyses of a case, to be run one after the other on one mesh. Collective.

    One that fails keeps those from running whose preload it was to find.

    Args:
        cases: From `Case.analyses`, all or the rest of them.
        folder: Of the results of the whole case.
        petsc: PETSc options that win over the case's own.
        comm: The ranks that work together.
        before: The run of the first one that is continued.
        body: The mesh, where it has been read for another run of the same mesh.

    Attributes:
        several: There is more than one.
        errors: Analysis to its error, of those that have failed.
    """

    def __init__(
        self,
        cases: Sequence[Case],
        folder: Path,
        petsc: dict[str, PetscValue],
        comm: MPI.Comm,
        before: Unfinished | None = None,
        body: Body | None = None,
    ) -> None:
        if before is None:
            _check_start(cases[-1], folder)
        self.several, self.errors = len(cases) > 1, dict[str, SolveError]()
        self._folder, self._comm = folder, comm
        self._lease = FolderLease(comm, folder)
        shared = _Shared(keep=any(one.preloaded for one in cases))
        if body is not None:
            shared.body = cases[0].curved, body
        self.runs = [
            CaseRun(one, folder / one.analysis if self.several else folder, petsc, comm, shared)
            for one in cases
        ]
        self.runs[0].before = before

    @classmethod
    def going_on(cls, stopped: Unfinished, petsc: PetscOptions) -> InTurn:
        """What is left of a case of which a run was stopped. Collective.

        Args:
            petsc: PETSc options that win over those of the first run.
        """
        options = {**_options_before(stopped), **petsc}
        folder = stopped.folder.parent if stopped.rest else stopped.folder
        return cls([stopped.case, *stopped.rest], folder, options, stopped.found.comm, stopped)

    def __iter__(self) -> Iterator[CaseRun]:
        for one in self.runs[1:]:
            one.check()
        for one in self.runs:
            if "statics" in self.errors and one.case.preload_of_statics:
                log.warning("[%s] is left out: its preload was not found", one.case.analysis)
                continue
            if self.several:
                self._lease.acquire()
            yield one
            if self.several:
                on_root(self._comm, lambda: _remove_results(self._folder))

    @contextmanager
    def trying(self, one: CaseRun) -> Iterator[None]:
        """Logs and keeps the error of an analysis that fails, so that others run.  Collective.

        Raises:
            SolveError: The error itself, where there is no other analysis.
        """
        try:
            yield
        except SolveError as error:
            if not self.several:
                raise
            self.errors[one.case.analysis] = error
            text = "\n  ".join([str(error), *getattr(error, "__notes__", ())])
            log.error("[%s]: %s", one.case.analysis, text)

    def close(self) -> None:
        """Lets others write into the folder. Not collective."""
        self._lease.close()


def _check_start(case: Case, folder: Path) -> None:
    """Refuses a motion that would overwrite the results from which it starts. Not collective.

    Args:
        case: The last analysis: a motion is the last one.
        folder: Of the results of the whole case.

    Raises:
        InputError: They are in the folder of its own results.
    """
    if case.file_of_start is None:
        return
    path = (case.folder / case.file_of_start).resolve()
    source = path.parent if path.suffix == ".xdmf" else path
    own = folder.resolve()
    if source == own or (case.whole is not case and source == own / case.analysis):
        with locate_errors(case.file):
            raise InputError(
                f"'{case.file_of_start}' is in the folder of this run's own results, "
                "which it overwrites",
                where="dynamics.start.file",
                expected="another folder for the results: output.folder, or --output",
            )


@dataclass
class _Shared:
    """What the analyses of a case share.

    Attributes:
        keep: The equilibrium that statics finds is the preload of another one.
        body: The mesh, and whether it follows curved surfaces.
        known: Load factor and unknowns of that equilibrium.
        told: Notes that were logged.
    """

    keep: bool = False
    body: tuple[bool | None, Body] | None = None
    known: tuple[float, InitialGuess] | None = None
    told: set[str] = field(default_factory=set)

    def body_of(self, case: Case, comm: MPI.Comm) -> Body:
        """The mesh of a case, read once. Collective."""
        if self.body is None or self.body[0] != case.curved:
            self.body = case.curved, read_body(case, comm)
        return self.body[1]


@dataclass
class CaseRun:
    """A run of one analysis; see `InTurn` for the attributes.

    Attributes:
        problem: Of the states that it yields; None before.
    """

    case: Case
    folder: Path
    petsc: dict[str, PetscValue]
    comm: MPI.Comm
    shared: _Shared = field(default_factory=_Shared)
    before: Unfinished | None = None
    asked: Callable[[], bool] | None = None
    problem: Problem | None = None

    @property
    def around(self) -> Path | None:
        """Folder of all analyses of the case; None of a single one."""
        return self.folder.parent if self.case.whole is not self.case else None

    def check(self) -> None:
        """Finds what this analysis lacks, before another one is computed. Collective.

        Raises:
            InputError: Such as a material without density, or a law that knows no buckling.
        """
        with locate_errors(self.case.file):
            problem = self.case.make_problem(self.shared.body_of(self.case, self.comm))
            self.case.solver_for(problem, self.petsc)

    def states(self, *, asked: Callable[[], bool] | None = None) -> States:
        """All states and modes after they are written; see `run`. Collective."""
        self.asked = asked
        return loop_together(self.comm, self._locked(self.before))

    def _locked(self, before: Unfinished | None) -> States:
        """All states and modes, while no other run can write into the folder. Collective.

        Args:
            before: The run that is continued; None: from the start.
        """
        with closing(FolderLease(self.comm, self.folder, self.case.output.names())) as lock:
            lock.acquire()  # before computing, if the folder exists; else in `_write_all`
            if before is not None:
                before.check_newest()
            if self.comm.rank == 0:  # not before the lock: the file may be for another run
                remove_stop_file(self.folder)
            yield from self._states(before, lock)

    def _states(self, before: Unfinished | None, lock: FolderLease) -> States:
        timing.begin()
        with timing.stage("mesh"):
            body = self.shared.body_of(self.case, self.comm)
        description = describe_run(self.case, body, self.petsc, before)
        if before is not None:
            with timing.stage("mesh"):
                before.check_mesh(description)
        told = self.shared.told
        notes = log_notes(self.case, body, told)
        problem = self.problem = self.case.make_problem(body)
        more, sums = check_problem(self.case, problem, told)
        model = model_record(self.case, body, sums, [*notes, *more], self.petsc)
        solver = self.case.make_solver(problem, petsc=self.petsc)
        if self.case.gives_modes:
            cast("PreloadedAnalysis", solver).known = self.shared.known
        steps = _steps(solver, problem, before)
        step, settings = 0 if before is None else before.step, self.case.output.checkpoint
        checkpoints = Checkpoints(self.comm, self.folder, settings, description, step=step)
        run_checkpoints = RunCheckpoints(checkpoints, solver, self.asked)
        with locate_errors(self.case.file), closing(steps):
            files = outputs_of(self.case, model)
            yield from self._write_all(problem, files, steps, run_checkpoints, before, lock)
        checkpoints.clear()
        if self.shared.keep and self.case.analysis == "statics":
            from dolfin_elastic.solvers.statics.load_stepping import InitialGuess

            scalars = cast(RestartableSolver, solver).restart_state().numbers["scalars"]
            guess = InitialGuess(problem.w.x.array.copy(), tuple(scalars))
            self.shared.known = self.case.final_load, guess

    def _write_all(
        self,
        problem: Problem,
        files: Sequence[Output],
        steps: States,
        checkpoints: RunCheckpoints,
        before: Unfinished | None,
        lock: FolderLease,
    ) -> States:
        """Yields what the solver yields, after it is written to all outputs. Collective."""
        probe = self.case.output.make_probe(problem)
        probed = (
            probe.add_to(step) if isinstance(step, State) and not step.between else step
            for step in steps
        )
        # The first state is computed before the folder is made: an error in it leaves none behind.
        first = [] if before else list(islice(probed, 1))
        modes = any(isinstance(file, Modes) for file in files)  # they follow the last state
        lock.acquire(create=True)
        checkpoints.remove_foreign(new=before is None)
        saved = None if before is None else before.found.content["outputs"]
        known = self.shared.known
        with open_outputs(files, problem, self.folder, saved) as writers:
            if known and first and first[0].load_factor == known[0]:  # statics has told its stress
                for writer in writers:
                    if isinstance(writer, SummaryWriter):
                        writer.silence()
            try:
                for result in chain(first, probed):
                    if not (isinstance(result, State) and result.between):
                        give_back()  # what solving needed for the moment
                        if isinstance(result, State) and result.done >= 1.0 and not modes:
                            _prepare(writers, result)
                        checkpoints.forget()  # the files are about to be ahead of it
                        for writer in writers:
                            _write(writer, result)
                    checkpoints.save_if_due(result, writers)
                    try:
                        yield result
                    except GeneratorExit:
                        checkpoints.save_at_stop(result, writers)
                        raise
                    checkpoints.remember(result)
                    if isinstance(result, State) and result.done < 1.0:
                        result.derived.clear()  # its stress, which all outputs have written
            except StoppedError:
                acknowledge()  # the checkpoint is written in order
                checkpoints.save_remembered(writers)
                raise


def _steps(solver: Solver, problem: Problem, before: Unfinished | None) -> States:
    """The solver's generator, from the start or from a checkpoint."""
    if before is None:  # after a restart it is unknown whether there was contact before
        return _warn_of_untouched(problem, solver.steps())
    assert isinstance(solver, RestartableSolver)  # others have no checkpoints
    return cast(States, solver.steps(before.found))


def _warn_of_untouched(problem: Problem, states: States) -> States:
    """Passes states on, and warns in the end of contacts that have never touched. Collective."""
    never = {pair.label for pair in problem.contact_pairs}
    with closing(states):
        for state in states:
            numbers = state.numbers if isinstance(state, State) else {}
            area = {label: numbers.get(f"contact_area_{label}", 1.0) for label in never}
            never -= {label for label in never if area[label] > 0}
            yield state
    for label in sorted(never):
        log.warning("contact '%s' was never touched", label)


def _prepare(writers: Iterable[Writer], last: State) -> None:
    """Has the summary estimate the error of a run's last state before it is written."""
    for writer in writers:
        if isinstance(writer, SummaryWriter):
            writer.prepare(last)


def _write(writer: Writer, result: State | Mode) -> None:
    if isinstance(result, State):
        writer.write(result)
    elif isinstance(writer, ModeWriter):
        writer.write_mode(result)


# --- output files ---


@timing.stage("checks")
def log_notes(case: Case, body: Body, told: set[str] | None = None) -> list[str]:
    """Logs how a body was made, and warns of what is doubtful in it and in its case. Collective.

    Args:
        told: What was logged before, and is not again; it grows.

    Returns:
        The warnings.
    """
    made = [f"mesh: {text}" for text in (*body.information, *unit_information(case, body))]
    _log_new(logging.INFO, made, told)
    notes = [*(f"mesh: {note}" for note in mesh_notes(case, body)), *check(case, body)]
    _log_new(logging.WARNING, notes, told)
    return notes


def _log_new(level: int, texts: Sequence[str], told: set[str] | None) -> None:
    for text in texts:
        if not told or text not in told:
            log.log(level, "%s", text)
    if told is not None:
        told.update(texts)


@timing.stage("checks")
def check_problem(
    case: Case, problem: Problem, told: set[str] | None = None
) -> tuple[list[str], tuple[LoadSum, ...]]:
    """Warns of what needs the problem: loads beyond the material, obstacles, elements. Collective.

    Args:
        told: See `log_notes`.

    Returns:
        The warnings, and the resultants of the loads; none where one has no value at some time.

    Raises:
        CaseError: A formula has a pole in the body, see `check_poles`.
    """
    integrals = Integrals(problem, case.metres_thick(problem.body))
    with locate_errors(case.file):
        check_poles(case, integrals)
    finders = tie_notes, contact_notes, bending_notes, shape_notes, section_notes
    notes = [f"mesh: {note}" for note in untied_notes(case, problem)]
    notes += [note for find in finders for note in find(case, problem)]
    sums: tuple[LoadSum, ...] = ()
    with suppress(CaseError):  # of a load without a value at some time: the run finds it, or not
        sums = load_sums(case, integrals)
        notes += stress_notes(case, integrals, sums)
    _log_new(logging.WARNING, notes, told)
    return notes, sums


def outputs_of(case: Case, model: Mapping[str, object]) -> list[Output]:
    """The outputs of a case, its summary with copies of it and of its model. Not collective.

    Args:
        model: See `model_record`.
    """
    copies = {"case": written_tables(case), "model": model}

    def complete(file: Output) -> Output:
        if isinstance(file, Summary):
            return file.model_copy(update=copies)
        return file.in_folder(case.folder) if isinstance(file, Export) else file

    return [complete(file) for file in case.files()]


@contextmanager
def open_outputs(
    files: Sequence[Output],
    problem: Problem,
    folder: Path,
    saved: Sequence[Mapping[str, Any]] | None = None,
) -> Iterator[list[Writer]]:
    """Opens the outputs, and closes them as completed, failed or stopped. Collective.

    Args:
        saved: Restart states of their writers, where the run continues from a checkpoint.
    """
    writers: list[Writer] = []
    ending: tuple[str, object] = ("completed", None)
    try:
        with nullcontext() if saved is None else restoring(folder):
            for index, file in enumerate(files):
                writers.append(file.open(problem, folder, None if saved is None else saved[index]))
        on_root(problem.body.comm, lambda: _remove_others(folder, files))
        yield writers
    except StoppedError:
        acknowledge()
        ending = ("stopped", "on request")
        raise
    except ElasticError as error:
        ending = ("failed", error)
        if isinstance(error, SolveError) and isinstance(error.state, State):
            try:
                _write_failed(problem, folder, error.state)
                error.add_note(f"the state that failed is in {folder / _FAILED}")
            except OutputError as second:
                log.warning("%s", second)
        raise
    except GeneratorExit:
        ending = ("stopped", "on request")
        raise
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):  # a second one: nothing waits for what is solved
            with suppress(OSError, ValueError):
                mark_stopped(folder)
        writers.clear()  # perhaps on this rank alone: closing is collective and would deadlock
        end_all_if_alone(problem.body.comm)
        raise
    finally:
        _close(writers, ending)


def _remove_others(folder: Path, files: Sequence[Output]) -> None:
    """Removes files of an older run that this one does not overwrite. Not collective."""
    Xdmf(file=_FAILED).remove(folder)
    kinds = {type(file) for file in files}
    others: list[type[Output]] = [*FORMATS.values(), History]
    for kind in others:
        if kind not in kinds:
            kind.model_construct().remove(folder)  # defaults need no check, which costs its schema
    if Modes not in kinds:
        clear_modes(folder)


def _remove_results(folder: Path) -> None:
    """Removes files of an older run with one analysis, beside the folders of several."""
    _remove_others(folder, ())
    (folder / "summary.json").unlink(missing_ok=True)


def _close(writers: Iterable[Writer], ending: tuple[str, object]) -> None:
    """Closes all writers, also after one could not be closed. Collective.

    Args:
        ending: Status and cause. An error of closing is raised only if the run itself had none.
    """
    fault: OutputError | None = None
    give_back()  # what the solver held
    for writer in writers:
        try:
            writer.close(*ending)
        except OutputError as error:
            fault = fault or error
            log.warning("%s", error)
    if fault is not None and ending[0] == "completed":
        raise fault


def _write_failed(problem: Problem, folder: Path, state: State) -> None:
    """Writes a state without equilibrium into a file of its own. Collective."""
    fields = ["displacement", "jacobian", "von_mises"]
    fields += ["residual"] * (state.v is None) + ["energy_density"] * problem.has_energy
    writer = Xdmf(file=_FAILED, fields=tuple(fields)).open(problem, folder)
    writer.write(state)
    writer.close("failed", None)
