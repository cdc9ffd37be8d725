"""Memory that a user writes: what is remembered, and what a step makes of it.

In closed form, with `next`, the energy may use the names of history, which are values at the start
of a step, and dt, its length [s].  `next` gives the values at its end, of F, of those at its start
and of dt.  The stress is dpsi/dF with the history fixed, so that it has a potential and its tangent
is symmetric.  By evolution, with `rate` or `residual`: see `implicit`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Literal, Self

import numpy as np
import ufl
from pydantic import Field, PrivateAttr, field_serializer, field_validator, model_validator
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError, nearest
from dolfin_elastic.core.schema import quoted
from dolfin_elastic.model.materials.law import SplitLaw, once
from dolfin_elastic.model.materials.memory import Memory, Variable
from dolfin_elastic.model.materials.stepped import SteppedLaw, SteppedSplitLaw
from dolfin_elastic.model.materials.viscous import Viscous

DT = "dt"
OLD = "_old"
"""After a name of history: its value at the start of a step, where the name is that at its end."""
_STARTS = {"I": 1.0, "0": 0.0}
"""Texts for tensors at the start."""
_KEEPS = "determinant"
"""Key of a table {start = "I", determinant = 1} of a tensor whose determinant stays."""


def old(name: str) -> str:
    """The name of the value at the start of a step."""
    return name + OLD


@cache
def opaque(value: float) -> Expr:
    """A number as a UFL scalar that UFL does not compute with: dt = 0 may be a denominator.

    Of `where(dt > 0, a/dt, b)` UFL would refuse a/0 before it has seen the condition.
    """
    return ufl.variable(ufl.as_ufl(value))


@cache
def _at_start(variable: Variable) -> Expr:
    """A variable of the body at rest."""
    if variable.shape == "scalar":
        return opaque(variable.start)
    return opaque(variable.start) * ufl.Identity(3)


def _variable(name: str, start: object) -> Variable:
    if isinstance(start, Variable):
        return start
    if isinstance(start, Mapping):
        return _unimodular(name, start)
    if isinstance(start, int | float) and not isinstance(start, bool) and np.isfinite(start):
        return Variable(name, start=float(start))
    if isinstance(start, str) and start in _STARTS:
        return Variable(name, "symmetric", _STARTS[start])
    if isinstance(start, np.ndarray | list) and np.shape(start) == (3, 3):
        tensor = np.asarray(start)
        if np.issubdtype(tensor.dtype, np.number) and np.array_equal(
            tensor, tensor[0, 0] * np.eye(3)
        ):
            return Variable(name, "symmetric", float(tensor[0, 0]))
    raise InputError(
        f"{quoted(start)} is no start of a history",
        where=name,
        expected='a number; of a symmetric tensor "I", "0" or a multiple of the unit matrix',
    )


def _unimodular(name: str, table: Mapping[object, object]) -> Variable:
    """A tensor whose determinant stays, {start = "I", determinant = 1}."""
    rest = {key: value for key, value in table.items() if key not in ("start", _KEEPS)}
    variable = _variable(name, table.get("start", "I"))
    if rest or table.get(_KEEPS, 1) != 1 or variable.shape == "scalar" or variable.start != 1.0:
        raise InputError(
            f"{quoted(dict(table))} is no start of a history",
            where=name,
            expected=f'{{start = "I", {_KEEPS} = 1}} of a tensor whose determinant stays 1',
        )
    return Variable(name, variable.shape, 1.0, unimodular=_KEEPS in table)


def check_names(history: Collection[str], given: Collection[str], key: str) -> None:
    """Checks the names of `next`, `rate` or `residual`.

    Args:
        key: Where they were given: one of these three.

    Raises:
        InputError: A name that is none of history, or a name of history that is missing.
    """
    for name in given:
        if name not in history:
            raise InputError(
                f"there is no history '{name}'",
                where=f"{key}.{name}",
                expected=nearest(name, history),
            )
    for name in history:
        if name not in given:
            raise InputError(
                f"nothing says what '{name}' is at the end of a step",
                where=key,
                expected=f"a formula for {name}, too",
            )


def which(given: Mapping[str, object], *, history: bool) -> str | None:
    """The key that says how a history follows: "next", "rate" or "residual"; None without any.

    Args:
        given: These keys to what is written there.
        history: The material has a history, whose names these keys follow.

    Raises:
        InputError: More than one, none beside a history, or one without a history.
    """
    written = [key for key, value in given.items() if value]
    if len(written) > 1:
        raise InputError(
            f"`{written[0]}` beside `{written[1]}`",
            where=written[1],
            expected="one of them: next, rate or residual",
        )
    if history and not written:
        raise InputError(
            "a history, and nothing says how it follows",
            where="history",
            expected="next, values at the end of a step; or rate, derivatives by time; or "
            "residual, equations of a step",
        )
    if written and not history:
        raise InputError(
            f"`{written[0]}` without a history",
            where="history",
            expected='{h = 0, Cv = "I"}, values in the body at rest',
        )
    return written[0] if written else None


class Remembering(Viscous):
    """A law that may have a history of the user's own.

    Attributes:
        history: Name to value in the body at rest: what is remembered at each point. The energy and
            `next` may use the names, which are values at the start of a time step, and dt [s].
        rate_integration: How a step follows `rate`: "backward-euler", or "trapezoidal", whose error
            falls with the square of the step where loads do not jump.
    """

    history: dict[str, Variable] = Field(default={})
    rate_integration: Literal["backward-euler", "trapezoidal"] | None = None

    _past: Mapping[str, Expr] = PrivateAttr(default={})

    @field_validator("history", mode="before")
    @classmethod
    def _starts(cls, table: object) -> dict[str, Variable]:
        if not isinstance(table, Mapping) or not table:
            raise InputError(f"{quoted(table)} is wrong", expected="expected {h = 0, ...}")
        return {str(name): _variable(str(name), start) for name, start in table.items()}

    @model_validator(mode="after")
    def _remembers_one_thing(self) -> Self:
        if self.history and self.viscous:
            raise InputError(
                "`viscous` beside a history of your own",
                where="viscous",
                expected="one of them; branches can be written into energy and next",
            )
        return self

    @model_validator(mode="after")
    def _integrates_a_rate(self) -> Self:
        if self.rate_integration is not None and not self.by_rate:
            raise InputError(
                "`rate_integration` without a rate",
                where="rate_integration",
                expected="`rate` of a history, derivatives by time",
            )
        return self

    @field_serializer("history")
    def _starts_as_written(self, table: Mapping[str, Variable]) -> dict[str, object]:
        texts = {start: text for text, start in _STARTS.items()}
        return {
            name: v.start
            if v.shape == "scalar"
            else {"start": "I", _KEEPS: 1}
            if v.unimodular
            else texts.get(v.start, (v.start * np.eye(3)).tolist())
            for name, v in table.items()
        }

    @property
    def of_history(self) -> frozenset[str]:
        """Names that the history adds to those of an energy."""
        if not self.history:
            return frozenset()
        before = [old(name) for name in self.history] if self.evolves else []
        return frozenset({*self.history, *before, DT})

    @property
    def trapezoidal(self) -> bool:
        """Rates at both ends of a step count."""
        return self.rate_integration == "trapezoidal"

    @property
    def unimodular(self) -> frozenset[str]:
        """Names of the history whose determinant stays 1."""
        return frozenset(name for name, v in self.history.items() if v.unimodular)

    @property
    @abstractmethod
    def follows_by(self) -> str | None:
        """The key that says how the history follows: "next", "rate" or "residual"."""

    @property
    def evolves(self) -> bool:
        """`rate` or `residual` says how the history follows."""
        return self.follows_by in ("rate", "residual")

    @property
    def by_rate(self) -> bool:
        """`rate` says so."""
        return self.follows_by == "rate"

    @property
    @abstractmethod
    def timed(self) -> bool:
        """Energy or `next` use dt."""

    @abstractmethod
    def following(self, F: Expr) -> dict[str, Expr]:
        """What `next`, `rate` or `residual` gives, by name: UFL scalars, tensors of (3, 3)."""

    def with_past(self, past: Mapping[str, Expr]) -> Self:
        """The law over a step, with other values than those of the body at rest and dt = 0.

        Args:
            past: Of names of history at the start of the step, and "dt".
        """
        result = self.model_copy()
        result._past = past
        return result

    def past_values(self, wanted: Collection[str]) -> dict[str, Expr]:
        """Values at the start of the step, of those names in `wanted` that are of history."""
        at_rest = {DT: opaque(0.0)} if self.history else {}
        at_rest |= {name: _at_start(v) for name, v in self.history.items()}
        at_rest |= {old(name): _at_start(v) for name, v in self.history.items() if self.evolves}
        return {n: self._past.get(n, value) for n, value in at_rest.items() if n in wanted}


class UserMemory(Memory):
    """What a user's law remembers."""

    def __init__(self, law: Remembering) -> None:
        self._law, self.timed = law, law.timed
        self.variables = tuple(law.history.values())

    def over_step(self, past: Mapping[str, Expr], step: Mapping[str, Expr]) -> SteppedLaw:
        """See `Memory`."""
        if isinstance(self._law, SplitLaw):
            return SteppedUserSplit(self._law, past, step)
        return SteppedUser(self._law, past, step)

    def step(self, dt: float, *, passes: bool) -> dict[str, float]:
        """See `Memory`."""
        starts = {f"start.{v.name}": v.start for v in self.variables}
        return {DT: dt, **starts, f"start.{DT}": 0.0}


