"""Uniaxial stress over time of a law that remembers: relaxation, creep, and loops of cycles.

The law over steps at one point, whose sides are free.  Of a standard linear solid with the modulus
E after a long time, that of a sudden load E_0 and the relaxation time tau,

    stress at a held strain  e (E + (E_0 - E) exp(-t/tau)),
    strain at a held stress  s (1/E - (1/E - 1/E_0) exp(-t E/(tau E_0))),

and a cycle of the amplitude a loses pi a^2 E'' (J. D. Ferry, Viscoelastic Properties of Polymers
(1980), chapters 1 and 3).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import ufl

from dolfin_elastic.core.si_text import percent, quantity
from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.model.kinematics import deformation_from, gradient_symbol
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.memory import SIX
from dolfin_elastic.model.materials.plasticity import Plastic
from dolfin_elastic.model.point.steps import PointOverSteps
from dolfin_elastic.model.point.tested import Finding, note

_LARGEST = 1.1
"""Stretch of these tests, if the curves of the material go so far."""
_YIELD_STRAINS = 2.0
"""The same strain of a metal, over its strain at yield."""
_STEPS, _CYCLES = 180, 3
"""Of each test; the last cycle is told."""
_BEFORE, _AFTER = 1e-2, 1e2
"""First time over the shortest of the law's own, and last over the longest."""
_ANY = np.logspace(-9, 9, 73)
"""Times after a sudden strain at which a law is asked that does not tell its own [s]."""
_RELAXED = 1e-3
"""Of the stress: what relaxes less does not."""
_BEGIN, _END = 0.1, 0.9
"""Relaxed at the shortest and at the longest time of such a law, over what relaxes at all."""
_ITERATIONS, _NEAR = 25, 1e-8
"""Of Newton's method, and the last change of F, whose square is round-off."""


@dataclass(frozen=True)
class Loop:
    """Cycles of strain: the last one of some.

    Attributes:
        frequency: [Hz]; nan where time does not matter.
        stretch: Shape (n,).
        nominal: Force over undeformed area [Pa], shape (n,).
    """

    frequency: float
    stretch: FloatArray
    nominal: FloatArray

    @property
    def name(self) -> str:
        """How fast it is."""
        return f"{self.frequency:.3g} Hz" if np.isfinite(self.frequency) else "cycles"

    @property
    def lost(self) -> float:
        """Area of the loop [J/m^3]."""
        return float(np.trapezoid(self.nominal, self.stretch))


@dataclass(frozen=True)
class TimeCurves:
    """Uniaxial tests; curves end where no state with free sides follows.

    Attributes:
        held: The stretch that is held, and the largest of the cycles.
        t: Times after a sudden load [s], shape (n,), 0 first; empty where time does not matter.
        relaxation: Nominal stress at the held stretch [Pa], shape (n,).
        creep: Stretch under the nominal stress that is the first of `relaxation`, shape (n,).
        loops: From the fastest to the slowest; one of all cycles where time does not matter.
    """

    held: float
    t: FloatArray
    relaxation: FloatArray
    creep: FloatArray
    loops: tuple[Loop, ...]

    @property
    def largest(self) -> float:
        """Of the nominal stresses [Pa]."""
        return float(np.nanmax([np.abs(loop.nominal).max() for loop in self.loops]))


class _Bars:
    """Bars with free sides, side by side; each goes its own way.

    F is upper triangular, which excludes rotations and nothing else.

    Attributes:
        H: F - I in the order of `memory.SIX`, shape (count, 6).
        nominal: Force over undeformed area [Pa], shape (count,).
    """

    def __init__(self, law: Law) -> None:
        symbol = ufl.Constant(gradient_symbol().ufl_domain(), (6,))
        h = ufl.variable(symbol)
        place = {ij: h[k] for k, ij in enumerate(SIX)}
        rows = [[place.get((i, j), 0) for j in range(3)] for i in range(3)]
        F = deformation_from(ufl.as_matrix(rows))
        self._point = PointOverSteps(law, F, [symbol])
        P = self._point.law.stress(F)
        P = ufl.as_vector([P[i, j] for i, j in SIX])
        self._stress, self._tangent = map(self._point.quantity, (P, ufl.diff(P, h)))
        self._start = self._point.values
        self.begin(1)

    def begin(self, count: int) -> None:
        """So many bars at rest that remember nothing."""
        self._point.values = self._start
        self.H: FloatArray = np.zeros((count, 6))
        self.nominal: FloatArray = np.zeros(count)

    @property
    def stretch(self) -> FloatArray:
        """Shape (count,)."""
        return np.asarray(1 + self.H[:, 0])

    def advance(self, targets: FloatArray, pulled: BoolArray, dt: FloatArray) -> None:
        """One step of each bar; one that finds no state becomes nan.

        Args:
            targets: Nominal stresses [Pa] of the bars that are `pulled`, stretches of the others.
            dt: Lengths of the steps [s], shape (count,).
        """
        H, going = self.H.copy(), np.isfinite(self.H[:, 0])
        H[~pulled, 0] = targets[~pulled] - 1
        for _ in range(_ITERATIONS):
            P, A = self._stress(H, dt=dt).copy(), self._tangent(H, dt=dt).copy()
            P[pulled, 0] -= targets[pulled]
            P[~pulled, 0], A[~pulled, 0], A[~pulled, 0, 0] = 0.0, 0.0, 1.0
            going &= np.isfinite(P).all(axis=1) & np.isfinite(A).all(axis=(1, 2))
            going[going] = np.abs(np.linalg.det(A[going])) > 0
            change = np.full_like(P, np.nan)
            change[going] = np.linalg.solve(A[going], P[going, :, None])[..., 0]
            H -= change
            if not (np.abs(change[going]) > _NEAR).any():
                break
        going &= (np.abs(change) <= _NEAR).all(axis=1) & (H[:, :3] > -1).all(axis=1)
        going &= self._point.found(H, dt=dt)
        self.nominal = np.where(going, self._stress(H, dt=dt)[:, 0], np.nan)
        self._point.commit(H, dt=dt)
        self.H = np.where(going[:, None], H, np.nan)


