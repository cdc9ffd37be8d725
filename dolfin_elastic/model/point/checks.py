"""Conditions that every material law must satisfy, checked at a few deformation gradients.

`check_energy` is the short list, which a user's energy must pass before every run; `checks` is the
long one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
import ufl
from ufl.algorithms import expand_derivatives

from dolfin_elastic.core.errors import InputError, keyed
from dolfin_elastic.core.si_text import percent, quantity
from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.model.kinematics import gradient_symbol
from dolfin_elastic.model.materials.law import Law, SplitLaw
from dolfin_elastic.model.materials.moduli import Isotropic
from dolfin_elastic.model.materials.plasticity import Plastic
from dolfin_elastic.model.materials.user import UserEnergy
from dolfin_elastic.model.materials.written.history import DT, Remembering, opaque
from dolfin_elastic.model.point.ufl_to_numpy import LawAtPoints, NumpyProgram
from dolfin_elastic.model.point.viscous_curves import viscous_curves

I = np.eye(3)  # noqa: E741  of the textbooks
ROUND_OFF = 1e-9
"""Of the stiffness at rest; regularised principal stretches leave about 1e-12."""
_DIFFERENCES = 1e-6
_STEP = 1e-3
_NEARLY_RIGID = 1e4
"""Bulk over shear stiffness that stands for an infinite one."""


@dataclass(frozen=True)
class Finding:
    """What one check found.

    Attributes:
        check: What was checked.
        verdict: `fail` ends a run of a user's energy; a `note` is no fault.
        text: The numbers, or the reason.
        values: The numbers, for scripts.
    """

    check: str
    verdict: Literal["pass", "fail", "note"]
    text: str
    values: Mapping[str, object]


def _found(check: str, good: bool, text: str, **values: object) -> Finding:
    return Finding(check, "pass" if good else "fail", text, values)


def _note(check: str, text: str, **values: object) -> Finding:
    return Finding(check, "note", text, values)


def with_finite_moduli(law: Law) -> Law:
    """The law itself, or with a large number in place of an infinite modulus."""
    endless = [n for n, value in vars(law).items() if isinstance(value, float) and np.isinf(value)]
    if not endless or not isinstance(law, SplitLaw):
        return law
    shape = law.model_copy(update=dict.fromkeys(endless, 0.0))
    size = float(np.abs(LawAtPoints(shape).tangent(I[None])).max())
    return law.model_copy(update=dict.fromkeys(endless, _NEARLY_RIGID * size))


class LawUnderTest:
    """A law with the deformation gradients at which it is checked.

    Args:
        law: Any law with numbers; an infinite modulus is replaced by a large one.
    """

    def __init__(self, law: Law) -> None:
        self.given, self.law = law, with_finite_moduli(law)
        self.point = LawAtPoints(self.law)
        draw = np.random.default_rng(7).uniform(-1, 1, (12, 3, 3))
        self.near = I + 0.03 * draw[:6]
        self._far = I + 0.2 * draw[6:]
        turned, _ = np.linalg.qr(np.random.default_rng(8).standard_normal((12, 3, 3)))
        self.rotations = turned * np.linalg.det(turned)[:, None, None]

    @cached_property
    def samples(self) -> AnyArray:
        """Deformation gradients, shape (n, 3, 3): small, and larger ones with finite stress."""
        fine = np.isfinite(self.point.stress(self._far)).all(axis=(1, 2))
        return np.concatenate([self.near, self._far[fine]])

    @cached_property
    def rest(self) -> AnyArray:
        """Tangent at F = I [Pa], shape (3, 3, 3, 3)."""
        return self.point.tangent(I[None])[0]

    @cached_property
    def scale(self) -> float:
        """Stiffness by which errors are divided [Pa]."""
        sizes = [float(np.abs(a).max()) for a in (self.rest, self.point.tangent(self.near))]
        return next((s for s in sizes if np.isfinite(s) and s > 0), 1.0)

    @property
    def frame_indifferent(self) -> bool:
        """The law claims to be frame-indifferent."""
        return self.law.frame_indifferent


# --- at rest ---


def rest_energy(tested: LawUnderTest) -> Iterator[Finding]:
    """psi(I) = 0."""
    if not tested.law.has_energy:
        yield _note("no energy at rest", "the law has no energy")
        return
    psi = float(tested.point.energy(I[None])[0])
    good = abs(psi) <= ROUND_OFF * tested.scale
    hint = "" if good else f"; subtract {psi:.10g} from the energy"
    yield _found("no energy at rest", good, f"psi(I) = {psi:.3g} J/m^3{hint}", psi=psi)


def rest_stress(tested: LawUnderTest) -> Iterator[Finding]:
    """P(I) = 0."""
    P = tested.point.stress(I[None])[0]
    size = float(np.abs(P).max())
    good = size <= ROUND_OFF * tested.scale
    hint = "" if good else _balance(P)
    yield _found(
        "no stress at rest", good, f"largest of P(I) = {quantity(size, 'Pa')}{hint}", P=size
    )


def _balance(P: AnyArray) -> str:
    mean = np.trace(P) / 3
    if not np.isfinite(P).all() or np.abs(P - mean * I).max() > 1e-6 * abs(mean):
        return ""
    return f"; it is the pressure {-mean:.6g} Pa: subtract {mean:.10g}*ln(J) from the energy"


def finite(tested: LawUnderTest) -> Iterator[Finding]:
    """No nan or inf near F = I."""
    parts: dict[str, Callable[[AnyArray], AnyArray]] = {"stress": tested.point.stress}
    parts["stiffness"] = tested.point.tangent
    if tested.law.has_energy:
        parts = {"energy": tested.point.energy, **parts}
    F = np.concatenate([I[None], tested.near])
    for name, program in parts.items():
        bad: AnyArray = np.asarray(~np.isfinite(program(F).reshape(len(F), -1)).all(axis=1))
        if bad.any():
            place = "at rest" if bad[0] else "at strains of a few per cent"
            place += _at_once(tested.given)
            yield _found("finite values", False, f"the {name} is not finite {place}")
            return
    yield _found("finite values", True, "energy, stress and stiffness near the rest")


def _at_once(law: Law) -> str:
    """That there is no time, where a history depends on it."""
    timed = isinstance(law, Remembering) and law.timed
    return ", with dt = 0 as in a sudden load: where(dt > 0, ..., ...)" if timed else ""


_HINT_VOLUME = "add a term that grows with |J - 1|, or volumetric and K beside the energy"
_HINT_SHAPE = "has a term or a parameter the wrong sign?"


def stable(tested: LawUnderTest) -> Iterator[Finding]:
    """The stiffness at rest is positive."""
    stiffness = voigt(tested.rest)
    values, vectors = np.linalg.eigh(stiffness)
    ratio = float(values[0] / values[-1])
    good = ratio > ROUND_OFF
    text = f"smallest over largest stiffness {ratio:.3g}"
    if not good:
        mode = vectors[:, 0]
        volume = np.abs(mode[3:]).max() < 1e-3 and np.ptp(mode[:3]) < 1e-3
        what = "a change of volume" if volume else "a small strain"
        text += f"; {what} is not resisted"
        if isinstance(tested.given, UserEnergy):
            text += f": {_HINT_VOLUME if volume else _HINT_SHAPE}"
    yield _found("stable at rest", good, text, ratio=ratio)


# --- symmetries ---


def objectivity(tested: LawUnderTest) -> Iterator[Finding]:
    """psi(QF) = psi(F), P(QF) = Q P(F) and P F^T = F P^T."""
    F, name = tested.samples, "frame indifference"
    Q = tested.rotations[: len(F)]
    P, far = tested.point.stress(F), tested.point.stress(Q @ F)
    error = _relative(far, Q @ P, tested.scale)
    if tested.law.has_energy:
        first, second = tested.point.energy(F), tested.point.energy(Q @ F)
        error = max(error, _relative(first, second, 1e-3 * tested.scale))
    if not tested.frame_indifferent:
        yield _note(name, f"none, as the law says (error {error:.2g})", error=error)
        return
    good = error <= 1e3 * ROUND_OFF
    text = f"largest difference {error:.2g}"
    if not good:
        text += "; write the energy in C, E or invariants: turning the body must not change it"
    yield _found(name, good, text, error=error)
    tau = P @ F.transpose(0, 2, 1)
    skew = _relative(tau, tau.transpose(0, 2, 1), tested.scale)
    yield _found(
        "symmetric Cauchy stress", skew <= 1e3 * ROUND_OFF, f"asymmetry {skew:.2g}", error=skew
    )


def symmetric_tangent(tested: LawUnderTest) -> Iterator[Finding]:
    """A_ijkl = A_klij, if there is an energy."""
    A = tested.point.tangent(tested.samples)
    skew = _relative(A, A.transpose(0, 3, 4, 1, 2), tested.scale)
    if not tested.law.has_energy:
        yield _note("symmetric tangent", f"no energy: asymmetry {skew:.2g}", error=skew)
        return
    good = skew <= 1e3 * ROUND_OFF
    yield _found("symmetric tangent", good, f"asymmetry {skew:.2g}", error=skew)


def material_symmetry(tested: LawUnderTest) -> Iterator[Finding]:
    """P(FQ) = P(F) Q for all rotations Q, or for those about the fibre."""
    error = _material_error(tested, tested.rotations)
    if error <= 1e3 * ROUND_OFF:
        yield _found("isotropy", True, f"isotropic, to {error:.2g}", error=error)
        return
    fibre = getattr(tested.law, "fibre", None)
    if isinstance(tested.law, Isotropic):
        yield _found("isotropy", False, f"an isotropic law is not: {error:.2g}", error=error)
    elif fibre is None or getattr(tested.law, "fibre2", None) is not None:
        yield _note("isotropy", f"anisotropic ({error:.2g})", error=error)
    else:
        axis = np.zeros(3)
        axis[: len(fibre)] = [float(part) for part in fibre]
        axis /= np.linalg.norm(axis)
        about = _material_error(tested, _about(axis / np.linalg.norm(axis)))
        good = about <= 1e3 * ROUND_OFF
        text = f"the same all round the fibre, to {about:.2g}"
        other = f"anisotropic, also round its fibre ({about:.2g})"
        yield Finding("isotropy", "pass" if good else "note", text if good else other, {})


def _material_error(tested: LawUnderTest, turns: AnyArray) -> float:
    if not tested.frame_indifferent:  # laws for small rotations: compare the stiffness at rest
        A = tested.rest
        turned = np.einsum("nai,nbj,nck,ndl,abcd->nijkl", *[turns] * 4, A, optimize=True)
        return _relative(turned, np.broadcast_to(A, turned.shape), tested.scale)
    F = tested.samples
    Q = turns[: len(F)]
    return _relative(tested.point.stress(F @ Q), tested.point.stress(F) @ Q, tested.scale)


def _about(a: AnyArray) -> AnyArray:
    """Rotations about a unit vector (Rodrigues)."""
    W = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    angles = np.linspace(0.4, 5.9, 12)[:, None, None]
    return np.asarray(I + np.sin(angles) * W + (1 - np.cos(angles)) * W @ W)


def _relative(a: AnyArray, b: AnyArray, least: float) -> float:
    """Largest difference over the largest entry of b, or over 1e-3 of `least` if that is more."""
    size = max(float(np.abs(b).max()), 1e-3 * least)
    return float(np.abs(a - b).max()) / size


# --- derivatives ---


Evaluation: TypeAlias = Callable[[AnyArray], AnyArray]
"""Energy, stress or tangent of a law at deformation gradients, shape (n, 3, 3)."""


def derivatives(tested: LawUnderTest) -> Iterator[Finding]:
    """P = dpsi/dF and A = dP/dF, against central differences of fourth order."""
    F = tested.samples[::2]
    pairs: list[tuple[str, Evaluation, Evaluation]] = [
        ("tangent is dP/dF", tested.point.stress, tested.point.tangent)
    ]
    if tested.law.has_energy:
        pairs.insert(0, ("stress is dpsi/dF", tested.point.energy, tested.point.stress))
    for name, function, derivative in pairs:
        exact = derivative(F)
        size = np.abs(exact).max()
        near, far = (_differences(function, F, step) for step in (_STEP / 4, _STEP))
        # Where fibres go slack there is no derivative: differences of two steps then disagree.
        axes = tuple(range(1, exact.ndim))
        smooth = np.abs(near - far).max(axis=axes) <= _DIFFERENCES * size
        if not smooth.any():
            smooth[:] = True
        error = float(np.abs(exact - far)[smooth].max() / size)
        good = error <= _DIFFERENCES
        yield _found(name, good, f"largest difference {error:.2g}", error=error)


def _differences(f: Evaluation, F: AnyArray, step: float) -> AnyArray:
    D = step * np.eye(9).reshape(9, 1, 3, 3)
    shifted = np.concatenate([F + k * D for k in (1, -1, 2, -2)]).reshape(-1, 3, 3)
    values = f(shifted)
    a, b, c, d = values.reshape(4, 9, len(F), *values.shape[1:])
    slopes = (8 * (a - b) - (c - d)) / (12 * step)
    rows = np.moveaxis(slopes, 0, -1)
    return np.asarray(rows.reshape(*rows.shape[:-1], 3, 3))


# --- history ---

_STEPS = (0.0, 1e-3, 1.0)
"""Lengths of steps at which a history is checked [s]."""
_TINY = 1e-12
"""In place of the stiffness: of a history nobody knows the unit."""


def _ends(law: Remembering, F: AnyArray, dt: float) -> FloatArray:
    """A user's history at the end of the first step, shape (n, numbers)."""
    symbol = gradient_symbol()
    ends = law.with_past({DT: opaque(dt)}).ends(symbol)
    return NumpyProgram(expand_derivatives(ends), symbol)(F)


