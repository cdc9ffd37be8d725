"""Gradients of natural frequencies of a body at rest.

With K u = omega^2 M u, d(omega^2)/dm = u . (dK/dm - omega^2 dM/dm) u/(u . M u): the mode does not
count, and no further system is solved.  Source: R. L. Fox and M. P. Kapoor, AIAA J. 6 (1968) 2426.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import ufl
from dolfinx import fem

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import Mode
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled, integral
from dolfin_elastic.study.gradient.functionals import Functional
from dolfin_elastic.study.gradient.parameters import Sides

if TYPE_CHECKING:
    from dolfin_elastic.case.case import Case

_NAME = re.compile(r"frequency_([1-9]\d*)")
_OPTION = "--of"
_APART = 5e-3
"""Relative distance of two frequencies below which they count as one."""
_SAME = 1e-6
"""Relative distance of Rayleigh's quotient from the frequency, whose error is that of the mode."""


def is_frequency(name: str) -> bool:
    """Whether a number is a natural frequency."""
    return _NAME.fullmatch(name.strip()) is not None


class Frequency(Functional):
    """A natural frequency by Rayleigh's quotient of its mode.  All of it is collective.

    Args:
        shape: Of the mode, as the displacement's local array.
    """

    def __init__(self, name: str, problem: Problem, shape: FloatArray) -> None:
        super().__init__(name, "Hz", problem)
        u = fem.Function(problem.V)
        u.x.array[:] = shape
        self._square = problem.constant(0.0)
        stiffness = ufl.action(ufl.action(problem.weak_form.tangent, u), u)
        mass = sum(rho * ufl.inner(u, u) * dx for rho, dx in problem.context.inertia(()))
        self._forms = compiled(problem, [stiffness, mass])
        self.form = stiffness - self._square * mass
        self.shape, self._mass = shape, 0.0

    def value(self, forces: FloatArray) -> float:
        """See `Functional`."""
        stiffness, self._mass = (integral(self.problem, form) for form in self._forms)
        self._square.value = stiffness / self._mass
        return float(np.sqrt(self._square.value)) / (2 * np.pi)

    @property
    def factor(self) -> float:
        """See `Functional`."""
        return 1 / (4 * np.pi * float(np.sqrt(self._square.value)) * self._mass)

    def by_unknowns(self, assembler: Assembler) -> FloatArray:
        """See `Functional`: the body is at rest."""
        return np.zeros(assembler.size)


class AtRest:
    """The modes of a body at rest, see `parameters.Basis`."""

    def __init__(self, frequencies: Sequence[Frequency]) -> None:
        self._frequencies = frequencies

    def evaluated(self) -> Sides:
        """All frequencies with the present constants. Collective."""
        nothing: FloatArray = np.zeros(0)
        return Sides(nothing, nothing, np.array([one.value(nothing) for one in self._frequencies]))

    def on(self, changed: Problem) -> Sides:
        """Of another problem, with the same modes. Collective."""
        return AtRest(
            [Frequency(one.name, changed, one.shape) for one in self._frequencies]
        ).evaluated()


def frequencies(
    names: Sequence[str], problem: Problem, modes: Mapping[int, Mode]
) -> list[Frequency]:
    """Natural frequencies as functionals. Collective.

    Args:
        names: "frequency_1" ...
        modes: Number to mode, of all that were found.

    Raises:
        InputError: There is no such mode, it is rigid, or another one has the same frequency.
    """
    result = []
    for name in names:
        match = _NAME.fullmatch(name.strip())
        assert match is not None
        number = int(match[1])
        mode = modes.get(number)
        if mode is None or mode.kind != "elastic":
            raise InputError(
                f"mode {number} is {'rigid' if mode else 'not among those that were found'}",
                where=_OPTION,
                expected=f"frequency_N of {len(modes)} modes, or a larger modal.count",
            )
        near = [
            other.number
            for other in modes.values()
            if other is not mode and abs(other.frequency - mode.frequency) < _APART * mode.frequency
        ]
        if near:
            raise InputError(
                f"modes {number} and {near[0]} have the same frequency, which has no derivative",
                where=_OPTION,
                expected="another mode, or a body without that symmetry",
            )
        one = Frequency(name.strip(), problem, np.array(mode.u.x.array))
        if abs(one.value(np.zeros(0)) - mode.frequency) > _SAME * mode.frequency:
            raise InputError(
                f"Rayleigh's quotient of mode {number} is not its frequency: the case has a "
                "stiffness that gradients do not know",
                where="gradient",
                expected="`sweep`",
            )
        result.append(one)
    return result


def with_one_more(case: Case, names: Sequence[str]) -> Case:
    """The case with a mode beyond those of names, which tells whether the last one is alone."""
    if case.modal is None or case.modal.below is not None:
        return case
    numbers = [int(match[1]) for name in names if (match := _NAME.fullmatch(name.strip()))]
    count = case.modal.count or 6
    return case.changed({"modal.count": count + 1}) if max(numbers) == count else case


def check_modes(case: Case, problem: Problem) -> None:
    """Refuses modes whose stiffness depends on more than the case's numbers.

    Raises:
        InputError: They are about a loaded state, or have other unknowns or contact.
    """
    preloaded = case.modal is not None and bool(case.modal.preload)
    beside = problem.w is not problem.u
    if preloaded or beside or problem.contact_pairs or problem.terms.bars:
        what = "with unknowns beside the displacement, or contact"
        what = "about a loaded state" if preloaded else what
        raise InputError(
            f"there is no gradient of frequencies {what}", where="gradient", expected="`sweep`"
        )
