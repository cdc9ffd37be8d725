"""Gradients of natural frequencies of a body at rest.

With K u = omega^2 M u, d(omega^2)/dm = u . (dK/dm - omega^2 dM/dm) u/(u . M u): the mode does not
count, and no further system is solved.  Source: R. L. Fox and M. P. Kapoor, AIAA J. 6 (1968) 2426.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
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

_NAMES = {"modal": "frequency", "buckling": "load_factor"}
_NAME = re.compile(r"(frequency|load_factor)_([1-9]\d*)")
_OPTION = "--of"
_APART = 5e-3
"""Relative distance of two frequencies below which they count as one."""
_SAME = 1e-6
"""Relative distance of Rayleigh's quotient from the frequency, whose error is that of the mode."""


def analysis_of(name: str) -> str:
    """Whose number it is: "modal", "buckling", or else "statics"."""
    match = _NAME.fullmatch(name.strip())
    words = {word: analysis for analysis, word in _NAMES.items()}
    return "statics" if match is None else words[match[1]]


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
    for name, mode in chosen(names, modes, "elastic"):
        one = Frequency(name, problem, np.array(mode.u.x.array))
        check_quotient(mode, one.value(np.zeros(0)), mode.frequency)
        result.append(one)
    return result


def chosen(
    names: Sequence[str], modes: Mapping[int, Mode], kind: str
) -> Iterator[tuple[str, Mode]]:
    """Names without blanks, and the mode of each, which is alone. Not collective.

    Args:
        names: "frequency_1" ... or "load_factor_1" ...
        modes: Number to mode, of all that were found.
        kind: "elastic" or "buckling".

    Raises:
        InputError: See `frequencies`.
    """
    for name in names:
        match = _NAME.fullmatch(name.strip())
        assert match is not None
        number = int(match[2])
        mode = modes.get(number)
        if mode is None or mode.kind != kind:
            raise InputError(
                f"mode {number} is {'rigid' if mode else 'not among those that were found'}",
                where=_OPTION,
                expected=f"one of the {len(modes)} modes, or a larger count",
            )
        near = [
            other.number
            for other in modes.values()
            if other is not mode
            and abs(other.eigenvalue - mode.eigenvalue) < 2 * _APART * abs(mode.eigenvalue)
        ]
        if near:
            raise InputError(
                f"modes {number} and {near[0]} have the same {match[1].replace('_', ' ')}, which "
                "has no derivative",
                where=_OPTION,
                expected="another mode, or a body without that symmetry",
            )
        yield name.strip(), mode


def check_quotient(mode: Mode, found: float, known: float) -> None:
    """Compares Rayleigh's quotient of a mode with its eigenvalue. Not collective.

    Args:
        found: Quotient of the forms that are differentiated.
        known: Value that the eigensolver gives [1/s or 1].

    Raises:
        InputError: They differ.
    """
    if not abs(found - known) <= _SAME * abs(known):
        raise InputError(
            f"Rayleigh's quotient of mode {mode.number} is not its value: the case has a "
            "stiffness that gradients do not know",
            where="gradient",
            expected="`sweep`",
        )


def with_one_more(case: Case, names: Sequence[str]) -> Case:
    """The case with a mode beyond those of names, which tells whether the last one is alone.

    Raises:
        InputError: The case asks for fewer modes.
    """
    numbers = [int(match[2]) for name in names if (match := _NAME.fullmatch(name.strip()))]
    count = 0
    if case.buckling is not None:
        count = case.buckling.count
    elif case.modal is not None and case.modal.below is None:
        count = case.modal.count or 6
    if 0 < count < max(numbers):
        raise InputError(
            f"mode {max(numbers)} is not among the {count} of the case",
            where=_OPTION,
            expected=f"a mode up to {count}, or {case.analysis}.count = {max(numbers)}",
        )
    return case.changed({f"{case.analysis}.count": count + 1}) if max(numbers) == count else case


def check_modes(case: Case, problem: Problem) -> None:
    """Refuses modes whose stiffness depends on more than the case's numbers.

    Raises:
        InputError: They are about a loaded state, or have other unknowns or contact.
    """
    settings = case.modal or case.buckling
    preloaded = settings is not None and bool(settings.preload)
    beside = problem.w is not problem.u
    if preloaded or beside or problem.contact_pairs or problem.terms.bars:
        what = "with unknowns beside the displacement, or contact"
        what = "about a loaded state" if preloaded else what
        raise InputError(
            f"there is no gradient of modes {what}", where="gradient", expected="`sweep`"
        )
