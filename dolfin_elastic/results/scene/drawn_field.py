"""What a picture interpolates between the nodes, and the value that it shows there.

The von Mises stress of a mean of two stresses is not the mean of their von Mises stresses: between
tension and compression it falls to zero.  So components are interpolated, by the shape functions
of the displacement as a probe does it, and the shown value follows from them at each point.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.ghosts import with_ghosts
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.fields import table_of
from dolfin_elastic.results.grid import to_nodes
from dolfin_elastic.results.recovery.stress import (
    StressRecovery,
    field_rows,
    safety_factor,
    von_mises,
)

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem

_SMOOTH = ("displacement", "velocity", "acceleration")


class DrawnField:
    """A field as a picture shows it.  All of it is collective but `shown`.

    Args:
        name: Name of `field_table`, one that a picture can show.

    Attributes:
        name: As given.
        linear: Its value, not components, is given at the nodes and linear between them: means of
            cells and pressures of contact, which must not overshoot, forces of nodes, and
            components in local axes.
    """

    def __init__(self, problem: Problem, name: str) -> None:
        field = table_of(problem)[name]
        self.name, self._recovered = name, field.recovered and field.component is None
        self.linear = not self._recovered and name not in _SMOOTH
        self._recovery = StressRecovery(problem) if self._recovered else None
        self._evaluate = Evaluator(problem, [] if self._recovered else [name])
        self.grid = self._evaluate.grid

    def values(self, state: State) -> AnyArray:
        """This rank's rows of a field without recovered stress, see `Evaluator`."""
        return self._evaluate(state)[self.name]

    def at_nodes(self, state: State) -> AnyArray:
        """Components, or the value of a `linear` field, at the local nodes (ghosts included).

        Returns:
            Shape (nodes, columns).
        """
        V = self.grid.V
        if self._recovery is not None:
            stress = self._recovery(state)
            safety = self.name == "safety_factor"
            return with_ghosts(V.dofmap.index_map, stress.utilisation if safety else stress.stress)
        values = self.values(state)
        if self.linear and values.shape[1] > 1:
            values = np.linalg.norm(values, axis=1, keepdims=True)
        if self._evaluate.table[self.name].centre == "cell":
            return to_nodes(V, values)
        return with_ghosts(V.dofmap.index_map, values)

    def shown(self, components: AnyArray) -> AnyArray:
        """The shown value at points, shape (points, 1). Not collective.

        Args:
            components: What `at_nodes` gives, interpolated at the points.
        """
        if self._recovered:
            # Of the safety factor the components are the stress over the allowable one.
            safety = safety_factor(von_mises(components))
            components = field_rows(self.name, components, safety)
        if components.shape[1] > 1:
            components = np.linalg.norm(components, axis=1, keepdims=True)
        return components