@np.errstate(all="ignore")
def time_curves(law: Law, largest: float) -> TimeCurves | None:
    """The tests of a law.

    Args:
        law: With numbers as constants, not values that vary in space.
        largest: Stretch of its other curves, which these do not exceed.

    Returns:
        None: it remembers nothing, or nothing that time changes; of metals whose yield takes no
        time, see `cyclic_curve`.
    """
    memory = law.memory
    if memory is None or (isinstance(law, Plastic) and not memory.timed):
        return None
    stretch = min(largest, _LARGEST)
    if isinstance(law, Plastic) and law.first_yield is not None and isinstance(law.E, float):
        stretch = min(stretch, 1 + _YIELD_STRAINS * law.first_yield / law.E)
    bars, nothing = _Bars(law), np.zeros(0)
    if not memory.timed:
        stretches, P = _followed(bars, stretch, nothing, np.ones(1))
        return TimeCurves(stretch, nothing, nothing, nothing, (Loop(np.nan, stretches[0], P[0]),))
    own = law.series[1] if law.viscous else _own_times(bars, stretch)
    if own is None:
        return None
    first, last = float(own.min()), float(own.max())
    t = np.concatenate([[0.0], np.geomspace(_BEFORE * first, _AFTER * last, _STEPS)])
    spread = 10.0 if first == last else 1.0
    periods = 2 * np.pi * np.geomspace(first / spread, last * spread, 3)
    stretches, P = _followed(bars, stretch, t, periods)
    if not np.isfinite(P[:, 0]).all():
        return None
    cycle = slice(-_STEPS // _CYCLES - 1, None)
    loops = [Loop(float(1 / T), stretches[k, cycle], P[k, cycle]) for k, T in enumerate(periods, 2)]
    return TimeCurves(stretch, t, P[0], stretches[1], tuple(loops))


def _followed(
    bars: _Bars, stretch: float, t: FloatArray, periods: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Stretches and nominal stresses [Pa] of bars, each of shape (bars, steps + 1).

    Args:
        t: Times of two bars, of which one is held at the stretch, and one at the nominal stress
            that it has at first; empty: there are none.
        periods: Of bars that are strained up to the stretch in cycles [s].
    """
    held, cycled = (2, len(periods)) if len(t) else (0, len(periods))
    pulled = np.arange(held + cycled) == held - 1
    past = np.diff(t) if held else np.zeros(_STEPS)
    bars.begin(held + cycled)
    bars.advance(np.repeat([stretch, 1.0], [held, cycled]), pulled & False, np.zeros(held + cycled))
    stretches, P = [bars.stretch], [bars.nominal]
    for i in range(_STEPS):
        strain = (stretch - 1) * np.sin(2 * np.pi * _CYCLES * (i + 1) / _STEPS)
        targets = np.repeat([stretch, 1 + strain], [held, cycled])
        targets[pulled] = P[0][pulled]
        dt = np.concatenate([np.full(held, past[i]), periods * _CYCLES / _STEPS])
        bars.advance(targets, pulled, dt)
        stretches.append(bars.stretch)
        P.append(bars.nominal)
    return np.column_stack(stretches), np.column_stack(P)


def _own_times(bar: _Bars, stretch: float) -> FloatArray | None:
    """Times at which a sudden strain has begun to relax, and has nearly done so [s], shape (2,)."""
    stress = []
    for dt in np.diff(_ANY, prepend=[0.0, 0.0]):
        bar.advance(np.array([stretch]), np.zeros(1, dtype=bool), np.array([dt]))
        stress.append(bar.nominal[0])
    P = np.array(stress)
    P = P[np.isfinite(P)]
    relaxed = P[0] - P if len(P) else np.zeros(1)
    most = float(relaxed.max())
    if not len(P) or most < _RELAXED * abs(P[0]):
        return None
    at = [int(np.argmax(relaxed > part * most)) - 1 for part in (_BEGIN, _END)]
    return np.asarray(_ANY[np.maximum(at, 0)])


def time_findings(curves: TimeCurves) -> Iterator[Finding]:
    """The numbers of the tests, in words."""
    strain = curves.held - 1
    lost = max(curves.loops, key=lambda loop: np.nan_to_num(loop.lost))
    values = {"strain": strain, "lost": lost.lost, "frequency": lost.frequency}
    if len(curves.t):
        yield _creep(curves)
    between = f"between strains of {percent(strain)} and -{percent(strain)}"
    energy = quantity(lost.lost, "J/m^3")
    text = (
        f"{between}: of three cycles that at {quantity(lost.frequency, 'Hz')} loses most, {energy}"
    )
    if not len(curves.t):
        text = f"{between}, from the rest: {energy} is lost"
    yield note("loops", text, **values)


def _creep(curves: TimeCurves) -> Finding:
    good = np.flatnonzero(np.isfinite(curves.creep))
    end, at = float(curves.creep[good[-1]]) - 1, float(curves.t[good[-1]])
    load = float(curves.relaxation[0])
    text = (
        f"under the nominal stress of a sudden strain of {percent(curves.held - 1)}, "
        f"{quantity(load, 'Pa')}, the strain is {percent(end)} after {quantity(at, 's')}"
    )
    if len(good) < len(curves.t):
        text += "; no state with free sides follows"
    return note("creep", text, strain=curves.held - 1, stress=load, end=end, time=at)
