"""Whether formulas have values wherever they are used: at nodes and points, and between them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from mpi4py import MPI

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.initial_state import TIMES
from dolfin_elastic.case.check.integrals import Integrals
from dolfin_elastic.case.toml import key_text
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.parallel import first_of
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.geometry.curved import edge_points, node_points
from dolfin_elastic.mesh.geometry.simplices import (
    EDGE_ENDS,
    cell_corners,
    cells_beside_edges,
    facet_nodes,
)
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.model.loads import ConcentratedLoad, Load
from dolfin_elastic.model.materials.spatial import PLACE, SpatialFormula
from dolfin_elastic.model.supports.displacement import Normal, Restraint
from dolfin_elastic.model.supports.springs import ResistingSupport
from dolfin_elastic.model.values import Component, number_at
from dolfin_elastic.problem.terms.edges_points import owned
from dolfin_elastic.problem.terms.undefined import no_value, undefined_formula

_HALVINGS = 60
_ROUND_OFF = 2.0**-50
_FAR, _NEAR = 2.0**-15, 2.0**-30
"""Distances from a zero of a denominator at which values are compared, in shares of a cell."""
_ANY, _NOT_INTEGRABLE = 2.0**3, 2.0**12
"""Growth from far to near of poles of the orders 0.2 and 0.8: values are needed, or integrals."""


@dataclass(frozen=True)
class _Use:
    """Where formulas are used.

    Attributes:
        where: Key of the case.
        values: Some of them may be formulas.
        places: Corners of facets, cells or edges, then points inside them, or nodes [m]; shape
            (entities, points, dim).  Found for formulas only.
        inside: The first of the points inside, at which there must be values; None: others look.
        growth: Of values near a pole, from which on it is refused.
        corners: How many of the places are corners between which there is an integral.
        ring: The integral has the radius x as a factor.
    """

    where: str
    values: tuple[Component, ...]
    places: Callable[[], FloatArray]
    inside: int | None
    growth: float = _ANY
    corners: int = 0
    ring: bool = False


def all_times(case: Case) -> list[float]:
    """Times of a motion, or load parameters of statics without 0, where no load acts."""
    if case.dynamics is None:
        return [float(t) for t in np.linspace(0.0, case.final_load, TIMES)[1:]]
    return [float(t) for t in np.linspace(0.0, case.dynamics.end, TIMES)]


def check_formulas(case: Case, integrals: Integrals) -> None:
    """Evaluates formulas that have no resultant, and looks for poles between places. Collective.

    Args:
        case: Its loads, supports, materials and initial motion.

    Raises:
        CaseError: A formula gives no finite number somewhere.
    """
    times, comm = all_times(case), integrals.body.comm
    for use in _uses(case, integrals):
        formulas = [value for value in use.values if isinstance(value, Formula)]
        if formulas and use.inside is not None:
            X = use.places()[:, use.inside :]
            for value in formulas:
                for t in _times_of(value, times):
                    if (error := undefined_formula(comm, value, use.where, X, t)) is not None:
                        raise error
    check_poles(case, integrals)


def check_poles(case: Case, integrals: Integrals) -> None:
    """Looks for poles of formulas between the places and times at which they are used. Collective.

    A pole lies between two points of a facet, cell or edge at which a part of a denominator has
    opposite signs, if values grow towards the place where it is zero.  In loads and springs, which
    are integrated, poles such as 1/sqrt(x) are none.  A pole may also run along nodes, so that all
    corners but one are on it; at a single corner even 1/r can be integrated.

    Args:
        case: Its loads, supports, materials and initial motion.

    Raises:
        CaseError: There is a pole.
    """
    times, comm = all_times(case), integrals.body.comm
    _check_in_time(case, [0.0, *times])
    for use in _uses(case, integrals):
        divided = [v for v in use.values if isinstance(v, Formula) and v.divisors]
        X = use.places() if divided else np.empty(0)
        for value in divided:
            _check_poles(value, X, use, times, comm)


def _check_in_time(case: Case, times: Sequence[float]) -> None:
    """Refuses poles of formulas in t alone: curves, and what moves rigid surfaces and obstacles."""
    given: list[tuple[str, object]] = []
    for key in ("support", "load", "contact"):
        for i, row in enumerate(getattr(case, key)):
            if (curve := getattr(row, "curve", None)) is not None:
                given.append((f"{key}[{i}].curve", curve.formula))
            if isinstance(row, Restraint):
                moved = [value for values in row.time_functions for value in values]
                given += [(f"support[{i}]", value) for value in moved]
            if isinstance(row, Contact):
                given += [(f"contact[{i}].motion", value) for value in row.values]
                given.append((f"contact[{i}].force", row.push))
                if row.rotation is not None:
                    given.append((f"contact[{i}].rotation.angle", row.rotation.value))
    for where, value in given:
        if not isinstance(value, Formula) or value.names != {"t"}:
            continue
        pole = next(_poles_in_time(value, np.zeros((1, 3)), times), None)
        if pole is not None:
            raise no_value(value, where, (), pole, pole=True)


# --- what is evaluated where ---


def _uses(case: Case, integrals: Integrals) -> Iterator[_Use]:
    """All uses of numbers or formulas in the place, the same on all ranks. Local."""
    for i, load in enumerate(integrals.problem.loads):
        yield from _of_load(f"load[{i}]", load, integrals)
    for i, support in enumerate(case.support):
        yield from _of_support(f"support[{i}]", support, integrals)
    body = integrals.body
    if (motion := case.dynamics) is not None:
        every = partial(_cells, integrals, body.owned_cells())
        yield _Use("dynamics.initial_displacement", motion.displacement, every, None)
        yield _Use("dynamics.initial_velocity", motion.velocity, every, None)
    ring = integrals.problem.geometry == "axisymmetric"
    for name, material in case.materials.items():
        places = partial(_filled, case, name, integrals)
        for constant, item in material.law.spatial_constants().items():
            formula = item.known(body.fields) if isinstance(item, SpatialFormula) else None
            if formula is not None and formula.names <= set(PLACE):
                where = f"materials.{key_text(name)}.{constant}"
                yield _Use(where, (formula,), places, None, _ANY, body.dim + 1, ring)


def _cells_of(body: Body, names: Sequence[str], *more: IndexArray) -> IndexArray:
    """Owned cells of regions and others, each once, sorted."""
    result = [np.empty(0, dtype=np.int32), *more, *(body.owned_cells(name) for name in names)]
    return np.unique(np.concatenate(result))


def _filled(case: Case, name: str, integrals: Integrals) -> FloatArray:
    """Places in the cells of a material: of its regions, or of none of the others'."""
    body, regions = integrals.body, case.materials[name].regions
    if regions:
        return _cells(integrals, _cells_of(body, regions))
    others = [_cells_of(body, one.regions) for one in case.materials.values() if one.regions]
    return _cells(integrals, np.setdiff1d(body.owned_cells(), _cells_of(body, [], *others)))


