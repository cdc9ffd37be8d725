"""How the numbers of a run change with constants of materials: one linear solution for each.

At an equilibrium R(u; m) = 0 displacements change with a constant by K du/dm = -dR/dm, and a
number by dQ/dm at fixed u and dQ/du . du/dm: with few constants and many numbers this takes fewer
solutions than adjoints, and no further run.

Source: D. A. Tortorelli and P. Michaleris, Inverse Problems in Engineering 1 (1994) 71 (direct
differentiation).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import closing
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import State
from dolfin_elastic.solvers.nonlinear.newton import Newton
from dolfin_elastic.study.gradient.functionals import functionals
from dolfin_elastic.study.gradient.gradient import without_gradient
from dolfin_elastic.study.gradient.parameters import Equilibrium, parameters
from dolfin_elastic.study.identify.motions import Motion, Motions
from dolfin_elastic.study.identify.points import LocatedPoints
from dolfin_elastic.study.wanted import Wanted

if TYPE_CHECKING:
    from dolfin_elastic.case.case import Case

_AXIS = re.compile(r"(?P<stem>\w+)_(?P<axis>[xyz])")


class Tangents:
    """Derivatives by constants in all states of a run.  Collective.

    Args:
        case: The case with the values of this run.
        keys: Of the k constants, see `differentiable`.
        wanted: Numbers of the run, in the order of all arrays of them.
        points: Where displacements are told.
        probes: Name to the place of probes that are points [m].

    Attributes:
        numbers: In each state the derivatives of the numbers, shape (numbers, k).
        fields: In each state those of the displacements at the points of each set [m], each of
            shape (n, dim, k).
        smoothed: A largest value is among the numbers, for which a norm stands here.

    Raises:
        InputError: A number has no derivatives.
    """

    def __init__(
        self,
        case: Case,
        problem: Problem,
        keys: Sequence[str],
        wanted: Sequence[Wanted],
        points: Sequence[LocatedPoints],
        probes: Mapping[str, Sequence[float]],
    ) -> None:
        self._problem, self._points = problem, points
        self._parameters = parameters(keys, problem, case)
        names = [_name(one, problem, probes) for one in wanted]
        self._functionals = functionals(names, problem, probes)
        self.smoothed = any(one.name.startswith("norm:") for one in self._functionals)
        self.numbers, self.fields = list[FloatArray](), list[list[FloatArray]]()
        self._values = list[FloatArray]()

    def __call__(self, newton: Newton, state: State) -> None:
        """Adds the derivatives in a state that has just been found."""
        if state.step == 0:  # at rest, whatever the constants
            self._values.append(np.zeros(len(self._functionals)))
            self._add([np.zeros(len(self._functionals))] * len(self._parameters), None)
            return
        numbers = self._functionals
        here = Equilibrium(newton, lambda _: numbers, numbers, state.t)
        with here.kept(), closing(Motions(here)) as motions:
            found = [motions.by(one.derivative(here)) for one in self._parameters]
            self._values.append(here.evaluated().numbers)
        self._add([one.numbers for one in found], [self._moved(one) for one in found])

    def _moved(self, motion: Motion) -> fem.Function:
        result = fem.Function(self._problem.V)
        result.x.array[:] = motion.displacements
        return result

    def _add(self, numbers: Sequence[FloatArray], moved: Sequence[fem.Function] | None) -> None:
        k, dim = len(self._parameters), self._problem.body.dim
        self.numbers.append(np.array(numbers).T)
        self.fields.append(
            [
                np.zeros((points.count, dim, k))
                if moved is None
                else np.stack([points.displacements(u) for u in moved], axis=2)
                for points in self._points
            ]
        )

    def agree(self, values: FloatArray) -> bool:
        """Whether the numbers of the last state are those that a run has told, shape (numbers,)."""
        return bool(np.allclose(self._values[-1], values, rtol=1e-6, atol=0.0))


def differentiable(problem: Problem, keys: Sequence[str]) -> bool:
    """Whether a linear solution tells derivatives by these constants at every equilibrium."""
    known = problem.parameters
    return not (
        any(key not in known or known[key].ufl_shape for key in keys)
        or without_gradient(problem)
        or problem.terms.bars
    )


def _name(wanted: Wanted, problem: Problem, probes: Mapping[str, Sequence[float]]) -> str:
    """A column of the history by the name of the same number."""
    match = None if wanted.part else _AXIS.fullmatch(wanted.name)
    if match is None:
        return str(wanted).replace(" on ", " of ") if wanted.name == "reaction" else str(wanted)
    stem, axis = match["stem"], match["axis"]
    support = stem.removeprefix("reaction_")
    if stem != support and support in problem.constraints.labels:
        return f"reaction_{axis} of {support}"
    if stem in probes:
        return f"displacement_{axis} of {stem}"
    return str(wanted)
