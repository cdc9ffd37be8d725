"""PETSc options as they stand on a command line."""

from __future__ import annotations

import sys
from typing import Any

from dolfin_elastic.core.errors import CaseError
from dolfin_elastic.core.petsc_options import check_ours

OF_PETSC = (
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
"""Options that PETSc reads itself when it starts, not the solvers."""


def petsc_options(words: list[str]) -> tuple[dict[str, Any], list[str]]:
    """Options for the solvers by name, and those PETSc itself wants when it starts.

    Raises:
        CaseError: A word is neither an option nor the value of one.
    """
    options: dict[str, Any] = {}
    name = ""
    for word in words:
        if word.startswith("-") and not _is_number(word):
            name = word.lstrip("-")
            options[name] = None
        elif name:
            options[name], name = word, ""
        else:
            raise CaseError(
                f"'{word}' is no PETSc option",
                where="command line",
                expected="after -- write for example -ksp_type gmres",
            )
    check_ours(options, "command line")
    own = [name for name in options if name in OF_PETSC]
    started = [text for name in own for text in (f"-{name}", options.pop(name)) if text]
    return options, started


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def start_petsc(options: list[str]) -> None:
    """Starts PETSc with the options it reads itself. Collective."""
    if options:
        import petsc4py

        petsc4py.init([sys.argv[0], *options])
