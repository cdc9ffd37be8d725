"""What records say of themselves: one sentence of each support, load, contact and tie."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.si_text import given
from dolfin_elastic.model.materials.spatial import units_in_lists, units_of

_UNITS = dict.fromkeys(("motion", "displacement"), "m")
_UNITS["force"] = "N"
"""Of keys whose lists stay as they are written, formulas and all."""


class Setting(NamedTuple):
    """What a sentence depends on beside the record that says it.

    Attributes:
        metres: Per unit of length of the mesh, in which bare numbers of places beside it are.
        linear: All laws are linear, so that loads act on the undeformed body.
        kinds: Name of a part to "surface", "edge" or "point"; others are surfaces.
    """

    metres: float = 1.0
    linear: bool = False
    kinds: Mapping[str, str] = {}


ALONE = Setting()


def other_keys(record: Record, *told: str) -> str:
    """What else a record in metres gives, as "; key value" each, with units.

    Args:
        told: Keys that its sentence has said already.
    """
    table = record.model_dump(exclude_unset=True, exclude_none=True, by_alias=True)
    units = {**_UNITS, **dict.fromkeys(record.given_lengths(), "m")}
    units |= {**units_of(type(record)), **units_in_lists(type(record))}
    return "".join(
        f"; {key.replace('_', ' ')} {given(value, units.get(key, ''))}"
        for key, value in table.items()
        if key not in ("kind", "on", "name", *told)
    )
