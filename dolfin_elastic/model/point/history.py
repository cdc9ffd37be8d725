"""Conditions that a history must satisfy which a user has written, checked at points by steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import ufl

from dolfin_elastic.core.si_text import percent, quantity
from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.model.kinematics import variables
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.memory import LOST, Values
from dolfin_elastic.model.materials.written.history import Remembering, SteppedUser
from dolfin_elastic.model.point.steps import PointOverSteps
from dolfin_elastic.model.point.tested import (
    ROUND_OFF,
    Finding,
    I,
    LawUnderTest,
    found,
    note,
    relative,
)

SYMMETRY = "tangent of a step"
_STEPS = (0.0, 1e-3, 1.0)
"""Lengths of steps at which a history is checked [s]."""
_TINY = 1e-12
"""In place of the stiffness: of a history nobody knows the unit."""
_PATHS, _LONG = 1000, 6
"""Random paths, and steps of each, on which nothing may be won."""
_DIGITS = 1e-14
"""Of the stored energy: what a step dissipates is not known better."""
_LENGTHS = np.logspace(-6, 12, 10)
"""Lengths of steps at which the tangent is looked at [s]: of one of them the history changes."""
_CHANGED = 1e-3
"""Relative change of a history that counts as one."""
_STRAINED = 0.3
"""Size of the gradients of displacement on these paths."""
_FASTEST, _SLOWEST = -4.0, 2.0
"""Decades of the lengths of their steps [s], which come in any order."""


class _Steps(PointOverSteps):
    """A user's law over steps at points."""

    def __init__(self, law: Remembering) -> None:
        super().__init__(law)
        self.start, self._names = dict(self.values), tuple(law.history)
        self.lengths = _STEPS if law.timed else _STEPS[:1]
        self._stress = self.quantity(self.law.stress(self.F))
        self._energy = self.quantity(self.law.energy(self.F))

    def after(self, F: AnyArray, values: Values, dt: float) -> dict[str, FloatArray]:
        """The history after a step; NaN where its equations have no root."""
        self.values = dict(values)
        lost = ~self.found(F, dt=dt)
        return {
            name: np.where(lost[:, None], np.nan, value)
            for name, value in self.at_end(F, dt=dt).items()
        }

    def numbers(self, F: AnyArray, values: Values, dt: float) -> FloatArray:
        """Those of the user's own history after a step, shape (n, m)."""
        end = self.after(F, values, dt)
        return np.hstack([end[name] for name in self._names])

    def energy(self, F: AnyArray, dt: float) -> FloatArray:
        """What is stored at the end of a step from `values` [J/m^3], shape (n,)."""
        return self._energy(F, dt=dt)

    def stress(self, F: AnyArray, values: Values, dt: float) -> FloatArray:
        """P at the end of a step [Pa], shape (n, 3, 3); NaN where its equations have no root."""
        self.values = dict(values)
        return np.where(self.found(F, dt=dt)[:, None, None], self._stress(F, dt=dt), np.nan)


def changes_at_rest(law: Law) -> str:
    """What of a user's history changes in a body at rest, in words; empty: nothing."""
    if not isinstance(law, Remembering) or not law.history:
        return ""
    return _change_at_rest(law, _Steps(law))


def _change_at_rest(law: Remembering, steps: _Steps) -> str:
    names = [name for name, v in law.history.items() for _ in range(v.size)]
    start = np.hstack([steps.start[name] for name in law.history])[0]
    for dt in steps.lengths:
        end = steps.numbers(I[None], steps.start, dt)[0]
        off = np.abs(end - start) > ROUND_OFF * np.maximum(np.abs(start), 1.0)
        if off.any():
            i = int(np.argmax(off))
            step = f", in a step of {quantity(dt, 's')}" if law.timed else ""
            return f"{names[i]} changes at rest, from {start[i]:.6g} to {end[i]:.6g}{step}"
    return ""


