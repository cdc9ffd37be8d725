"""`SelfContact`: surfaces that never pass through themselves or each other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Self

from pydantic import AliasChoices, Field, model_validator

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.units import Size, Velocity
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.model.describe import ALONE, Setting, other_keys
from dolfin_elastic.model.values import OnSurfaces


class SelfContact(OnSurfaces):
    """Surfaces no part of which passes through another one, by incremental potential contact.

    Attributes:
        on: Name of the surface, or of several; in a case file `self`.
        all: All outer surfaces, in place of names.
        friction: Coulomb's coefficient: tangential over normal force where parts slide; 0: none.
        distance: Up to which two parts repel each other; a tenth of the median edge by default.
        slow: Speed up to which friction is smoothed [m/s]: so fast may parts that stick creep; 1e-3
            of the surface's size a second by default.
        intersection_free: Always true: parts never meet.

    Example:
        SelfContact(on="skin", friction=0.3)
    """

    lengths = ("distance",)
    key_hints: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("between", "plane", "sphere", "cylinder", "box", "cone", "mesh"),
        "a contact has either this or one of self and all: write a [[contact]] for each",
    )

    on: str | list[str] = Field(
        default="", validation_alias=AliasChoices("on", "self"), serialization_alias="self"
    )
    all: bool = False
    friction: float = Field(default=0.0, ge=0, allow_inf_nan=False)
    distance: Size | None = None
    slow: Velocity | None = Field(default=None, gt=0)
    intersection_free: bool = True

    @model_validator(mode="before")
    @classmethod
    def _named_once(cls, row: object) -> object:
        if isinstance(row, Mapping) and {"on", "self"} <= row.keys():
            raise InputError(
                "a surface that may touch itself is given twice",
                where="on",
                expected="its name as `self` alone; with `on` an obstacle",
            )
        if isinstance(row, Mapping) and isinstance(row.get("self"), bool):
            raise InputError(
                "true is no name of a surface",
                where="self",
                expected="a surface's name, or all = true in place of `self`",
            )
        return row

    @model_validator(mode="after")
    def _somewhere(self) -> Self:
        if bool(self.on) == self.all:
            raise InputError(
                "both names and all surfaces are given" if self.all else "no name is given",
                where="self",
                expected="a surface's name, or all = true in place of `self`",
            )
        if not self.intersection_free:
            raise InputError(
                "contact of a surface with itself is always free of intersections",
                where="intersection_free",
                expected="true, which it is by itself; or contact `between` two surfaces",
            )
        return self

    @property
    def label(self) -> str:
        """See `OnSurfaces`."""
        return self.name or ("all" if self.all else super().label)

    @property
    def surfaces(self) -> tuple[str, ...]:
        """See `OnSurfaces`; () of all."""
        return () if self.all else super().surfaces

    @property
    def key_of_names(self) -> str:
        """The key that names its surfaces."""
        return "all" if self.all else "self"

    def check(self, dim: int, *, axisymmetric: bool) -> None:
        """Raises where it does not fit the body.

        Raises:
            InputError: With the key inside the contact's table.
        """
        if axisymmetric:
            raise InputError(
                "a section of an axisymmetric body does not touch itself",
                where=self.key_of_names,
                expected="plane strain, plane stress or a solid; `between` for rings that touch",
            )

    def describe(self, setting: Setting = ALONE) -> str:
        """What it prevents."""
        what = "no outer surface" if self.all else "never"
        return f"{what} passes through itself{other_keys(self, 'on', 'self', 'all')}"


AnyContact = Contact | SelfContact
"""A row of the contacts of a case."""
