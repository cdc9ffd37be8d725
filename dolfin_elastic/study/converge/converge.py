"""`converge`: solves a case on meshes that are refined where the error is, until a result is known.

Each mesh is refined where the estimated error in energy is largest, and at the place of the result
that is wanted.  The solution is interpolated to the finer mesh, from where Newton's method goes on.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic.case.case import Case, locate_errors
from dolfin_elastic.case.model_record import model_record
from dolfin_elastic.case.run import check_problem, log_notes, open_outputs, outputs_of
from dolfin_elastic.core import timing
from dolfin_elastic.core.compat import collapsed
from dolfin_elastic.core.errors import InputError, StoppedError
from dolfin_elastic.core.parallel import on_root, total
from dolfin_elastic.core.petsc_options import PetscOptions, PetscValue
from dolfin_elastic.core.signals import acknowledge, raise_if_agreed, remove_stop_file
from dolfin_elastic.core.together import loop_together
from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.refine.marking import bulk
from dolfin_elastic.mesh.refine.refinement import Refinement, refine_body
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import RestartState, State
from dolfin_elastic.results.checkpoint.lock import FolderLease
from dolfin_elastic.results.quantity import Measured
from dolfin_elastic.results.recovery.error import ErrorEstimate, ErrorEstimator
from dolfin_elastic.results.recovery.peaks import Peak, find_peaks, percent
from dolfin_elastic.results.writers.summary import SummaryWriter, mark_stopped
from dolfin_elastic.solvers.statics.load_stepping import InitialGuess
from dolfin_elastic.solvers.statics.statics import Statics
from dolfin_elastic.study.converge.extrapolation import extrapolate, grows
from dolfin_elastic.study.converge.report import Level, Progress, Verdict, write_report
from dolfin_elastic.study.wanted import Wanted, WantedNumber

log = logging.getLogger("dolfin_elastic")


def refined_unknowns(
    refinement: Refinement, coarse: Problem, w: fem.Function, fine: Problem
) -> FloatArray:
    """All unknowns of a problem, interpolated to the same problem on a finer mesh. Collective.

    The functions are the same on cells whose nodes were not moved to a CAD surface.

    Args:
        refinement: From the body of one to that of the other.
        coarse: The problem that was solved, without periodic faces.

    Returns:
        The local array of `fine.w`, ghosts included.
    """
    guess = fem.Function(fine.W)
    fields = coarse.unknowns.auxiliary_fields
    if not fields:
        guess.x.array[:] = _carried(refinement, coarse.V, w.x.array, fine.V)
    for i, scale in enumerate((1.0, *(_rescaled(coarse, fine, f.name) for f in fields))):
        if fields:
            (before, here), (after, there) = (collapsed(p.W.sub(i)) for p in (coarse, fine))
            guess.x.array[there] = scale * _carried(refinement, before, w.x.array[here], after)
    guess.x.scatter_forward()
    return np.asarray(guess.x.array)


def _rescaled(coarse: Problem, fine: Problem, name: str) -> float:
    """An unknown is its field over a scale, which depends on the cells' size."""
    return float(coarse.unknowns.scale[name].value) / float(fine.unknowns.scale[name].value)


def _carried(
    refinement: Refinement, before: fem.FunctionSpace, values: AnyArray, after: fem.FunctionSpace
) -> FloatArray:
    """The local array of a function of a Lagrange space, continuous or not. Collective."""
    width = before.dofmap.index_map_bs
    rows = values.reshape(-1, width)[before.dofmap.list]
    result = refinement.interpolated(int(before.ufl_element().degree), rows)
    index = after.dofmap.index_map
    table = np.zeros((index.size_local + index.num_ghosts, width))
    table[after.dofmap.list] = result
    return table.reshape(-1)


States = Generator[State, None, None]

REFINEMENTS, UNKNOWNS = 8, 500_000
"""Limits unless others are given."""
_MESHES = 3
"""Meshes that must be seen: two may agree by accident."""
_SHARE, _PEAK_SHARE = {2: 0.7, 3: 0.5}, 0.9
"""Share of the squared error that the refined cells carry: of all cells, in the plane and in space,
where a divided cell becomes more of them; and of the cells at the peak."""