def history(tested: LawUnderTest) -> Iterator[Finding]:
    """A user's history after a step is finite, the same in a turned body, and wins no energy."""
    law = tested.law
    if not isinstance(law, Remembering) or not law.history:
        return
    steps = _Steps(law)
    near = np.concatenate([I[None], tested.near])
    for dt in steps.lengths:
        if not np.isfinite(steps.numbers(near, steps.start, dt)).all():
            what = "its equations have no root that is found" if law.evolves else "not finite"
            text = f"{what} at rest or at strains of a few per cent, with dt = {dt:g} s"
            if law.evolves and not np.isfinite(_at_rest(steps, dt)).all():
                text = (
                    f"its equations or their derivatives are not finite at rest, with dt = {dt:g} "
                    "s: of sqrt(inner(A, A)) write norm(A), whose derivative at 0 has a value"
                )
            elif law.by_rate:
                text += ": is `rate` too fast, or its sign wrong?"
            yield found("finite history", False, text)
            return
    yield found("finite history", True, "finite near the rest")
    if tested.frame_indifferent:
        yield from _turned(tested, law, steps)
        yield from _after_a_step(tested, steps)
    skew = _skew(law, steps, tested.near)
    yield found("symmetric history", skew <= 1e3 * ROUND_OFF, f"asymmetry {skew:.2g}", error=skew)
    if law.evolves:
        # Of the trapezoidal rule only short steps lose energy surely; it is the rate that is asked.
        euler = law.model_copy(update={"rate_integration": None}) if law.trapezoidal else law
        yield from _dissipation(euler, _Steps(euler) if law.trapezoidal else steps)
        yield from _symmetry(tested, law, steps)
    if change := _change_at_rest(law, steps):
        yield note("history at rest", change)
    else:
        yield found("history at rest", True, "does not change")


def _at_rest(steps: _Steps, dt: float) -> FloatArray:
    """Equations of a body at rest, and their derivatives."""
    steps.values = dict(steps.start)
    return steps.equations(I[None], dt=dt)


def _turned(tested: LawUnderTest, law: Remembering, steps: _Steps) -> Iterator[Finding]:
    F, error = tested.near, 0.0
    Q = tested.rotations[: len(F)]
    for dt in steps.lengths:
        ends, turned = (steps.numbers(G, steps.start, dt) for G in (F, Q @ F))
        error = max(error, relative(turned, ends, _TINY))
    good = error <= 1e3 * ROUND_OFF
    text = f"largest difference {error:.2g}"
    if not good:
        text += (
            f"; write {law.follows_by} in C, E or invariants: turning the body must not change it"
        )
    yield found("history frame indifference", good, text, error=error)


def _skew(law: Remembering, steps: _Steps, F: AnyArray) -> float:
    """Largest asymmetry of the formulas of tensors in the second step, over their largest entry."""
    error, steps.values = 0.0, steps.after(F[::-1], steps.start, 1.0)
    assert isinstance(steps.law, SteppedUser)
    for name, formula in steps.law.formulas(steps.F).items():
        if law.history[name].shape != "scalar":
            value = steps.quantity(formula)(F, dt=1.0)
            error = max(error, relative(value, value.transpose(0, 2, 1), _TINY))
    return error


def _after_a_step(tested: LawUnderTest, steps: _Steps) -> Iterator[Finding]:
    """The stress of the second step, of a body that was strained, is finite and turns with it."""
    F = tested.near
    past, Q = steps.after(F[:1], steps.start, 1.0), tested.rotations[: len(F)]
    P, turned = (steps.stress(G, past, 1.0) for G in (F, Q @ F))
    if not np.isfinite(P).all():
        yield found("second step", False, "the stress after a step of 1 s is not finite")
        return
    error = relative(turned, Q @ P, tested.scale)
    good = error <= 1e3 * ROUND_OFF
    text = f"finite, and turns with the body, to {error:.2g}"
    if not good:
        text = f"the stress does not turn with the body ({error:.2g}): write the energy in C, E or "
        text += "invariants"
    yield found("second step", good, text, error=error)


def _dissipation(law: Remembering, steps: _Steps) -> Iterator[Finding]:
    """-dpsi/dx : dx is nowhere negative on random paths of fast and slow steps."""
    draw = np.random.default_rng(9)
    values = {name: np.repeat(value, _PATHS, axis=0) for name, value in steps.start.items()}
    good = np.ones(_PATHS, dtype=bool)
    negative, most = np.zeros(_PATHS, dtype=bool), 0.0
    for dt in map(float, draw.permutation(np.logspace(_FASTEST, _SLOWEST, _LONG))):
        F = I + _STRAINED * draw.uniform(-1, 1, (_PATHS, 3, 3)) / np.sqrt(3)
        end = steps.after(F, values, dt)
        good &= np.isfinite(np.hstack([*end.values()])).all(axis=1)
        change = (end[LOST.name] - values[LOST.name])[:, 0]
        most = max(most, float(np.abs(change[good]).max(initial=0.0)))
        stored = float(np.abs(steps.energy(F, dt)[good]).max(initial=0.0))
        negative |= good & (change < -max(ROUND_OFF * most, _DIGITS * stored))
        values = {name: np.where(good[:, None], value, values[name]) for name, value in end.items()}
    wins = float(negative.mean())
    if wins:
        text = (
            f"energy is won on {percent(wins)} of {_PATHS} random paths: -dpsi/dx dx/dt < 0; has "
        )
        text += f"`{law.follows_by}` a wrong sign, or a tensor no determinant = 1?"
    else:
        text = f"not negative on {_PATHS} random paths"
    yield found("dissipation", not wins, text, fraction=wins)
    if lost := float(1 - good.mean()):
        yield note(
            "equations of a step",
            f"without a root on {percent(lost)} of {_PATHS} random paths with gradients up to "
            f"{_STRAINED:g} and steps of {10**_FASTEST:g} s to {10**_SLOWEST:g} s: there a step is "
            "halved",
            fraction=lost,
        )


