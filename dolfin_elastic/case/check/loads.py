"""Resultants of the loads of a case on the undeformed body."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.formulas import all_times
from dolfin_elastic.case.check.initial_state import TIMES
from dolfin_elastic.case.check.integrals import Integrals
from dolfin_elastic.core.errors import CaseError, keyed
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.si_text import quantity
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.geometry.curved import QuadraturePoints
from dolfin_elastic.model.amplitude import CONSTANT, PROPORTIONAL
from dolfin_elastic.model.loads import ConcentratedLoad, Load, LoadPoints
from dolfin_elastic.model.supports.rigid_surface import Rigid
from dolfin_elastic.model.values import depends_on_time, fields_of, vector_at
from dolfin_elastic.problem.constraints.rigid_motion import RigidMotion
from dolfin_elastic.problem.material_regions import young
from dolfin_elastic.problem.mesh_fields import check_finite
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.terms.undefined import undefined

_ROUND_OFF = 1e-12
"""Sums of forces, over the sum of their lengths, below which they are round-off."""


@dataclass(frozen=True)
class LoadSum:
    """Resultant of a load on the undeformed body.

    Attributes:
        load: Its key and kind.
        on: The parts it acts on.
        force: Total force [N]; of an axisymmetric body radial (summed up round the axis) and
            axial.  None: this kind of load depends on more than the undeformed body.
        moment: Total moment about the origin [N m], about z in a plane; empty where
            there is none (axisymmetric), None as above.
        time: Load parameter at the end in statics; in motion the time of the largest load [s].
    """

    load: str
    on: str
    force: tuple[float, ...] | None
    moment: tuple[float, ...] | None
    time: float


def load_sums(case: Case, integrals: Integrals) -> tuple[LoadSum, ...]:
    """Force and moment of each load, and of all if they are largest together. Collective.

    Raises:
        CaseError: A formula gives no finite number somewhere.
    """
    rows = [
        _load_sum(case, i, load, integrals)
        for i, load in enumerate(integrals.problem.loads)
        if not load.is_eigenstrain
    ]
    rows += _rigid_sums(case, integrals.problem)
    forces = [row.force for row in rows if row.force is not None]
    moments = [row.moment for row in rows if row.moment is not None]
    if len(rows) > 1 and len(forces) == len(rows) and len({row.time for row in rows}) == 1:
        force, moment = np.sum(forces, axis=0), np.sum(moments, axis=0)
        rows.append(LoadSum("all loads", "", _plain(force), _plain(moment), rows[0].time))
    return tuple(rows)


def stress_notes(case: Case, integrals: Integrals, sums: tuple[LoadSum, ...]) -> Iterator[str]:
    """Whether a load's force over the supports' area exceeds half Young's modulus. Collective.

    Not with obstacles, which carry loads, too, nor of materials with fibres, which stiffen far
    beyond their modulus at rest: in an artery the pressure is several times that.

    Args:
        sums: Of the loads, see `load_sums`.
    """
    body = integrals.body
    names = [name for support in case.support for name in support.surfaces]
    names = [n for n in names if n in body.surfaces and n not in body.uncovered]
    forces = [row.force for row in sums if row.force is not None]
    obstacles = any(pair.contact.between is None for pair in integrals.problem.contact_pairs)
    soft = [part for part in integrals.problem.regions if "fibre" not in part.typical.directions]
    if not names or not forces or obstacles or not soft:
        return
    points = integrals.facets(names)
    area = float(total(body.comm, float(integrals.full_weights(points).sum())))
    strongest = max(float(np.linalg.norm(force)) for force in forces)
    weakest = min(soft, key=lambda part: young(part.typical))
    if area > 0 and strongest / area > young(weakest.typical) / 2:
        yield (
            f"the loads on the area of the supports are {quantity(strongest / area, 'Pa')} "
            f"in the mean, Young's modulus of '{weakest.name}' is "
            f"{quantity(young(weakest.typical), 'Pa')}: "
            "was mesh.unit, or a unit of a load or modulus, forgotten?"
        )


def _load_sum(case: Case, index: int, load: Load, integrals: Integrals) -> LoadSum:
    """The resultant of a load at the time when it is largest. Collective."""
    name, on = f"load[{index}] ({load.kind})", ", ".join(load.parts) or "(whole body)"
    points = _points(load, integrals)
    default = PROPORTIONAL if case.dynamics is None else CONSTANT
    factors = {t: default.of(load.amplitude, t) for t in _times(case, load)}
    if depends_on_time(load.values):
        result = {t: _resultant(load, t, points, integrals) for t in factors}
    else:
        result = dict.fromkeys(factors, _resultant(load, max(factors), points, integrals))
    sums = {t: factors[t] * s for t, s in result.items() if s is not None}
    if case.dynamics is None and sums and depends_on_time(load.values):
        for t in all_times(case):
            early = _resultant(load, float(t), points, integrals)
            if early is not None:
                _check_finite(index, load, points, early, float(t), integrals)
    if not sums:
        return LoadSum(name, on, None, None, max(factors))
    dim = integrals.body.dim
    time = max(sums, key=lambda t: (round(_strength(sums[t], dim), 12), -t))
    _check_finite(index, load, points, sums[time], time, integrals)
    moment = () if integrals.problem.geometry == "axisymmetric" else _plain(sums[time][dim:])
    return LoadSum(name, on, _plain(sums[time][:dim]), moment, time)


def _rigid_sums(case: Case, problem: Problem) -> Iterator[LoadSum]:
    """Resultants of the forces and moments prescribed on rigid surfaces."""
    motions, dim = {m.label: m for m in problem.constraints.rigid_motions}, problem.body.dim
    for index, support in enumerate(case.support):
        if not isinstance(support, Rigid) or not any(x != 0.0 for x in support.action(dim)):
            continue
        result = {
            t: _rigid_resultant(motions[support.label], t, case, dim) for t in _rigid_times(case)
        }
        time = max(result, key=lambda t: (round(_strength(result[t], dim), 12), -t))
        force, moment = _plain(result[time][:dim]), _plain(result[time][dim:])
        yield LoadSum(f"support[{index}] (rigid)", ", ".join(support.surfaces), force, moment, time)


def _rigid_resultant(motion: RigidMotion, t: float, case: Case, dim: int) -> FloatArray:
    """Force and moment about the origin; given are those about the surface's point."""
    default = PROPORTIONAL if case.dynamics is None else CONSTANT
    values = np.array(motion.support.at_time(motion.support.action(dim), t, default))
    resultant = _force_and_moment(motion.centre[None, None, :dim], values[None, None, :dim])
    resultant[dim:] += values[dim:]
    return resultant


