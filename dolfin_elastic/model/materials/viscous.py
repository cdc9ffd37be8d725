"""Relaxation of the stress by a series of branches, each with a time (a Prony series).

Each branch has an overstress h that follows the second Piola-Kirchhoff stress S of the law and
fades, h' = S' - h/tau.  The stress is a S + sum w h with the weights w of the branches and the part
a that stays: a = 1 where the law's constants are those after a long time, a = 1 - sum w where they
are those of a sudden load.  Over a step with x = dt/tau, e = exp(-x) and f = (1 - e)/x, exact where
S is linear in time,

    h <- e h + f (S - S0),        stress of the step = (a + sum w f) S + H,
    H = sum w (e h - f S0),

so that the stress is a function of F and of one tensor H that is the same for the whole step; its
derivative by F is symmetric.  It acts either on the whole stress, S = F^-1 P, H on C/2; or on the
isochoric one alone, that of psi(J^-1/3 F), S and H on J^-2/3 C/2, which leaves the pressure to the
volume.  In linear laws these are the stress on eps, and its deviator on the deviator of eps.

Of linear laws it is known what the branches store and lose.  With h = C e, e the strain of the
spring of a branch, it stores w e:C:e/2 and loses w e:C:e/tau per time.  A strain that grows by d
in a step gives e <- exp(-x) e + f d, and the integrals are quadratic in e and d, see `_Account`.
Of large strains no free energy of the branches is known.

Source: J. C. Simo, Comput. Methods Appl. Mech. Eng. 60 (1987) 153; Simo & Hughes, Computational
Inelasticity (1998), sections 10.2 and 10.3; f: R. L. Taylor, K. S. Pister and G. L. Goudreau, Int.
J. Numer. Methods Eng. 2 (1970) 45.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from math import factorial

import numpy as np
import ufl
from ufl.core.expr import Expr

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.kinematics import (
    cofactor,
    deformation_from,
    displacement_gradient,
    infinitesimal_strain,
    volume_change,
)
from dolfin_elastic.model.materials.law import Law, SplitLaw, once
from dolfin_elastic.model.materials.memory import (
    Equations,
    ImplicitMemory,
    ImplicitStep,
    Memory,
    Root,
    Values,
    Variable,
    WholeStep,
    of_dissipation,
    unimodular,
    with_dissipation,
)
from dolfin_elastic.model.materials.stepped import SteppedLaw, SteppedSplitLaw

_ROWS = 2048
"""Points whose history is changed at once: a tensor of each takes 98 kB, so that those of a few
branches stay in the second cache."""


class Viscous(Law):
    """A law whose stress may relax, by its keys `viscous`."""

    def branches(self) -> Memory:
        """See `Law`."""
        if self.viscous_deviation == "large":
            return LargeRelaxation(self)
        return LinearRelaxation(self) if self.linear else Relaxation(self)


# --- what relaxes ---


def _isochoric(F: Expr) -> Expr:
    """J^-1/3 F; for linear laws see `_without_volume`."""
    J = ufl.det(F)
    r = J ** (1 / 3)
    swelling = volume_change(F) / (1 + r + r * r)  # r - 1
    return deformation_from((displacement_gradient(F) - swelling * ufl.Identity(3)) / r)


def _without_volume(F: Expr) -> Expr:
    """I + dev eps."""
    return deformation_from(ufl.dev(infinitesimal_strain(F)))


@dataclass(frozen=True)
class Relaxed(SteppedLaw):
    """A law over a time step whose whole stress relaxes.

    `past` is H of the module [Pa]; in `step`, "instant" is the factor of the law's stress, a +
    sum w f, and "lasting" the same after a long time, a.
    """

    law: Viscous

    @once
    def relaxing(self, F: Expr) -> Expr:
        """First Piola-Kirchhoff stress of the law that relaxes [Pa]."""
        return self.law.stress(F)

    def relaxing_energy(self, F: Expr) -> Expr:
        """Its energy [J/m^3]."""
        return self.law.energy(F)

    def of_the_past(self, F: Expr) -> Expr:
        """Stress of H [Pa]: the derivative of H : C/2, of linear laws of H : eps."""
        H = self.past["H"]
        return H if self.law.linear else F * H

    def second(self, F: Expr) -> Expr:
        """S of the module [Pa]."""
        P = self.relaxing(F)
        return P if self.law.linear else cofactor(F).T * P / ufl.det(F)

    def energy(self, F: Expr) -> Expr:
        """See `SteppedLaw`, after a long time: what no branch can lose."""
        return self.step["lasting"] * self.relaxing_energy(F)

    def stress(self, F: Expr) -> Expr:
        """See `SteppedLaw`."""
        return self.step["instant"] * self.relaxing(F) + self.of_the_past(F)

    def branch_stress(self, F: Expr) -> Expr:
        """See `SteppedLaw`: the stress of all branches, which is lost after a long time."""
        share = self.step["instant"] - self.step["lasting"]
        return share * self.relaxing(F) + self.of_the_past(F)

    def at_end(self, F: Expr) -> dict[str, Expr]:
        """S of the module, of linear laws the strain, too."""
        S = self.second(F)
        return {"S": S, "E": infinitesimal_strain(F)} if self.law.linear else {"S": S}

    def stored(self, F: Expr) -> Expr | None:
        """See `OverStep`."""
        return self._told("stored", F)

    def lost(self, F: Expr) -> Expr | None:
        """See `OverStep`."""
        return self._told("lost", F)

    def missed(self) -> Expr | None:
        """See `OverStep`."""
        return self.past.get("missed")

    def _told(self, name: str, F: Expr) -> Expr | None:
        """A quadratic function of the strain, see `LinearRelaxation.tell`."""
        if name not in self.past:
            return None
        E = infinitesimal_strain(F)
        linear = self.past[name] + ufl.inner(self.past[f"{name} by E"], E)
        return linear + self.step[name] * ufl.inner(self.second(F), E)


@dataclass(frozen=True)
class RelaxedShape(Relaxed):
    """A law over a time step whose isochoric stress relaxes."""

    def _of_shape(self, F: Expr) -> Expr:
        """The law's stress, of split laws without volumetric part [Pa]."""
        return self.law.stress(F)

    def _stored(self, F: Expr) -> Expr:
        """Its energy [J/m^3]."""
        return self.law.energy(F)

    @once
    def relaxing(self, F: Expr) -> Expr:
        """See `Relaxed`."""
        return self.isochoric_stress(F)

    def isochoric_stress(self, F: Expr) -> Expr:
        """P of the energy at J^-1/3 F, of linear laws at I + dev eps [Pa]."""
        law = self.law
        if law.linear:
            return ufl.dev(self._of_shape(_without_volume(F)))
        if law.isochoric_shape:
            return self._of_shape(F)
        P, J = self._of_shape(_isochoric(F)), ufl.det(F)
        return (P - ufl.inner(P, F) / (3 * J) * cofactor(F)) / J ** (1 / 3)

    def relaxing_energy(self, F: Expr) -> Expr:
        """See `Relaxed`."""
        if self.law.linear:
            return self._stored(_without_volume(F))
        return self._stored(F if self.law.isochoric_shape else _isochoric(F))

    def of_the_past(self, F: Expr) -> Expr:
        """Stress of H [Pa]: the derivative of H : J^-2/3 C/2, of linear laws of H : dev eps."""
        H = self.past["H"]
        if self.law.linear:
            return ufl.dev(H)
        FH, J = F * H, ufl.det(F)
        return J ** (-2 / 3) * (FH - ufl.inner(FH, F) / (3 * J) * cofactor(F))

    def second(self, F: Expr) -> Expr:
        """See `Relaxed`."""
        P = self.relaxing(F)
        return P if self.law.linear else ufl.det(F) ** (-1 / 3) * cofactor(F).T * P

    def energy(self, F: Expr) -> Expr:
        """See `Relaxed`."""
        return self.law.energy(F) + (self.step["lasting"] - 1) * self.relaxing_energy(F)

    def stress(self, F: Expr) -> Expr:
        """See `Relaxed`."""
        return self.law.stress(F) + self._change(F)

    def _change(self, F: Expr) -> Expr:
        """By how much the stress differs from the law's [Pa]."""
        return (self.step["instant"] - 1) * self.relaxing(F) + self.of_the_past(F)