@dataclass(frozen=True)
class Goal:
    """The quantity that is wanted, its tolerance, and the limits of the effort.

    Attributes:
        quantity: What is wanted.
        tolerance: Its relative error.
        refinements: Largest number of refinements.
        unknowns: Largest number of unknowns of a mesh.
    """

    quantity: Wanted
    tolerance: float
    refinements: int = REFINEMENTS
    unknowns: int = UNKNOWNS


def converge(
    case: Case,
    goal: Goal,
    *,
    output: Path | None = None,
    petsc: PetscOptions | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> Generator[Progress, None, None]:
    """Solves a case on finer and finer meshes; yields what is known after each.  Collective.

    The results of the finest mesh, and the report, are written before they are yielded.

    Args:
        case: From `read_case`, or made in Python; its statics is computed.
        output: Folder of the results; by default that of `run` with "_converged" at its end.
        petsc: PETSc options that win over the case's own.
        comm: The ranks that work together.

    Raises:
        InputError: The case is wrong, or has no such quantity; or a run is still going in the
            folder.
        SolveError: No solution was found on a mesh; the results of the one before are complete.
        OutputError: Results cannot be written.
        StoppedError: A signal has asked for the end; the results of the mesh before are complete.
    """
    case = case.first_of("statics")
    _check_kind(case)
    yield from loop_together(
        comm, _locked(case, goal, output or case.folder_beside("converged"), petsc, comm)
    )


def _locked(
    case: Case, goal: Goal, folder: Path, petsc: PetscOptions | None, comm: MPI.Comm
) -> Generator[Progress, None, None]:
    """All meshes, while no other run can write into the folder. Collective."""
    with closing(FolderLease(comm, folder, case.output.names())) as lock:
        lock.acquire()
        if comm.rank == 0:
            remove_stop_file(folder)
        yield from _Convergence(case, goal, folder, dict(petsc or {}), comm, lock).levels()


def _check_kind(case: Case) -> None:
    """Refuses all but statics without periodic faces."""
    what = f"[{case.analysis}]" if case.analysis != "statics" else ""
    if case.periodic is not None:
        what = "a periodic cell, whose opposite faces must have the same mesh"
    if what:
        raise InputError(
            f"converge refines the meshes of [statics], but this is {what}",
            where=case.file,
            expected="compute it with `run` on two meshes",
        )


@dataclass(frozen=True)
class _Solved:
    """The solution on one mesh.

    Attributes:
        body: With its names.
        problem: On it.
        state: At the end of the load.
        saved: The solver's restart state there.
        measured: The quantity.
        at_peak: Owned cells of this rank where a field is about as large.
        estimate: Of the error.
        peak: Where the quantity is the largest von Mises stress.
        newton: Newton iterations.
    """

    body: Body
    problem: Problem
    state: State
    saved: RestartState
    measured: Measured
    at_peak: IndexArray
    estimate: ErrorEstimate
    peak: Peak | None
    newton: int


@dataclass(frozen=True)
class _Convergence:
    """One sequence of meshes; see `converge`."""

    case: Case
    goal: Goal
    folder: Path
    petsc: dict[str, PetscValue]
    comm: MPI.Comm
    lock: FolderLease

    def levels(self) -> Generator[Progress, None, None]:
        """All meshes. Collective."""
        timing.begin()
        body = self._first_body()
        notes = first = log_notes(self.case, body)
        progress = Progress(self.goal.quantity, self.goal.tolerance, ())
        refinement, before = None, None
        try:
            while progress.verdict == "running":
                raise_if_agreed(self.comm)
                problem = self.case.make_problem(body)
                if before is None:
                    check_problem(self.case, problem)
                elif problem.num_dofs > self.goal.unknowns:
                    progress = self._ended(
                        progress,
                        "unknowns",
                        f"the next mesh has {problem.num_dofs} unknowns, above the limit of "
                        f"{self.goal.unknowns} (--unknowns){_doubt(before.peak)}"
                        f"{_cut_off(before, self.goal.tolerance)}",
                    )
                    yield progress
                    return
                solved = self._solve(body, problem, refinement, before)
                progress = self._judged(progress, solved)
                self._write(solved, progress, notes)
                yield progress
                if progress.verdict == "running":
                    with timing.stage("mesh"):
                        refinement, before = self._refined(solved), solved
                        body = refinement.body
                    told = [f"mesh: {note}" for note in body.notes]
                    for note in told:
                        log.warning("%s", note)
                    notes = [*(re.sub("^mesh: ", "first mesh: ", n) for n in first), *told]
        except StoppedError:
            acknowledge()
            if progress.levels:
                ended = replace(progress, verdict="stopped", reason="stopped on request")
                on_root(self.comm, lambda: self._mark_stopped(ended))
            raise

    def _mark_stopped(self, ended: Progress) -> None:
        write_report(ended, self.folder, plot=False)
        mark_stopped(self.folder, "on request", before="completed")

    def _first_body(self) -> Body:
        with timing.stage("mesh"):
            body = self.case.read_body(self.comm)
        probes = [*self.case.output.probes]
        supports = [support.label for support in self.case.support]
        self.goal.quantity.check(body, probes, supports)
        return body

    def _solve(
        self,
        body: Body,
        problem: Problem,
        refinement: Refinement | None,
        before: _Solved | None,
    ) -> _Solved:
        """The equilibrium at the end of the load, and the quantity there. Collective."""
        solver = self.case.make_solver(problem, petsc=self.petsc)
        assert isinstance(solver, Statics)  # see `_check_kind`
        near = None
        if refinement is not None and before is not None:
            unknowns = refined_unknowns(refinement, before.problem, before.problem.w, problem)
            near = InitialGuess(unknowns, tuple(before.saved.numbers["scalars"]))
        newton, state, saved = 0, None, None
        with locate_errors(self.case.file), closing(solver.steps(near=near)) as steps:
            for state in steps:
                newton += state.newton
                saved = solver.restart_state()
            assert state is not None
            assert saved is not None
            state = self.case.output.make_probe(problem).add_to(state)
            with timing.stage("output"):
                estimate = ErrorEstimator(problem)(state)
                number = WantedNumber(self.goal.quantity, problem)
                measured, cells = number(state)
                peak = number.peak(measured, estimate)
        return _Solved(body, problem, state, saved, measured, cells, estimate, peak, newton)

    # --- what is known ---

    def _judged(self, progress: Progress, solved: _Solved) -> Progress:
        """Progress with one more mesh: its value, error and verdict. Collective."""
        levels, measured, problem = progress.levels, solved.measured, solved.problem
        d = problem.body.dim
        unknowns = [*(float(level.unknowns) for level in levels), float(problem.num_dofs)]
        sizes = np.array([*(level.size for level in levels), measured.cell_size])
        values = [*(level.value for level in levels), measured.value]
        # A peak depends on the cells around it, as long as each mesh has finer ones there.
        local = len(sizes) > 1 and bool(np.all(sizes[1:] < 0.8 * sizes[:-1]))
        fineness = [float(h**-d) for h in sizes] if local else unknowns
        rate = self.goal.quantity.order(problem.degree) / d
        result = extrapolate(fineness, values, rate=rate)
        # Two meshes may agree by accident: displacements and energies are hardly known better than
        # by the energy's error, and peaks of stress by that of the recovered stress.  The forces of
        # supports balance the loads on every mesh.  A peak that is not resolved is not known (nan).
        recovered = _recovered(solved.peak)
        bare = bool(measured.place) or self.goal.quantity.name.startswith("reaction")
        least = 0.0 if bare else solved.estimate.relative**2
        least = least if solved.peak is None else recovered
        # No refinement of a finished mesh brings straight cells nearer to a curved face.
        cut_off = solved.estimate.cut_off if solved.peak is None else 0.0
        estimated = float(np.maximum(result.error + cut_off, least))
        level = Level(
            number=len(levels) + 1,
            cells=problem.body.num_cells,
            unknowns=problem.num_dofs,
            value=measured.value,
            error=estimated if len(values) > 1 else recovered,
            limit=result.limit,
            rate=result.rate,
            energy_error=solved.estimate.relative,
            place=measured.place,
            size=measured.cell_size,
            newton=solved.newton,
        )
        progress = replace(progress, levels=(*levels, level))
        if solved.state.failure:
            return self._ended(progress, "audit", f"audit FAIL: {solved.state.failure}")
        if reason := self._singular(progress, solved):
            return self._ended(progress, "singular", reason)
        if level.number >= _MESHES and level.error <= self.goal.tolerance:
            return replace(progress, verdict="reached")
        if len(levels) >= self.goal.refinements:
            return self._ended(
                progress,
                "refinements",
                f"that is {self.goal.refinements} refinements, the limit (--refinements)"
                f"{_doubt(solved.peak)}{_cut_off(solved, self.goal.tolerance)}",
            )
        return progress

    def _ended(self, progress: Progress, verdict: Verdict, reason: str) -> Progress:
        ended = replace(progress, verdict=verdict, reason=reason)
        on_root(self.comm, lambda: write_report(ended, self.folder))
        return ended

    def _singular(self, progress: Progress, solved: _Solved) -> str:
        """Why the quantity has no limit; empty: it may have one. Collective.

        Where the geometry says so two refinements confirm it, else three.
        """
        place, peak = progress.last.place, solved.peak
        known = peak.singular if peak is not None else ""
        sizes = [level.size for level in progress.levels]
        values = [level.value for level in progress.levels]
        exponent = grows(sizes, values, 2 if known else 3) if place else 0.0
        if not exponent:
            return ""
        by = f", at {known}," if known else ""
        text = (
            f"{progress.quantity} has no limit: at {solved.problem.body.unit.point(place)}{by} "
            f"it grows with every refinement, like h^-{exponent:.2f}"
        )
        regular = find_peaks(solved.problem, solved.estimate).regular if known else None
        if regular is not None:
            text += f"; the largest elsewhere is {regular.text()}"
        return text + (_doubt(peak) if peak is not None and peak.unresolved else "")

    # --- the next mesh ---

    def _refined(self, solved: _Solved) -> Refinement:
        """The mesh, finer where the error is and at the place of the quantity. Collective."""
        indicators = solved.estimate.cells
        there = np.zeros_like(indicators)
        there[solved.at_peak] = indicators[solved.at_peak]
        everywhere = bulk(self.comm, indicators, _SHARE[solved.body.dim])
        marked = np.union1d(everywhere, bulk(self.comm, there, _PEAK_SHARE)).astype(np.int32)
        if not total(self.comm, len(marked)):  # no error anywhere: all cells, to see it confirmed
            marked = solved.body.owned_cells()
        return refine_body(solved.body, marked)

    # --- what is written ---

    def _write(self, solved: _Solved, progress: Progress, notes: Sequence[str]) -> None:
        """The results of this mesh, in place of those of the one before. Collective.

        Args:
            notes: What is doubtful in the first mesh, the case and this mesh.
        """
        self.lock.acquire(create=True)
        model = model_record(self.case, solved.body, (), notes, {})
        with open_outputs(outputs_of(self.case, model), solved.problem, self.folder) as writers:
            for writer in writers:
                if isinstance(writer, SummaryWriter) and progress.verdict == "running":
                    writer.silence()
                writer.write(solved.state)
        with timing.stage("output"):
            on_root(self.comm, lambda: write_report(progress, self.folder))


def _doubt(peak: Peak | None) -> str:
    """A warning where the quantity is at a singular place, or not resolved; empty elsewhere."""
    if peak is None:
        return ""
    if not (peak.singular or peak.unresolved):
        known = np.isfinite(peak.error)
        return "" if known else "; its error is not known, for a face elsewhere is not resolved"
    if peak.unresolved:
        return f"; its peak is not known: {peak.unresolved}"
    return f"; it is at {peak.singular}, where the stress has no limit"


def _cut_off(solved: _Solved, tolerance: float) -> str:
    """A warning where straight cells at curved faces keep the goal from being reached."""
    share = solved.estimate.cut_off
    if share < tolerance or solved.body.cad is not None:
        return ""
    return (
        f"; straight elements cut {percent(share)} of the energy off at curved faces, which no "
        "refinement of this mesh changes: a mesh of quadratic elements follows them"
    )


def _recovered(peak: Peak | None) -> float:
    """The error that is known of one mesh alone; nan if it is not."""
    return float("nan") if peak is None else peak.error
