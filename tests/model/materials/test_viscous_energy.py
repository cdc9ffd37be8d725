"""What branches of linear laws store and lose, at a point: closed forms, and one step as many."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import ufl
from ufl.algorithms import expand_derivatives

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.kinematics import gradient_symbol
from dolfin_elastic.model.materials.memory import SIX
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.model.materials.stepped import SteppedLaw
from dolfin_elastic.model.materials.viscous import LinearRelaxation, _Account
from dolfin_elastic.model.point.ufl_to_numpy import NumpyProgram

RATIOS, TIMES = np.array([0.4, 0.25]), np.array([0.5, 0.05])
SERIES = [{"ratio": r, "time": t} for r, t in zip(RATIOS, TIMES, strict=True)]
MU = 2.0
KINDS = [("linear-elastic", "isochoric"), ("linear-elastic", "whole"), ("orthotropic", "whole")]


def law(name: str, on: str) -> Any:
    given: Any = {"mu": MU, "nu": 0.3} if name == "linear-elastic" else MATERIALS[name].example
    return MATERIALS[name](**given, viscous=SERIES, viscous_on=on)


class Point:
    """What a law remembers at one point, along strains of given times.

    Attributes:
        lost: At each time, from the values; shape (n,).
        stored: The same, from the law over a step that begins there.
        before: Lost and stored at the end of each step, from the law over that step.
    """

    def __init__(self, material: Any, F: FloatArray, t: FloatArray) -> None:
        memory = material.memory
        assert isinstance(memory, LinearRelaxation)
        self._symbol = gradient_symbol()
        domain = self._symbol.ufl_domain()
        self._past = ufl.Constant(domain, (21,))
        self._memory, self._F = memory, F
        S, E = (self._numbers(name) for name in ("S", "E"))
        values = {v.name: np.zeros((1, v.size)) for v in memory.variables}
        self.before, lost, stored = [], [], []
        for n in range(1, len(t)):
            dt = t[n] - t[n - 1]
            self.before.append(self._told(values, dt, F[n]))
            now = {"S": S[n : n + 1], "E": E[n : n + 1]}
            values = dict(memory.follow(values, now, dt))
            lost.append(values["lost"][0, 0])
            stored.append(self._told(values, 0.0, F[n])[1])
        self.lost, self.stored = np.array(lost), np.array(stored)
        self.values = values

    def _over(self, dt: float) -> SteppedLaw:
        past, at = {}, 0
        for v in (*self._memory.seen, *self._memory.told):
            part = ufl.as_vector([self._past[at + i] for i in range(v.size)])
            past[v.name], at = v.value(part), at + v.size
        step = {n: ufl.as_ufl(x) for n, x in self._memory.step(dt, passes=True).items()}
        over = self._memory.over_step(past, step)
        assert isinstance(over, SteppedLaw)
        return over

    def _numbers(self, name: str) -> FloatArray:
        expression = expand_derivatives(self._over(0.1).at_end(self._symbol)[name])
        tensor = NumpyProgram(expression, self._symbol, self._past)(
            self._F, np.zeros((len(self._F), 21))
        )
        return np.stack([tensor[:, i, j] for i, j in SIX], axis=1)

    def _told(self, values: Any, dt: float, F: FloatArray) -> tuple[float, float]:
        given = {**self._memory.fold(values, dt), **self._memory.tell(values, dt)}
        every = (*self._memory.seen, *self._memory.told)
        row = np.concatenate([given[v.name][0] for v in every])
        over = self._over(dt)
        lost, stored = (
            NumpyProgram(expand_derivatives(one), self._symbol, self._past)(F[None], row[None])[0]
            for one in (over.lost(self._symbol), over.stored(self._symbol))
        )
        return float(lost), float(stored)


def shears(amounts: FloatArray) -> FloatArray:
    F = np.tile(np.eye(3), (len(amounts), 1, 1))
    F[:, 0, 2] = amounts
    return F


# --- one branch ---


@pytest.mark.parametrize("x", [1e-12, 1e-6, 0.01, 0.3, 0.5, 0.500001, 2.0, 60.0, 1e4])
def test_the_integrals_of_a_branch(x: float) -> None:
    """By quadrature in 40 digits; with what is stored, lost is the work."""
    import mpmath as mp

    with mp.workdps(40):
        X = mp.mpf(x)

        def strain(s: Any, e: float, d: float) -> Any:
            E = mp.exp(-s)
            return e * E + d / X * (1 - E)

        def lost(e: float, d: float) -> Any:
            nodes = [0, *(X * mp.mpf(10) ** -k for k in range(5, -1, -1))]
            return mp.quad(lambda s: strain(s, e, d) ** 2, nodes)

        squares = [lost(1, 0), lost(1, 1) - lost(1, 0) - lost(0, 1), lost(0, 1)]
        wanted = [float(one) for one in squares]
    f = -np.expm1(-x) / x
    account = _Account(np.array([x]), np.array([np.exp(-x)]), np.array([f]))
    # Of (1 - f)/x - f^2/2 at x = 0.5 a sixth of the terms is left.
    assert account.lost[:, 0] == pytest.approx(wanted, rel=2e-14)
    work = np.array([0, f, account.g[0] + f**2 / 2])
    stored = account.stored[:, 0] - [0.5, 0, 0]
    assert account.lost[:, 0] + stored == pytest.approx(work, rel=1e-13, abs=1e-14)


# --- a law ---


@pytest.mark.parametrize(("name", "on"), KINDS)
def test_one_step_is_as_many(name: str, on: str) -> None:
    """Of strains linear in time the steps are exact, energies too; and never less than 0 is lost.

    The law over a step tells at its end what is remembered then.
    """
    random = np.random.default_rng(2)
    corners = np.concatenate([np.zeros((1, 3, 3)), 1e-2 * random.normal(size=(6, 3, 3))])
    times = np.array([0, 0.01, 0.5, 0.6, 3.0, 3.001, 3.2])
    coarse = Point(law(name, on), np.eye(3) + corners, times)
    t = np.concatenate(
        [[0.0], *(np.linspace(a, b, 8)[1:] for a, b in zip(times, times[1:], strict=False))]
    )
    path = np.stack([np.interp(t, times, c) for c in corners.reshape(7, 9).T], axis=1)
    fine = Point(law(name, on), np.eye(3) + path.reshape(-1, 3, 3), t)
    assert coarse.lost == pytest.approx(fine.lost[6::7], rel=1e-11)
    assert coarse.stored == pytest.approx(fine.stored[6::7], rel=1e-11)
    for point in (coarse, fine):
        told = np.array(point.before)
        assert told[:, 0] == pytest.approx(point.lost, rel=1e-11)
        assert told[:, 1] == pytest.approx(point.stored, rel=1e-11)
        assert np.all(np.diff(point.lost, prepend=0.0) >= 0)
        assert np.all(point.stored > 0)


def test_a_sudden_shear_is_lost_in_the_end() -> None:
    """First all is stored, mu/2 sum w s^2; of each branch exp(-2 t/tau) is left."""
    size, t = 0.01, np.concatenate([[0.0, 0.0], 0.2 * np.arange(1, 8)])
    point = Point(
        law("linear-elastic", "isochoric"), shears(np.where(np.arange(9) > 0, size, 0)), t
    )
    stored = MU / 2 * size**2 * np.exp(-2 * t[1:, None] / TIMES) @ RATIOS
    assert point.stored == pytest.approx(stored, rel=1e-12)
    assert point.lost == pytest.approx(stored[0] - stored, rel=1e-12, abs=1e-20)


def lost_in_a_cycle(steps: int) -> float:
    """Of the fifth period of a shear of 0.01 sin(6 t)."""
    omega, size = 6.0, 0.01
    t = np.linspace(0, 5 * 2 * np.pi / omega, 5 * steps + 1)
    lost = Point(law("linear-elastic", "whole"), shears(size * np.sin(omega * t)), t).lost
    return float(lost[-1] - lost[-1 - steps])


@pytest.mark.long
def test_a_cycle_loses_the_loss_modulus() -> None:
    """pi G'' s^2, Ferry (1980), chapter 1, (47), to second order.

    Of the transient exp(-4 period/tau), 2e-4 of the slower branch, is left in the stress.
    """
    x = 6.0 * TIMES
    wanted = np.pi * MU * (RATIOS @ (x / (1 + x**2))) * 0.01**2
    found = [lost_in_a_cycle(n) for n in (12, 24, 48)]
    changes = np.abs(np.diff(found))
    assert np.log2(changes[0] / changes[1]) == pytest.approx(2, abs=0.1)
    assert found[2] + (found[2] - found[1]) / 3 == pytest.approx(wanted, rel=1e-4)