@dataclass(frozen=True)
class RelaxedSplit(SteppedSplitLaw, RelaxedShape):
    """The same of a law with a volumetric part, which remembers nothing."""

    @property
    def _split(self) -> SplitLaw:
        assert isinstance(self.law, SplitLaw)
        return self.law

    @once
    def _of_shape(self, F: Expr) -> Expr:
        return self._split.shape_stress(F)

    def _stored(self, F: Expr) -> Expr:
        return self._split.shape_energy(F)

    def shape_stress(self, F: Expr) -> Expr:
        """See `SplitLaw`, over the step."""
        change = self._change(F)  # before the other, of which the last F alone is kept
        return self._of_shape(F) + change

    def shape_energy(self, F: Expr) -> Expr:
        """See `SteppedLaw`, after a long time: what no branch can lose."""
        return self._stored(F) + (self.step["lasting"] - 1) * self.relaxing_energy(F)


class Relaxation(Memory):
    """What a viscous law remembers: S and one h for each branch [Pa], see the module.

    All branches fold into one tensor H, the same for the whole step.
    """

    fades = True
    seen = (Variable("H", "symmetric"),)
    found: tuple[Variable, ...] = (Variable("S", "symmetric"),)

    def __init__(self, law: Viscous) -> None:
        self._law = law
        self._ratios, self._times = law.series
        self._names = [f"h{i + 1}" for i in range(len(self._times))]
        self.variables = tuple(Variable(name, "symmetric") for name in ("S", *self._names))
        self._room = np.empty((3, _ROWS, 6))

    def _weights(self, dt: float) -> tuple[FloatArray, FloatArray]:
        """e and f of each branch."""
        x = dt / self._times
        return np.exp(-x), -np.expm1(-x) / x if dt > 0.0 else np.ones_like(x)

    def over_step(self, past: Mapping[str, Expr], step: Mapping[str, Expr]) -> Relaxed:
        """See `Memory`."""
        law = self._law
        if law.relaxes_whole:
            return Relaxed(law, past, step)
        if isinstance(law, SplitLaw):
            return RelaxedSplit(law, past, step)
        return RelaxedShape(law, past, step)

    def step(self, dt: float, *, passes: bool) -> dict[str, float]:
        """See `Memory`."""
        law, f = self._law, self._weights(dt)[1]
        return {
            "instant": law.lasting + float(self._ratios @ f),
            "lasting": law.lasting if passes else law.sudden,
        }

    def fold(self, values: Values, dt: float) -> Values:
        """See `Memory`: H."""
        out = {v.name: np.empty((len(values["S"]), v.size)) for v in self.seen}
        self.fold_into(values, dt, out)
        return out

    def fold_into(self, values: Values, dt: float, out: Values) -> None:
        """See `Memory`."""
        e, f = self._weights(dt)
        instant, past = -float(self._ratios @ f), self._ratios * e
        for rows, (part, _) in self._parts(len(values["S"])):
            H = np.multiply(values["S"][rows], instant, out=out["H"][rows])
            for weight, name in zip(past, self._names, strict=True):
                H += np.multiply(values[name][rows], weight, out=part)

    def follow(self, values: Values, found: Values, dt: float) -> Values:
        """See `Memory`: in place."""
        e, f = self._weights(dt)
        for rows, (part, change) in self._parts(len(values["S"])):
            np.subtract(found["S"][rows], values["S"][rows], out=change)
            self._account(values, found, dt, rows, change)
            for i, name in enumerate(self._names):
                h = values[name][rows]
                h *= e[i]
                h += np.multiply(change, f[i], out=part)
            values["S"][rows] = found["S"][rows]
        return values

    def numbers(self, dt: float) -> FloatArray:
        """See `Memory`: e and f of each branch."""
        return np.concatenate(self._weights(dt))

    def whole_step(
        self, F: Expr, values: Mapping[str, Expr], step: Mapping[str, Expr], numbers: Expr
    ) -> WholeStep:
        """See `Memory`."""
        n, S0 = range(len(self._times)), values["S"]
        e, f = [numbers[i] for i in n], [numbers[len(n) + i] for i in n]
        h = [values[name] for name in self._names]
        H = sum((w * (e[i] * h[i] - f[i] * S0) for i, w in enumerate(self._ratios)), 0 * S0)
        law = self.over_step({"H": H}, step)
        stress = law.stress(F)
        S = law.second(F)
        at_end = {name: e[i] * h[i] + f[i] * (S - S0) for i, name in enumerate(self._names)}
        return WholeStep(stress, law.branch_stress(F), {"S": S, **at_end})

    def _account(
        self, values: Values, found: Values, dt: float, rows: slice, change: FloatArray
    ) -> None:
        """Accounts for the energy of a step before the branches follow.

        Args:
            change: S at the end of the step less that at its start, of these rows alone [Pa].
        """

    def _parts(self, count: int) -> Iterator[tuple[slice, FloatArray]]:
        """Rows that fit into the cache together, with room for two tensors in each."""
        for begin in range(0, count, _ROWS):
            rows = slice(begin, min(begin + _ROWS, count))
            yield rows, self._room[:2, : rows.stop - begin]