def changes_at_rest(law: Law) -> str:
    """What of a user's history changes in a body at rest, in words; empty: nothing."""
    if not isinstance(law, Remembering) or not law.history:
        return ""
    names = [name for name, v in law.history.items() for _ in range(v.size)]
    start = np.concatenate([v.at_start for v in law.history.values()])
    for dt in _STEPS if law.timed else _STEPS[:1]:
        end = _ends(law, I[None], dt)[0]
        off = np.abs(end - start) > ROUND_OFF * np.maximum(np.abs(start), 1.0)
        if off.any():
            i = int(np.argmax(off))
            step = f", in a step of {quantity(dt, 's')}" if law.timed else ""
            return f"{names[i]} changes at rest, from {start[i]:.6g} to {end[i]:.6g}{step}"
    return ""


def history(tested: LawUnderTest) -> Iterator[Finding]:
    """A user's history after a step is finite, symmetric and the same in a turned body."""
    law = tested.given
    if not isinstance(law, Remembering) or not law.history:
        return
    steps = _STEPS if law.timed else _STEPS[:1]
    for dt in steps:
        if not np.isfinite(_ends(law, np.concatenate([I[None], tested.near]), dt)).all():
            text = f"not finite at rest or at strains of a few per cent, with dt = {dt:g} s"
            yield _found("finite history", False, text)
            return
    yield _found("finite history", True, "finite near the rest")
    error = 0.0
    for dt in steps:
        F = tested.near
        ends, turned = _ends(law, F, dt), _ends(law, tested.rotations[: len(F)] @ F, dt)
        error = max(error, _relative(turned, ends, _TINY))
    text = f"largest difference {error:.2g}"
    good = error <= 1e3 * ROUND_OFF
    if not good:
        text += "; write next in C, E or invariants: turning the body must not change it"
    yield _found("history frame indifference", good, text, error=error)
    skew = _skew(law, tested.near)
    yield _found("symmetric history", skew <= 1e3 * ROUND_OFF, f"asymmetry {skew:.2g}", error=skew)
    yield from _after_a_step(tested, law)
    if change := changes_at_rest(law):
        yield _note("history at rest", change)
    else:
        yield _found("history at rest", True, "does not change")


