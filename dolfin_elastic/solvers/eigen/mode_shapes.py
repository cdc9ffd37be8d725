"""Common to vibration and buckling: refused problems, completeness of modes, mode shapes."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.errors import ConvergenceError, InputError
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.petsc_options import PREFIX, PetscOptions, PetscValue
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.amplitude import RAMP
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.term_list import refuse_motion
from dolfin_elastic.solvers.eigen.slepc import SPARE, Pair, Pencil, Search, uneven

log = logging.getLogger("dolfin_elastic")

GAP = 1e-4
"""Relative distance of two eigenvalues between which can be counted."""

_OF_MODES = ("eps_", "st_", "bv_", "ds_")
"""How the names of SLEPc's options begin."""


def refuse(problem: Problem, table: str, *, loaded: bool) -> None:
    """Refuses problems without modes. Collective.

    Args:
        table: Name of the case file's table.

    Raises:
        InputError: Something of it has none.
    """
    if problem.cell is not None:
        raise InputError(
            "a periodic cell has no modes of its own",
            where="periodic",
            expected=f"leave it out, or write [statics] in place of [{table}]",
        )
    if problem.terms.opens:
        raise InputError(
            "contact opens and closes, so the body has no modes",
            where="contact",
            expected="a support in its place, or [dynamics]",
        )
    refuse_motion(problem.terms)
    for region in problem.regions:
        if not region.law.has_energy:
            raise InputError(
                f"'{region.law.name()}' has no strain energy, which modes are defined by",
                where=f"{region.table}.law",
                expected="for example st-venant-kirchhoff",
            )
    if loaded and not problem.symmetric:
        index = next(i for i, load in enumerate(problem.loads) if load.follower)
        raise InputError(
            "the pressure follows a surface whose edge is free: it has no potential, and the body "
            "may flutter",
            where=f"load[{index}]",
            expected="a fixed edge, a closed surface, a traction, or [dynamics]",
        )


def shared(users: PetscOptions) -> tuple[dict[str, PetscValue], dict[str, PetscValue]]:
    """The user's PETSc options for the way to a loaded state, and those for its modes."""
    plain = {name.lstrip("-").removeprefix(PREFIX): value for name, value in users.items()}
    modal = {name: value for name, value in plain.items() if name.startswith(_OF_MODES)}
    return {n: v for n, v in plain.items() if n not in modal}, modal


def at_rest(problem: Problem) -> None:
    """Sets the undeformed state without loads. Collective.

    Raises:
        InputError: Growth or warmth acts from the start.
    """
    problem.set_time(0.0, default=RAMP)
    if problem.history is not None:
        problem.history.reset()
    for index, load in enumerate(problem.loads):
        if load.is_eigenstrain and (load.amplitude or RAMP).at(0.0) != 0.0:
            raise InputError(
                f"{load.kind} acts at rest, too: the body is not free of stress",
                where=f"load[{index}]",
                expected="modal.preload = true, or no curve",
            )
    problem.w.x.array[:] = 0.0
    problem.unknowns.w_to_u()


def shape(problem: Problem, vector: FloatArray) -> tuple[fem.Function, float]:
    """The displacement in owned entries of all unknowns, of largest length 1, and that length.

    The sign is the same on any number of ranks. Collective.

    Args:
        vector: Owned entries of all unknowns.
    """
    u = fem.Function(problem.V, name="mode")
    motion, dim, comm = (
        vector[problem.unknowns.displacement_dofs],
        problem.body.dim,
        problem.body.comm,
    )
    problem.constraints.extend(motion)
    lengths = np.linalg.norm(motion.reshape(-1, dim), axis=1)
    size = largest(comm, float(np.max(lengths, initial=0.0)))
    if total(comm, float(vector @ uneven(problem, 0))) < 0.0:
        size = -size
    u.x.array[: len(motion)] = motion / size
    u.x.scatter_forward()
    return u, size


def complete(
    spectrum: Pencil,
    shift: float,
    count: int,
    *,
    room: int,
    known: Sequence[FloatArray] = (),
    zeros: int = 0,
) -> list[Pair]:
    """The lowest eigenpairs, of which none is missing. Collective.

    They are counted by the signs of pivots in a gap above the last one.  What is missing of
    repeated eigenvalues is looked for among the vectors orthogonal to those that are found.  Where
    nothing can be counted, a second search among these must find nothing new.

    Args:
        shift: Below all eigenvalues.
        count: How many are wanted; a few more are given.
        room: How many there are beside the known ones.
        known: Vectors that are not looked for.
        zeros: How many of the eigenvalues belong to these.

    Raises:
        ConvergenceError: Some are not found.
    """
    pairs = spectrum.near(Search(shift, count, room, spare=SPARE, known=known))
    for attempt in range(1, 6):
        values = np.array([pair.value for pair in pairs])
        if not len(values):
            return pairs
        top, result = _gap(values, count)
        vectors = [*known, *(pair.vector for pair in pairs)]
        left = room - len(pairs)
        again = Search(shift, SPARE, left, known=vectors, seed=attempt)
        if spectrum.counted:
            below = _counted(spectrum, top)
            missing = below - result - zeros
            if missing < 0:
                raise ConvergenceError(
                    f"{result + zeros} modes were found where there are only {below}",
                    advice="a smaller tolerance",
                )
            if missing == 0 or left == 0:
                log.info("checked for missed modes by the signs of pivots: none")
                return pairs
            log.info("%d modes are missing: another search", missing)
            pairs += spectrum.near(replace(again, count=missing))
        else:
            more = spectrum.near(replace(again, below=top))
            if not any(pair.value < top for pair in more):
                log.info("checked for missed modes by a second search: none")
                return pairs
            pairs += more
        pairs.sort(key=lambda pair: pair.value)
    raise ConvergenceError("modes are still missing after five searches", advice="fewer modes")


def _counted(spectrum: Pencil, top: float) -> int:
    """How many eigenvalues lie below a number, or just above it if there is one. Collective."""
    for _ in range(10):
        below = spectrum.below(top)
        if below is not None:
            return below
        top *= 1 + GAP / 10
    raise undetermined()


def undetermined() -> ConvergenceError:
    """A matrix that is singular with any shift."""
    return ConvergenceError(
        "modes cannot be counted: the stiffness stays singular whatever multiple of the mass is "
        "added, because a pressure is left undetermined",
        advice="of several bodies that cannot be compressed, does one have no free surface? A nu "
        "a little below 0.5 there",
    )


def _gap(values: FloatArray, count: int) -> tuple[float, int]:
    """A number above the last wanted value, away from all, and how many values lie below it."""
    for k in range(min(count, len(values)), len(values)):
        low, high = values[k - 1], values[k]
        if high - low > GAP * abs(high):
            return float(low + high) / 2, k
    return float(values[-1] + GAP / 2 * abs(values[-1])), len(values)
