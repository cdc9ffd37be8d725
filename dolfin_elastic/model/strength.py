"""Strengths that depend on direction and on the sign of the stress, and when they are exhausted.

A `Strength` is the table that may stand in place of one allowable von Mises stress.  It answers one
question: which fraction of the strength does a stress use?  This utilisation grows in proportion to
the stress, so that its inverse is the factor on the stress at which the criterion is met.

All criteria are functions of four numbers of a stress or strain (`Measures`).  With an axis they
are the stress along it, the two principal stresses of the plane across it and the shear between
axis and plane, so that the plane has no direction of its own: layers of a print, or fibres of wood,
bone and laminates.  Without an axis they are the principal stresses and the largest shear stress.

Formulas are written once, for UFL expressions and for arrays of numbers alike.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, TypeAlias

import numpy as np
import ufl
from pydantic import Field, model_validator
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError, all_errors, keyed
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import Quantity, SpatialValue, Stress, to_si
from dolfin_elastic.model.materials.spatial import Direction

Criterion = Literal["tsai-hill", "hoffman", "largest-stress", "largest-strain"]
NAMES: Mapping[str, str] = {
    "tsai-hill": "Tsai-Hill",
    "hoffman": "Hoffman",
    "largest-stress": "largest stress",
    "largest-strain": "largest strain",
}
"""Of criteria, for people."""
_LIMITS = ("tension", "compression", "shear")
Scalar: TypeAlias = "Expr | FloatArray"
"""A UFL scalar, or numbers of shape (n,)."""


class Limits(Record):
    """Strengths in one direction.

    Attributes:
        tension: Largest tensile stress [Pa], or strain.
        compression: Largest compressive stress [Pa], or strain, as a positive number.
    """

    tension: Stress | None = Field(default=None, gt=0)
    compression: Stress | None = Field(default=None, gt=0)


class Strength(Record):
    """Strengths of a material in tension, compression and shear.

    Without a direction, `tension` and `compression` are those of all directions.  With one, `along`
    are those along `axis`, `across` those of all directions in the plane across it, and `shear` is
    the strength against sliding of the one over the other, as between layers.

    Criteria, with the stress a along the axis, the principal stresses p and q of the plane across
    it, and the shear stress t between them (X, Y, S the strengths along, across and in shear):

    - "tsai-hill": a^2/X^2 - a (p + q)/X^2 + p^2/Yp^2 + q^2/Yq^2 + (1/(Xt Xc) - 1/Yp^2 - 1/Yq^2) p q
      + t^2/S^2 = 1, each strength that of the sign of its stress.
    - "hoffman": Cy (p - q)^2 + Cx ((a - p)^2 + (a - q)^2) + (1/Xt - 1/Xc) a
      + (1/Yt - 1/Yc) (p + q) + t^2/S^2 = 1 with Cx = 1/(2 Xt Xc) and Cy = 1/(Yt Yc) - Cx.
    - "largest-stress": each stress for itself.
    - "largest-strain": each strain for itself, shear as an angle.

    Source: R. Hill, Proc. R. Soc. A 193 (1948) 281; V. D. Azzi and S. W. Tsai, Exp. Mech. 5 (1965)
    283; O. Hoffman, J. Compos. Mater. 1 (1967) 200; strains of bone: E. F. Morgan and T. M.
    Keaveny, J. Biomech. 34 (2001) 569, H. H. Bayraktar et al., J. Biomech. 37 (2004) 27.

    Attributes:
        criterion: When the strength is exhausted; by default "tsai-hill" with a direction and
            "largest-stress" without.
        tension: Largest tensile stress [Pa], or strain, in any direction.
        compression: Largest compressive stress [Pa], or strain, as a positive number.
        along: The same along `axis`.
        across: The same across it.
        shear: Largest shear stress [Pa], or angle, between `axis` and the plane across it; without
            a direction the largest of all.
        axis: The direction; by default the first one of the law.
    """

    criterion: Criterion | None = None
    tension: Stress | None = Field(default=None, gt=0)
    compression: Stress | None = Field(default=None, gt=0)
    along: Limits | None = None
    across: Limits | None = None
    shear: Stress | None = Field(default=None, gt=0)
    axis: Direction | None = None

    key_hints: ClassVar[Mapping[str, str]] = {
        "field": "a strength that is a field: allowable = {field = ..., unit = ...} alone"
    }

    @model_validator(mode="before")
    @classmethod
    def _read_units(cls, data: object) -> object:
        """Stresses with units in pascals; strains are pure numbers."""
        if not isinstance(data, dict):
            return data
        unit, read = "" if data.get("criterion") == "largest-strain" else "Pa", dict(data)
        with all_errors() as attempt:
            for key in _LIMITS:
                if key in read:
                    with attempt(), keyed(key):
                        read[key] = to_si(read[key], unit)
            for key in ("along", "across"):
                if isinstance(table := read.get(key), dict):
                    read[key] = {}
                    for name, value in table.items():
                        with attempt(), keyed(key), keyed(name):
                            known = name in _LIMITS[:2]
                            read[key][name] = to_si(value, unit) if known else value
        return read

    def model_post_init(self, context: object) -> None:
        """Checks that the criterion has the strengths that it needs, and no others."""
        if isinstance(self.axis, SpatialValue):
            raise InputError(
                "an axis that varies in space",
                where="axis",
                expected="leave it out: it is then the first direction of a law such as "
                "orthotropic, which may vary",
            )
        if self.directed:
            self._check_directed()
        elif self.axis is not None:
            raise InputError(
                "an axis, but the same strengths along and across it",
                where="axis",
                expected="along = {tension = ...} and across = {tension = ...}",
            )
        if self.kind == "tsai-hill" and not self.directed:
            raise InputError(
                "Tsai-Hill without a direction",
                where="criterion",
                expected='along and across, or criterion = "hoffman", or one number: the '
                "allowable von Mises stress",
            )
        if self.kind in ("tsai-hill", "hoffman"):
            self._check_quadratic()
        elif not any(self._given().values()):
            raise InputError("no strength is given", expected="tension, compression or shear")

    def _check_directed(self) -> None:
        for name, value in (("tension", self.tension), ("compression", self.compression)):
            if value is not None:
                raise InputError(
                    "strengths of all directions beside those along and across one",
                    where=name,
                    expected=f"along = {{{name} = ...}} and across = {{{name} = ...}}",
                )

    def _check_quadratic(self) -> None:
        name, given = NAMES[self.kind], self._given()
        needed = [key for key in given if self.directed or key != "shear"]
        if missing := [key for key in needed if given[key] is None]:
            raise InputError(
                f"{name} needs {' and '.join(missing)}", expected=f"all of {', '.join(needed)}"
            )
        if not self.directed and self.shear is not None:
            raise InputError(
                "without a direction the strength in shear follows from tension and compression",
                where="shear",
                expected='leave it out, or criterion = "largest-stress"',
            )
        (xt, xc), (yt, yc) = self._pair(self.along), self._pair(self.across)
        if 4 * xt * xc <= yt * yc:
            raise InputError(
                f"{name} has no limit for some stresses across the axis where the strength along "
                "it is half of that across or less",
                where="along",
                expected='higher strengths, or criterion = "largest-stress"',
            )

    def _given(self) -> dict[str, float | None]:
        """Dotted key to strength of all that may be given."""
        if not self.directed:
            return {key: getattr(self, key) for key in _LIMITS}
        tables = {"along": self.along or Limits(), "across": self.across or Limits()}
        named = {
            f"{key}.{name}": getattr(t, name) for key, t in tables.items() for name in _LIMITS[:2]
        }
        return {**named, "shear": self.shear}

    def __gt__(self, limit: object) -> bool:
        """True: the bound of the number in whose place it stands is not one of the table."""
        return True

    @property
    def directed(self) -> bool:
        """The strengths depend on the direction."""
        return self.along is not None or self.across is not None

    @property
    def kind(self) -> Criterion:
        """The criterion, if none is given the usual one."""
        return self.criterion or ("tsai-hill" if self.directed else "largest-stress")

    @property
    def of_strain(self) -> bool:
        """Limits are strains."""
        return self.kind == "largest-strain"

    def stresses(self) -> dict[str, float]:
        """Dotted key to strength [Pa] of all that are given; none of strains."""
        given = {} if self.of_strain else self._given()
        return {key: value for key, value in given.items() if value is not None}

    def _pair(self, limits: Limits | None) -> tuple[float, float]:
        """Strengths in tension and compression; infinite where none is given."""
        given = (limits or Limits()) if self.directed else self
        return given.tension or np.inf, given.compression or np.inf

    def used(self, tensor: Expr, axis: Expr | None) -> Expr:
        """Utilisation of the strength, 1 where the criterion is met, a UFL scalar.

        Args:
            tensor: Symmetric stress [Pa] or strain, 3x3, in a frame that turns with the material.
            axis: Unit vector in that frame; None without a direction.
        """
        measures = _principal(tensor) if axis is None else _about(tensor, axis)
        return self._used(measures, _UFL)

    def used_at(self, tensors: FloatArray, axis: FloatArray | None) -> FloatArray:
        """The same of many tensors; NaN where they are.

        Args:
            tensors: Shape (n, 3, 3).
            axis: Unit vectors, shape (3,) or (n, 3); None without a direction.
        """
        known = np.asarray(np.isfinite(tensors).all(axis=(1, 2)))
        some = np.where(known[:, None, None], tensors, 0.0)
        if axis is None:
            low, middle, high = np.linalg.eigvalsh(some).T
            measures = Measures(middle, high, low, (high - low) / 2)
        else:
            measures = _about_many(some, np.broadcast_to(axis, (len(some), 3)))
        return np.where(known, self._used(measures, _NUMPY), np.nan)

    def _used(self, m: Measures, to: _Functions) -> Scalar:
        if self.kind == "tsai-hill":
            return self._tsai_hill(m, to)
        return self._hoffman(m, to) if self.kind == "hoffman" else self._largest(m, to)

    def _tsai_hill(self, m: Measures, to: _Functions) -> Scalar:
        (xt, xc), (yt, yc) = self._pair(self.along), self._pair(self.across)
        assert self.shear is not None
        x = to.by_sign(m.along, xt**-2, xc**-2)
        p, q = to.by_sign(m.high, yt**-2, yc**-2), to.by_sign(m.low, yt**-2, yc**-2)
        # The mean of 1/X^2 in the product of p and q: it must not jump with the sign of a.
        index = x * m.along * (m.along - m.high - m.low) + p * m.high**2 + q * m.low**2
        index += (1 / (xt * xc) - p - q) * m.high * m.low + (m.shear / self.shear) ** 2
        return to.sqrt(to.larger(index, 0.0))

    def _hoffman(self, m: Measures, to: _Functions) -> Scalar:
        (xt, xc), (yt, yc) = self._pair(self.along), self._pair(self.across)
        cx = 1 / (2 * xt * xc)
        cy = 1 / (yt * yc) - cx
        square = cy * (m.high - m.low) ** 2
        square += cx * ((m.along - m.high) ** 2 + (m.along - m.low) ** 2)
        if self.shear is not None:
            square += (m.shear / self.shear) ** 2
        linear = (1 / xt - 1 / xc) * m.along + (1 / yt - 1 / yc) * (m.high + m.low)
        # square s^2 + linear s = 1 at the factor s; u = 1/s is a root of u^2 - linear u - square.
        return to.larger((linear + to.sqrt(linear**2 + 4 * to.larger(square, 0.0))) / 2, 0.0)

    def _largest(self, m: Measures, to: _Functions) -> Scalar:
        (xt, xc), (yt, yc) = self._pair(self.along), self._pair(self.across)
        shear = (self.shear or np.inf) / (2 if self.of_strain else 1)
        each = [(m.along, xt), (-m.along, xc), (m.high, yt), (-m.low, yc), (m.shear, shear)]
        result: Scalar = 0.0 * m.shear
        for value, limit in each:
            if np.isfinite(limit):
                result = to.larger(result, value / limit)
        return result

    def sentence(self) -> str:
        """The criterion for people, such as "Tsai-Hill"."""
        return NAMES[self.kind]


if TYPE_CHECKING:
    Allowable: TypeAlias = float | Strength
else:
    Allowable = Annotated[float, Quantity("Pa", Strength)]
    """An allowable von Mises stress [Pa], or a table of strengths."""


@dataclass(frozen=True)
class Measures:
    """What criteria know of a symmetric tensor; each a UFL scalar or an array.

    Attributes:
        along: Normal component along the axis; without an axis the middle principal value.
        high: Larger principal value of the plane across the axis; without one the largest.
        low: Smaller one; without an axis the smallest.
        shear: Resultant shear component between axis and plane; without an axis half the
            difference of the largest and the smallest principal value.
    """

    along: Scalar
    high: Scalar
    low: Scalar
    shear: Scalar


@dataclass(frozen=True)
class _Functions:
    """Functions of UFL scalars, or of arrays.

    Attributes:
        sqrt: Square root.
        larger: The larger of two numbers.
        by_sign: Of a number the first constant where it is not negative, else the second.
    """

    sqrt: Callable[[Scalar], Scalar]
    larger: Callable[[Scalar, Scalar | float], Scalar]
    by_sign: Callable[[Scalar, float, float], Scalar]


_UFL = _Functions(
    ufl.sqrt, ufl.max_value, lambda x, plus, minus: ufl.conditional(ufl.ge(x, 0), plus, minus)
)
_NUMPY = _Functions(
    np.sqrt, np.maximum, lambda x, plus, minus: np.where(np.asarray(x) >= 0, plus, minus)
)


def _about(T: Expr, n: Expr) -> Measures:
    """Measures of a tensor about an axis, in UFL."""
    Tn = T * n
    a = ufl.inner(n, Tn)
    sliding = Tn - a * n
    m = (ufl.tr(T) - a) / 2
    plane = ufl.Identity(3) - ufl.outer(n, n)
    # The deviator of the plane, without the cancellation of squares.
    D = T - ufl.outer(n, sliding) - ufl.outer(sliding, n) - a * ufl.outer(n, n) - m * plane
    radius = ufl.sqrt(ufl.inner(D, D) / 2)
    return Measures(a, m + radius, m - radius, ufl.sqrt(ufl.inner(sliding, sliding)))


def _about_many(T: FloatArray, n: FloatArray) -> Measures:
    """The same of many tensors, shape (n, 3, 3), and axes, shape (n, 3)."""
    Tn = np.einsum("kij,kj->ki", T, n)
    a = np.einsum("ki,ki->k", n, Tn)
    sliding = Tn - a[:, None] * n
    m = (np.trace(T, axis1=1, axis2=2) - a) / 2
    cross = np.einsum("ki,kj->kij", n, sliding)
    axial = np.einsum("ki,kj->kij", n, n)
    D = T - cross - np.swapaxes(cross, 1, 2) - a[:, None, None] * axial
    D = D - m[:, None, None] * (np.eye(3) - axial)
    radius = np.linalg.norm(D, axis=(1, 2)) / np.sqrt(2)
    return Measures(a, m + radius, m - radius, np.linalg.norm(sliding, axis=1))


def _principal(T: Expr) -> Measures:
    """Measures of a tensor without an axis, in UFL: its eigenvalues by the cosine of an angle.

    Source: O. K. Smith, Commun. ACM 4 (1961) 168.
    """
    m = ufl.tr(T) / 3
    D = T - m * ufl.Identity(3)
    r = ufl.sqrt(ufl.inner(D, D) / 6)
    apart = ufl.conditional(ufl.gt(r, 0), ufl.det(D) / (2 * r**3), 1.0)
    angle = ufl.acos(ufl.max_value(ufl.min_value(apart, 1.0), -1.0)) / 3
    high, low = m + 2 * r * ufl.cos(angle), m + 2 * r * ufl.cos(angle + 2 * ufl.pi / 3)
    return Measures(3 * m - high - low, high, low, (high - low) / 2)
