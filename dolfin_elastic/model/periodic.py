"""Periodic unit cells: pairs of faces and the macroscopic deformation or stress."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from dolfin_elastic.core.errors import InputError, keyed
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.amplitude import CONSTANT, Amplitude, Curve
from dolfin_elastic.model.values import Component, at_time, component

Matrix = tuple[tuple[Component, ...], ...]
Pair = Annotated[list[str], Field(min_length=2, max_length=2)]


class Periodic(Record):
    """The faces of a cell that is repeated in all directions, and its macroscopic deformation.

    On the faces of a pair u+ - u- = (F - I)(X+ - X-) with the macroscopic deformation gradient F.
    Source: S. Saeb, P. Steinmann & A. Javili, Appl. Mech. Rev. 68 (2016) 050801, section 3.

    Attributes:
        pairs: Two opposite surfaces each, as many pairs as the space has dimensions.
        gradient: F at full load, row by row: numbers, formulas in t, or "free" where the stress is
            prescribed.
        stress: Macroscopic first Piola-Kirchhoff stress [Pa] where the gradient is free; 0 by
            default.
        curve: Amplitude of F - I and of the stress over time.  Without one, numbers grow with the
            load steps, and formulas in t are used as they are.

    Example:
        Periodic(pairs=[["left", "right"], ["bottom", "top"]], gradient=[[1.1, 0], [0, 1]])
    """

    pairs: list[Pair]
    gradient: list[list[Any]]
    stress: list[list[Any]] | None = None
    curve: Curve | None = None

    @model_validator(mode="after")
    def _read_components(self) -> Periodic:
        self._check_stresses()
        self._check_turns()
        return self

    @cached_property
    def gradient_components(self) -> Matrix:
        """Components of F; None where they are free."""
        return _matrix(self.gradient, "", "gradient")

    @cached_property
    def stress_components(self) -> Matrix:
        """Components of the stress; None where they are not prescribed."""
        if self.stress is None:
            return tuple(
                tuple(0.0 if s is None else None for s in row) for row in self.gradient_components
            )
        return _matrix(self.stress, "Pa", "stress")

    @cached_property
    def free(self) -> tuple[tuple[int, int], ...]:
        """Indices (i, j) of the free components of F."""
        return tuple(
            (i, j)
            for i, row in enumerate(self.gradient_components)
            for j, value in enumerate(row)
            if value is None
        )

    @property
    def dim(self) -> int:
        """Rows of the gradient."""
        return len(self.gradient_components)

    def _check_stresses(self) -> None:
        if len(self.stress_components) != self.dim:
            raise InputError(
                f"{len(self.stress_components)} rows given",
                where="stress",
                expected=f"as many as gradient has: {self.dim}",
            )
        for i, row in enumerate(self.stress_components):
            for j, value in enumerate(row):
                if (i, j) not in self.free and value not in (None, 0.0):
                    raise InputError(
                        f"F{i + 1}{j + 1} is prescribed, so its stress is a result",
                        where=f"stress[{i}][{j}]",
                        expected=f'"free" here, or "free" at gradient[{i}][{j}]',
                    )
                if (i, j) in self.free and value is None:
                    raise InputError(
                        f"neither F{i + 1}{j + 1} nor its stress is prescribed",
                        where=f"stress[{i}][{j}]",
                        expected=f"a stress here, or a number at gradient[{i}][{j}]",
                    )

    def _check_turns(self) -> None:
        """Refuses rigid rotations: to first order F12 and F21 free together let the cell rotate."""
        for i, j in self.free:
            if i < j and (j, i) in self.free:
                one, two = f"{i + 1}{j + 1}", f"{j + 1}{i + 1}"
                raise InputError(
                    f"F{one} and F{two} are both free: the cell can turn",
                    where=f"gradient[{j}][{i}]",
                    expected=f"a number for one of them, for example F{two} = 0",
                )

    def gradient_at(self, t: float, default: Amplitude) -> FloatArray:
        """Macroscopic deformation gradient.

        Args:
            t: Time [s], or load parameter.
            default: Amplitude of numbers where the record has no curve.

        Returns:
            Shape (dim, dim); NaN where F is free.
        """
        rest = np.eye(self.dim)
        return rest + self._at(self.gradient_components, rest, t, default)

    def stress_at(self, t: float, default: Amplitude) -> FloatArray:
        """Prescribed macroscopic first Piola-Kirchhoff stress [Pa].

        Args:
            t: Time [s], or load parameter.
            default: Amplitude of numbers where the record has no curve.

        Returns:
            Shape (dim, dim); NaN where F is prescribed and the stress a result.
        """
        result = self._at(self.stress_components, np.zeros((self.dim, self.dim)), t, default)
        given = np.zeros((self.dim, self.dim), dtype=bool)
        for i, j in self.free:
            given[i, j] = True
        return np.where(given, result, np.nan)

    def _at(self, values: Matrix, rest: FloatArray, t: float, default: Amplitude) -> FloatArray:
        result = np.full(rest.shape, np.nan)
        for i, row in enumerate(values):
            for j, value in enumerate(row):
                if value is not None:
                    off = at_time(value, t) - rest[i, j]
                    result[i, j] = off * self._amplitude(value, default).at(t)
        return result

    def _amplitude(self, value: Component, default: Amplitude) -> Amplitude:
        if self.curve is not None:
            return self.curve
        return CONSTANT if isinstance(value, Formula) else default


def _matrix(written: Sequence[Sequence[object]], unit: str, key: str) -> Matrix:
    rows = len(written)
    if rows not in (2, 3) or any(len(row) != rows for row in written):
        raise InputError(
            f"rows of {', '.join(str(len(row)) for row in written)} components",
            where=key,
            expected="3 rows of 3 components (in a plane 2 rows of 2)",
        )
    return tuple(
        tuple(_component(item, unit, f"{key}[{i}][{j}]") for j, item in enumerate(row))
        for i, row in enumerate(written)
    )


def _component(written: object, unit: str, where: str) -> Component:
    with keyed(where):
        value = component(written, unit, may_be_free=True)
    if isinstance(value, Formula) and (extra := set(value.names) - {"t"}):
        raise InputError(
            f"a macroscopic quantity is the same at all points, not a formula in "
            f"{', '.join(sorted(extra))}",
            where=where,
            expected="a formula in t",
        )
    return value
