"""`gradient`: derivatives of numbers of an equilibrium by constants, loads, fields, and shape."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np
import ufl
from mpi4py import MPI

from dolfin_elastic.case.case import Case, locate_errors
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.petsc_options import PetscOptions
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import Body, cell_size
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import Mode, State
from dolfin_elastic.solvers.assembly.dofs import ConstrainedDofs
from dolfin_elastic.solvers.nonlinear.adjoint import Adjoint, AdjointState
from dolfin_elastic.solvers.nonlinear.newton import Newton
from dolfin_elastic.solvers.statics.statics import Statics
from dolfin_elastic.study.gradient.buckling import LinearState, Prebuckling, load_factors
from dolfin_elastic.study.gradient.functionals import Functional, functionals
from dolfin_elastic.study.gradient.modes import (
    AtRest,
    analysis_of,
    check_modes,
    frequencies,
    with_one_more,
)
from dolfin_elastic.study.gradient.parameters import (
    STEP,
    Basis,
    Equilibrium,
    Sides,
    parameters,
)
from dolfin_elastic.study.gradient.spatial import (
    OFFSET,
    CellConstant,
    Shape,
    check_shape,
    coefficient_of,
    nodes_moved,
)
from dolfin_elastic.study.gradient.table import Derivative, Gradient, GradientTable
from dolfin_elastic.study.gradient.taylor import with_orders
from dolfin_elastic.study.quiet import quietly

CLOSED = 1e-6
"""Gap that a solution leaves over the height of the elements, without the user's word: the gradient
is that of no gap at all, and by the default a slender number is off by a percent."""


@dataclass(frozen=True)
class Asked:
    """What a gradient is asked for.

    Attributes:
        of: Numbers, by names such as "displacement_z of tip".
        by: Dotted keys of numbers of the case.
        fields: Keys of constants of materials, as fields.
        offsets: Surfaces that move along their normals.
    """

    of: Sequence[str]
    by: Sequence[str] = ()
    fields: Sequence[str] = ()
    offsets: Sequence[str] = ()


class Gradients:
    """Evaluates gradients at equilibria of a problem.  All of it is collective.

    Args:
        case: From which numbers that are no constants of materials are changed; None: none.
        probes: Name to the place of probes that are points [m].

    Raises:
        InputError: There is no such number or parameter, or no derivative.
    """

    def __init__(
        self,
        asked: Asked,
        problem: Problem,
        case: Case | None = None,
        probes: Mapping[str, Sequence[float]] | None = None,
    ) -> None:
        if what := without_gradient(problem):
            raise InputError(
                f"there is no gradient {what}",
                where="gradient",
                expected="`sweep`, whose runs take the whole way",
            )
        self.problem, self._of, self._probes = problem, asked.of, probes or {}
        self._functionals = self._numbers_of(problem)
        self._by = _By(asked, problem, case)

    def _numbers_of(self, problem: Problem) -> list[Functional]:
        return functionals(self._of, problem, self._probes)

    def at(self, newton: Newton, state: State) -> tuple[Gradient, ...]:
        """At the equilibrium that a solver has just found.

        Args:
            newton: The solver, after the solve.
            state: What it has found; its time counts.
        """
        here = Equilibrium(newton, self._numbers_of, self._functionals, state.t)
        if not self._by.some:
            values, none = here.evaluated().numbers, [None] * len(self._functionals)
            return self._by.gradients(here.assembler, self._functionals, values, [], none)
        with here.kept(), closing(Adjoint(newton)) as adjoint:
            of_scalars = here.by_scalars()
            values, sides = self._by.sides(here)
            solutions = [
                adjoint.solve(one.by_unknowns(here.assembler), row, one.motion())
                for one, row in zip(self._functionals, of_scalars, strict=True)
            ]
            return self._by.gradients(here.assembler, self._functionals, values, sides, solutions)


class _By:
    """All parameters together.  Collective.

    Attributes:
        some: There are any.
    """

    def __init__(self, asked: Asked, problem: Problem, case: Case | None) -> None:
        self._asked, self._comm = asked, problem.body.comm
        self._parameters = parameters(asked.by, problem, case)
        self.some = bool(asked.by or asked.fields or asked.offsets)
        self._cells: list[CellConstant] | None = None
        self._shape: Shape | None = None
        for key in asked.fields:
            coefficient_of(key, problem)
        for surface in asked.offsets:
            check_shape(problem)
            nodes_moved(problem.body, surface)
        self._offsets = dict[str, FloatArray]()

    def sides(self, basis: Basis) -> tuple[FloatArray, list[Sides]]:
        """Values, and what parameters change at fixed unknowns; functionals are left as they are.

        Args:
            basis: The equilibrium, or the body at rest.
        """
        sides = [one.derivative(basis) for one in self._parameters]
        return basis.evaluated().numbers, sides

    def gradients(
        self,
        dofs: ConstrainedDofs,
        functionals: Sequence[Functional],
        values: FloatArray,
        sides: Sequence[Sides],
        solutions: Sequence[AdjointState | None],
        residual: ufl.Form | None = None,
    ) -> tuple[Gradient, ...]:
        """Of all functionals.

        Args:
            values: Of each.
            sides: Of each parameter.
            solutions: The adjoint of each; None: it does not depend on the unknowns.
            residual: Virtual work of the equations; None: of the problem's.
        """
        if self._cells is None:
            self._cells = [CellConstant(key, dofs, residual) for key in self._asked.fields]
            if self._asked.offsets:
                self._shape = Shape(dofs, residual)
                self._offsets = {one: self._shape.offset(one) for one in self._asked.offsets}
        return tuple(
            self._gradient(one, float(values[number]), number, sides, solutions[number])
            for number, one in enumerate(functionals)
        )

    def _gradient(
        self,
        functional: Functional,
        value: float,
        number: int,
        sides: Sequence[Sides],
        solution: AdjointState | None,
    ) -> Gradient:
        by = []
        for parameter, side in zip(self._parameters, sides, strict=True):
            slope = float(side.numbers[number])
            if solution is not None:
                works = solution.fields @ side.forces + solution.pressures @ side.pressures
                slope += total(self._comm, float(works))
                slope += float(solution.scalars @ side.equations)
            if not math.isfinite(slope):
                raise InputError(
                    f"the derivative of '{functional.name}' by '{parameter.key}' is not finite",
                    where="gradient",
                    expected="another number, or `sweep`",
                )
            size = parameter.step / STEP
            key, at, unit = parameter.key, parameter.value, parameter.unit
            by.append(Derivative(key, at, unit, slope, size, room=parameter.room))
        cells = {one.key: one.by_logarithm(solution, functional) for one in self._cells or ()}
        nodes = None
        if self._shape is not None:
            slopes = self._shape.by_positions(solution, functional)
            for surface, motion in self._offsets.items():
                along = total(self._comm, float(slopes @ motion))
                size = cell_size(self._shape.problem.body)
                by.append(Derivative(f"{OFFSET}{surface}", 0.0, "m", along, size))
            nodes = self._shape.at_nodes(slopes)
        return Gradient(functional.name, value, functional.unit, tuple(by), cells, nodes)


def without_gradient(problem: Problem) -> str:
    """What of a problem a state alone does not tell; empty: nothing. Not collective."""
    what = ""
    if problem.history is not None:
        what = "of materials that remember"
    elif problem.terms.dissipates or problem.terms.follows_path:
        what = "with friction, which depends on all steps before"
    return what


def close_gaps(problem: Problem) -> None:
    """Has solutions leave the gaps that derivatives need, unless the user has said which."""
    for pair in problem.contact_pairs:
        if pair.contact.gap_tolerance is None:
            pair.tolerance = CLOSED * pair.size


@dataclass(frozen=True)
class Found:
    """Gradients of a case, and the state that they belong to.

    Attributes:
        gradients: One for each number.
        problem: With the state in its unknowns.
        state: At the end of the load.
    """

    gradients: tuple[Gradient, ...]
    problem: Problem
    state: State


def gradients_of(
    case: Case,
    asked: Asked,
    *,
    body: Body | None = None,
    petsc: PetscOptions | None = None,
    verify: bool = False,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> Found:
    """Solves the statics of a case, with gradients of its last state. Collective.

    Args:
        case: From `read_case`.
        body: The mesh, if it is read already.
        petsc: PETSc options that win over the case's own.
        verify: Solve twice more for each parameter, for Taylor's remainders.
        comm: The ranks that work together.

    Raises:
        InputError: The case is wrong, or there is no such derivative.
        SolveError: No solution was found.
    """
    if not asked.of:
        raise InputError("no number is given", where="--of", expected="for example strain_energy")
    analyses = {analysis_of(name) for name in asked.of}
    case = case.first_of(*analyses)
    if {case.analysis} != analyses:
        raise InputError(
            "gradients are those of frequencies alone, with [modal], of load factors alone, with "
            f"[buckling], or of other numbers, with [statics]: here is [{case.analysis}]",
            where=case.file,
            expected="numbers of one of them, or `sweep` for other analyses",
        )
    body = case.read_body(comm) if body is None else body
    found, only = _solved(case, asked, body, petsc), Asked(asked.of)
    if not verify:
        return found

    # Unknowns as they are now: a little beyond nu = 0.45 there would be a pressure among them.
    same = {"mesh.formulation": "mixed" if found.problem.mixed else "displacement"}

    def values(changed: Case) -> list[float]:
        alike = changed.changed(same)
        return [one.value for one in _solved(alike, only, body, petsc).gradients]

    with quietly():
        return replace(found, gradients=with_orders(found.gradients, case, body, values))


def _solved(case: Case, asked: Asked, body: Body, petsc: PetscOptions | None) -> Found:
    """One solution with its gradients. Collective."""
    problem, found = case.make_problem(body), list[Found]()
    if case.analysis != "statics":
        return _of_modes(case, asked, problem, petsc)
    with locate_errors(case.file):
        gradients = Gradients(asked, problem, case, places_of_probes(case, body))
    solver = case.make_solver(problem, petsc=petsc)
    assert isinstance(solver, Statics)
    close_gaps(problem)

    def look(newton: Newton, state: State) -> None:
        if state.done >= 1.0:
            found.append(Found(gradients.at(newton, state), problem, state))

    solver.observer = look
    with locate_errors(case.file), closing(solver.steps()) as steps:
        for _ in steps:
            pass
    return found[-1]


def _of_modes(case: Case, asked: Asked, problem: Problem, petsc: PetscOptions | None) -> Found:
    """Natural frequencies or load factors with their gradients. Collective."""
    check_modes(case, problem)
    with locate_errors(case.file):
        by = _By(asked, problem, case)
    case = with_one_more(case, asked.of)
    with locate_errors(case.file), closing(case.make_solver(problem, petsc=petsc).steps()) as steps:
        modes = {one.number: one for one in steps if isinstance(one, Mode)}
        if case.analysis == "buckling":
            return _of_buckling(case, asked.of, by, problem, modes, petsc)
        chosen = frequencies(asked.of, problem, modes)
        values, sides = by.sides(AtRest(chosen))
        nothing = [None] * len(chosen)
        gradients = by.gradients(ConstrainedDofs(problem), chosen, values, sides, nothing)
    return Found(gradients, problem, State(0, 0.0, problem.u))


def _of_buckling(
    case: Case,
    of: Sequence[str],
    by: _By,
    problem: Problem,
    modes: Mapping[int, Mode],
    petsc: PetscOptions | None,
) -> Found:
    """Load factors with their gradients. Collective."""
    with closing(Prebuckling(case, problem, petsc)) as before:
        chosen = load_factors(of, before, modes)
        values, sides = by.sides(LinearState(before, chosen))
        solutions = [before.adjoint.solve(one.by_unknowns(), np.zeros(0)) for one in chosen]
        gradients = by.gradients(
            before.assembler, chosen, values, sides, solutions, before.residual
        )
    return Found(gradients, problem, State(0, 0.0, problem.u))


def gradient(
    case: Case,
    of: Sequence[str],
    by: Sequence[str] = (),
    *,
    fields: Sequence[str] = (),
    offsets: Sequence[str] = (),
    body: Body | None = None,
    petsc: PetscOptions | None = None,
    verify: bool = False,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> GradientTable:
    """Derivatives of numbers of a case's last state of statics, or of its frequencies. Collective.

        table = gradient(case, ["displacement_z of tip"], ["materials.gel.E", "load[0].value[2]"])
        table["displacement_z of tip"]["materials.gel.E"].value

    Args:
        case: From `read_case`.
        of: Numbers, such as "displacement_z of tip", "reaction_x of left", "strain_energy",
            "mean von_mises on fillet" or "von_mises on fillet", for which a smooth norm stands; or
            "frequency_1" of [modal], or "load_factor_1" of [buckling].
        by: Dotted keys of numbers of the case.
        fields: Keys of constants of materials whose values in all cells are parameters.
        offsets: Names of surfaces that move along their normals, each by itself.
        body: The mesh, if it is read already.
        petsc: PETSc options that win over the case's own.
        verify: Also solve twice more for each parameter, for Taylor's remainders.
        comm: The ranks that work together.

    Returns:
        One gradient for each number, a table of all.

    Raises:
        InputError: The case is wrong, or there is no such derivative.
        SolveError: No solution was found.
    """
    asked = Asked(*map(_names, (of, by, fields, offsets)))
    found = gradients_of(case, asked, body=body, petsc=petsc, verify=verify, comm=comm)
    return GradientTable(found.gradients)


def _names(given: str | Sequence[str]) -> tuple[str, ...]:
    """Each name once."""
    return (given,) if isinstance(given, str) else tuple(dict.fromkeys(given))


def places_of_probes(case: Case, body: Body) -> dict[str, list[float]]:
    """Name to the place of the case's probes that are points [m]."""
    scale = body.unit.metres
    return {n: one.place(scale) for n, one in case.output.probes.items() if one.at is not None}