def _of_load(key: str, load: Load, integrals: Integrals) -> Iterator[_Use]:
    body, inside, growth = integrals.body, None, _NOT_INTEGRABLE
    corners, ring = 2, integrals.problem.geometry == "axisymmetric"
    if isinstance(load, ConcentratedLoad):
        if load.on is not None and load.part_kinds != ("edge",):
            return  # nodes have nothing between them
        places = partial(_edges, body, load.parts) if load.on is not None else partial(_line, load)
    elif load.domain.kind == "surface":
        places, corners = partial(_facets, integrals, load.parts), body.dim
    else:
        regions = [name for name in load.parts if name in body.regions]  # a bolt may have a cut
        cells = _cells_of(body, regions) if regions else body.owned_cells()
        places, corners = partial(_cells, integrals, cells), body.dim + 1
        if load.is_eigenstrain:
            inside, growth = body.dim + 1, _ANY
    yield _Use(f"{key}.value", load.values, places, inside, growth, corners, ring)


def _of_support(key: str, support: Restraint, integrals: Integrals) -> Iterator[_Use]:
    given, resists, body = dict(support.vectors), False, integrals.body
    if isinstance(support, ResistingSupport):
        resists = True
        given["normal"] = support.coefficients if support.by_normal else ()
    elif isinstance(support, Normal):
        given["displacement"] = (support.value,)
    for kind, names in _by_kind(body, support).items():
        if kind == "point":
            places, inside = partial(_nodes, body, names), 0
        elif kind == "edge":
            places, inside = partial(_edges, body, names), 2
        else:
            places, inside = partial(_facets, integrals, names), body.dim
        growth, corners = (_NOT_INTEGRABLE, inside) if resists else (_ANY, 0)
        ring = integrals.problem.geometry == "axisymmetric"
        looked = inside if resists else None
        for name, values in given.items():
            yield _Use(f"{key}.{name}", values, places, looked, growth, corners, ring)


