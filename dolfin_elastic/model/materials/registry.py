"""The table of material laws.  A new law is one class in one file and one row here."""

from __future__ import annotations

from dolfin_elastic.model.materials.law import Isotropic, Law, SplitLaw
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

MATERIALS: dict[str, type[Law]] = {
    kind.name(): kind
    for kind in (
        LinearElastic,
        Orthotropic,
        StVenantKirchhoff,
        Corotated,
        FixedCorotated,
        Hencky,
        NeoHookean,
        NeoHookeanSplit,
        MooneyRivlin,
        Yeoh,
        Ogden,
        ArrudaBoyce,
        Gent,
        BlatzKo,
        Guccione,
        HolzapfelGasserOgden,
        Textbook,
    )
}

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
