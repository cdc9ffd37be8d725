"""The initial state: gaps of contacts, initial displacement and velocity; supports over time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from dolfinx import fem

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.tables import MeshTable
from dolfin_elastic.core.parallel import smallest
from dolfin_elastic.mesh.body import span
from dolfin_elastic.model.amplitude import CONSTANT, PROPORTIONAL
from dolfin_elastic.problem.loads.contact import ContactPair
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.dynamics.dynamics import DynamicsSettings
from dolfin_elastic.solvers.dynamics.initial_conditions import set_initial
from dolfin_elastic.solvers.nonlinear.contact import buried, check_start, first_gaps

TIMES = 41
"""Times of a motion, or of statics, at which supports and loads are evaluated."""
_SHARE = 0.5
"""Gap over the body's diagonal up to which an obstacle in another unit would fit."""
_ROUND_OFF = 1e-9
"""Gap over the size of a cell that is none."""


@dataclass(frozen=True)
class ContactGap:
    """Where a contact begins.

    Attributes:
        contact: Its key and name.
        on: The surfaces that may touch.
        obstacle: Its shape: "plane", "sphere" or "cylinder".
        gap: Smallest gap at the nodes at the start [m], negative inside the obstacle.
        place: Where that is in the undeformed body [m].
    """

    contact: str
    on: str
    obstacle: str
    gap: float
    place: tuple[float, ...]


def contact_gaps(case: Case, problem: Problem) -> tuple[ContactGap, ...]:
    """All contacts. Collective."""
    gaps = first_gaps(problem, moving=case.dynamics is not None)
    return tuple(
        ContactGap(
            f"contact[{i}] '{touch.label}'",
            ", ".join(touch.contact.surfaces),
            touch.contact.shape,
            gap if abs(gap) > _ROUND_OFF * touch.size else 0.0,
            place,
        )
        for i, (touch, (gap, place)) in enumerate(zip(problem.contact_pairs, gaps, strict=True))
    )


def contact_notes(case: Case, problem: Problem) -> Iterator[str]:
    """Obstacles that begin farther away than the body is large and do not come near. Collective."""
    if not problem.contact_pairs:
        return
    far = span(problem.body)
    gaps = first_gaps(problem, moving=case.dynamics is not None)
    for touch, (gap, _) in zip(problem.contact_pairs, gaps, strict=True):
        moved = float(np.linalg.norm([_size(value) for value in touch.contact.values])) * case.full
        if abs(gap) > far + moved:
            yield (
                f"contact '{touch.label}': "
                + (
                    f"the obstacle is {gap:.3g} m away, farther than the body is large"
                    if gap > 0
                    else f"it begins {-gap:.3g} m deep in the obstacle, more than the body is large"
                )
                + _unit_hint(case.mesh, touch, far)
            )


def _size(value: object) -> float:
    return abs(value) if isinstance(value, int | float) else 0.0


def _unit_hint(mesh: MeshTable, touch: ContactPair, far: float) -> str:
    """Whether the obstacle would be near if its numbers were in the mesh's unit. Collective."""
    if mesh.scale == 1.0:
        return ""
    x = list(touch.places().T / mesh.scale)
    gaps = np.asarray(touch.contact.obstacle.gap(x, float, np.sqrt)[0])
    near = mesh.scale * smallest(touch.comm, float(np.min(gaps, initial=np.inf)))
    if abs(near) > _SHARE * far:
        return ""
    there = f"be {abs(near):.3g} m away" if abs(near) > _ROUND_OFF * touch.size else "touch"
    return (
        f"; bare numbers of a contact are in m, not in mesh.unit: were they in {mesh.unit}, it "
        f"would {there}"
    )


# --- motion ---


def check_supports(case: Case, problem: Problem) -> None:
    """Looks whether supports have values all the way; ends as at the start. Collective.

    Raises:
        InputError: A formula gives no finite number somewhere.
    """
    if all(support.at_rest for support in problem.supports):
        return
    end, default = (case.dynamics.end, CONSTANT) if case.dynamics else (case.full, PROPORTIONAL)
    held = problem.dirichlet
    for t in np.linspace(0.0, end, TIMES):
        held.move_to(float(t), default)
        held.check_finite()
    held.move_to(0.0, default)


def start_notes(problem: Problem, settings: DynamicsSettings) -> tuple[str, ...]:
    """Supports and obstacles that the body does not begin with; leaves it at rest. Collective.

    Raises:
        InputError: It cannot begin so: a formula is not finite, or it lies deep in an obstacle.
    """
    v, s = fem.Function(problem.V), settings
    shocks = set_initial(problem, v, s.displacement, s.velocity, s.end)
    gaps = zip(problem.contact_pairs, check_start(problem, moving=True), strict=True)
    deep = [buried(touch, gap, at) for touch, (gap, at) in gaps if gap < -touch.tolerance]
    problem.u.x.array[:] = 0.0
    problem.unknowns.take()
    return (*([s.limited] if s.limited else []), *(str(shock) for shock in shocks), *deep)