def _rigid_times(case: Case) -> list[float]:
    if case.dynamics is None:
        return [case.final_load]
    return [float(t) for t in np.linspace(0.0, case.dynamics.end, TIMES)]


def _points(load: Load, integrals: Integrals) -> QuadraturePoints | None:
    """Quadrature points of a load; None: it has points of its own. Local."""
    if isinstance(load, ConcentratedLoad):
        return None
    return (
        integrals.facets(load.parts)
        if load.domain.kind == "surface"
        else integrals.cells(load.parts)
    )


def _strength(sums: FloatArray, dim: int) -> float:
    """Norm of the force, or of the moment where forces cancel; infinite if not finite.

    So a time at which a formula has no value is the one that is reported.
    """
    size = float(np.linalg.norm(sums[:dim])) or float(np.linalg.norm(sums))
    return size if np.isfinite(size) else np.inf


def _times(case: Case, load: Load) -> list[float]:
    """Times at which a load is evaluated: the end in statics, many in motion."""
    if case.dynamics is None:
        return [case.final_load]
    if load.amplitude in (None, CONSTANT) and not depends_on_time(load.values):
        return [0.0]
    end = case.dynamics.end
    times = {float(t) for t in np.linspace(0.0, end, TIMES)}
    if load.curve is not None:
        times.update(t for t, _ in load.curve.table if 0 <= t <= end)
    return sorted(times)


