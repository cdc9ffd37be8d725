"""A law at the deformation gradients at which it is checked, and what a check has found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.model.materials.law import Law, SplitLaw
from dolfin_elastic.model.point.ufl_to_numpy import LawAtPoints

I = np.eye(3)  # noqa: E741  of the textbooks
ROUND_OFF = 1e-9
"""Of the stiffness at rest; regularised principal stretches leave about 1e-12."""
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


def found(check: str, good: bool, text: str, **values: object) -> Finding:
    """What a check found that passes or fails."""
    return Finding(check, "pass" if good else "fail", text, values)


def note(check: str, text: str, **values: object) -> Finding:
    """What a check found that is no fault."""
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


def relative(a: AnyArray, b: AnyArray, least: float) -> float:
    """Largest difference over the largest entry of b, or over 1e-3 of `least` if that is more."""
    size = max(float(np.abs(b).max()), 1e-3 * least)
    return float(np.abs(a - b).max()) / size
