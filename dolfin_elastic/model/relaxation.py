"""Keys of the branches of a material that relaxes, see `materials.viscous`."""

from __future__ import annotations

from pydantic import AliasChoices, Field

from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.units import Number, Time

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
