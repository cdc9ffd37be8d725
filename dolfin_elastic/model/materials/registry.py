"""The table of material laws.  A new law is one class in one file and one row here."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, MutableMapping
from importlib import import_module

from dolfin_elastic.model.materials.law import Law, SplitLaw
from dolfin_elastic.model.materials.moduli import Isotropic

_CLASSES = {
    "linear-elastic": "LinearElastic",
    "orthotropic": "Orthotropic",
    "st-venant-kirchhoff": "StVenantKirchhoff",
    "corotated": "Corotated",
    "fixed-corotated": "FixedCorotated",
    "hencky": "Hencky",
    "j2": "J2",
    "j2-logarithmic": "J2Logarithmic",
    "neo-hookean": "NeoHookean",
    "neo-hookean-split": "NeoHookeanSplit",
    "mooney-rivlin": "MooneyRivlin",
    "yeoh": "Yeoh",
    "ogden": "Ogden",
    "arruda-boyce": "ArrudaBoyce",
    "gent": "Gent",
    "blatz-ko": "BlatzKo",
    "guccione": "Guccione",
    "holzapfel-gasser-ogden": "HolzapfelGasserOgden",
    "textbook": "Textbook",
}
"""Name to class, which stands in the module of that name in `laws/`."""


class Laws(MutableMapping[str, type[Law]]):
    """Name to law.  A law is imported when it is asked for: a case has one or two of them.

    Args:
        classes: Name of a law to its class.
    """

    def __init__(self, classes: Mapping[str, str]) -> None:
        self._rows: dict[str, type[Law] | str] = dict(classes)

    def __getitem__(self, name: str) -> type[Law]:
        law = self._rows[name]
        if isinstance(law, str):
            place = f"dolfin_elastic.model.materials.laws.{name.replace('-', '_')}"
            law = self._rows[name] = getattr(import_module(place), law)
        return law

    def __setitem__(self, name: str, law: type[Law]) -> None:
        self._rows[name] = law

    def __delitem__(self, name: str) -> None:
        del self._rows[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)

    def __contains__(self, name: object) -> bool:
        return name in self._rows


MATERIALS = Laws(_CLASSES)

__all__ = ["MATERIALS", "Isotropic", "Law", "Laws", "SplitLaw"]