# --- energy of linear laws ---

_TWICE = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
"""How often each of the six numbers stands in a tensor."""
_SMALL = 0.5
"""x up to which a difference is computed by its series."""
_SERIES = [(-1) ** n * (2 - 2.0 ** (n - 1)) / factorial(n) for n in range(24, 2, -1)] + [0.0]
"""Coefficients of (1 - f)/x - f^2/2 in x, the highest first; at x = 0.5 the rest is 1e-23."""


@dataclass(frozen=True)
class _Account:
    """Integrals over a step of a branch of weight 1, see the module.

    A strain e(s) = e E + d/x (1 - E) with E = exp(-s/tau) has, over 0 < s < dt,

        lost = (1 - exp(-2 x))/2 e:C:e + (1 - exp(-x)) f e:C:d + g d:C:d,    g = (1 - f)/x - f^2/2,

    which is never negative, and with what is stored the work of h on d.  The trapezoidal rule has
    (h + h1):d/2 in place of that.
    """

    x: FloatArray
    e: FloatArray
    f: FloatArray

    @cached_property
    def g(self) -> FloatArray:
        """See the class."""
        x = np.where(self.x > _SMALL, self.x, 1.0)
        plain = (1 - self.f) / x - self.f**2 / 2
        return np.where(self.x > _SMALL, plain, np.polyval(_SERIES, np.minimum(self.x, _SMALL)))

    @cached_property
    def lost(self) -> FloatArray:
        """Factors of e:C:e, e:C:d and d:C:d in what is lost, shape (3, branches)."""
        return np.stack([-np.expm1(-2 * self.x) / 2, (1 - self.e) * self.f, self.g])

    @cached_property
    def stored(self) -> FloatArray:
        """The same in what is stored at the end."""
        return np.stack([self.e**2, 2 * self.e * self.f, self.f**2]) / 2

    @cached_property
    def missed(self) -> FloatArray:
        """Factors of e:C:d and d:C:d in the trapezoidal work less the work, (2, branches)."""
        return np.stack([(1 + self.e) / 2 - self.f, self.f / 2 - self.g - self.f**2 / 2])