@dataclass(frozen=True)
class SteppedUser(SteppedLaw):
    """A user's law over a time step.

    Nobody knows how much of the work is stored: `energy` is that of a body without a past, and the
    work of the rest of the stress, `branch_stress`, is stored or lost.
    """

    law: Remembering

    def _then(self, F: Expr) -> Remembering:
        """The law over the step."""
        return self.law.with_past({**self.past, DT: self.step[DT]})

    def formulas(self, F: Expr) -> dict[str, Expr]:
        """What the formulas of the history give over the step, see `Remembering.following`."""
        return self._then(F).following(F)

    @property
    def _fresh(self) -> Remembering:
        """The law without a past; in constants, for forms would divide by a number 0."""
        past = {DT: self.step[f"start.{DT}"]}
        for name, variable in self.law.history.items():
            start = self.step[f"start.{name}"]
            past[name] = start if variable.shape == "scalar" else start * ufl.Identity(3)
        return self.law.with_past(past)

    @once
    def stress(self, F: Expr) -> Expr:
        """See `SteppedLaw`."""
        return self._then(F).stress(F)

    def energy(self, F: Expr) -> Expr:
        """See the class."""
        return self._fresh.energy(F)

    def branch_stress(self, F: Expr) -> Expr:
        """See the class: what the past adds to the stress."""
        return self.stress(F) - self._fresh.stress(F)

    def at_end(self, F: Expr) -> dict[str, Expr]:
        """See `OverStep`."""
        return self._then(F).following(F)


@dataclass(frozen=True)
class SteppedUserSplit(SteppedSplitLaw, SteppedUser):
    """The same with a volumetric part, which remembers nothing."""

    @once
    def shape_stress(self, F: Expr) -> Expr:
        """See `SplitLaw`, over the step."""
        then = self._then(F)
        assert isinstance(then, SplitLaw)
        return then.shape_stress(F)

    def shape_energy(self, F: Expr) -> Expr:
        """See the class, without volumetric part."""
        fresh = self._fresh
        assert isinstance(fresh, SplitLaw)
        return fresh.shape_energy(F)

    def branch_stress(self, F: Expr) -> Expr:
        """See `SteppedUser`."""
        fresh = self._fresh
        assert isinstance(fresh, SplitLaw)
        return self.shape_stress(F) - fresh.shape_stress(F)