def _resultant(
    load: Load, t: float, points: QuadraturePoints | None, integrals: Integrals
) -> FloatArray | None:
    """Force and moment about the origin, shape (dim + 3,), in a plane (3,). Collective."""
    if points is None:
        assert isinstance(load, ConcentratedLoad)
        X, weights = _samples(load, integrals)
        if given := fields_of(load.values):
            assert integrals.problem.nodal_loads is not None
            forces = integrals.problem.nodal_loads.values(load, t)
        else:
            forces = vector_at(load.values, X, t)
        sums = _force_and_moment(X[None], (weights[:, None] * forces)[None])
        whole = load.on is None and not given
        return sums if whole else np.asarray(total(integrals.body.comm, sums))
    density = integrals.density(points) if load.needs_density else None
    result = _sums(load, t, points, density, integrals)
    if result is None or not load.needs_density or load.parts:
        return result
    for where, surface_density in integrals.mounted():
        mounted = _sums(load, t, where, surface_density, integrals)
        result = result if mounted is None else np.asarray(result + mounted)
    return result


def _sums(
    load: Load,
    t: float,
    points: QuadraturePoints,
    density: FloatArray | None,
    integrals: Integrals,
) -> FloatArray | None:
    """Force and moment of the points of one integral, see `_resultant`. Collective."""
    weights = integrals.full_weights(points)
    axisymmetric = integrals.problem.geometry == "axisymmetric"
    size = float(total(integrals.body.comm, float(weights.sum())))
    share = partial(total, integrals.body.comm)
    fields = partial(_field, integrals.body, points)
    intensity = load.intensity(
        LoadPoints(
            points.X, t, points.N, density, size, axisymmetric, weights, share, fields=fields
        )
    )
    if intensity is None:
        return None
    forces = weights[..., None] * intensity
    sums = np.asarray(total(integrals.body.comm, _force_and_moment(points.X, forces)))
    lengths, arms = np.linalg.norm(forces, axis=-1), np.linalg.norm(points.X, axis=-1)
    scales = total(integrals.body.comm, np.array([lengths.sum(), (arms * lengths).sum()]))
    limits = _ROUND_OFF * np.repeat(scales, [forces.shape[-1], len(sums) - forces.shape[-1]])
    return np.where(np.abs(sums) < limits, 0.0, sums)


def _field(body: Body, points: QuadraturePoints, name: str) -> FloatArray:
    return body.mesh_field(name).over(points)


def _samples(load: Load, integrals: Integrals) -> tuple[FloatArray, FloatArray]:
    """Points of a concentrated load [m] and their weights: all by place, else this rank's."""
    assert isinstance(load, ConcentratedLoad)
    if load.on is None and not fields_of(load.values):
        return load.samples()
    assert integrals.problem.nodal_loads is not None
    return integrals.problem.nodal_loads.samples(load)


def _force_and_moment(X: FloatArray, forces: FloatArray) -> FloatArray:
    """Sums of forces and of their moments about the origin.

    Args:
        X: Points, shape (entities, points, dim) [m].
        forces: At the points, the same shape [N].

    Returns:
        Shape (dim + 3,), in a plane (3,).
    """
    if X.shape[-1] == 2:
        x, y = X[..., 0], X[..., 1]
        moments = (x * forces[..., 1] - y * forces[..., 0])[..., None]
    else:
        moments = np.asarray(np.cross(X, forces), dtype=np.float64)
    return np.asarray(np.concatenate([forces, moments], axis=-1).sum(axis=(0, 1)))


def _check_finite(
    index: int,
    load: Load,
    points: QuadraturePoints | None,
    sums: FloatArray,
    t: float,
    integrals: Integrals,
) -> None:
    """Raises on all ranks where a load's resultant is not finite. Collective."""
    if not np.isfinite(sums).all():
        X = _samples(load, integrals)[0] if points is None else points.X
        error = undefined(integrals.body.comm, index, load, X, t)
        if error is not None:
            raise error
        with keyed(f"load[{index}].value"):
            check_finite(integrals.body, load.values, sums)
        raise CaseError(
            f"the load is not finite somewhere at t = {t:g}",
            where=f"load[{index}].value",
            expected="a formula that gives a number at every point it acts on",
        )


def _plain(values: Sequence[float] | FloatArray) -> tuple[float, ...]:
    return tuple(float(value) for value in values)
