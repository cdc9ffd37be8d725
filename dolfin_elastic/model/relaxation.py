"""Keys of the branches of a material that relaxes, see `materials.viscous`."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import AliasChoices, Field, model_validator

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.units import Number, Quantity, Temperature, Time

SUM_BELOW_ONE = 'ratios whose sum is below 1, or viscous_constants = "long-term"'
"""What is expected of ratios to the stress of a sudden strain."""


class ViscousTerm(Record):
    """One branch of a viscous law.

    Attributes:
        ratio: Stress of the branch after a sudden strain, over that of the law's constants.
        time: Time in which it falls to 1/e [s].
    """

    ratio: Number = Field(gt=0, validation_alias=AliasChoices("ratio", "g"))
    time: Time = Field(gt=0, validation_alias=AliasChoices("time", "tau"))


class SeriesFile(Record):
    """A CSV file of branches, which is read with the case; its name alone is the same.

    Attributes:
        file: Its path, relative to the case file's folder.
        ratio: Heading of the column of ratios; by default "ratio" or "g".
        time: Heading of the column of times; by default "time" or "tau".
        unit: Unit of the times without one of their own; by default seconds.
    """

    file: str
    ratio: str = ""
    time: str = ""
    unit: str = ""


class InFile:
    """Of an annotated type: in a case file, a `SeriesFile` may stand in its place."""


GAS = 8.31446261815324
"""Molar gas constant [J/(mol K)], exact since 2019."""
_MOST_DECADES = 100.0
"""By which times may be shifted: no material is known over so many."""


class Shift(Record):
    """How relaxation times depend on temperature: all are multiplied by one factor a.

    "wlf", above the glass transition: log10 a = -C1 (T - T0)/(C2 + T - T0). "arrhenius", below it:
    ln a = energy/R (1/T - 1/T0) with the molar gas constant R. T0 is `reference`.

    Source: M. L. Williams, R. F. Landel and J. D. Ferry, J. Am. Chem. Soc. 77 (1955) 3701, (19);
    J. D. Ferry, Viscoelastic Properties of Polymers (1980), chapter 11, (21) and (36).

    Attributes:
        law: "wlf" or "arrhenius".
        temperature: That of the material [K].
        reference: That at which the times of the branches hold [K].
        C1: Of "wlf".
        C2: Of "wlf" [K].
        energy: Activation energy of "arrhenius" [J/mol].
    """

    law: Literal["wlf", "arrhenius"]
    temperature: Annotated[float, Temperature("K")] = Field(gt=0)
    reference: Annotated[float, Temperature("K")] = Field(gt=0)
    C1: Number | None = Field(default=None, gt=0)
    C2: Annotated[float, Quantity("K")] | None = Field(default=None, gt=0)
    energy: Annotated[float, Quantity("J/mol")] | None = Field(default=None, gt=0)

    @model_validator(mode="after")
    def _has_its_constants(self) -> Self:
        needed = ("C1", "C2") if self.law == "wlf" else ("energy",)
        for key in ("C1", "C2", "energy"):
            if key in needed and getattr(self, key) is None:
                raise InputError(
                    f"this key of '{self.law}' is missing",
                    where=key,
                    expected='for example "100 kJ/mol"'
                    if key == "energy"
                    else "for example C1 = 17.44 and C2 = 51.6 K from the glass transition on",
                )
            if key not in needed and getattr(self, key) is not None:
                raise InputError(
                    f"'{self.law}' has no such constant", where=key, expected="leave it out"
                )
        if self.law == "wlf" and self._from_pole <= 0:
            raise InputError(
                f"at {self.temperature:.6g} K nothing relaxes by 'wlf', whose limit is "
                f"{self.temperature - self._from_pole:.6g} K",
                where="temperature",
                expected='a temperature above reference - C2, or law = "arrhenius"',
            )
        if abs(self.decades) > _MOST_DECADES:
            raise InputError(
                f"the times are shifted by {self.decades:.3g} decades",
                where="temperature",
                expected="temperatures for which the constants hold",
            )
        return self

    @property
    def _from_pole(self) -> float:
        """Temperature over that at which the times of "wlf" are infinite [K]."""
        return (self.C2 or 0.0) + self.temperature - self.reference

    @property
    def decades(self) -> float:
        """log10 a."""
        T, T0 = self.temperature, self.reference
        if self.law == "wlf":
            return -(self.C1 or 0.0) * (T - T0) / self._from_pole
        return (self.energy or 0.0) / GAS * (1 / T - 1 / T0) / math.log(10)

    @property
    def factor(self) -> float:
        """Relaxation times over those of the branches as they are given, a."""
        return float(10.0**self.decades)
