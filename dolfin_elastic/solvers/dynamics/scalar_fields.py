"""Scalar fields beside the displacement, as functions of their own."""

from __future__ import annotations

from dolfinx import fem

from dolfin_elastic.problem.problem import Problem


class AuxiliaryFields:
    """The scalar unknowns of a problem, each in a space of its own.  Collective to make.

    Args:
        problem: Whose unknowns.

    Attributes:
        fields: Name to function, up to date after `take`.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        found = {
            extra.name: problem.W.sub(1 + k).collapse()
            for k, extra in enumerate(problem.unknowns.extras)
        }
        self._dofs = {name: dofs for name, (_, dofs) in found.items()}
        self.fields = {name: fem.Function(S, name=name) for name, (S, _) in found.items()}

    def take(self) -> None:
        """From all unknowns to the fields. Not collective."""
        for name, field in self.fields.items():
            field.x.array[:] = self._problem.w.x.array[self._dofs[name]]

    def give(self) -> None:
        """From the fields and the displacement to all unknowns. Not collective."""
        self._problem.unknowns.take()
        for name, field in self.fields.items():
            self._problem.w.x.array[self._dofs[name]] = field.x.array
