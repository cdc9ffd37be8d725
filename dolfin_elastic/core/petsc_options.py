"""Names of PETSc options that are not the user's to give."""

from __future__ import annotations

from collections.abc import Iterable

from dolfin_elastic.core.errors import CaseError

PREFIX = "elastic_"

OURS = {
    "ts_type": "dynamics.scheme",
    "ts_dt": "dynamics.dt",
    "ts_time_step": "dynamics.dt",
    "ts_max_time": "dynamics.end",
    "ts_max_steps": "dynamics.end",
}
"""Options of what a case says, and its keys."""


def check_ours(names: Iterable[str], where: str) -> None:
    """No option is for what a case says.

    Args:
        names: Of options, with or without the prefix.
        where: They stand there.

    Raises:
        CaseError: One is.
    """
    for name in names:
        bare = name.lstrip("-").removeprefix(PREFIX)
        if bare in OURS:
            raise CaseError(
                f"the PETSc option -{bare} has no effect here",
                where=where,
                expected=f"leave it out; {OURS[bare]} says it",
            )
