"""What a case is made for: equilibrium, motion, vibration or buckling."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.schema import Idle, refuse_idle
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.dynamics.dynamics import Dynamics
from dolfin_elastic.solvers.eigen.buckling import Buckling
from dolfin_elastic.solvers.eigen.modal import Modal
from dolfin_elastic.solvers.statics.statics import Statics

if TYPE_CHECKING:
    from dolfin_elastic.case.case import Case

Analysis = Literal["statics", "dynamics", "modal", "buckling"]
Solver = Statics | Dynamics | Modal | Buckling

ANALYSES: tuple[Analysis, ...] = ("statics", "dynamics", "modal", "buckling")
"""Keys of the tables, of which a case has one; [statics] also beside a preload."""


def refuse_both(tables: Any) -> None:
    """Two analyses, said before what is wrong inside of one that may be left out.

    Raises:
        InputError: There are statics and dynamics.
    """
    if isinstance(tables, Mapping) and all(
        tables.get(key) is not None for key in ("statics", "dynamics")
    ):
        raise InputError(
            "[statics] and [dynamics] given together",
            expected="a case has one analysis; leave one of them out",
        )


def check_analyses(case: Case) -> None:
    """A case has one analysis.

    Raises:
        InputError: It has several, or one that a periodic cell has not.
    """
    given = [key for key in ANALYSES if getattr(case, key) is not None]
    others = [key for key in given if key != "statics"]
    if len(others) > 1 or ("statics" in given and "dynamics" in given):
        raise InputError(
            f"[{given[0]}] and [{given[1]}] given together",
            expected="a case has one analysis; leave one of them out",
        )
    if len(given) > 1 and not case.preloaded:
        raise InputError(
            f"[statics] beside [{others[0]}] says how the preload is found, but there is none",
            where="statics",
            expected=f"leave it out, or write {others[0]}.preload",
        )
    if case.periodic is not None and others:
        what = {"dynamics": "motion", "modal": "modes of its own", "buckling": "modes of its own"}
        raise InputError(
            f"a periodic cell has no {what[others[0]]}",
            where=others[0],
            expected="leave it out, or write [statics]",
        )
    _check_contacts(case)
    _check_output(case)


def _check_contacts(case: Case) -> None:
    rule = Idle(
        ["gap_tolerance"],
        "in motion the penalty decides how far a surface penetrates",
        "leave it out; a higher `stiffness` makes it less",
    )
    for index, contact in enumerate(case.contact if case.dynamics is not None else ()):
        refuse_idle(contact, [rule], f"contact[{index}]")


def _check_output(case: Case) -> None:
    """Keys of [output] for what the analysis does not give.

    Raises:
        InputError: There is one.
    """
    rules = [Idle(["frames", "amplitude"], f"there are no modes in {case.analysis}")]
    if case.analysis in ("modal", "buckling"):
        rules = []
        if not case.output.checkpoint.off:
            what = f"a run of [{case.analysis}] has no checkpoints and is not gone on with"
            rules.append(Idle(["checkpoint"], what))
        if not case.preloaded:
            what = "modes without a preload are drawn and listed, but there are no states beside"
            expected = f"leave it out, or write {case.analysis}.preload"
            rules.append(Idle(["fields", "every", "probes"], what, expected))
    refuse_idle(case.output, rules, "output")


def solver_of(case: Case, problem: Problem, petsc: Mapping[str, Any] | None) -> Solver:
    """The solver of a case's analysis. Collective.

    Args:
        case: The case.
        problem: Made of it.
        petsc: PETSc options that win over the case's own.
    """
    if case.dynamics is not None:
        return Dynamics(problem, case.dynamics, linear=case.solver, petsc=petsc)
    if case.modal is not None:
        return Modal(problem, case.modal, statics=case.statics, linear=case.solver, petsc=petsc)
    if case.buckling is not None:
        return Buckling(
            problem, case.buckling, statics=case.statics, linear=case.solver, petsc=petsc
        )
    return Statics(problem, case.statics, linear=case.solver, petsc=petsc)
