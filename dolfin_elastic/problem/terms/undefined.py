"""Formulas that have no finite value: which one, where and when."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.errors import CaseError
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.parallel import first_of
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.loads import Cavity, ConcentratedLoad, Load
from dolfin_elastic.model.values import PLACE, FieldFormula, number_at
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
        if any(isinstance(value, Formula) for value in load.values):
            X = _places(problem, load)
            if (error := undefined(problem.body.comm, index, load, X, t)) is not None:
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
    """The error about the first formula of one load without a finite value. Collective.

    Args:
        X: Points of this rank [m], shape (..., 2 or 3).
        t: Time [s], or load parameter.

    Returns:
        See `undefined_formula`; with the key of the component.
    """
    for component, value in enumerate(load.values):
        if isinstance(value, Formula):
            where = f"load[{index}].{_key(load, component)}"
            if (error := undefined_formula(comm, value, where, X, t)) is not None:
                return error
    return None


def undefined_formula(
    comm: MPI.Comm, formula: Formula, where: str, X: FloatArray, t: float
) -> CaseError | None:
    """The error about a formula without a finite value. Collective.

    Args:
        formula: In x, y, z [m] and t.
        X: Points of this rank [m], shape (..., 2 or 3).
        t: Time [s], or load parameter.

    Returns:
        With the least of its places by coordinates, the same on every rank; None if it has values.
    """
    if isinstance(formula, FieldFormula):
        return None  # is checked where its values are taken from the mesh
    bad = X[~np.isfinite(number_at(formula, X, t))]
    # Rounded, lest the last digits differ with the number of ranks.
    first = first_of(comm, [tuple(float(x) + 0.0 for x in row.round(12)) for row in bad])
    return None if first is None else no_value(formula, where, first, t)


def no_value(
    formula: Formula, where: str, place: tuple[float, ...], t: float, *, pole: bool = False
) -> CaseError:
    """The error about a formula without a finite value.

    Args:
        place: A point at which it has none [m]; empty where that is not told.
        t: Time [s], or load parameter.
        pole: It divides by zero between the points and times at which it is evaluated.
    """
    told = place and (pole or formula.names & PLACE)
    at = [f"({', '.join(f'{x:.6g}' for x in place)}) m"] if told else []
    at += [f"t = {t:g}"] if "t" in formula.names or not at else []
    text = f"'{formula.text}' has no finite value"
    return CaseError(
        f"{text} near {' at '.join(at)}: it divides by zero"
        if pole
        else f"{text} at {' at '.join(at)}",
        where=where,
        expected="a formula that gives a number at every point and time it acts on",
    )


def _key(load: Load, component: int) -> str:
    key = load.key if isinstance(load, Cavity) else "value"
    written = getattr(load, key)
    listed = isinstance(written, list | tuple) and len(written) == len(load.values)
    return f"{key}[{component}]" if listed else key
