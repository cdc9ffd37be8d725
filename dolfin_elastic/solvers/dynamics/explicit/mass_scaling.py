"""Mass that is added at nodes of thin cells, which would make the steps of a whole motion short.

A node of mass m whose cells have the bound r of omega^2, see `FrequencyBound`, gets the mass m r/s,
where r is above a rate s that is the same for all: then s bounds omega^2 of the body.

Without a step of the user's only nodes whose r is above THIN times a rate q get mass, m r/(EASY q),
so that they are no stiffer than the whole of the others, whose omega^2 is below their largest r.  q
is as low as a limit of the added mass permits, but not below the median of r: where no element is
thin nothing is added.

The mass is added in all directions: it slows what moves there, and adds to the weight of nothing.
A cell of altitude e h in a mesh of size h has a step of about sqrt(e) of the others, and needs 1/e
times the mass of its nodes.

Source: Abaqus 2016 Analysis User's Guide, section 11.6.1, Mass scaling; T. Belytschko, W. K. Liu,
B. Moran, K. Elkhodary, Nonlinear Finite Elements for Continua and Structures, 2nd ed., Wiley 2014,
section 6.2.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from math import ceil, floor, log10
from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import largest_row, total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.dynamics.explicit.frequency_bound import FrequencyBound, extremes

log = logging.getLogger("dolfin_elastic")

MARGIN = 0.9
"""The user's step over the one that is stable with the added mass: bodies become stiffer."""
THIN = 2.0
"""Bound of a node that is to get mass, over the median: those of a regular mesh differ by less."""
EASY = 0.6
"""Of a regular mesh, omega_max^2 over the median of the bounds."""
ABOVE = 1e-8
"""Of a rate over the lowest one that a limit permits: it is rounded, and more may be thin below."""
NOTHING = 1e-6
"""Of a node's mass: less is round-off of its rate, and not added."""
HALVINGS = 60
"""Of an interval of rates: to the last digits."""


class ScaledMass(NamedTuple):
    """A mass with what is added to it.

    Attributes:
        mass: At every owned entry [kg].
        numbers: Fraction that is added, and where most is, undeformed [m], by name.
    """

    mass: FloatArray
    numbers: dict[str, float]


class Scaling(NamedTuple):
    """By what the masses of nodes are multiplied.

    Attributes:
        factors: Of each owned node, at least 1.
        fraction: Of the whole mass that is added.
        nodes: Nodes of all ranks that get any.
        needed: Fraction that would make thin elements no stiffer than the others.
        before: Stable step by the bound of elements without added mass [s].
        after: The same with it.
    """

    factors: FloatArray
    fraction: float
    nodes: int
    needed: float
    before: float
    after: float


def check_scaled(problem: Problem) -> None:
    """Refuses problems without a bound by cells. Not collective.

    Raises:
        InputError: There is none.
    """
    if not FrequencyBound.applies(problem):
        raise InputError(
            "mass is added by the frequencies of elements, which are not known in bodies of "
            "revolution, in curved elements and under loads that follow the body",
            where="dynamics.mass_scaling",
            expected="leave it out",
        )


def scaling(
    comm: MPI.Comm, rates: FloatArray, nodal: FloatArray, *, most: float, dt: float | None
) -> Scaling:
    """What is added to the masses of nodes. Collective.

    Args:
        comm: The ranks of the run.
        rates: Bounds of omega^2 at owned nodes [1/s^2].
        nodal: Their masses [kg].
        most: Largest fraction of the body's mass that may be added.
        dt: The step that is to be stable [s]; None: as long as `most` permits.
    """
    whole = total(comm, float(nodal.sum()))

    def factors(rate: float) -> FloatArray:
        """Of the mass of each node, for a rate."""
        if dt is not None:
            return np.asarray(np.where(rates > (1 + NOTHING) * rate, rates / rate, 1.0))
        return np.asarray(np.where(rates > THIN * rate, rates / (EASY * rate), 1.0))

    def added(rate: float) -> float:
        """Fraction of the whole mass."""
        return float(total(comm, float(np.dot(nodal, factors(rate) - 1)))) / whole

    worst = extremes(comm, [float(rates.max(initial=0.0))])[0]
    if dt is not None:
        rate = (2 * MARGIN / dt) ** 2
        needed = added(rate)
    else:
        least = _median(comm, rates, worst)
        needed = added(least)
        rate = _lowest(added, least, worst, most) * (1 + ABOVE)
    rate = float(f"{rate:.9e}")  # the same on any number of ranks
    factor = factors(rate)
    after = extremes(comm, [float((rates / factor).max(initial=0.0))])[0]
    count = int(total(comm, int(np.sum(factor > 1.0))))
    before, after = (2 / float(np.sqrt(max(one, 1e-300))) for one in (worst, after))
    return Scaling(factor, added(rate), count, needed, before, after)


