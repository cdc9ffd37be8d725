"""Loads that change the natural state of a material: temperature and growth."""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
import ufl
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError, keyed
from dolfin_elastic.model.kinematics import deformation_from
from dolfin_elastic.model.loads.base import Load, LoadContext, ScalarLoad
from dolfin_elastic.model.values import Component, component


class Eigenstrain(Load):
    """A load without virtual work that changes the natural state, see `materials.growth`.

    Several on one region are multiplied; where the law is linear, their strains are added.
    """

    on: str | list[str] | None = None
    is_eigenstrain: ClassVar[bool] = True

    @property
    def vectors(self) -> dict[str, tuple[Component, ...]]:
        """See `Load.vectors`."""
        return {}

    @abstractmethod
    def growth(self, context: LoadContext, expansion: Expr | None, share: Expr | None) -> Expr:
        """Growth part Fg of the deformation gradient, a UFL tensor of shape (3, 3).

        Args:
            expansion: The material's coefficient of thermal expansion [1/K], if it has one.
            share: Indicator function of the load's regions; None: the whole body.
        """


class Thermal(ScalarLoad, Eigenstrain):
    """A change of temperature [K], from that at which the body is free of stress.

    Fg = (1 + alpha dT) I with the coefficient of expansion alpha of the material.

    Attributes:
        value: A number, a text with a unit, a formula in x, y, z [m] (undeformed) and t, or a
            field of the mesh.

    Example:
        Thermal(value=60)
    """

    kind: Literal["thermal"] = "thermal"
    unit: ClassVar[str] = "K"
    takes_fields: ClassVar[bool] = True
    sentence: ClassVar[str] = "change of temperature by {}"

    def growth(self, context: LoadContext, expansion: Expr | None, share: Expr | None) -> Expr:
        """See `Eigenstrain.growth`."""
        assert expansion is not None
        strain = expansion * context.scalar(self.values[0], self.amplitude)
        return deformation_from((strain if share is None else share * strain) * ufl.Identity(3))


class Growth(Eigenstrain):
    """Growth, swelling or shrinking by given stretches; 1 is none.

    At amplitude a it is Fg = I + a (G - I).

    Attributes:
        value: Stretches along x, y and z, or a 3x3 list G; numbers, formulas in x, y, z [m] and t,
            or scalar fields of the mesh.  In a plane the third is across it, in a body of
            revolution around the axis; it may be left out, and is 1 then.

    Example:
        Growth(value=[1.1, 1, 1])
    """

    kind: Literal["growth"] = "growth"
    sentence: ClassVar[str] = "growth by the stretches {}"

    @cached_property
    def values(self) -> tuple[Component, ...]:
        """The nine components of G, row by row."""
        with keyed("value"):
            rows = self._rows(self.value)
        return tuple(item for row in rows for item in row)

    def _rows(self, written: list[Any]) -> list[list[Component]]:
        if len(written) == 3 and all(isinstance(row, list | tuple) for row in written):
            if any(len(row) != 3 for row in written):
                raise InputError("this is no 3x3 list", expected=_GROWTH)
            result = [[component(item, "", fields=True) for item in row] for row in written]
            if all(isinstance(item, float) for row in result for item in row):
                change = float(np.linalg.det(np.array(result, dtype=np.float64)))
                if not change > 0:
                    raise InputError(
                        f"the determinant of this growth is {change:.3g}",
                        expected="a determinant above 0: the factor by which the volume grows",
                    )
            return result
        if len(written) not in (2, 3) or any(isinstance(row, list | tuple) for row in written):
            raise InputError(f"{written!r} is no growth", expected=_GROWTH)
        stretches = [component(item, "", fields=True) for item in [*written, 1.0][:3]]
        if any(isinstance(item, float) and item <= 0 for item in stretches):
            raise InputError("a stretch must be above 0", expected="1 is no growth")
        return [[stretches[i] if i == j else 0.0 for j in range(3)] for i in range(3)]

    def growth(self, context: LoadContext, expansion: Expr | None, share: Expr | None) -> Expr:
        """See `Eigenstrain.growth`."""
        one, factors = ufl.Identity(3), context.factors(self.values, self.curve)
        items = [context.value(item) for item in self.values]
        if all(factor is factors[0] for factor in factors):
            strain = factors[0] * (ufl.as_matrix([items[i : i + 3] for i in (0, 3, 6)]) - one)
        else:
            rest = [1.0 if k % 4 == 0 else 0.0 for k in range(9)]
            terms = [f * (g - r) for f, g, r in zip(factors, items, rest, strict=True)]
            strain = ufl.as_matrix([terms[i : i + 3] for i in (0, 3, 6)])
        return deformation_from(strain if share is None else share * strain)


_GROWTH = "expected stretches such as [1.1, 1, 1], or a 3x3 list"
