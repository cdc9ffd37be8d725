"""Words of other programs and of the trade, and the names of case files that mean the same."""

from __future__ import annotations

import re
from collections.abc import Sequence

_WORDS = {
    # materials
    "allowable": "re rm reh yield yieldstrength yieldstress yieldpoint "
    "strength tensilestrength sigmay rp02",
    "E": "young youngs youngsmodulus youngmodulus elasticmodulus elasticitymodulus modulus emod",
    "nu": "poisson poissons poissonsratio poissonratio",
    "K": "bulk bulkmodulus compressionmodulus",
    "mu": "G shear shearmodulus mu0 lamemu",
    "lambda": "lame lamelambda lame1",
    "density": "rho massdensity specificmass",
    "expansion": "alpha cte thermalexpansion expansioncoefficient coefficientofthermalexpansion",
    "viscous": "viscoelastic viscoelasticity relaxation maxwell",
    "energy": "psi strainenergy potential strainenergydensity",
    "fibre": "fiber fiberdirection fibredirection",
    "law": "model type materialmodel constitutive constitutivelaw",
    "linear-elastic": "linear elastic hooke hookean isotropic linearelasticity",
    "st-venant-kirchhoff": "svk stvk stvenant",
    "neo-hookean": "hyperelastic rubber neohooke",
    "holzapfel-gasser-ogden": "hgo holzapfel",
    "corotated": "corotational",
    "orthotropic": "anisotropic wood laminate",
    # supports
    "fixed": "fix clamp clamps clamped clamping encastre encastred builtin "
    "pin pinned ground grounded held",
    "normal": "slide sliding slider frictionless",
    "symmetry": "mirror symmetric symmetryplane",
    "rotation": "turn rotate twist",
    "displacement": "prescribed imposed enforced move motion u disp deflection deformation",
    "rigid": "rigidbody rbe2 coupling remote remotedisplacement hinge",
    "spring": "winkler foundation elasticsupport elasticfoundation bedding",
    "dashpot": "damper",
    # loads
    "force": "load totalforce nodalload",
    "traction": "surfaceload surfaceforce distributedload shearload",
    "body-force": "volumeforce volumeload bodyload",
    "gravity": "weight selfweight deadweight acceleration",
    "base-acceleration": "baseexcitation groundmotion earthquake seismic shaking",
    "centrifugal": "spin rpm rotationalvelocity angularvelocity omega",
    "point-force": "pointload nodalforce concentratedforce",
    "line-force": "lineload edgeload",
    "remote-force": "rbe3 remote remoteload remotemoment momentload",
    "bearing": "bearingload bearingforce boltload pinload lugload",
    "thermal": "temperature heat heating thermalload",
    "bolt": "pretension preload boltpreload boltpretension screw",
    "growth": "swelling eigenstrain prestrain initialstrain",
    # tables and keys
    "mesh": "geometry part body cad step stl",
    "support": "bc bcs boundary boundaryconditions boundarycondition constraint fixture restraint",
    "load": "loading force forces",
    "contact": "obstacle floor",
    "mass": "pointmass lumpedmass addedmass remotemass nonstructuralmass",
    "tie": "glue glued bonded mpc",
    "periodic": "rve unitcell homogenisation homogenization",
    "statics": "static analysis study equilibrium stationary",
    "dynamics": "transient motion",
    "modal": "frequency eigenfrequency modes frequencies eigenmodes "
    "eigenfrequencies naturalfrequencies vibration",
    "buckling": "stability eigenbuckling",
    "output": "result results post",
    "size": "elementsize meshsize cellsize h lc",
    "degree": "order elementorder",
    "thickness": "depth",
    "tip": "apex vertex",
    "half_angle": "angle semiangle coneangle apexangle",
    "on": "surface surfaces face faces region where part domain applyto",
    "kind": "type",
    "value": "magnitude vector amount total",
    "curve": "amplitude table timefunction",
    "steps": "increments loadsteps substeps nsteps",
    "end": "time duration tend endtime period",
    "dt": "timestep step stepsize",
    "scheme": "integrator timeintegration",
    "count": "number modes nmodes",
    "fields": "variables quantities",
    "probes": "sensors monitors gauges",
    "pictures": "images plots",
    "folder": "dir directory path",
    # results
    "von_mises": "mises vm equivalentstress effectivestress stress seqv",
    "safety_factor": "yield allowable safety fos factorofsafety reserve utilisation",
    "cauchy_stress": "sigma truestress",
    "reaction": "reactionforce reactions",
    # units of length
    "mm": "mm millimeter millimetre millimeters millimetres",
    "cm": "cm centimeter centimetre centimeters centimetres",
    "m": "m meter metre meters metres",
    "inch": "inches",
}
"""Name to words that mean it, in small letters, without blanks and signs."""

_STRESS = re.compile(r"(?:stress|sigma|s)([xyz]{2})")
"""A component of the stress, without signs: "stressxx"."""


def meant(word: str, known: Sequence[str]) -> list[str]:
    """The known names that a word means, by its meaning in the trade; mostly none or one.

    Args:
        word: As it was written, such as "Young's modulus" or "yield_strength".
    """
    plain = re.sub(r"[\W_]", "", word).casefold()
    if stress := _STRESS.fullmatch(plain):  # the component, or else the tensor
        names = (f"cauchy_stress_{stress[1]}", "cauchy_stress")
        return [name for name in names if name in known][:1]
    return [name for name in known if plain in _WORDS.get(name, "").casefold().split()]