def _after_a_step(tested: LawUnderTest, law: Remembering) -> Iterator[Finding]:
    """The stress of the second step, of a body that was strained, is finite and turns with it."""
    numbers = iter(_ends(law, tested.near[:1], 1.0)[0].tolist())
    past = {
        name: v.value(ufl.as_vector([opaque(next(numbers)) for _ in range(v.size)]))
        for name, v in law.history.items()
    }
    point = LawAtPoints(law.with_past({**past, DT: opaque(1.0)}))
    F = tested.near
    Q = tested.rotations[: len(F)]
    P, turned = point.stress(F), point.stress(Q @ F)
    if not np.isfinite(P).all():
        yield _found("second step", False, "the stress after a step of 1 s is not finite")
        return
    error = _relative(turned, Q @ P, tested.scale)
    good = error <= 1e3 * ROUND_OFF
    text = f"finite, and turns with the body, to {error:.2g}"
    if not good:
        text = f"the stress does not turn with the body ({error:.2g}): write the energy in C, E or "
        text += "invariants"
    yield _found("second step", good, text, error=error)


def _skew(law: Remembering, F: AnyArray) -> float:
    """Largest asymmetry of the tensors at the end of a step, over their largest entry."""
    symbol = gradient_symbol()
    values = law.with_past({DT: opaque(1.0)}).next_values(symbol)
    error = 0.0
    for name, variable in law.history.items():
        if variable.shape != "scalar":
            program = NumpyProgram(expand_derivatives(ufl.as_ufl(values[name])), symbol)
            end = program(F)
            error = max(error, _relative(end, end.transpose(0, 2, 1), _TINY))
    return error


