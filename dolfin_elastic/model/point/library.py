"""Typical constants of well-known materials, with their sources.

Ranges for a first estimate; they do not replace a measurement.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TypicalMaterial:
    """Constants of a material from handbooks.

    Attributes:
        name: The material.
        E: Young's modulus.
        nu: Poisson's ratio.
        density: Mass per volume.
        law: A suitable law.
        source: Source of the numbers.
    """

    name: str
    E: str
    nu: str
    density: str
    law: str
    source: str


_ASHBY = "M. Ashby, Materials Selection in Mechanical Design, 4th ed. 2011, appendix A"
_NU = "nu: Granta CES EduPack"
_DUCK = "density: F. Duck, Physical Properties of Tissue, 1990"
_SOFT = "nearly 0.5"

TYPICAL_MATERIALS = (
    TypicalMaterial(
        name="steel, low alloy",
        E="205-217 GPa",
        nu="0.28-0.30",
        density="7800-7900 kg/m^3",
        law="linear-elastic",
        source=f"{_ASHBY}; {_NU}; ASM Handbook 1, 1990",
    ),
    TypicalMaterial(
        name="aluminium alloys",
        E="68-82 GPa",
        nu="0.32-0.36",
        density="2500-2900 kg/m^3",
        law="linear-elastic",
        source=f"{_ASHBY}; {_NU}; ASM Handbook 2, 1990",
    ),
    TypicalMaterial(
        name="PLA, solid",
        E="3.4-3.8 GPa",
        nu="0.36-0.40",
        density="1210-1250 kg/m^3",
        law="linear-elastic",
        source=f"{_ASHBY}; {_NU}; what is printed is softer, across its layers most",
    ),
    TypicalMaterial(
        name="natural rubber",
        E="1.0-2.5 MPa",
        nu="0.499-0.4999",
        density="920-930 kg/m^3",
        law="neo-hookean",
        source=f"{_ASHBY}; L. Treloar, Trans. Faraday Soc. 40 (1944) 59: mu = 0.39 MPa",
    ),
    TypicalMaterial(
        name="bone, cortical",
        E="17 GPa along, 11.5 GPa across",
        nu="0.46 along, 0.58 across",
        density="1800-2000 kg/m^3",
        law="linear-elastic",
        source="D. Reilly and A. Burstein, J. Biomech. 8 (1975) 393; density: S. Cowin (ed.), "
        "Bone Mechanics Handbook, 2nd ed. 2001",
    ),
    TypicalMaterial(
        name="bone, trabecular",
        E="10-3000 MPa, by site",
        nu="0.3 is often taken",
        density="100-1000 kg/m^3, apparent",
        law="linear-elastic",
        source="T. Keaveny et al., Annu. Rev. Biomed. Eng. 3 (2001) 307",
    ),
    TypicalMaterial(
        name="soft tissue, brain",
        E="0.1-1 kPa",
        nu=_SOFT,
        density="1030-1060 kg/m^3",
        law="neo-hookean",
        source=f"A. Engler et al., Cell 126 (2006) 677; {_DUCK}",
    ),
    TypicalMaterial(
        name="soft tissue, muscle",
        E="8-17 kPa",
        nu=_SOFT,
        density="1040-1060 kg/m^3",
        law="neo-hookean",
        source=f"A. Engler et al., Cell 126 (2006) 677; {_DUCK}",
    ),
    TypicalMaterial(
        name="soft tissue, artery",
        E="0.1-1 MPa, rises with stretch",
        nu=_SOFT,
        density="1050-1060 kg/m^3",
        law="an energy of your own, with fibres",
        source="Y. C. Fung, Biomechanics: Mechanical Properties of Living Tissues, 2nd ed. 1993, "
        f"chapter 8; {_DUCK}",
    ),
)