class LinearRelaxation(Relaxation):
    """What a linear viscous law remembers: strain and e:C:e of each branch, and what is lost, too.

    C is that of the law's constants; nothing but stresses and strains is needed for it.
    """

    pointwise = True
    found = (*Relaxation.found, Variable("E", "symmetric"))
    told = (
        Variable("lost"),
        Variable("lost by E", "symmetric"),
        Variable("stored"),
        Variable("stored by E", "symmetric"),
        Variable("missed"),
    )

    def __init__(self, law: Viscous) -> None:
        super().__init__(law)
        self._last: tuple[float, _Account] | None = None
        self._stored = [f"q{i + 1}" for i in range(len(self._times))]
        scalars = tuple(Variable(name) for name in (*self._stored, "lost"))
        self.variables = (*self.variables, Variable("E", "symmetric"), *scalars)

    def _account_of(self, dt: float) -> _Account:
        if self._last is None or self._last[0] != dt:
            x = np.asarray(dt / self._times, dtype=np.float64)
            self._last = dt, _Account(x, *self._weights(dt))
        return self._last[1]

    def step(self, dt: float, *, passes: bool) -> dict[str, float]:
        """See `Memory`."""
        account = self._account_of(dt)
        of_change = {n: float(self._ratios @ getattr(account, n)[2]) for n in ("lost", "stored")}
        return {**super().step(dt, passes=passes), **of_change}

    def numbers(self, dt: float) -> FloatArray:
        """See `Memory`: e and f, and the factors of `_Account`, with the weights where they sum."""
        account, w = self._account_of(dt), self._ratios
        (a, b, c), (k, m) = w * account.lost, w * account.missed
        of_branches = [super().numbers(dt), a, b, k, (2 * account.stored).ravel()]
        return np.concatenate([*of_branches, [c.sum(), m.sum()]])

    def whole_step(
        self, F: Expr, values: Mapping[str, Expr], step: Mapping[str, Expr], numbers: Expr
    ) -> WholeStep:
        """See `Memory`, and `_account`."""
        whole, count = super().whole_step(F, values, step, numbers), len(self._times)
        E = infinitesimal_strain(F)
        change, d = whole.at_end["S"] - values["S"], E - values["E"]
        dd = ufl.inner(change, d)
        lost, missed = values["lost"] + numbers[8 * count] * dd, numbers[8 * count + 1] * dd
        at_end = {**whole.at_end, "E": E}
        for i, (h, stored) in enumerate(zip(self._names, self._stored, strict=True)):
            a, b, k, one, two, three = (numbers[n * count + i] for n in range(2, 8))
            ed, q = ufl.inner(values[h], d), values[stored]
            lost += a * q + b * ed
            missed += k * ed
            at_end[stored] = one * q + two * ed + three * dd
        return WholeStep(whole.stress, None, {**at_end, "lost": lost, "missed": missed})

    def tell(self, values: Values, dt: float) -> Values:
        """See `Memory`.

        Of a sum of a e:C:e + b e:C:d + c d:C:d over the branches, with C e = h, C d = S - S0 and
        d = E - E0, the parts without E and with E alone; S:E0 = S0:E.
        """
        account, S, E = self._account_of(dt), values["S"], values["E"]
        result = {"missed": values.get("missed", np.zeros_like(values["lost"]))}
        for name, before in (("lost", values["lost"]), ("stored", np.zeros_like(values["lost"]))):
            a, b, c = self._ratios * getattr(account, name)
            slope = sum(y * values[h] for y, h in zip(b, self._names, strict=True)) - c.sum() * S
            rest = sum(y * values[q] for y, q in zip(a, self._stored, strict=True)) + before
            result[name] = rest - ((slope * E) @ _TWICE)[:, None]
            result[f"{name} by E"] = slope - c.sum() * S
        return result

    def follow(self, values: Values, found: Values, dt: float) -> Values:
        """See `Memory`; "missed" is no variable, for it is of one step."""
        result = {**values, "missed": np.zeros_like(values["lost"])}
        super().follow(result, found, dt)
        result["E"][:] = found["E"]
        return result

    def _account(
        self, values: Values, found: Values, dt: float, rows: slice, change: FloatArray
    ) -> None:
        account, w = self._account_of(dt), self._ratios
        part, d = self._room[0, : len(change)], self._room[2, : len(change)]
        np.subtract(found["E"][rows], values["E"][rows], out=d)
        dd = np.multiply(change, d, out=part) @ _TWICE
        branches = [values[name][rows] for name in self._names]
        ed = np.stack([np.multiply(h, d, out=part) @ _TWICE for h in branches])
        lost, missed = values["lost"][rows, 0], values["missed"][rows, 0]
        (a, b, c), (k, m) = w * account.lost, w * account.missed
        lost += b @ ed + c.sum() * dd
        missed += k @ ed + m.sum() * dd
        for i, name in enumerate(self._stored):
            q = values[name][rows, 0]
            lost += a[i] * q
            e, f, g = 2 * account.stored[:, i]
            q *= e
            q += f * ed[i] + g * dd