# --- small strains ---

_VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


def voigt(A: AnyArray) -> AnyArray:
    """A tangent at rest, shape (3, 3, 3, 3), as a 6x6 matrix in the order 11 22 33 23 13 12."""
    minor = (A + A.transpose(1, 0, 2, 3)) / 2
    minor = (minor + minor.transpose(0, 1, 3, 2)) / 2
    matrix = np.array([[minor[(*p, *q)] for q in _VOIGT] for p in _VOIGT])
    return np.asarray((matrix + matrix.T) / 2)


def small_strain(tested: LawUnderTest) -> Iterator[Finding]:
    """Young's modulus and Poisson's ratio along x, compared with the constants of the law."""
    try:
        soft = np.linalg.inv(voigt(tested.rest))
    except np.linalg.LinAlgError:
        return
    E, nu = 1 / soft[0, 0], -soft[0, 1] / soft[0, 0]
    text = f"E = {quantity(E, 'Pa')}, nu = {nu:.6g}"
    values = {"E": float(E), "nu": float(nu), "mu": float(1 / soft[5, 5])}
    sides = [1 / soft[k, k] for k in range(3)]
    if np.ptp(sides) > 1e-6 * max(sides):
        text = "E along x, y, z = " + ", ".join(quantity(side, "Pa") for side in sides)
    stated = [(name, getattr(tested.given, name, None)) for name in ("E", "nu")]
    known = [(n, v) for n, v in stated if isinstance(v, float) and np.isfinite(v)]
    if tested.given is not tested.law or len(known) < 2:
        yield _note("small strains", text, **values)
        return
    good = all(abs(values[n] - v) <= 1e-6 * max(abs(v), 1e-3) for n, v in known)
    text += ", as stated" if good else f"; stated {quantity(known[0][1], 'Pa')}, {known[1][1]:.6g}"
    yield _found("small strains", good, text, **values)