def _by_kind(body: Body, support: Restraint) -> dict[str, list[str]]:
    """Kind of part to the names of those that a support holds; empty sets of nodes left out."""
    result: dict[str, list[str]] = {}
    for name in support.surfaces:
        if name in body.surfaces and name not in body.uncovered:
            result.setdefault("surface", []).append(name)
        elif name in body.parts["edge"]:
            result.setdefault("edge", []).append(name)
        elif name in body.parts["point"]:
            result.setdefault("point", []).append(name)
    return result


def _facets(integrals: Integrals, names: Sequence[str]) -> FloatArray:
    body = integrals.body
    facets = np.unique(np.concatenate([body.owned_facets(name) for name in names]))
    corners = body.mesh.geometry.x[facet_nodes(body.mesh, facets)][..., : body.dim]
    return np.concatenate([corners, integrals.facets(names).X], axis=1)


def _nodes(body: Body, names: Sequence[str]) -> FloatArray:
    return node_points(body.mesh, owned(body, "point", names)).X


def _line(load: ConcentratedLoad) -> FloatArray:
    return load.samples()[0][None]


def _cells(integrals: Integrals, cells: IndexArray) -> FloatArray:
    inside = integrals.cells().X[cells]
    return np.concatenate([cell_corners(integrals.body.mesh, cells), inside], axis=1)


def _edges(body: Body, names: Sequence[str]) -> FloatArray:
    edges = owned(body, "edge", names)
    cells, local = cells_beside_edges(body.mesh, edges)
    ends = np.take_along_axis(body.mesh.geometry.dofmap[cells], np.array(EDGE_ENDS)[local], axis=1)
    inside = edge_points(body.mesh, edges, 4).X
    return np.concatenate([np.asarray(body.mesh.geometry.x[ends]), inside], axis=1)


# --- values and poles ---


def _check_poles(
    value: Formula, X: FloatArray, use: _Use, times: Sequence[float], comm: MPI.Comm
) -> None:
    """Raises on all ranks where a formula has a pole between two points or times. Collective."""
    first = first_of(
        comm, [pole for t in _times_of(value, times) for pole in _poles(value, X, t, use)]
    )
    if first is not None:
        raise no_value(value, use.where, first[1:], first[0], pole=True)
    if "t" in value.names:
        early = first_of(comm, _poles_in_time(value, X.reshape(-1, X.shape[-1]), [0.0, *times]))
        if early is not None:
            raise no_value(value, use.where, (), early, pole=True)


def _times_of(value: Formula, times: Sequence[float]) -> Sequence[float]:
    return times if "t" in value.names else [0.0]


