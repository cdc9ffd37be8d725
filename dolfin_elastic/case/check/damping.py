"""What damping and mass scaling would do in a motion, before anything is compiled."""

from __future__ import annotations

from collections.abc import Iterator
from math import pi, sqrt

import numpy as np
from dolfinx import la

from dolfin_elastic.case.case import Case
from dolfin_elastic.core.parallel import largest_row
from dolfin_elastic.core.si_text import percent
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import extent
from dolfin_elastic.mesh.geometry.simplices import cell_corners, signed_volumes
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.problem.material_regions import poisson, shear_modulus, young
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.dynamics.explicit.mass_scaling import check_scaled, scaling
from dolfin_elastic.solvers.dynamics.settings import DynamicsSettings

RESOLVED = 10
"""Steps a period from which a motion is resolved."""


def damping_of(case: Case, problem: Problem) -> tuple[list[str], list[str]]:
    """What damping and mass scaling would do, and what of it is probably not meant. Collective.

    Returns:
        Lines and notes.

    Raises:
        InputError: Mass scaling cannot be computed.
    """
    motion, lines, notes = case.dynamics, list[str](), list[str]()
    if motion is None:
        return lines, notes
    laws = [material.law for material in case.materials.values()]
    known = all(
        isinstance(law.density, int | float) and not law.spatial_constants() for law in laws
    )
    if motion.rayleigh is not None and known:
        lines.append(_rayleigh(motion, _wave(laws, problem)))
        notes += _overdamped(motion, _wave(laws, problem))
    if (bulk := motion.bulk_viscosity) is not None:
        lines.append(
            f"bulk viscosity: ratio {bulk.linear:.3g} of the volume mode of an element; the stable "
            f"step is at most {sqrt(1 + bulk.linear**2) - bulk.linear:.2g} of that without"
        )
        if bulk.linear >= 1.0:
            notes.append(
                f"dynamics.bulk_viscosity: linear = {bulk.linear:.3g} is above critical damping of "
                "an element, and makes the stable step much shorter; usual is 0.06"
            )
    if motion.mass_scaling is not None:
        check_scaled(problem)
        if known:
            line, refused = _added_mass(case, problem, motion)
            lines.append(line)
            notes += refused
    return lines, notes


# --- Rayleigh's damping ---


def _wave(laws: list[Law], problem: Problem) -> float:
    """Frequency of a longitudinal wave along the part and back, c/(2 L) [Hz]. Collective."""
    speed = max(sqrt(young(law) / float(law.density or np.inf)) for law in laws)
    return speed / (2 * max(extent(problem.body)))


def _ratio(motion: DynamicsSettings, f: float) -> float:
    """Damping ratio at a frequency [Hz]; its source is `Rayleigh`."""
    a, b = motion.damping["mass"], motion.damping["stiffness"]
    return a / (4 * pi * f) + b * pi * f


def _rayleigh(motion: DynamicsSettings, wave: float) -> str:
    at = [(wave, "a wave along the part")]
    a, b = motion.damping["mass"], motion.damping["stiffness"]
    if a > 0 and b > 0:
        at.append((sqrt(a / b) / (2 * pi), "the least"))
    if motion.implicit and motion.dt is not None and not motion.adaptive:
        at.append((1 / (RESOLVED * motion.dt), f"{RESOLVED} steps a period"))
    told = (f"{percent(_ratio(motion, f))} at {f:.3g} Hz ({what})" for f, what in at)
    return f"damping ratio {', '.join(told)}"


def _overdamped(motion: DynamicsSettings, wave: float) -> Iterator[str]:
    ratio, (a, b) = _ratio(motion, wave), (motion.damping["mass"], motion.damping["stiffness"])
    if ratio < 1.0:
        return
    by_mass = a / (4 * pi * wave) > b * pi * wave
    key, slower = ("mass", "slower") if by_mass else ("stiffness", "faster")
    usual = 0.02 * (4 * pi * wave if by_mass else 1 / (pi * wave))
    yield (
        f"dynamics.rayleigh: a wave along the part, about {wave:.3g} Hz, has a damping ratio of "
        f"{ratio:.3g}, and {slower} motions more: above 1 the part creeps and does not vibrate; "
        f"for 2 % there {key} = {usual:.2g}"
    )


# --- added mass ---


def _added_mass(case: Case, problem: Problem, motion: DynamicsSettings) -> tuple[str, list[str]]:
    """What would be added, and a note where the run would be refused. Collective."""
    assert motion.mass_scaling is not None
    body = problem.body
    rates, mass = _rates(case, problem)
    found = scaling(body.comm, rates, mass, most=motion.mass_scaling, dt=motion.dt)
    if not found.nodes:
        return "mass scaling: no element is thin, and no mass is added", []
    places = body.mesh.geometry.x[: len(mass), : body.dim]
    row = largest_row(body.comm, found.factors, lambda rows: places[rows])
    where = "" if row is None else f", most at {body.unit.point(row.place)}"
    line = (
        f"mass scaling: about {percent(found.fraction)} of the mass at {found.nodes} nodes{where}; "
        f"steps of {found.after:.2g} s are stable, {found.before:.2g} s without"
    )
    if found.fraction > motion.mass_scaling * (1 + 1e-6):
        return line, [
            f"dynamics.mass_scaling: dt = {motion.dt:.3g} s needs about {percent(found.fraction)} "
            f"more mass, above the limit of {percent(motion.mass_scaling)}: a run would be refused"
        ]
    return line, []


def _rates(case: Case, problem: Problem) -> tuple[FloatArray, FloatArray]:
    """Bound of omega^2 [1/s^2] and mass [kg] of owned nodes, by material at rest. Collective.

    That of `FrequencyBound` with A_iJkL = lambda d_iJ d_kL + mu (d_ik d_JL + d_iL d_kJ), so that
    A_iJkL A_iMkN H_JM H_LN = (lambda^2 + mu^2) (tr H)^2 + (4 lambda mu + (d + 2) mu^2) H : H.
    Springs, obstacles and mounted masses are left out.
    """
    mesh, d = problem.body.mesh, problem.body.dim
    nodes = mesh.geometry.index_map()
    sums = la.vector(nodes, 2)
    rows = sums.array.reshape(-1, 2)
    for part in problem.regions:
        law = case.materials[part.name].law
        mu, nu = shear_modulus(law), min(poisson(law), 0.499999)
        lam = 2 * mu * nu / (1 - 2 * nu)
        cells = part.cells[part.cells < mesh.topology.index_map(d).size_local]
        corners = cell_corners(mesh, cells)
        volumes = np.abs(signed_volumes(corners))
        inverse = np.linalg.inv(corners[:, 1:] - corners[:, :1])  # columns: gradients of nodes
        H = inverse @ (np.eye(d) + 1) @ inverse.swapaxes(1, 2)  # with that of the first node
        squares = (lam**2 + mu**2) * np.trace(H, axis1=1, axis2=2) ** 2
        squares += (4 * lam * mu + (d + 2) * mu**2) * np.sum(H**2, axis=(1, 2))
        assert isinstance(law.density, int | float)
        of_cells = np.stack([volumes * np.sqrt(squares), law.density * volumes / (d + 1)], axis=1)
        for column in mesh.geometry.dofmap[cells].T:
            np.add.at(rows, column, of_cells)
    sums.scatter_reverse(la.InsertMode.add)
    stiff, mass = rows[: nodes.size_local].T
    return np.asarray(stiff / mass), np.asarray(mass)
