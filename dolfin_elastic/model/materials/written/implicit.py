"""Memory that a user writes as an evolution: its rate, or equations of a step.

The energy psi(F, x) is what is stored; its names of history x are values at the end of a step, and
x_old those at its start.  A rate dx/dt = f(F, x) becomes the equations of backward Euler,

    x - x_old - dt f(F, x) = 0,

or of the trapezoidal rule, with the mean of f at both ends of the step, of which that at its start
is remembered.  `residual` gives equations of one's own.  The stress is dpsi/dF with x fixed.  A
variable that keeps its determinant is x/det(x)^(1/3) of the root x.

Source: Simo & Hughes, Computational Inelasticity (1998), sections 1.4 and 8.2; the rule: E. Hairer
and G. Wanner, Solving Ordinary Differential Equations II (1996), section IV.3; the projection:
A. V. Shutov, R. Landgraf and J. Ihlemann, Comput. Methods Appl. Mech. Eng. 265 (2013) 213, whose
closed form for a Maxwell branch backward Euler equals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.model.materials.law import SplitLaw, once
from dolfin_elastic.model.materials.memory import (
    Equations,
    ImplicitMemory,
    ImplicitStep,
    Root,
    Variable,
    of_dissipation,
    unimodular,
    with_dissipation,
)
from dolfin_elastic.model.materials.stepped import SteppedSplitLaw
from dolfin_elastic.model.materials.written.history import (
    DT,
    Remembering,
    SteppedUser,
    old,
)


def _rate(variable: Variable) -> Variable:
    """Derivative of a variable by time [1/s]."""
    return Variable(f"rate_of_{variable.name}", variable.shape)


def _mean(before: Expr, rate: Expr) -> Expr:
    """Of the rates at both ends of a step; where there was none before, as at rest, the last one.

    So a sudden load is followed by backward Euler, which knows nothing of the time before it.
    """
    share = ufl.conditional(ufl.eq(ufl.inner(before, before), 0), 0.0, 0.5)
    return share * before + (1 - share) * rate


class EvolutionMemory(ImplicitMemory):
    """What a user's law remembers that gives rates or equations."""

    def __init__(self, law: Remembering) -> None:
        self._law, self.timed = law, law.timed
        self.unknowns = tuple(law.history.values())
        rates = map(_rate, self.unknowns) if law.trapezoidal else ()
        self.variables = (*self.unknowns, *of_dissipation(self.unknowns), *rates)

    def with_root(
        self, past: Mapping[str, Expr], step: Mapping[str, Expr], root: Root
    ) -> SteppedEvolution:
        """See `ImplicitMemory`."""
        if isinstance(self._law, SplitLaw):
            return SteppedSplitEvolution(self._law, past, step, root)
        return SteppedEvolution(self._law, past, step, root)

    def step(self, dt: float, *, passes: bool) -> dict[str, float]:
        """See `Memory`."""
        return {DT: dt}


@dataclass(frozen=True)
class SteppedEvolution(ImplicitStep, SteppedUser):
    """A user's law over a time step whose history follows from equations.

    Attributes:
        root: Of the equations.
    """

    root: Root

    def _at(self, values: Mapping[str, Expr]) -> Remembering:
        """The law with values at the end of the step."""
        starts = {old(v.name): self.past[v.name] for v in self.root.variables}
        return self.law.with_past({**values, **starts, DT: self.step[DT]})

    def equations(self, F: Expr) -> Equations:
        """See `ImplicitStep`."""

        def residual(now: Mapping[str, Expr]) -> Mapping[str, Expr]:
            given = self._at(now).following(F)
            if not self.law.by_rate:
                return given
            dt = self.step[DT]
            if self.law.trapezoidal:
                before = {v.name: self.past[_rate(v).name] for v in self.root.variables}
                given = {name: _mean(before[name], f) for name, f in given.items()}
            return {name: now[name] - self.past[name] - dt * f for name, f in given.items()}

        return residual

    @once
    def _now(self, F: Expr) -> dict[str, Expr]:
        """The history at the end of the step."""
        return self._kept(self.root.values(self.root.numbers(self.equations(F))))

    def _kept(self, values: Mapping[str, Expr]) -> dict[str, Expr]:
        """Values whose determinants are 1 where they are to be."""
        kept = self.law.unimodular
        return {name: unimodular(x) if name in kept else x for name, x in values.items()}

    @once
    def _then(self, F: Expr) -> Remembering:
        return self._at(self._now(F))

    @once
    def stress(self, F: Expr) -> Expr:
        """See `SteppedLaw`."""
        return self._then(F).stress(F)

    def energy(self, F: Expr) -> Expr:
        """See `SteppedLaw`."""
        return self._then(F).energy(F)

    @once
    def at_end(self, F: Expr) -> dict[str, Expr]:
        """See `OverStep`."""
        # Of x/det(x)^(1/3) the derivative is the part of the force that can do work.
        end = with_dissipation(
            self.root, self._now(F), self.past, lambda x: self._at(self._kept(x)).energy(F)
        )
        if self.law.trapezoidal:
            rates = self._then(F).following(F)
            end |= {_rate(v).name: rates[v.name] for v in self.root.variables}
        return end


@dataclass(frozen=True)
class SteppedSplitEvolution(SteppedSplitLaw, SteppedEvolution):
    """The same with a volumetric part, which remembers nothing."""

    @once
    def shape_stress(self, F: Expr) -> Expr:
        """See `SplitLaw`, over the step."""
        then = self._then(F)
        assert isinstance(then, SplitLaw)
        return then.shape_stress(F)

    def shape_energy(self, F: Expr) -> Expr:
        """See `SplitLaw`."""
        then = self._then(F)
        assert isinstance(then, SplitLaw)
        return then.shape_energy(F)