def relaxation(tested: LawUnderTest) -> Iterator[Finding]:
    """What relaxes, and the moduli of a sudden load and after a long time."""
    law = tested.given
    if not law.viscous:
        return
    times = sorted(term.time for term in law.viscous)
    what = "whole" if law.relaxes_whole else "isochoric"
    values: dict[str, object] = {"on": what, "times": times}
    left = law.lasting / law.sudden
    if (known := law.small_strain()) is None:
        text = f"after a long time {percent(left)} of that of a sudden load"
    else:
        parts = []
        for name, factor in (("", law.sudden), ("_long", law.lasting)):
            E, mu = factor * known.E, factor * known.mu
            if not law.relaxes_whole:  # the bulk modulus stays
                E = 1 / (1 / known.E + (1 / factor - 1) / (3 * known.mu))
            values |= {f"E{name}": E, f"mu{name}": mu}
            parts.append(f"E = {quantity(E, 'Pa')}, mu = {quantity(mu, 'Pa')}")
        text = f"sudden {parts[0]}; after a long time {parts[1]} ({percent(left)})"
    shown = ", ".join(quantity(time, "s") for time in times)
    curves = viscous_curves(law)
    assert curves is not None
    most, omega = curves.most_damped
    yield _note(
        "relaxation",
        f"of the {what} stress: {text}; relaxation times {shown}; loss factor up to {most:.2g}, "
        f"at {omega / (2 * np.pi):.2g} Hz",
        **values,
        loss_factor=most,
        omega=omega,
    )


