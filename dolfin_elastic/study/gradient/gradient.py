"""`gradient`: derivatives of numbers of an equilibrium by constants, loads, fields, and shape."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from mpi4py import MPI

from dolfin_elastic.case.case import Case, locate_errors
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.petsc_options import PetscOptions
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import State
from dolfin_elastic.solvers.nonlinear.adjoint import Adjoint
from dolfin_elastic.solvers.nonlinear.newton import Newton
from dolfin_elastic.solvers.statics.statics import Statics
from dolfin_elastic.study.gradient.functionals import functionals
from dolfin_elastic.study.gradient.parameters import Equilibrium, Sides, parameters
from dolfin_elastic.study.gradient.spatial import OFFSET, CellConstant, Shape
from dolfin_elastic.study.gradient.table import Derivative, Gradient, GradientTable
from dolfin_elastic.study.gradient.taylor import with_orders

if TYPE_CHECKING:
    from dolfin_elastic.mesh.body import Body

log = logging.getLogger("dolfin_elastic")


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
        _check(problem)
        self.problem, self._asked = problem, asked
        self._functionals = functionals(asked.of, problem, probes or {})
        self._parameters = parameters(asked.by, problem, case)
        self._cells: list[CellConstant] | None = None
        self._shape: Shape | None = None

    def at(self, newton: Newton, state: State) -> tuple[Gradient, ...]:
        """At the equilibrium that a solver has just found.

        Args:
            newton: The solver, after the solve.
            state: What it has found; its time counts.
        """
        here = Equilibrium(newton, self._functionals, state.t)
        adjoint = Adjoint(newton)
        try:
            values = here.evaluated().numbers
            sides = [one.derivative(here) for one in self._parameters]
            of_scalars = here.by_scalars()
            here.evaluated()  # back, with the functionals linearised here
            self._make_fields(here)
            return tuple(
                self._gradient(here, adjoint, number, float(value), sides, of_scalars[number])
                for number, value in enumerate(values)
            )
        finally:
            adjoint.destroy()

    def _make_fields(self, here: Equilibrium) -> None:
        if self._cells is None:
            self._cells = [CellConstant(key, here.assembler) for key in self._asked.fields]
            self._shape = Shape(here.assembler) if self._asked.offsets else None

    def _gradient(
        self,
        here: Equilibrium,
        adjoint: Adjoint,
        number: int,
        value: float,
        sides: Sequence[Sides],
        of_scalars: FloatArray,
    ) -> Gradient:
        functional = self._functionals[number]
        comm = self.problem.body.comm
        slope = functional.by_unknowns(here.assembler)
        solution = adjoint.solve(slope, of_scalars)
        by = []
        for parameter, side in zip(self._parameters, sides, strict=True):
            through = total(comm, float(solution.fields @ side.forces))
            through += float(solution.scalars @ side.equations)
            by.append(
                Derivative(
                    parameter.key,
                    parameter.value,
                    parameter.unit,
                    float(side.numbers[number]) + through,
                )
            )
        cells = {one.key: one.by_logarithm(solution, functional) for one in self._cells or ()}
        nodes = None
        if self._shape is not None:
            slopes = self._shape.by_positions(solution, functional)
            for surface in self._asked.offsets:
                along = total(comm, float(slopes @ self._shape.offset(surface)))
                by.append(Derivative(f"{OFFSET}{surface}", 0.0, "m", along))
            nodes = self._shape.at_nodes(slopes)
        return Gradient(
            functional.name, value, functional.unit, tuple(by), cells, nodes, solution.iterations
        )


def _check(problem: Problem) -> None:
    """Refuses what a state does not tell.

    Raises:
        InputError: The equilibrium depends on the way to it.
    """
    what = ""
    if problem.history is not None:
        what = "of materials that remember"
    elif problem.terms.dissipates or problem.terms.follows_path:
        what = "with friction, which depends on all steps before"
    if what:
        raise InputError(
            f"there is no gradient {what}",
            where="gradient",
            expected="`sweep`, whose runs take the whole way",
        )


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
    case = next((one for one in case.analyses() if one.analysis == "statics"), case)
    if case.analysis != "statics":
        raise InputError(
            f"gradients are those of [statics], but this is [{case.analysis}]",
            where=case.file,
            expected="`sweep` for other analyses",
        )
    body = case.read_body(comm) if body is None else body
    found, only = _solved(case, asked, body, petsc), Asked(asked.of)
    if not verify:
        return found

    def values(changed: Case) -> list[float]:
        return [one.value for one in _solved(changed, only, body, petsc).gradients]

    level = log.level
    log.setLevel(logging.ERROR)  # of solutions that are like the first one
    try:
        return replace(found, gradients=with_orders(found.gradients, case, body, values))
    finally:
        log.setLevel(level)


def _solved(case: Case, asked: Asked, body: Body, petsc: PetscOptions | None) -> Found:
    """One solution with its gradients. Collective."""
    problem, found = case.make_problem(body), list[Found]()
    with locate_errors(case.file):
        gradients = Gradients(asked, problem, case, places_of_probes(case, body))
    solver = case.make_solver(problem, petsc=petsc)
    assert isinstance(solver, Statics)

    def look(newton: Newton, state: State) -> None:
        if state.done >= 1.0:
            found.append(Found(gradients.at(newton, state), problem, state))

    solver.observer = look
    with locate_errors(case.file), closing(solver.steps()) as steps:
        for _ in steps:
            pass
    return found[-1]


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
    """Derivatives of numbers of the last state of a case's statics. Collective.

        table = gradient(case, ["displacement_z of tip"], ["materials.gel.E", "load[0].value[2]"])
        table["displacement_z of tip"]["materials.gel.E"].value

    Args:
        case: From `read_case`.
        of: Numbers, such as "displacement_z of tip", "reaction_x of left", "strain_energy",
            "mean von_mises on fillet" or "von_mises on fillet", for which a smooth norm stands.
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
    asked = Asked(tuple(of), tuple(by), tuple(fields), tuple(offsets))
    found = gradients_of(case, asked, body=body, petsc=petsc, verify=verify, comm=comm)
    return GradientTable(found.gradients)


def places_of_probes(case: Case, body: Body) -> dict[str, list[float]]:
    """Name to the place of the case's probes that are points [m]."""
    scale = body.unit.metres
    return {n: one.place(scale) for n, one in case.output.probes.items() if one.at is not None}