# --- a branch far from equilibrium ---
#
# F = Fe Fv in the branch: a spring, the isochoric stress of the law at Fe times the ratio w, in
# series with a dashpot.  With U the viscous stretch, Fv = R U with any rotation R, Fe = F U^-1, and
# the Mandel stress M = Fe^T P(Fe), which is symmetric in isotropic laws,
#
#     d(U U)/dt = 1/(mu time) U dev M U,
#
# so that small deviations fade as exp(-t/time), mu being the law's shear modulus at small strains.
# A step of backward Euler is an equation for U at each point; U keeps its determinant.
#
# Source: S. Reese and S. Govindjee, Int. J. Solids Struct. 35 (1998) 3455, (24) to (33), here by U
# in place of the left tensor of Fe.

STRETCH = Variable("viscous_stretch", "symmetric", 1.0, unimodular=True)


class LargeRelaxation(ImplicitMemory):
    """What a law remembers whose branch may deviate far."""

    fades = True
    unknowns = (STRETCH,)
    variables = (STRETCH, *of_dissipation(unknowns))

    def __init__(self, law: Viscous) -> None:
        self._law = law
        (self._ratio,), (self._time,) = law.series

    def with_root(
        self, past: Mapping[str, Expr], step: Mapping[str, Expr], root: Root
    ) -> LargeRelaxed:
        """See `ImplicitMemory`."""
        if isinstance(self._law, SplitLaw):
            return LargeRelaxedSplit(self._law, past, step, root)
        return LargeRelaxed(self._law, past, step, root)

    def step(self, dt: float, *, passes: bool) -> dict[str, float]:
        """See `Memory`; "old" is 1/(1 + dt/time), and "left" the ratio, 0 after a long time."""
        law, endless = self._law, dt == float("inf")
        return {
            "old": 1.0 if endless else 1 / (1 + dt / self._time),
            "left": 0.0 if endless else float(self._ratio),
            "lasting": law.lasting,
        }