def _symmetry(tested: LawUnderTest, law: Remembering, steps: _Steps) -> Iterator[Finding]:
    """Whether the tangent of a step is symmetric, in bodies that were strained before.

    Where no step changes the history nothing is known of it, which is said as not symmetric.
    """
    H, variable = variables(steps.F)
    tangent = steps.quantity(ufl.diff(steps.law.stress(variable), H))
    draw, skew, changed = np.random.default_rng(10), 0.0, 0.0
    for dt in map(float, _LENGTHS if steps.lengths[1:] else _LENGTHS[:3]):
        some = I + _STRAINED * draw.uniform(-1, 1, (6, 3, 3)) / np.sqrt(3)
        F = np.concatenate([tested.near, some])
        before = steps.after(F[::-1], steps.start, dt)
        end, A = steps.after(F, before, dt), tangent(F, dt=dt)
        good = np.isfinite(A).all(axis=(1, 2, 3, 4))
        good &= np.isfinite(np.hstack([*end.values()])).all(axis=1)
        if good.any():
            skew = max(skew, relative(A[good], A[good].transpose(0, 3, 4, 1, 2), tested.scale))
            moved = [np.abs(end[v] - before[v])[good].max() for v in law.history]
            sizes = [np.abs(end[v][good]).max() for v in law.history]
            changed = max(
                changed, *(a / b for a, b in zip(moved, sizes, strict=True) if b > 0), 0.0
            )
    symmetric = skew < ROUND_OFF and changed > _CHANGED
    text = f"asymmetry {skew:.2g}" if changed > _CHANGED else "unknown: no step changes the history"
    if not symmetric:
        text += ": systems of equations take more memory, and longer"
    yield note(SYMMETRY, text, error=skew, symmetric=symmetric)


_SHORTER = np.logspace(0, 6, 13)
"""What a step is divided by."""
_SMALL_STRAIN = 1e-4
"""At which viscous flow is linear, and metals creep no more than they do slowly."""


def error_of_rates(law: Law) -> Callable[[float], float]:
    """Error of the stress of a small shear that grows linearly, by steps of up to a length [s].

    Of the deviator, over the deviator, the largest of steps of this length and of shorter ones,
    which see more of what relaxes within a long one; by Richardson's extrapolation from one step
    and two of half the length: the error of backward Euler is proportional to the length, that of
    the trapezoidal rule, in a second step, to its square.  0 where no rate is integrated.
    """
    if not isinstance(law, Remembering) or not law.by_rate:
        return lambda dt: 0.0
    steps, strain = _Steps(law), np.diag([1.0, -0.6, -0.4]) + 0.5 * np.eye(3, k=1)
    begin, half, end = ((I + k * _SMALL_STRAIN * strain)[None] for k in (0.5, 0.75, 1))

    def deviator(F: FloatArray, start: Values, dt: float) -> FloatArray:
        P = steps.stress(F, start, dt)[0]
        return np.asarray(P - np.trace(P) / 3 * I)

    def of_one(dt: float) -> float:
        start = steps.after(begin, steps.start, dt)
        whole = deviator(end, start, dt)
        halves = deviator(end, steps.after(half, start, dt / 2), dt / 2)
        power = 4 if law.trapezoidal else 2
        exact = (power * halves - whole) / (power - 1)
        found = np.abs(whole - exact).max() / np.abs(exact).max()
        return float(found) if np.isfinite(found) else 0.0

    def error(dt: float) -> float:
        return max(of_one(dt / shorter) for shorter in _SHORTER)

    return error
