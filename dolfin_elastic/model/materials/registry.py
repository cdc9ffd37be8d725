"""The table of material laws.  A new law is one class in one file and one row here."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, MutableMapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

from dolfin_elastic.model.materials.law import Isotropic, Law, SplitLaw

if TYPE_CHECKING:
    from dolfin_elastic.model.materials.laws.arruda_boyce import ArrudaBoyce
    from dolfin_elastic.model.materials.laws.blatz_ko import BlatzKo
    from dolfin_elastic.model.materials.laws.corotated import Corotated
    from dolfin_elastic.model.materials.laws.fixed_corotated import FixedCorotated
    from dolfin_elastic.model.materials.laws.gent import Gent
    from dolfin_elastic.model.materials.laws.guccione import Guccione
    from dolfin_elastic.model.materials.laws.hencky import Hencky
    from dolfin_elastic.model.materials.laws.holzapfel_gasser_ogden import HolzapfelGasserOgden
    from dolfin_elastic.model.materials.laws.linear_elastic import LinearElastic
    from dolfin_elastic.model.materials.laws.mooney_rivlin import MooneyRivlin
    from dolfin_elastic.model.materials.laws.neo_hookean import NeoHookean
    from dolfin_elastic.model.materials.laws.neo_hookean_split import NeoHookeanSplit
    from dolfin_elastic.model.materials.laws.ogden import Ogden
    from dolfin_elastic.model.materials.laws.orthotropic import Orthotropic
    from dolfin_elastic.model.materials.laws.st_venant_kirchhoff import StVenantKirchhoff
    from dolfin_elastic.model.materials.laws.textbook import Textbook
    from dolfin_elastic.model.materials.laws.yeoh import Yeoh

_CLASSES = {
    "linear-elastic": "LinearElastic",
    "orthotropic": "Orthotropic",
    "st-venant-kirchhoff": "StVenantKirchhoff",
    "corotated": "Corotated",
    "fixed-corotated": "FixedCorotated",
    "hencky": "Hencky",
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
_NAMES = {law: name for name, law in _CLASSES.items()}

__all__ = [
    "MATERIALS",
    "ArrudaBoyce",
    "BlatzKo",
    "Corotated",
    "FixedCorotated",
    "Gent",
    "Guccione",
    "Hencky",
    "HolzapfelGasserOgden",
    "Isotropic",
    "Law",
    "LinearElastic",
    "MooneyRivlin",
    "NeoHookean",
    "NeoHookeanSplit",
    "Ogden",
    "Orthotropic",
    "SplitLaw",
    "StVenantKirchhoff",
    "Textbook",
    "Yeoh",
]


def __getattr__(name: str) -> Any:
    if name not in _NAMES:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return MATERIALS[_NAMES[name]]
