"""Sums of nodal reactions over parts, or at one node."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import span
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.derived.part_numbers import members
from dolfin_elastic.results.evaluate import Evaluator

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem

REACTION = "reaction"
"""The field that is a force at nodes: it is summed up, not averaged."""

_AT_NODE = 1e-6
"""Distance of a point from the node that is meant, over the body's size."""


class ReactionSums:
    """Sums of the supports' nodal forces over parts, or at one node.  All of it is collective.

    Args:
        parts: Name to the name of a surface, edge or point, or to the place of a node [m].

    Raises:
        InputError: There is no node at a place.
    """

    def __init__(self, problem: Problem, parts: Mapping[str, str | Sequence[float]]) -> None:
        self._comm, self._dim = problem.body.comm, problem.body.dim
        self._evaluator = Evaluator(problem, [REACTION])
        self._nodes = {
            name: members(problem, "surface", part, "node")
            if isinstance(part, str)
            else node_at(problem, part, f"output.probes.{name}")
            for name, part in parts.items()
        }

    def __call__(self, state: State) -> dict[str, FloatArray]:
        """Name to the force of the supports on the body there [N], the same on every rank.

        Raises:
            InputError: The state is one of a motion.
        """
        forces = self._evaluator(state)[REACTION][:, : self._dim]
        sums = np.array([forces[nodes].sum(axis=0) for nodes in self._nodes.values()])
        return dict(zip(self._nodes, total(self._comm, sums), strict=True))


def node_at(problem: Problem, place: Sequence[float], where: str) -> IndexArray:
    """The node at a place, on the rank that owns it; the others have none. Collective.

    Args:
        place: In the reference configuration, shape (gdim,) [m].
        where: Key of the case file, for the message.

    Raises:
        InputError: There is none.
    """
    own, dim = problem.V.dofmap.index_map.size_local, problem.body.dim
    x = problem.places[:own, :dim]
    distance = np.linalg.norm(x - np.array(place[:dim]), axis=1)
    first = int(np.argmin(distance)) if own else -1
    local = (float(distance[first]), problem.body.comm.rank, tuple(x[first])) if own else None
    nearest = min(one for one in problem.body.comm.allgather(local) if one is not None)
    unit = problem.body.unit
    if nearest[0] > _AT_NODE * span(problem.body):
        raise InputError(
            f"there is no node at {unit.point(place[:dim])}, and a reaction is a force at nodes",
            where=where,
            expected=f"the nearest is at {unit.point(nearest[2])}; or on = the name of a part",
        )
    return np.array([first] if nearest[1] == problem.body.comm.rank else [], dtype=np.int64)