@dataclass(frozen=True)
class LargeRelaxed(ImplicitStep, RelaxedShape):
    """A law over a time step with a branch that may deviate far.

    Attributes:
        root: Of the branch's equations.
    """

    root: Root

    @property
    def _mu(self) -> Expr:
        moduli = self.law.small_strain()
        assert moduli is not None
        return moduli.mu

    @once
    def _now(self, F: Expr) -> tuple[Expr, Expr]:
        """U at the end of the step, and Fe."""
        U = unimodular(self.root.values(self.root.numbers(self.equations(F)))[STRETCH.name])
        return U, F * ufl.inv(U)

    def equations(self, F: Expr) -> Equations:
        """See `ImplicitStep`."""

        def residual(now: Mapping[str, Expr]) -> Mapping[str, Expr]:
            U, before, old = now[STRETCH.name], self.past[STRETCH.name], self.step["old"]
            one = unimodular(U)
            flow = one * self._mandel(F * ufl.inv(one)) * one / self._mu
            # The projection makes no difference between multiples of U: of the longest steps the
            # last term alone says which one the root is.
            grown = (1 - old) * (ufl.det(U) - 1) * U * U
            return {STRETCH.name: old * (U * U - before * before) - (1 - old) * flow + grown}

        return residual

    def _mandel(self, Fe: Expr) -> Expr:
        """dev M of the law without the ratio [Pa]."""
        return ufl.dev(ufl.sym(Fe.T * self.isochoric_stress(Fe)))

    @once
    def _branch(self, F: Expr) -> Expr:
        """The branch's stress over the ratio [Pa], at the end of the step."""
        U, Fe = self._now(F)
        return self.isochoric_stress(Fe) * ufl.inv(U)

    @once
    def _beside(self, F: Expr) -> Expr:
        """By how much the stress differs from the law's [Pa]."""
        if self.law.lasting == 1.0:
            return self.step["left"] * self._branch(F)
        change = (self.step["lasting"] - 1) * self.isochoric_stress(F)  # before Fe, see `once`
        return change + self.step["left"] * self._branch(F)

    @once
    def stress(self, F: Expr) -> Expr:
        """See `SteppedLaw`."""
        elastic = self._of_shape(F)
        return elastic + self._beside(F)

    def _stored_beside(self, F: Expr) -> Expr:
        lasting = (self.step["lasting"] - 1) * self.relaxing_energy(F)
        return lasting + self.step["left"] * self.relaxing_energy(self._now(F)[1])

    def energy(self, F: Expr) -> Expr:
        """See `SteppedLaw`: with what the branch stores."""
        return self.law.energy(F) + self._stored_beside(F)

    @once
    def at_end(self, F: Expr) -> dict[str, Expr]:
        """See `OverStep`."""

        def energy(values: Mapping[str, Expr]) -> Expr:
            U = unimodular(values[STRETCH.name])
            return self.step["left"] * self.relaxing_energy(F * ufl.inv(U))

        return with_dissipation(self.root, {STRETCH.name: self._now(F)[0]}, self.past, energy)


@dataclass(frozen=True)
class LargeRelaxedSplit(RelaxedSplit, LargeRelaxed):
    """The same of a law with a volumetric part, which remembers nothing."""

    @once
    def shape_stress(self, F: Expr) -> Expr:
        """See `SplitLaw`, over the step."""
        elastic = self._of_shape(F)  # before the branch's, of which the last F alone is kept
        return elastic + self._beside(F)

    def shape_energy(self, F: Expr) -> Expr:
        """See `SplitLaw`: with what the branch stores."""
        return self._stored(F) + self._stored_beside(F)
