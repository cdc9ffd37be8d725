"""Named surfaces of bodies that touch without being joined or tied."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from dolfin_elastic.core.parallel import total
from dolfin_elastic.mesh.body import span
from dolfin_elastic.problem.connectivity import ConnectedBodies
from dolfin_elastic.problem.constraints.ties.exchange import Owners
from dolfin_elastic.problem.constraints.ties.facets import opposite, owned
from dolfin_elastic.problem.constraints.ties.segments import cut
from dolfin_elastic.problem.problem import Problem

NEAR = 1e-6
"""Distance over the body's diagonal within which surfaces touch."""


def touching_surfaces(problem: Problem) -> Iterator[tuple[str, str, float]]:
    """Names of two surfaces of different bodies, and the area on which they touch. Collective.

    Bodies that a tie connects are one here.
    """
    body, bodies = problem.body, ConnectedBodies(problem)
    if bodies.count == 1:
        return
    imap = problem.V.dofmap.index_map
    owners = Owners(body.comm, imap.local_range[0], imap.size_local)
    of_node = bodies.of_node[: imap.size_local]
    near = NEAR * span(body)
    facets = {name: owned(body, problem.V, [name]) for name in sorted(body.surfaces)}
    pairs, local = [*combinations(facets, 2)], []
    for a, b in pairs:
        there = opposite(body.comm, facets[a], facets[b], near)
        pieces = cut(facets[a], there, near)
        one, other = (
            owners.values_at(of_node, side.nodes[which, 0])
            for side, which in ((facets[a], pieces.near), (there, pieces.far))
        )
        local.append(float(pieces.weights[one != other].sum()))
    for (a, b), area in zip(pairs, total(body.comm, np.array(local)), strict=True):
        if area > 0.0:
            yield a, b, float(area)
