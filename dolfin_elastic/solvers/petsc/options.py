"""PETSc options under one prefix, in force for one solver only."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from petsc4py import PETSc

from dolfin_elastic.core.errors import ElasticError, InputError
from dolfin_elastic.core.petsc_options import PREFIX, PetscOptions, PetscValue, refuse_case_keys
from dolfin_elastic.solvers.petsc.c_api import option_used

log = logging.getLogger("dolfin_elastic")


def cause_of(error: PETSc.Error) -> str:
    """What PETSc says has gone wrong, without where in its code."""
    return str(error).strip().splitlines()[-1].split("] ", 1)[-1]


def _cause_here(error: BaseException) -> ElasticError | KeyboardInterrupt | None:
    """What is behind an error of PETSc: functions that it calls may call it themselves."""
    cause = error.__cause__
    while cause is not None and not isinstance(cause, ElasticError | KeyboardInterrupt):
        cause = cause.__cause__
    return cause


def failed_by_petsc(error: PETSc.Error) -> str:
    """What PETSc cannot do with the numbers it has; empty where an exception of ours is behind it.

    Or where it lacks memory, or was interrupted.
    """
    first: BaseException = error
    while first.__cause__ is not None:
        first = first.__cause__
    ours = not isinstance(first, PETSc.Error) or first.ierr in _NO_OPTION
    return "" if ours else cause_of(first)


class Options:
    """PETSc options that are in the database only while a solver works.

    Configure objects with `setOptionsPrefix(PREFIX)`, and call `setFromOptions()` and everything
    that sets solvers up inside `in_force`: levels of multigrid and splits read their options (under
    PREFIX + "mg_levels_", "fieldsplit_u_" and the like) when they are set up.

    Args:
        defaults: Option to value; True and None stand for options without a value.
        users: The same, from the user, with or without the prefix; they win.

    Attributes:
        users: As given, without prefix.
        all: What is in force.

    Raises:
        InputError: A key of the case stands for one of the user's.
    """

    def __init__(self, defaults: PetscOptions, users: PetscOptions) -> None:
        self.users = {name.lstrip("-").removeprefix(PREFIX): value for name, value in users.items()}
        refuse_case_keys(self.users, "solver.petsc")
        self.all = {**defaults, **self.users}
        self._reported = False
        self._uses: list[dict[str, PetscValue]] = []
        self._used: set[str] = set()

    @contextmanager
    def in_force(self, **more: PetscValue) -> Iterator[None]:
        """Puts the options into PETSc's database and takes them out again.

        May be nested, as where a TS solves with the options of its Newton's method: the inner use
        leaves in the database what the outer one has put there.

        Args:
            more: Further options for this once; the user's win.
        """
        database = PETSc.Options()
        merged = {**self.all, **more, **self.users}
        for name, value in merged.items():
            database[PREFIX + name] = _text(value)
        self._uses.append(merged)
        try:
            yield
        finally:
            self._uses.pop()
            self._used |= {name for name in self.users if option_used(PREFIX + name)}
            outer = self._uses[-1] if self._uses else {}
            for name in merged:
                database.delValue(PREFIX + name)
                if name in outer:
                    database[PREFIX + name] = _text(outer[name])

    def take(self, name: str) -> dict[str, PetscValue]:
        """Takes an option of the user out, for a caller that carries it out itself.

        Args:
            name: Without prefix.

        Returns:
            The option and its value; nothing where the user has not given it.
        """
        self.all.pop(name, None)
        return {name: self.users.pop(name)} if name in self.users else {}

    def update(self, defaults: PetscOptions) -> None:
        """Changes defaults for all later uses; the user's options still win.

        Args:
            defaults: Option, without prefix, to value.
        """
        self.all = {**self.all, **defaults, **self.users}

    @contextmanager
    def elastic_errors(self) -> Iterator[None]:
        """Lets errors that PETSc hands over be those of this package.

        To be used around solves, too: PETSc reads what concerns levels, blocks and factors when
        it makes them.  Of an error raised in a function that PETSc calls, petsc4py makes one of its
        own.

        Raises:
            ElasticError: A function that PETSc has called raised it.
            KeyboardInterrupt: The same, by Ctrl-C.
            InputError: PETSc cannot do what the user's options ask for.
        """
        try:
            yield
        except PETSc.Error as error:
            if ours := _cause_here(error):
                raise ours from ours.__cause__
            if not self.users or error.ierr in _NO_OPTION:
                raise
            cause = cause_of(error)
            blamed = [name for name, value in self.users.items() if f" {value} " in cause]
            names = blamed or list(self.users)
            given = ", ".join(f"-{name} {self.users[name]}" for name in names)
            raise InputError(
                f"PETSc refuses the option{'s' * (len(names) > 1)} {given}: {cause}",
                where="solver.petsc",
                expected="see the manual pages of PETSc",
            ) from None

    def report_unused(self) -> None:
        """Warns once of options of the user that nothing asked for: mistyped ones.

        To be called within `in_force`; in a nested use nothing is reported, because the outer
        solver may still read them.
        """
        if self._reported or len(self._uses) > 1:
            return
        for name in self.users:
            if name not in self._used and not option_used(PREFIX + name):
                log.warning("PETSc option '-%s' was not used by any solver", name)
        self._reported = True


_NO_OPTION = (-1, 55, 59, 78, 98)
"""Codes that no option is to blame for: a Python exception in a function that PETSc calls, and
PETSC_ERR_MEM, _SIG, _MEMC and _MPI."""


def _text(value: PetscValue) -> bool | int | float | str:
    return "" if value is None or value is True else value


def _names(enumeration: type) -> dict[int, str]:
    return {value: name for name, value in vars(enumeration).items() if isinstance(value, int)}


def snes_reason(number: int) -> str:
    """PETSc's name of a SNESConvergedReason; the number itself where it has none."""
    return _names(PETSc.SNES.ConvergedReason).get(number, str(number))


def ksp_reason(number: int) -> str:
    """PETSc's name of a KSPConvergedReason; see `snes_reason`."""
    return _names(PETSc.KSP.ConvergedReason).get(number, str(number))


def ts_reason(number: int) -> str:
    """PETSc's name of a TSConvergedReason; see `snes_reason`."""
    return _names(PETSc.TS.ConvergedReason).get(number, str(number))
