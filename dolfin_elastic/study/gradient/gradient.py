"""`gradient`: derivatives of numbers of an equilibrium by constants, loads, fields, and shape."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
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
from dolfin_elastic.study.gradient.spatial import CellConstant, Shape

if TYPE_CHECKING:
    from dolfin_elastic.mesh.body import Body


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


@dataclass(frozen=True)
class Derivative:
    """Of one number by one parameter.

    Attributes:
        key: Of the parameter.
        at: The parameter's value.
        unit: Of the parameter.
        value: dQ/dm, unit of Q over that of the parameter.
    """

    key: str
    at: float
    unit: str
    value: float


@dataclass(frozen=True)
class Gradient:
    """Of one number.

    Attributes:
        name: What it is.
        value: Of it.
        unit: SI.
        by: Its derivatives.
        cells: Key of a constant to dQ/d ln m of each owned cell, in the unit of Q.
        nodes: dQ/dX at the owned nodes of the mesh's geometry, shape (nodes, dim), unit of Q per m;
            None where no surface moves.
        iterations: Of the adjoint's linear solver.
    """

    name: str
    value: float
    unit: str
    by: tuple[Derivative, ...]
    cells: Mapping[str, FloatArray] = field(default_factory=dict)
    nodes: FloatArray | None = None
    iterations: int = 0


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
            state: What it has found.
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
                by.append(Derivative(f"offset of {surface}", 0.0, "m", along))
            nodes = slopes.reshape(-1, self.problem.body.dim)
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


def gradient(
    case: Case,
    of: Sequence[str],
    by: Sequence[str] = (),
    *,
    fields: Sequence[str] = (),
    offsets: Sequence[str] = (),
    body: Body | None = None,
    petsc: PetscOptions | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> tuple[Gradient, ...]:
    """Derivatives of numbers of the last state of a case's statics. Collective.

    Args:
        case: From `read_case`.
        of: Numbers, such as "displacement_z of tip", "reaction_x of left", "strain_energy",
            "mean von_mises on fillet" or "von_mises on fillet", for which a smooth norm stands.
        by: Dotted keys of numbers of the case.
        fields: Keys of constants of materials whose values in all cells are parameters.
        offsets: Surfaces that move along their normals.
        body: The mesh, if it is read already.
        petsc: PETSc options that win over the case's own.
        comm: The ranks that work together.

    Returns:
        One for each number.

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
    problem = case.make_problem(body)
    asked = Asked(tuple(of), tuple(by), tuple(fields), tuple(offsets))
    result: list[tuple[Gradient, ...]] = []
    solver = case.make_solver(problem, petsc=petsc)
    assert isinstance(solver, Statics)
    gradients = Gradients(asked, problem, case, places_of_probes(case, body))

    def look(newton: Newton, state: State) -> None:
        if state.done >= 1.0:
            result.append(gradients.at(newton, state))

    solver.observer = look
    with locate_errors(case.file), closing(solver.steps()) as steps:
        for _ in steps:
            pass
    return result[-1]


def places_of_probes(case: Case, body: Body) -> dict[str, list[float]]:
    """Name to the place of the case's probes that are points [m]."""
    scale = body.unit.metres
    return {n: one.place(scale) for n, one in case.output.probes.items() if one.at is not None}
