"""PETSc options by name: which of them a user may give, and how a command line is read.

PETSc itself is started elsewhere, see `startup`: options that it reads as it starts must be known
before.
"""

from __future__ import annotations

import re
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


_OF_SOLVERS = re.compile(
    r"""(?:
    # what stands in front of the options of solvers inside solvers
    (?:mg_(?:levels|coarse|fine)(?:_\d+)?|fieldsplit_[a-z0-9]+|sub|esteig|redundant|telescope|st)_
    )*(?:
    ksp_(?:type|rtol|atol|divtol|max_it|min_it|norm_type|pc_side|error_if_not_converged
      |initial_guess_nonzero|diagonal_scale(?:_fix)?|lag_norm|check_norm_iteration
      |reuse_preconditioner|converged_\w+|richardson_\w+|chebyshev_\w+|f?gmres_\w+|lgmres_\w+
      |dgmres_\w+|pgmres_\w+|bcgsl_\w+|gcr_\w+|fcg_\w+|cg_\w+|pipefcg_\w+|minres_\w+)
    |pc_(?:type|use_amat|side
      |(?:factor|gamg|mg|hypre|ml|fieldsplit|asm|gasm|bjacobi|pbjacobi|vpbjacobi|sor|jacobi|redundant
      |telescope|cholesky|ilu|lu|kaczmarz|svd|spai|eisenstat)_\w+)
    |mat_mumps_(?:cntl_\d+|icntl_(?:[4-9]|1\d|2[013-9]|[3-5]\d))
    |mat_superlu_dist_\w+
    |snes_(?:type|linesearch_\w+|lag_\w+|ksp_ew\w*|force_iteration|max_fail|max_linear_solve_fail
      |check_jacobian_domain_error|trtol|tr_\w+|qn_\w+|ngmres_\w+|anderson_\w+|converged_reason
      |test_jacobian)
    |npc_(?:snes|ksp|pc)_(?:type|rtol|max_it)
    |ts_(?:adapt_\w+|alpha_\w+|theta_\w+|rtol|atol|exact_final_time|max_snes_failures|max_reject
      |converged_reason)
    |eps_(?:type|tol|max_it|ncv|nev|mpd|conv_\w+|harmonic|true_residual|two_sided|krylovschur_\w+
      |jd_\w+|gd_\w+|lobpcg_\w+|ciss_\w+|arnoldi_\w+|lanczos_\w+|power_\w+|blopex_\w+
      |purify|error_\w+|converged_reason)
    |bv_(?:type|orthog_\w+) | ds_(?:method|parallel) | st_(?:type|shift|matmode|transform)
    |(?:ksp|snes|ts|eps)_(?:monitor(?:_true_residual|_singular_value|_short|_range|_cancel|_all|_conv)?
      |view)
    )""",
    re.VERBOSE,
)
"""Options of solvers, preconditioners and tolerances, and monitors: what case files may give.

Not among them is what loads code (`pc_python_type`) or writes files: viewers of matrices and
solutions, MUMPS's units of output (icntl_1 to 3) and its factors on the disk (icntl_22).
"""
_NO_OPTIONS = re.compile(
    r"\w*(?:python|shell|dump|filename|print_to|print_subdomains|tmpdir|library)\w*"
)
_SCREEN = re.compile(
    r"(?:\w*_)?(?:monitor\w*|view\w*|converged_(?:reason|rate)|error_\w+|log|statistics)"
)
"""Options whose value is a viewer: the screen, or a file."""
_VIEWER = re.compile(r"(?:ascii)?(?:::ascii_\w+)?")
"""Viewers of the screen."""
_VALUE = re.compile(r"[\w.+,-]*")
_FOREIGN_CODE = ("python", "shell")
"""Types that are somebody's code."""


def chooses_solvers(name: str, value: PetscValue) -> bool:
    """Whether an option does no more than choose solvers, or has a key of its own.

    Args:
        name: With or without a leading dash and `PREFIX`.
    """
    bare = name.lstrip("-").removeprefix(PREFIX)
    text = "" if isinstance(value, bool) or value is None else str(value)
    known = _OF_SOLVERS.fullmatch(bare) and not _NO_OPTIONS.fullmatch(bare)
    fitting = (_VIEWER if _SCREEN.fullmatch(bare) else _VALUE).fullmatch(text)
    return bare in CASE_KEYS or bool(known and fitting and text not in _FOREIGN_CODE)


def refuse_beyond_solvers(options: PetscOptions, where: str) -> None:
    """Refuses options that do more than choose solvers: a case file may come from anybody.

    Args:
        options: Of a case; of those in `CASE_KEYS` is told where the options are used.

    Raises:
        CaseError: An option is not among those that case files may give, or its value names a file
            or code.
    """
    for name, value in options.items():
        if not chooses_solvers(name, value):
            given = name.lstrip("-") if value in (None, True, "") else f"{name.lstrip('-')} {value}"
            raise CaseError(
                f"a case file may not give the PETSc option -{given}: it may choose solvers, "
                "preconditioners, tolerances and monitors on the screen, and write no file",
                where=where,
                expected="check its name, or give it on the command line, after two dashes",
            )


def parse_arguments(arguments: list[str]) -> tuple[dict[str, PetscValue], list[str]]:
    """Reads PETSc options as they stand on a command line.

    Args:
        arguments: For example ``["-ksp_type", "gmres", "-log_view"]``.

    Returns:
        Options of the solvers, name to value (None: a switch), and the arguments for
        `startup.libraries.start`.

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