def scaled(
    problem: Problem, assembler: Assembler, mass: FloatArray, *, most: float, dt: float | None
) -> ScaledMass:
    """The mass with what is added to it. Collective.

    It is that of the undeformed body, whatever state the motion starts from.

    Args:
        mass: Lumped mass at every owned entry [kg].
        most: Largest fraction of the body's mass that may be added.
        dt: The step that is to be stable [s]; None: as long as `most` permits.

    Raises:
        InputError: More would have to be added, or there is no bound by cells.
    """
    check_scaled(problem)
    u, dim = problem.u.x.array, problem.body.dim
    state = u.copy()
    u[:] = 0.0
    rates, nodal = FrequencyBound(problem, assembler, mass).evaluate(), mass[::dim]
    u[:] = state
    comm = problem.body.comm
    found = scaling(comm, rates, nodal, most=most, dt=dt)
    if dt is None:
        _tell_of_limit(found.needed, most)
    coordinates = problem.places[:, :dim]
    row = largest_row(comm, found.factors, lambda rows: coordinates[rows])
    place = "" if row is None else f", most at {problem.body.unit.point(row.place)}"
    if found.fraction > most * (1 + 1e-6):
        raise InputError(
            f"{100 * found.fraction:.3g} % of the mass would have to be added at {found.nodes} "
            f"nodes{place}, where steps of {found.before:.2g} s are stable",
            where="dynamics.mass_scaling",
            expected=_advice(found.fraction),
        )
    if found.nodes:
        log.info(
            "mass scaling: %.3g %% of the mass is added at %d nodes%s, there %.3g times the "
            "node's; steps of %.3g s were stable without",
            100 * found.fraction,
            found.nodes,
            place,
            0.0 if row is None else row.value - 1,
            found.before,
        )
    numbers = {"added_mass_fraction": found.fraction}
    if found.nodes and row is not None:
        numbers |= {f"added_mass_{x}": v for x, v in zip("xyz", row.place, strict=False)}
    return ScaledMass(np.asarray(np.repeat(found.factors, dim) * mass), numbers)


def _tell_of_limit(needed: float, most: float) -> None:
    """Logs the fraction that would make thin elements no stiffer than others, if 0 or too much."""
    if not needed:
        log.info("mass scaling: no element is thin, and no mass is added")
    elif needed > most * (1 + 1e-6):
        log.info(
            "mass scaling: dynamics.mass_scaling = %.3g limits it; with %.3g thin elements would "
            "be no stiffer than the others",
            most,
            needed,
        )


def _advice(fraction: float) -> str:
    """What to do where a fraction of the mass would have to be added: settings permit 1."""
    ways = (
        "leave mass_scaling out if dt is not much longer: that is the bound of elements, below the "
        "stable step of the body, and the run may need no added mass; else a shorter dt, or a mesh "
        "without such thin elements"
    )
    digits = max(1 - floor(log10(fraction)), 0)
    enough = ceil(fraction * 10**digits) / 10**digits
    return f"{ways}, or mass_scaling = {enough:.2g}" if enough <= 1 else ways


def _lowest(added: Callable[[float], float], least: float, worst: float, most: float) -> float:
    """The lowest rate, from `least` to `worst`, for which no more than `most` is added."""
    if added(least) <= most or worst <= least:
        return least
    low, high = np.log(least), np.log(worst)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if added(np.exp(middle)) <= most else (middle, high)
    return float(np.exp(high))


def _median(comm: MPI.Comm, rates: FloatArray, worst: float) -> float:
    """The median of the nodes' rates, to a few digits. Collective."""
    count = int(total(comm, len(rates)))
    low, high = -200.0, np.log(max(worst, 1e-200))
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        below = int(total(comm, int(np.sum(rates <= np.exp(middle)))))
        low, high = (low, middle) if 2 * below >= count else (middle, high)
    return float(np.exp(high))
