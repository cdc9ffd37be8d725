"""PETSc options by name: which of them a user may give, and how a command line is read.

PETSc itself is imported in `start_petsc` only: options that it reads when it starts must be known
before any module that imports petsc4py.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from typing import TypeAlias

from dolfin_elastic.core.errors import CaseError

PREFIX = "elastic_"
"""Prefix of the options of all solvers of this package."""

PetscValue: TypeAlias = bool | int | float | str | None
"""Value of an option; True and None stand for options without a value."""
PetscOptions: TypeAlias = Mapping[str, PetscValue]
"""Option, with or without `PREFIX`, to value."""

CASE_KEYS = {
    "ts_type": "dynamics.scheme",
    "ts_dt": "dynamics.dt",
    "ts_time_step": "dynamics.dt",
    "ts_max_time": "dynamics.end",
    "ts_max_steps": "dynamics.end",
    "snes_rtol": "statics.rtol, in motion dynamics.rtol,",
    "snes_atol": "statics.atol, in motion dynamics.atol,",
    "snes_stol": "statics.rtol, in motion dynamics.rtol,",
    "snes_convergence_test": "statics.rtol, in motion dynamics.rtol,",
    "snes_max_it": "statics.max_iterations, in motion dynamics.max_iterations,",
    "snes_max_funcs": "statics.max_iterations, in motion dynamics.max_iterations,",
    "snes_divergence_tolerance": "statics.max_iterations, in motion dynamics.max_iterations,",
}
"""Options that a key of the case file stands for, and this key.

SNES would take its tolerances and limits without a word and not use them: Newton's method ends by
forces out of balance over applied forces, by no norm of the step and by a limit of its own, and a
test of PETSc's in place of it would take for equilibrium what is none.
"""

AT_START = (
    "log_view",
    "log_trace",
    "log_all",
    "info",
    "options_left",
    "options_view",
    "malloc_view",
    "malloc_debug",
    "memory_view",
    "fp_trap",
    "on_error_abort",
    "on_error_attach_debugger",
    "start_in_debugger",
)
"""Options that PETSc reads when it starts; no solver reads them."""


def refuse_case_keys(names: Iterable[str], where: str) -> None:
    """Refuses options in place of which the case file has a key.

    Args:
        names: Names of options, with or without a leading dash and `PREFIX`.
        where: Where the user wrote them, for the message.

    Raises:
        CaseError: A name is in `CASE_KEYS`.
    """
    for name in names:
        bare = name.lstrip("-").removeprefix(PREFIX)
        if bare in CASE_KEYS:
            raise CaseError(
                f"the PETSc option -{bare} has no effect here",
                where=where,
                expected=f"leave it out; {CASE_KEYS[bare]} says it",
            )


def parse_arguments(arguments: list[str]) -> tuple[dict[str, PetscValue], list[str]]:
    """Reads PETSc options as they stand on a command line.

    Args:
        arguments: For example ``["-ksp_type", "gmres", "-log_view"]``.

    Returns:
        Options of the solvers, name to value (None: a switch), and the arguments for
        `start_petsc`.

    Raises:
        CaseError: An argument is neither an option nor the value of one, or a key of the case
            file stands for the option.
    """
    options: dict[str, str | None] = {}
    name = ""
    for argument in arguments:
        if argument.startswith("-") and not _is_number(argument):
            name = argument.lstrip("-")
            options[name] = None
        elif name:
            options[name], name = argument, ""
        else:
            raise CaseError(
                f"'{argument}' is no PETSc option",
                where="command line",
                expected="after -- write for example -ksp_type gmres",
            )
    refuse_case_keys(options, "command line")
    at_start = [name for name in options if name in AT_START]
    started = [text for name in at_start for text in (f"-{name}", options.pop(name)) if text]
    return {**options}, started


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def start_petsc(arguments: list[str]) -> None:
    """Starts PETSc with the options that it reads itself. Collective."""
    if arguments:
        import petsc4py

        petsc4py.init([sys.argv[0], *arguments])
