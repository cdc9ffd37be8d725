"""What a check finds: how large everything is, what loads it, what holds it."""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

from dolfin_elastic.case.case import Case, locate_errors
from dolfin_elastic.case.check.cavities import cavity_notes
from dolfin_elastic.case.check.consistency import check, explicit, run_notes
from dolfin_elastic.case.check.initial_state import (
    ContactGap,
    check_supports,
    contact_gaps,
    contact_notes,
    start_notes,
)
from dolfin_elastic.case.check.integrals import Integrals
from dolfin_elastic.case.check.loads import LoadSum, load_sums, stress_notes
from dolfin_elastic.case.check.memory import Memory, memory
from dolfin_elastic.case.check.mesh_quality import cell_notes, part_notes
from dolfin_elastic.case.check.sizes import (
    PartSize,
    material_sizes,
    region_sizes,
    surface_sizes,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.petsc_options import refuse_case_keys
from dolfin_elastic.mesh.body import Body, extent
from dolfin_elastic.problem.damping import check_damped
from dolfin_elastic.problem.material_regions import locking_notes
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.results.probes import duplicate_column
from dolfin_elastic.solvers.diagnostics.rigid_body import FreeBody, check_held, free_bodies
from dolfin_elastic.solvers.eigen.buckling import Buckling
from dolfin_elastic.solvers.eigen.modal import UNMOVED, Modal
from dolfin_elastic.solvers.linear.choice import Choice, choose

PLANE = ("plane-strain", "plane-stress")


@dataclass(frozen=True)
class Report:
    """What a check finds.

    Attributes:
        case: Name of the case file.
        title: The case's title.
        mesh: Where the mesh comes from.
        dim: 3, or 2 for plane strain.
        extent: Sides of the body's bounding box [m].
        geometry: "solid", or what a plane mesh is.
        cells: Cells on all ranks.
        unknowns: Displacement components on all ranks.
        analysis: "statics", "dynamics", "modal" or "buckling".
        linear_solver: Which linear solver, and why.
        surfaces: The named surfaces.
        regions: The named regions.
        notes: What a user should know.
        fields: Name, place and range of each field that the mesh carries.
        materials: What each material fills.
        loads: What each load sums up to, and all of them.
        contacts: Where each contact begins.
        thickness: Of a plane body [m]; None: it has none.
        bodies: Connected bodies and the rigid motions that nothing prevents.
        memory: What the solution will need.
    """

    case: str
    title: str
    mesh: str
    dim: int
    geometry: str
    extent: tuple[float, ...]
    cells: int
    unknowns: int
    analysis: str
    linear_solver: str
    surfaces: tuple[PartSize, ...]
    regions: tuple[PartSize, ...]
    notes: tuple[str, ...]
    fields: tuple[str, ...]
    materials: tuple[PartSize, ...]
    loads: tuple[LoadSum, ...]
    contacts: tuple[ContactGap, ...]
    thickness: float | None
    bodies: tuple[FreeBody, ...]
    memory: Memory


def report(case: Case, *, comm: MPI.Comm = MPI.COMM_WORLD) -> Report:
    """Checks a case against its mesh and says how large everything is.

    Collective.

    Raises:
        InputError: Something is wrong.
    """
    body = case.read_body(comm)
    notes = (*run_notes(case), *check(case, body))
    try:
        problem = case.make_problem(body)
        notes = (*notes, *contact_notes(case, problem))
        with locate_errors(case.file):
            notes = (*notes, *_start(case, problem), *cavity_notes(case, problem))
            return _found(case, body, problem, notes)
    except InputError as error:
        for note in notes:
            error.add_note(f"note: {note}")
        raise


def check_probes(case: Case, problem: Problem) -> None:
    """No probe has the column of a reaction or a momentum. Not collective.

    Raises:
        InputError: One has.
    """
    taken = {f"reaction_{support.label}" for support in problem.supports}
    taken |= {f"reaction_{touch.label}" for touch in problem.contact_pairs}
    if case.dynamics is not None:
        taken |= {"momentum", "angular_momentum"}
    if twice := taken & case.output.probes.keys():
        raise duplicate_column(f"{min(twice)}_x")


def _start(case: Case, problem: Problem) -> tuple[str, ...]:
    """What the solver would refuse at its start, or warn of."""
    refuse_case_keys(case.solver.petsc, "solver.petsc")
    check_probes(case, problem)
    if case.analysis in ("statics", "buckling") or case.preloaded:
        check_held(problem)
    elif case.dynamics is not None:
        if case.dynamics.implicit:
            check_damped(problem, case.dynamics.damping.get("stiffness", 0.0))
        case.dynamics.row.scheme.check(problem, case.dynamics.scheme)
    notes = start_notes(problem, case.dynamics) if case.dynamics is not None else ()
    if case.analysis in ("statics", "dynamics") or case.preloaded:
        check_supports(case, problem)
    if case.modal is not None and case.preloaded and problem.context.linear:
        notes = (*notes, UNMOVED)
    return notes


def _found(case: Case, body: Body, problem: Problem, notes: tuple[str, ...]) -> Report:
    integrals = Integrals(problem, case.mesh.metres_thick)
    sums = load_sums(case, integrals)
    moving = case.dynamics is not None
    solver = case.make_solver(problem)
    if isinstance(solver, Modal | Buckling):
        choice: Choice | None = solver.choice
    else:
        choice = None if explicit(case) else choose(problem, case.solver, moving=moving)
    return Report(
        case=case.file,
        title=case.title,
        mesh=body.source,
        dim=body.dim,
        geometry=case.mesh.geometry if body.dim == 2 else "solid",
        extent=extent(body),
        cells=body.num_cells,
        unknowns=problem.num_dofs,
        analysis=case.analysis,
        linear_solver="none: explicit scheme" if choice is None else choice.why,
        surfaces=surface_sizes(case, integrals),
        regions=region_sizes(case, body, integrals),
        notes=(
            *body.notes,
            *notes,
            *locking_notes(body, problem.regions, problem.degree, problem.geometry),
            *stress_notes(case, integrals, sums),
            *part_notes(body),
            *cell_notes(body),
        ),
        fields=tuple(
            f"{name}: {body.fields[name].describe(body.comm)}" for name in sorted(body.fields)
        ),
        materials=material_sizes(integrals),
        loads=sums,
        contacts=contact_gaps(case, problem),
        thickness=_thickness(case, problem),
        bodies=tuple(free_bodies(problem)),
        memory=memory(problem, choice),
    )


def _thickness(case: Case, problem: Problem) -> float | None:
    plane = problem.body.dim == 2 and problem.geometry in PLANE
    return case.mesh.metres_thick if plane else None
