"""What a fit says in words: what the tests do not tell, which test would, and what is stable."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.point.ellipticity import acoustic_eigenvalues
from dolfin_elastic.model.point.stable_range import rising
from dolfin_elastic.model.point.tested import with_finite_moduli
from dolfin_elastic.model.point.ufl_to_numpy import LawAtPoints
from dolfin_elastic.study.fit.constants import VOLUME
from dolfin_elastic.study.fit.curves import KINDS, TestCurve
from dolfin_elastic.study.fit.homogeneous import HomogeneousTests
from dolfin_elastic.study.fit.model import Model
from dolfin_elastic.study.least_squares.certainty import Certainty
from dolfin_elastic.study.least_squares.remarks import remarks_on

_OTHERS = ("uniaxial", "equibiaxial", "planar", "shear")
_POINTS = 20
_GRID = 16
"""Points to each side of the rest at which stability is looked at."""
_BETTER = 3.0
"""By how much another test must see a change of constants better, to be named."""
_METAL = ("yield_stress", "hardening", "kinematic")


def remarks(model: Model, z: FloatArray, known: Certainty) -> tuple[list[str], list[str]]:
    """What is not told, and further remarks."""
    return remarks_on(model, z, known, "tests", "the law", partial(_which, model, z))


def _which(model: Model, z: FloatArray, weak: FloatArray, group: Sequence[int]) -> str:
    """The test that would tell, behind a colon; empty where none is known."""
    names = [model.free[i].name for i in group]
    if any(name in VOLUME for name in names):
        return ": a volumetric test would tell"
    if any(name.startswith("viscous") for name in names):
        return ": a relaxation test over more decades of time would tell"
    done = {curve.kind for curve in model.curves}
    if any(name.startswith(_METAL) for name in names):
        better = "a cyclic test" if "uniaxial" in done else "a test to larger strains"
        return f": {better} beyond yield would tell"
    if not isinstance(model.tests, HomogeneousTests) or not weak.any():
        return ""
    base = _seen(model, model.curves, z, weak)
    ends = [float(c.x.max()) for c in model.curves if c.mode.rest == 1.0]
    largest = max(ends, default=2.0)
    best, name = _BETTER * base, ""
    for kind in _OTHERS:
        if kind in done:
            continue
        rest = KINDS[kind].mode.rest
        x = np.linspace(rest, largest - 1 + rest, _POINTS, dtype=np.float64)
        seen = _seen(model, [TestCurve(kind, x, np.ones_like(x))], z, weak)
        if np.isfinite(seen) and seen > best:
            best, name = seen, kind
    article = "an" if name == "equibiaxial" else "a"
    return f": {article} {name} test would tell" if name else ""


def _seen(model: Model, curves: Sequence[TestCurve], z: FloatArray, weak: FloatArray) -> float:
    """Relative change of the stresses of tests by a small change of constants."""
    step = 1e-3 * weak / max(float(np.abs(weak / np.maximum(np.abs(z), 1e-3)).max()), 1e-300)
    result = 0.0
    for curve in curves:
        low, middle, high = model.tests.predict(
            curve, np.array([z - step, z, z + step]) * model.scale
        )
        size = float(np.sqrt(np.mean(middle**2)))
        result = max(result, float(np.sqrt(np.mean((high - low) ** 2))) / size)
    return result


def stability(law: Law, model: Model, z: FloatArray) -> Iterator[str]:
    """Where the law is strongly elliptic, and its force rises, in the tests.

    The pressure of an incompressible law does not enter its acoustic tensor: a law with a large
    bulk modulus in the same state stands for it. See `model.point.stable_range` for the source.
    """
    tests = model.tests
    if not isinstance(tests, HomogeneousTests) or law.linear:
        return
    point, lost = LawAtPoints(with_finite_moduli(law)), False
    strained = [c for c in model.curves if c.kind != "volumetric"]
    for mode in dict.fromkeys(c.mode for c in strained):
        curves, name = [c for c in strained if c.mode is mode], mode.name
        low = min(mode.rest, *(float(c.x.min()) for c in curves))
        high = max(mode.rest, *(float(c.x.max()) for c in curves))
        sides = np.linspace(low, mode.rest, _GRID), np.linspace(mode.rest, high, _GRID)
        x = np.unique(np.concatenate(sides))
        grid = TestCurve("shear" if name == "simple-shear" else name, x, np.ones(len(x)))
        F, P = tests.slow(grid, z[None] * model.scale)
        rest = int(np.argmin(np.abs(x - mode.rest)))
        good = (acoustic_eigenvalues(point, F) > 0) & rising(P[0], rest)
        bad = np.flatnonzero(~good)
        first = int(bad[bad <= rest].max(initial=-1)) + 1
        last = int(bad[bad > rest].min(initial=len(x))) - 1
        if (first, last) != (0, len(x) - 1):
            lost = True
            yield (
                f"not stable over the whole {name} test, {mode.symbol} {low:.4g} to {high:.4g}: "
                f"only from {x[min(first, rest)]:.4g} to {x[max(last, rest)]:.4g}"
            )
    if strained and not lost:
        yield "stable over the range of the tests: elliptic, and the force rises"
