"""Where contacts begin, and what looks wrong about it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.tables import MeshTable
from dolfin_elastic.core.parallel import smallest
from dolfin_elastic.mesh.body import span
from dolfin_elastic.problem.loads.contact import ContactPair
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.nonlinear.contact import first_gaps

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
        for i, (touch, (gap, place)) in enumerate(zip(problem.touching, gaps, strict=True))
    )


def contact_notes(case: Case, problem: Problem) -> Iterator[str]:
    """Obstacles that begin farther away than the body is large and do not come near. Collective."""
    if not problem.touching:
        return
    far = span(problem.body)
    gaps = first_gaps(problem, moving=case.dynamics is not None)
    for touch, (gap, _) in zip(problem.touching, gaps, strict=True):
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
