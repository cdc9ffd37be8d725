"""Formulas of loads that have no finite value: which one, where and when."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.errors import CaseError
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.parallel import first_of
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.loads import Cavity, ConcentratedLoad, Load
from dolfin_elastic.model.values import PLACE, Component, number_at
from dolfin_elastic.problem.context import formula_places

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem


def undefined_load(problem: Problem, t: float) -> CaseError | None:
    """The error about the first formula of a load without a finite value. Collective.

    Args:
        problem: Its loads are evaluated at the points of their integrals, or where they act.
        t: Time [s], or load parameter.

    Returns:
        The same on every rank; None if all formulas have values.
    """
    for index, load in enumerate(problem.loads):
        if not any(isinstance(value, Formula) for value in load.values):
            continue
        error = undefined(problem.body.comm, index, load, _places(problem, load), t)
        if error is not None:
            return error
    return None


def _places(problem: Problem, load: Load) -> FloatArray:
    """Points at which a load is evaluated on this rank [m], shape (n, dim). Collective."""
    if isinstance(load, ConcentratedLoad):
        assert problem.nodal_loads is not None
        return problem.nodal_loads.samples(load)[0]
    if not any(isinstance(value, Formula) and value.names & PLACE for value in load.values):
        return np.zeros((1, problem.body.dim))  # a formula in t has the same value everywhere
    return formula_places(problem.context, load.domain)[:, : problem.body.dim]


def undefined(comm: MPI.Comm, index: int, load: Load, X: FloatArray, t: float) -> CaseError | None:
    """The error about a formula of one load without a finite value. Collective.

    Args:
        X: Points of this rank [m], shape (..., 2 or 3).
        t: Time [s], or load parameter.

    Returns:
        With the key of the component, the formula, and the least of its places by coordinates; the
        same on every rank.  None if it has values.
    """
    points = np.asarray(X).reshape(-1, X.shape[-1])
    found = first_of(comm, _undefined(load.values, points, t))
    if found is None:
        return None
    component, place = found
    formula = load.values[component]
    assert isinstance(formula, Formula)
    where = f"load[{index}].{_key(load, component)}"
    return no_value(formula, where, place, t)


def _undefined(
    values: tuple[Component, ...], X: FloatArray, t: float
) -> list[tuple[int, tuple[float, ...]]]:
    """Formulas without a finite value on this rank, each with the least place."""
    found = []
    for component, value in enumerate(values):
        if isinstance(value, Formula) and (place := least_place(value, X, t)) is not None:
            found.append((component, place))
    return found


def least_place(formula: Formula, X: FloatArray, t: float) -> tuple[float, ...] | None:
    """The least point, by coordinates, at which a formula has no finite value. Not collective.

    Args:
        formula: In x, y, z [m] and t.
        X: Points of this rank [m], shape (..., 2 or 3).
        t: Time [s], or load parameter.
    """
    points = np.asarray(X).reshape(-1, X.shape[-1])
    bad = points[~np.isfinite(number_at(formula, points, t))]
    # Rounded, lest the last digits differ with the number of ranks.
    return min((tuple(float(x) + 0.0 for x in row.round(12)) for row in bad), default=None)


def no_value(formula: Formula, where: str, place: tuple[float, ...], t: float) -> CaseError:
    """The error about a formula without a finite value.

    Args:
        place: A point at which it has none [m].
        t: Time [s], or load parameter.
    """
    at = [f"({', '.join(f'{x:.6g}' for x in place)}) m"] if formula.names & PLACE else []
    at += [f"t = {t:g}"] if "t" in formula.names or not at else []
    return CaseError(
        f"'{formula.text}' has no finite value at {' at '.join(at)}",
        where=where,
        expected="a formula that gives a number at every place and time it acts on",
    )


def _key(load: Load, component: int) -> str:
    key = load.key if isinstance(load, Cavity) else "force" if "force" in load.vectors else "value"
    written = getattr(load, key)
    listed = isinstance(written, list | tuple) and len(written) == len(load.values)
    return f"{key}[{component}]" if listed else key