def yielding(tested: LawUnderTest) -> Iterator[Finding]:
    """Where a metal yields, beyond which the other tests are of the elastic law alone."""
    law = tested.given
    if not isinstance(law, Plastic) or law.first_yield is None or not isinstance(law.E, float):
        return
    strain = law.first_yield / law.E
    text = (
        f"in tension at {quantity(law.first_yield, 'Pa')}, a strain of {percent(strain)}; all "
        "other tests and curves here are of the elastic law"
    )
    yield _note("yields", text, stress=law.first_yield, strain=strain)


# --- lists of checks ---


@np.errstate(all="ignore")
def checks(tested: LawUnderTest) -> list[Finding]:
    """All checks at single deformation gradients; of a law that is not finite only the first."""
    result: list[Finding] = []
    for check in (finite, rest_energy, rest_stress):
        result += check(tested)
    if any(f.verdict == "fail" and f.check == "finite values" for f in result):
        return result
    for check in (stable, objectivity, material_symmetry, derivatives, symmetric_tangent):
        result += check(tested)
    others = (small_strain, yielding, relaxation, history)
    return [*result, *(finding for check in others for finding in check(tested))]


_SHORT = (finite, rest_energy, rest_stress, objectivity, symmetric_tangent, stable)


def check_energy(law: Law) -> None:
    """Checks an energy that a user wrote; other laws are checked by the tests of this package.

    Not collective: the result is the same on every rank.

    Raises:
        InputError: The first check that it fails.
    """
    if not isinstance(law, UserEnergy) or law.checked:
        return
    tested = LawUnderTest(law)
    with np.errstate(all="ignore"), keyed("energy"):
        failed = (f for check in _SHORT for f in check(tested) if f.verdict == "fail")
        failure = next(failed, None)  # the later ones want finite values
    if failure is not None:
        raise InputError(f"{failure.check}: {failure.text}", where="energy")
    with np.errstate(all="ignore"):
        failure = next((f for f in history(tested) if f.verdict == "fail"), None)
    if failure is not None:
        where = "energy" if failure.check == "second step" else "next"
        raise InputError(f"{failure.check}: {failure.text}", where=where)
    law.mark_checked()
