"""Which modes are looked for: the tables [modal] and [buckling]."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.schema import Record, UnusedKeys, refuse_unused_keys
from dolfin_elastic.core.units import Frequency

Stiffness = Literal["instantaneous", "long-term", "elastic"]
UNMOVED = "small-strain laws know no preload: the frequencies are those at rest"


class ModalSettings(Record):
    """Which modes of vibration are looked for.

    Attributes:
        count: How many, from the lowest on; rigid ones come in addition.
        below: All modes below this frequency, instead of so many [Hz].
        preload: They are those about the equilibrium under the loads; without, at rest.
        stiffness: Of materials that relax: "instantaneous", that of a sudden load, or "long-term",
            what is left of it after a long time. Of metals that have yielded under the preload:
            "elastic", that of small motions in which nothing flows.
        tolerance: Relative error of omega^2.
    """

    count: int | None = Field(default=None, ge=1)
    below: Frequency | None = Field(default=None, gt=0)
    preload: bool = False
    stiffness: Stiffness = "instantaneous"
    tolerance: float = Field(default=1e-9, gt=0, lt=1)

    @model_validator(mode="after")
    def _one_measure(self) -> Self:
        if self.count is not None and self.below is not None:
            raise InputError("count and below given together", expected="leave one of them out")
        return self


class BucklingSettings(Record):
    """Which buckling modes are looked for.

    Attributes:
        count: How many, from the smallest load factor on.
        negative: As many with the loads reversed, too, always linearised at rest.
        preload: Share of the loads at whose equilibrium the problem is linearised; 0: at rest.
        stiffness: Of materials that relax: "instantaneous", that of a sudden load, or "long-term",
            what is left of it after a long time. Of metals that have yielded under the preload:
            "elastic", that of small motions in which nothing flows.
        tolerance: Relative error of load factors.
    """

    count: int = Field(default=4, ge=1)
    negative: bool = False
    preload: float = Field(default=0.0, ge=0)
    stiffness: Stiffness = "instantaneous"
    tolerance: float = Field(default=1e-9, gt=0, lt=1)


def refuse_stiffness(
    settings: ModalSettings | BucklingSettings, table: str, *, relaxes: bool, flows: bool
) -> None:
    """Refuses a choice of stiffness that is none.

    Args:
        table: "modal" or "buckling".
        relaxes: The stress of a material fades with time, so that there are two.
        flows: A metal yields, so that there is another beyond the yield stress.

    Raises:
        InputError: `stiffness` is given, and none has.
    """
    elastic = settings.stiffness == "elastic"
    if elastic and not flows:
        raise InputError(
            "no metal yields: all stiffness is elastic",
            where=f"{table}.stiffness",
            expected="leave it out",
        )
    if not elastic and not relaxes:
        rule = UnusedKeys(["stiffness"], "no material relaxes: it has one stiffness")
        refuse_unused_keys(settings, [rule], table)
