"""Whether a part under compression is so slender that it may buckle, which small strains miss."""

from __future__ import annotations

from math import pi
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import extent, mean_thickness
from dolfin_elastic.problem.material_regions import young

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem


def may_buckle(problem: Problem, stress: FloatArray) -> bool:
    """Whether the mean compression exceeds Euler's stress of a bar as slender as the body.

    Of the body of volume V and surface A the thickness t = 2 V/A is that of a plate, and half the
    side of a square bar: the stress E pi^2 t^2/(48 L^2) of a bar clamped at one end is a careful
    guess, a quarter of the right one for a square bar.  A compressed strut of a frame whose other
    parts are in tension is not seen.  Collective; False where a law has large strains.

    Args:
        stress: Cauchy stress at the owned nodes [Pa], shape (n, 6).

    Source: S. Timoshenko and J. Gere, Theory of Elastic Stability (1961), section 2.1.
    """
    body = problem.body
    if not problem.context.linear:
        return False
    known = stress[np.isfinite(stress).all(axis=1), :3].sum(axis=1)
    trace, nodes = total(body.comm, np.array([known.sum(), len(known)]))
    stiff = min(young(part.typical) for part in problem.regions)
    limit = stiff * pi**2 * mean_thickness(body) ** 2 / (48 * max(extent(body)) ** 2)
    return bool(-trace / max(nodes, 1) > limit)
