"""Conditions that every material law must satisfy, checked at a few deformation gradients.

`check_energy` is the short list, which a user's energy must pass before every run; `checks` is the
long one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeAlias

import numpy as np

from dolfin_elastic.core.errors import InputError, keyed
from dolfin_elastic.core.si_text import percent, quantity
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.moduli import Isotropic
from dolfin_elastic.model.materials.plasticity import Plastic
from dolfin_elastic.model.materials.user import UserEnergy
from dolfin_elastic.model.materials.written.history import Remembering
from dolfin_elastic.model.point.history import history
from dolfin_elastic.model.point.tested import (
    ROUND_OFF,
    Finding,
    I,
    LawUnderTest,
    found,
    note,
    relative,
)
from dolfin_elastic.model.point.viscous_curves import viscous_curves

_DIFFERENCES = 1e-6
_STEP = 1e-3


# --- at rest ---


def rest_energy(tested: LawUnderTest) -> Iterator[Finding]:
    """psi(I) = 0."""
    if not tested.law.has_energy:
        yield note("no energy at rest", "the law has no energy")
        return
    psi = float(tested.point.energy(I[None])[0])
    good = abs(psi) <= ROUND_OFF * tested.scale
    hint = "" if good else f"; subtract {psi:.10g} from the energy"
    yield found("no energy at rest", good, f"psi(I) = {psi:.3g} J/m^3{hint}", psi=psi)


def rest_stress(tested: LawUnderTest) -> Iterator[Finding]:
    """P(I) = 0."""
    P = tested.point.stress(I[None])[0]
    size = float(np.abs(P).max())
    good = size <= ROUND_OFF * tested.scale
    hint = "" if good else _balance(P)
    yield found(
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
            yield found("finite values", False, f"the {name} is not finite {place}")
            return
    yield found("finite values", True, "energy, stress and stiffness near the rest")


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
    yield found("stable at rest", good, text, ratio=ratio)


# --- symmetries ---


def objectivity(tested: LawUnderTest) -> Iterator[Finding]:
    """psi(QF) = psi(F), P(QF) = Q P(F) and P F^T = F P^T."""
    F, name = tested.samples, "frame indifference"
    Q = tested.rotations[: len(F)]
    P, far = tested.point.stress(F), tested.point.stress(Q @ F)
    error = relative(far, Q @ P, tested.scale)
    if tested.law.has_energy:
        first, second = tested.point.energy(F), tested.point.energy(Q @ F)
        error = max(error, relative(first, second, 1e-3 * tested.scale))
    if not tested.frame_indifferent:
        yield note(name, f"none, as the law says (error {error:.2g})", error=error)
        return
    good = error <= 1e3 * ROUND_OFF
    text = f"largest difference {error:.2g}"
    if not good:
        text += "; write the energy in C, E or invariants: turning the body must not change it"
    yield found(name, good, text, error=error)
    tau = P @ F.transpose(0, 2, 1)
    skew = relative(tau, tau.transpose(0, 2, 1), tested.scale)
    yield found(
        "symmetric Cauchy stress", skew <= 1e3 * ROUND_OFF, f"asymmetry {skew:.2g}", error=skew
    )


def symmetric_tangent(tested: LawUnderTest) -> Iterator[Finding]:
    """A_ijkl = A_klij, if there is an energy."""
    A = tested.point.tangent(tested.samples)
    skew = relative(A, A.transpose(0, 3, 4, 1, 2), tested.scale)
    if not tested.law.has_energy:
        yield note("symmetric tangent", f"no energy: asymmetry {skew:.2g}", error=skew)
        return
    good = skew <= 1e3 * ROUND_OFF
    yield found("symmetric tangent", good, f"asymmetry {skew:.2g}", error=skew)


def material_symmetry(tested: LawUnderTest) -> Iterator[Finding]:
    """P(FQ) = P(F) Q for all rotations Q, or for those about the fibre."""
    error = _material_error(tested, tested.rotations)
    if error <= 1e3 * ROUND_OFF:
        yield found("isotropy", True, f"isotropic, to {error:.2g}", error=error)
        return
    fibre = getattr(tested.law, "fibre", None)
    if isinstance(tested.law, Isotropic):
        yield found("isotropy", False, f"an isotropic law is not: {error:.2g}", error=error)
    elif fibre is None or getattr(tested.law, "fibre2", None) is not None:
        yield note("isotropy", f"anisotropic ({error:.2g})", error=error)
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
        return relative(turned, np.broadcast_to(A, turned.shape), tested.scale)
    F = tested.samples
    Q = turns[: len(F)]
    return relative(tested.point.stress(F @ Q), tested.point.stress(F) @ Q, tested.scale)


def _about(a: AnyArray) -> AnyArray:
    """Rotations about a unit vector (Rodrigues)."""
    W = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    angles = np.linspace(0.4, 5.9, 12)[:, None, None]
    return np.asarray(I + np.sin(angles) * W + (1 - np.cos(angles)) * W @ W)


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
        yield found(name, good, f"largest difference {error:.2g}", error=error)


def _differences(f: Evaluation, F: AnyArray, step: float) -> AnyArray:
    D = step * np.eye(9).reshape(9, 1, 3, 3)
    shifted = np.concatenate([F + k * D for k in (1, -1, 2, -2)]).reshape(-1, 3, 3)
    values = f(shifted)
    a, b, c, d = values.reshape(4, 9, len(F), *values.shape[1:])
    slopes = (8 * (a - b) - (c - d)) / (12 * step)
    rows = np.moveaxis(slopes, 0, -1)
    return np.asarray(rows.reshape(*rows.shape[:-1], 3, 3))


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
        yield note("small strains", text, **values)
        return
    good = all(abs(values[n] - v) <= 1e-6 * max(abs(v), 1e-3) for n, v in known)
    text += ", as stated" if good else f"; stated {quantity(known[0][1], 'Pa')}, {known[1][1]:.6g}"
    yield found("small strains", good, text, **values)


def relaxation(tested: LawUnderTest) -> Iterator[Finding]:
    """What relaxes, and the moduli of a sudden load and after a long time."""
    law = tested.given
    if not law.viscous:
        return
    times = sorted(map(float, law.series[1]))
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
    yield note(
        "relaxation",
        f"of the {what} stress: {text}; relaxation times {shown}; loss factor up to {most:.2g}, "
        f"at {omega / (2 * np.pi):.2g} Hz",
        **values,
        loss_factor=most,
        omega=omega,
    )


def yielding(tested: LawUnderTest) -> Iterator[Finding]:
    """Where a metal yields: tests of other strains than those of cycles are of the elastic law."""
    law = tested.given
    if not isinstance(law, Plastic) or law.first_yield is None or not isinstance(law.E, float):
        return
    strain = law.first_yield / law.E
    text = (
        f"in tension at {quantity(law.first_yield, 'Pa')}, a strain of {percent(strain)}; all "
        "tests and curves but the cycles are of the elastic law"
    )
    yield note("yields", text, stress=law.first_yield, strain=strain)


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


def check_energy(law: Law) -> bool:
    """Checks an energy that a user wrote; other laws are checked by the tests of this package.

    Not collective: the result is the same on every rank.

    Returns:
        Whether the tangent of its time steps is symmetric.

    Raises:
        InputError: The first check that it fails.
    """
    if not isinstance(law, UserEnergy) or law.checked:
        return law.symmetric_steps
    tested = LawUnderTest(law)
    with np.errstate(all="ignore"), keyed("energy"):
        failed = (f for check in _SHORT for f in check(tested) if f.verdict == "fail")
        failure = next(failed, None)  # the later ones want finite values
    if failure is not None:
        raise InputError(f"{failure.check}: {failure.text}", where="energy")
    symmetric = True
    with np.errstate(all="ignore"):
        for failure in history(tested):
            if failure.verdict == "fail":
                break
            symmetric &= bool(failure.values.get("symmetric", True))
        else:
            failure = None
    if failure is not None:
        where = "energy" if failure.check == "second step" else str(law.follows_by)
        raise InputError(f"{failure.check}: {failure.text}", where=where)
    law.mark_checked(symmetric=symmetric)
    return law.symmetric_steps