def _poles(formula: Formula, X: FloatArray, t: float, use: _Use) -> Iterator[tuple[float, ...]]:
    """Poles on lines between two points of one facet, cell or edge: their time and place."""
    for divisor in formula.divisors if X.size else ():
        values = np.nan_to_num(number_at(divisor, X, t))
        across, from_corners = _across(X, values), _from_corners(X, values, use)
        growth = np.repeat([use.growth, _NOT_INTEGRABLE], [len(across[0]), len(from_corners[0])])
        ends = (np.concatenate(pair) for pair in zip(across, from_corners, strict=True))
        start, end = (np.insert(x, 0, t, axis=1) for x in ends)
        for pole in _poles_between(formula, divisor, start, end, growth):
            yield tuple(map(float, pole))


def _across(X: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ends of lines on which a denominator changes its sign, one for each facet, cell or edge."""
    rows = np.flatnonzero((values.min(axis=1) < 0) & (values.max(axis=1) > 0))
    return X[rows, values[rows].argmin(axis=1)], X[rows, values[rows].argmax(axis=1)]


def _from_corners(X: FloatArray, values: FloatArray, use: _Use) -> tuple[FloatArray, FloatArray]:
    """Ends of lines that begin where a denominator is zero: between all corners but one."""
    corners = X[:, : use.corners]
    zero = values[:, : use.corners] == 0
    if use.ring:  # the circumference makes up for 1/x
        zero &= corners[..., 0] != 0
    rows = np.flatnonzero((zero.sum(axis=1) == use.corners - 1) & (values != 0).any(axis=1))
    # Not in their middle, which may be a place of its own.
    shares = zero[rows] * (1.0 + 0.1 * np.arange(zero.shape[1]))
    start = np.einsum("nk,nkc->nc", shares / shares.sum(axis=1, keepdims=True), corners[rows])
    return start, X[rows, np.abs(values[rows]).argmax(axis=1)]


def _poles_in_time(formula: Formula, X: FloatArray, times: Sequence[float]) -> Iterator[float]:
    """Poles between some times, of denominators that depend on nothing else.

    Args:
        X: Shape (n, dim).
    """
    for divisor in formula.divisors if X.size else ():
        if divisor.names != {"t"}:
            continue
        values = np.nan_to_num(divisor.evaluate(t=np.array(times)))
        for (first, a), (last, b) in pairwise(zip(times, values, strict=True)):
            if a * b < 0:
                start, end = (np.insert(X, 0, t, axis=1) for t in (first, last))
                result = _poles_between(formula, divisor, start, end, np.full(len(X), _ANY))
                yield from map(float, result[:1, 0])


def _poles_between(
    formula: Formula, divisor: Formula, start: FloatArray, end: FloatArray, growth: FloatArray
) -> FloatArray:
    """Zeros of a denominator on lines, towards which values grow, shape (n, 1 + dim).

    A quotient of zeros counts as none.

    Args:
        start: Time and place where each line begins, shape (lines, 1 + dim).
        end: Where it ends, and the denominator has another sign or value than at its start.
        growth: Of values from far to near of a zero, from which on there is a pole, shape (lines,).
    """
    if not len(start):
        return start

    def along(item: Formula, s: FloatArray) -> FloatArray:
        points = start + s[:, None] * (end - start)
        return number_at(item, points[:, 1:], points[:, 0])

    low: FloatArray = np.zeros(len(start))
    high: FloatArray = np.ones(len(start))
    falls = along(divisor, high) < 0
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        values = along(divisor, middle)
        below = np.where(falls, -values, values) < 0
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    roots = np.where(high < _ROUND_OFF, 0.0, high)

    def around(distance: float) -> FloatArray:
        sides = [np.abs(along(formula, roots + side * distance)) for side in (-1, 1)]
        return np.asarray(np.nanmax([*sides, np.zeros(len(roots))], axis=0))

    with np.errstate(all="ignore"):
        near, far = around(_NEAR), around(_FAR)
    grow = (near > growth * far) | np.isinf(near)
    return np.asarray((start + roots[:, None] * (end - start))[grow])
