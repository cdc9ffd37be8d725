"""The report of a check: sizes, loads, free rigid-body motions, linear solver, memory."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

from mpi4py import MPI

from dolfin_elastic.case.case import Case, locate_errors
from dolfin_elastic.case.check.cavities import cavity_notes
from dolfin_elastic.case.check.consistency import check, run_notes
from dolfin_elastic.case.check.damping import damping_of
from dolfin_elastic.case.check.formulas import check_formulas
from dolfin_elastic.case.check.initial_state import (
    ContactGap,
    check_curves,
    check_supports,
    contact_gaps,
    contact_notes,
    mesh_notes,
    start_notes,
    tie_information,
    tie_notes,
    untied_notes,
)
from dolfin_elastic.case.check.integrals import Integrals
from dolfin_elastic.case.check.loads import LoadSum, load_sums, stress_notes
from dolfin_elastic.case.check.materials import (
    material_constants,
    material_information,
    stability_notes,
)
from dolfin_elastic.case.check.memory import Memory, memory
from dolfin_elastic.case.check.mesh_quality import (
    bending_notes,
    cell_notes,
    part_notes,
    section_notes,
    shape_notes,
)
from dolfin_elastic.case.check.plausibility import unit_information
from dolfin_elastic.case.check.rest import read_body
from dolfin_elastic.case.check.sizes import (
    PartSize,
    faces_used,
    lower_sizes,
    material_sizes,
    references,
    region_sizes,
    surface_sizes,
)
from dolfin_elastic.case.described import Described, described
from dolfin_elastic.case.toml import key_text
from dolfin_elastic.core.errors import CaseError, InputError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.petsc_options import refuse_case_keys
from dolfin_elastic.core.si_text import natural
from dolfin_elastic.mesh.body import Body, extent
from dolfin_elastic.mesh.selectors import Selector
from dolfin_elastic.problem.damping import check_damped
from dolfin_elastic.problem.material_regions import locking_notes
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.term_list import refuse_rest
from dolfin_elastic.results.derived.sections import SectionForces
from dolfin_elastic.results.fields import name_in_results
from dolfin_elastic.results.files import why_not_made
from dolfin_elastic.results.moments import columns_of_moments
from dolfin_elastic.results.probes import duplicate_column
from dolfin_elastic.results.reactions import REACTION, node_at
from dolfin_elastic.solvers.assembly.hydrostatic_constant import HydrostaticConstant
from dolfin_elastic.solvers.diagnostics.rigid_body import (
    FreeBody,
    check_no_rigid_motion,
    free_bodies,
)
from dolfin_elastic.solvers.eigen.settings import UNMOVED
from dolfin_elastic.solvers.linear.choice import Choice, choose
from dolfin_elastic.solvers.statics.settings import refuse_times

PLANE = ("plane-strain", "plane-stress")


@dataclass(frozen=True)
class Report:
    """What `dolfin-elastic check` reports.

    Attributes:
        case: Name of the case file.
        title: The case's title.
        mesh: Where the mesh comes from.
        information: How it was made, and corrections without effect.
        unit: Its unit of length.
        dim: 3, or 2 of a plane or axisymmetric mesh.
        extent: Sides of the body's bounding box [m].
        geometry: "solid", or what a plane mesh is.
        cells: Cells on all ranks.
        degree: Of the displacement in the elements, 1 or 2.
        unknowns: Degrees of freedom on all ranks.
        analysis: "statics", "modal", "buckling" or "dynamics"; of several, with commas.
        scheme: Of dynamics; else empty.
        damping: Ratios of Rayleigh's damping, bulk viscosity, and the mass that would be added.
        linear_solver: Which linear solver, and why.
        surfaces: The named surfaces, and the CAD faces that the case uses without a name.
        edges: The named edges of a solid.
        points: The named points, but for sets of nodes that are surfaces.
        regions: The named regions.
        notes: What is allowed but probably not meant.
        fields: Name, place and range of each field that the mesh carries.
        materials: The cells of each material.
        constants: Law, constants and source of each material in words.
        described: Its supports, loads, contacts and ties in words.
        loads: Resultant of each load, and of all of them.
        contacts: Initial gap of each contact.
        thickness: Of a plane body [m]; None of others.
        bodies: Connected bodies, with the rigid-body motions that no support prevents.
        memory: Estimate of what the solution needs.
    """

    case: str
    title: str
    mesh: str
    information: tuple[str, ...]
    unit: str
    dim: int
    geometry: str
    extent: tuple[float, ...]
    cells: int
    degree: int
    unknowns: int
    analysis: str
    scheme: str
    damping: tuple[str, ...]
    linear_solver: str
    surfaces: tuple[PartSize, ...]
    edges: tuple[PartSize, ...]
    points: tuple[PartSize, ...]
    regions: tuple[PartSize, ...]
    notes: tuple[str, ...]
    fields: tuple[str, ...]
    materials: tuple[PartSize, ...]
    constants: tuple[str, ...]
    described: tuple[Described, ...]
    loads: tuple[LoadSum, ...]
    contacts: tuple[ContactGap, ...]
    thickness: float | None
    bodies: tuple[FreeBody, ...]
    memory: Memory


def report(case: Case, *, comm: MPI.Comm = MPI.COMM_WORLD) -> Report:
    """Checks a case against its mesh, without compiling a form or solving. Collective.

    Args:
        comm: The ranks that share the mesh.

    Returns:
        The report, the same on every rank; of several analyses the loads of the first one.

    Raises:
        InputError: The first fault, on every rank; the notes so far are its notes.
    """
    bodies: dict[bool | None, Body] = {}
    reports = []
    for one in case.analyses():
        if one.curved not in bodies:
            bodies[one.curved] = read_body(one, comm)
        reports.append(_report(one, bodies[one.curved]))
    if len(reports) == 1:
        return reports[0]
    solvers = dict.fromkeys(one.linear_solver for one in reports)
    return replace(
        reports[0],
        analysis=", ".join(one.analysis for one in reports),
        scheme=next((one.scheme for one in reports if one.scheme), ""),
        damping=next((one.damping for one in reports if one.damping), ()),
        linear_solver="; ".join(solvers),
        notes=tuple(dict.fromkeys(note for one in reports for note in one.notes)),
        memory=max((one.memory for one in reports), key=lambda memory: memory.total),
    )


def _report(case: Case, body: Body) -> Report:
    """See `report`, of one analysis. Collective."""
    notes = (*run_notes(case), *check(case, body))
    try:
        with locate_errors(case.file):
            check_curves(case, body.dim)
        problem = case.make_problem(body)
        notes = (*notes, *contact_notes(case, problem), *tie_notes(case, problem))
        with locate_errors(case.file):
            notes = (*notes, *_solver_notes(case, problem), *cavity_notes(problem))
            return _make_report(case, body, problem, notes)
    except InputError as error:
        for note in (*body.notes, *notes):
            error.add_note(f"note: {note}")
        raise


def check_probes(case: Case, problem: Problem) -> None:
    """Checks columns of probes in history.csv, and that reactions are read at nodes. Collective.

    Raises:
        InputError: A probe has the column of a reaction or momentum, or no node; there is no
            support of whose moment a column is asked for.
    """
    columns_of_moments(case.output.reference_points(problem.body.unit.metres), problem)
    SectionForces(problem, case.output.sections)
    for name, probe in case.output.probes.items():
        if probe.at is not None and REACTION in probe.fields:
            place = probe.place(problem.body.unit.metres)
            node_at(problem, place, f"output.probes.{key_text(name)}")
    taken = {f"reaction_{support.label}" for support in problem.supports}
    taken |= {f"reaction_{pair.label}" for pair in problem.contact_pairs}
    if case.dynamics is not None:
        taken |= {"momentum", "angular_momentum"}
    if twice := taken & case.output.probes.keys():
        raise duplicate_column(f"{min(twice)}_x")


def check_folder(case: Case, comm: MPI.Comm) -> None:
    """Checks that the folder of the results can be made and written into. Collective.

    Args:
        comm: The ranks that work together.

    Raises:
        CaseError: It cannot.
    """
    folder = case.results_folder()
    if reason := on_root(comm, lambda: why_not_made(folder)):
        raise CaseError(
            f"the folder of the results, {str(folder)!r}, cannot be made: {reason}",
            where="output.folder",
            expected="" if "choose" in reason else "choose a folder you may write to",
        )


def _solver_notes(case: Case, problem: Problem) -> tuple[str, ...]:
    """What the solver would warn of at its start. Collective.

    Raises:
        InputError: What it would refuse.
    """
    refuse_case_keys(case.solver.petsc, "solver.petsc")
    check_probes(case, problem)
    check_folder(case, problem.body.comm)
    if case.analysis in ("statics", "buckling") or case.preloaded:
        refuse_rest(problem.terms)
        if case.statics is not None and case.statics.in_time:
            refuse_times(case.statics, problem)
        check_no_rigid_motion(problem, stay=True)
    if (start := case.start_of(problem)) is not None:
        start()
    if case.dynamics is not None:
        if case.dynamics.implicit:
            check_damped(problem, case.dynamics.damping.get("stiffness", 0.0))
        _moved_by(case, problem)
        case.dynamics.row.scheme.check(problem, case.dynamics.scheme)
        if case.dynamics.parameters is not None:
            from dolfin_elastic.solvers.dynamics.implicit.implicit import suited

            suited(problem, case.dynamics.parameters)
    notes = start_notes(problem, case.dynamics) if case.dynamics is not None else ()
    if case.analysis in ("statics", "dynamics") or case.preloaded:
        check_supports(case, problem)
    if case.modal is not None and case.preloaded and problem.context.linear:
        notes = (*notes, UNMOVED)
    return notes


def _inner_surfaces(case: Case) -> set[str | None]:
    """Surfaces that are meant to lie inside the body."""
    named = {
        name
        for name, given in case.surfaces.items()
        for one in ([given] if isinstance(given, Selector) else given)
        if one.is_inner
    }
    return {*named, *(section.on for section in case.output.sections.values())}


def _make_report(case: Case, body: Body, problem: Problem, notes: tuple[str, ...]) -> Report:
    """The report of a case without faults. Collective."""
    integrals = Integrals(problem, case.metres_thick(body))
    check_formulas(case, integrals)
    sums = load_sums(case, integrals)
    choice = _solver_choice(case, problem)
    use = partial(references, case, body)
    damping, doubts = damping_of(case, problem)
    return Report(
        case=case.file,
        title=case.title,
        mesh=body.source,
        information=(
            *body.information,
            *unit_information(case, body),
            *tie_information(problem),
            *material_information(case),
        ),
        unit=body.unit.name,
        dim=body.dim,
        geometry=case.mesh.geometry if body.dim == 2 else "solid",
        extent=extent(body),
        cells=body.num_cells,
        degree=problem.degree,
        unknowns=problem.num_dofs,
        analysis=case.analysis,
        scheme=_moved_by(case, problem) if case.dynamics else "",
        damping=tuple(damping),
        linear_solver="none: explicit scheme" if choice is None else choice.why,
        surfaces=surface_sizes(body, use, faces_used(case, body)),
        edges=lower_sizes(body, "edge", use),
        points=lower_sizes(body, "point", use),
        regions=region_sizes(body, use, integrals),
        notes=(
            *mesh_notes(case, body),
            *untied_notes(case, problem),
            *notes,
            *doubts,
            *stability_notes(case),
            *locking_notes(body, problem.regions, problem.degree, problem.geometry),
            *bending_notes(case, problem),
            *shape_notes(case, problem),
            *section_notes(case, problem),
            *stress_notes(case, integrals, sums),
            *HydrostaticConstant(problem).notes(),
            *part_notes(body, _inner_surfaces(case)),
            *cell_notes(body),
        ),
        fields=tuple(
            f"{name}: {body.fields[name].describe(body.comm)}{_renamed(name, body)}"
            for name in sorted(body.fields, key=natural)
        ),
        materials=material_sizes(integrals),
        constants=tuple(material_constants(case)),
        described=described(case, body),
        loads=sums,
        contacts=contact_gaps(case, problem),
        thickness=_thickness(case, problem),
        bodies=tuple(free_bodies(problem)),
        memory=memory(problem, choice),
    )


def _solver_choice(case: Case, problem: Problem) -> Choice | None:
    """How the equations are solved; None: none are. Collective."""
    solver = case.make_solver(problem)
    if case.gives_modes:
        from dolfin_elastic.solvers.eigen.buckling import Buckling
        from dolfin_elastic.solvers.eigen.modal import Modal

        assert isinstance(solver, Modal | Buckling)
        return solver.choice
    moving = case.dynamics is not None
    return None if case.explicit else choose(problem, case.solver, moving=moving)


def _renamed(name: str, body: Body) -> str:
    """What a field of the body is called in results, if that is another name."""
    renamed = name_in_results(name, body)
    return "" if renamed == name else f"; in results '{renamed}'"


def _thickness(case: Case, problem: Problem) -> float | None:
    plane = problem.body.dim == 2 and problem.geometry in PLANE
    return case.metres_thick(problem.body) if plane else None


def _moved_by(case: Case, problem: Problem) -> str:
    """The scheme of a motion, which terms of the problem may choose. Not collective.

    Raises:
        InputError: It does not see where surfaces touch themselves.
    """
    from dolfin_elastic.solvers.dynamics.dynamics import with_barriers

    assert case.dynamics is not None
    return with_barriers(problem, case.dynamics).scheme
