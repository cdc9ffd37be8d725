"""What a fit says in words: what the tests do not tell, and which test would."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.study.fit.constants import VOLUME
from dolfin_elastic.study.fit.curves import KINDS, TestCurve
from dolfin_elastic.study.fit.homogeneous import HomogeneousTests
from dolfin_elastic.study.fit.model import Model
from dolfin_elastic.study.least_squares.certainty import Certainty
from dolfin_elastic.study.least_squares.remarks import remarks_on

_OTHERS = ("uniaxial", "equibiaxial", "planar", "shear")
_POINTS = 20
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
