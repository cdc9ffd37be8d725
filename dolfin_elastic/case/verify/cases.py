"""Small cases whose results are known, in closed form or from publications.

Each is a case file as users write it; its result is read from the `summary.json` of a run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

Summary = Mapping[str, Any]


@dataclass(frozen=True)
class Verification:
    """A case and what its result must be.

    Attributes:
        name: In one word.
        what: What is computed, and what is compared.
        source: Where the reference is from.
        case: The case file.
        value: Reads the result off the summary.
        reference: What it must be.
        limit: Largest relative error: what the mesh, the steps or round-off allow.
        unit: Of the result.
        files: Name to text of what the case reads.
        full: It belongs to `verify --full` only.
    """

    name: str
    what: str
    source: str
    case: str
    value: Callable[[Summary], float]
    reference: float
    limit: float
    unit: str
    files: Mapping[str, str] = field(default_factory=dict)
    full: bool = False


def probe(name: str) -> Callable[[Summary], float]:
    """Reads one of a run's numbers."""
    return lambda summary: float(summary["numbers"][name])


def reaction(name: str, axis: int) -> Callable[[Summary], float]:
    """Reads a component of a reaction.

    Args:
        name: Of the support or obstacle.
        axis: 0, 1 or 2.
    """
    return lambda summary: float(summary["reactions"][name][axis])


# --- the patch test, and one tetrahedron ---

E, NU = 1e6, 0.3
LAMBDA, MU = E * NU / (1 + NU) / (1 - 2 * NU), E / 2 / (1 + NU)
GRADIENT = np.array([[1e-3, 2e-3, 0], [0, -5e-4, 1e-3], [5e-4, 0, 2e-3]])


def _patch_energy() -> float:
    strain = (GRADIENT + GRADIENT.T) / 2
    return float(MU * np.sum(strain**2) + LAMBDA / 2 * np.trace(strain) ** 2)


_MOVED = ", ".join(
    '"' + " + ".join(f"({h:g})*{x}" for h, x in zip(row, "xyz", strict=True)) + '"'
    for row in GRADIENT
)
PATCH_GEO = """
SetFactory("OpenCASCADE");
Box(1) = {0, 0, 0, 1, 1, 1};
Mesh.MeshSizeMin = 0.4;
Mesh.MeshSizeMax = 0.4;
"""
PATCH = Verification(
    name="patch",
    what="a cube of irregular tetrahedra whose boundary moves by u = H X: strain energy",
    source="closed form: mu eps:eps + lambda/2 (tr eps)^2, exact in every element; "
    "O. C. Zienkiewicz et al., The Finite Element Method (2013), ch. 9",
    case=f"""
[mesh]
file = "patch.geo"
[surfaces]
boundary = {{all = true}}
[materials.m]
law = "linear-elastic"
E = {E}
nu = {NU}
[[support]]
on = "boundary"
displacement = [{_MOVED}]
""",
    files={"patch.geo": PATCH_GEO},
    value=lambda summary: float(summary["energies"]["strain"]),
    reference=_patch_energy(),
    limit=1e-10,
    unit="J",
)
TETRAHEDRON = Verification(
    name="tetrahedron",
    what="one tetrahedron squeezed to half its height, F = diag(1, 1/2, 1): von Mises stress",
    source="closed form: sigma = lambda tr(E) I + 2 mu E with E22 = -3/8, so 3/4 mu "
    "(demos/tetrahedron)",
    case=f"""
[mesh]
file = "one.msh"
degree = 1
[surfaces]
boundary = {{all = true}}
[materials.m]
law = "textbook"
E = {E}
nu = {NU}
[[support]]
on = "boundary"
displacement = [0, "-(y - 1)/2", 0]
""",
    files={
        "one.msh": "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n1 1 1 0\n2 3 1 0\n3 1 3 0\n"
        "4 1 1 1\n$EndNodes\n$Elements\n1\n1 4 2 1 1 1 2 3 4\n$EndElements\n"
    },
    value=lambda summary: float(summary["extremes"]["von_mises"]["value"]),
    reference=0.75 * MU,
    limit=1e-10,
    unit="Pa",
)

# --- Cook's membrane, Lame's tube, the elastica ---

COOK = Verification(
    name="cook",
    what="Cook's membrane in plane stress, 16 x 16 quadratic triangles: deflection of the tip",
    source="R. D. Cook, J. Struct. Div. ASCE 100 (1974) 1851; 23.96 on fine meshes",
    case="""
[mesh]
file = "cook.geo"
degree = 2
geometry = "plane-stress"
[materials.m]
law = "linear-elastic"
E = 1
nu = 0.3333333333333333
[[support]]
on = "foot"
displacement = [0, 0]
[[load]]
kind = "traction"
on = "end"
value = [0, 0.0625]
[output]
probes = {tip = [48, 52]}
""",
    files={
        "cook.geo": """
Point(1) = {0, 0, 0};
Point(2) = {48, 44, 0};
Point(3) = {48, 60, 0};
Point(4) = {0, 44, 0};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4};
Plane Surface(1) = {1};
Transfinite Curve {1, 2, 3, 4} = 17;
Transfinite Surface {1};
Physical Curve("foot") = {4};
Physical Curve("end") = {2};
Physical Surface("membrane") = {1};
"""
    },
    value=probe("tip_y"),
    reference=23.96,
    limit=1e-3,
    unit="m",
)
INNER, OUTER, PRESSED = 0.02, 0.03, 50e6
LAME = Verification(
    name="lame",
    what="a thick steel tube under pressure, as a body of revolution: widening of its bore",
    source="G. Lame; S. Timoshenko and J. N. Goodier, Theory of Elasticity (1970), art. 28",
    case="""
[mesh]
rectangle = {size = [10, 10], cells = [8, 4], origin = [20, 0]}
unit = "mm"
geometry = "axisymmetric"
[materials.m]
law = "linear-elastic"
E = "210 GPa"
nu = 0.3
[[support]]
on = ["bottom", "top"]
kind = "normal"
[[load]]
kind = "pressure"
on = "left"
value = "50 MPa"
""",
    value=lambda summary: float(summary["max_displacement"]),
    reference=PRESSED
    * INNER**2
    * 1.3
    / (210e9 * (OUTER**2 - INNER**2))
    * (0.4 * INNER + OUTER**2 / INNER),
    limit=1e-5,
    unit="m",
)
ELASTICA = Verification(
    name="elastica",
    what="a slender strip bent by a dead load, P L^2 = E I: deflection of its tip",
    source="K. Mattiasson, Int. J. Numer. Meth. Eng. 17 (1981) 145: 0.30172 L",
    case="""
[mesh]
rectangle = {size = [1, 0.01], cells = [50, 2]}
[materials.m]
law = "neo-hookean"
E = "1 MPa"
nu = 0
[[support]]
on = "left"
displacement = [0, 0]
[[load]]
kind = "traction"
on = "right"
value = [0, -8.333333333333334]
[statics]
steps = 2
[output]
probes = {tip = [1, 0.005]}
""",
    value=probe("tip_y"),
    reference=-0.30172,
    limit=1e-4,
    unit="m",
)

# --- rubber ---


def _uniaxial(stretch: float) -> float:
    """Nominal stress of the neo-Hookean law of case files, free sideways."""
    low, high = 0.1, 2.0
    for _ in range(200):  # the stress across, mu (b - 1/b) + lambda ln(J)/b, grows with b
        across = (low + high) / 2
        if MU * (across - 1 / across) + LAMBDA * math.log(stretch * across**2) / across > 0:
            high = across
        else:
            low = across
    return MU * (stretch - 1 / stretch) + LAMBDA * math.log(stretch * across**2) / stretch


_PULLED = """
[[support]]
on = "left"
kind = "normal"
[[support]]
on = "front"
kind = "normal"
[[support]]
on = "bottom"
kind = "normal"
[[support]]
on = "right"
displacement = [0.5, "free", "free"]
[statics]
steps = 2
"""
RUBBER = Verification(
    name="uniaxial",
    what="a neo-Hookean cube pulled to 1.5 times its length: force",
    source="closed form: P = dpsi/dF with no stress across; J. Bonet and R. D. Wood (2008), (6.29)",
    case=f"""
[mesh]
box = {{size = [1, 1, 1], cells = [2, 2, 2]}}
[materials.m]
law = "neo-hookean"
E = {E}
nu = {NU}
{_PULLED}""",
    value=reaction("right", 0),
    reference=_uniaxial(1.5),
    limit=1e-7,
    unit="N",
)
INCOMPRESSIBLE = Verification(
    name="incompressible",
    what="a Mooney-Rivlin cube at nu = 0.5 pulled to 1.5 times its length: force",
    source="closed form: 2 (l - 1/l^2) (c10 + c01/l); L. R. G. Treloar (1975)",
    case=f"""
[mesh]
box = {{size = [1, 1, 1], cells = [2, 2, 2]}}
[materials.m]
law = "mooney-rivlin"
c10 = 3e5
c01 = 1e5
nu = 0.5
{_PULLED}""",
    value=reaction("right", 0),
    reference=2 * (1.5 - 1 / 1.5**2) * (3e5 + 1e5 / 1.5),
    limit=1e-7,
    unit="N",
)


def _tube_pressure(inner: float, outer: float, widened: float, mu: float) -> float:
    """Pressure that widens an incompressible neo-Hookean tube of fixed length.

    p = integral of mu (l^2 - 1/l^2)/r dr through the wall, l = r/R, r^2 - R^2 the same everywhere.
    """
    grown = widened**2 - inner**2
    x, w = np.polynomial.legendre.leggauss(40)
    outside = math.sqrt(outer**2 + grown)
    r = (widened + outside) / 2 + (outside - widened) / 2 * x
    square = r**2 / (r**2 - grown)
    return float(np.sum(w * mu * (square - 1 / square) / r) * (outside - widened) / 2)


TUBE = Verification(
    name="tube",
    what="a thick tube of incompressible rubber (nu = 0.5), blown up by 30 %: widening of its bore",
    source="closed form: R. S. Rivlin, Phil. Trans. R. Soc. A 242 (1949) 173",
    case=f"""
[mesh]
rectangle = {{size = [10, 5], cells = [10, 4], origin = [10, 0]}}
unit = "mm"
geometry = "axisymmetric"
[materials.m]
law = "neo-hookean-split"
mu = "0.4 MPa"
nu = 0.5
[[support]]
on = ["bottom", "top"]
kind = "normal"
[[load]]
kind = "pressure"
on = "left"
value = {_tube_pressure(0.01, 0.02, 0.013, 4e5)!r}
[statics]
steps = 4
""",
    value=lambda summary: float(summary["max_displacement"]),
    reference=0.003,
    limit=2e-5,
    unit="m",
)

# --- contact, cells ---

PLATE = Verification(
    name="contact",
    what="a neo-Hookean cube squeezed to 0.9 by a rigid plate, nu = 0: force of the plate",
    source="closed form: mu (l - 1/l)",
    case=f"""
[mesh]
box = {{size = [1, 1, 1], cells = [2, 2, 2]}}
[materials.m]
law = "neo-hookean"
E = {E}
nu = 0
[[support]]
on = "left"
kind = "normal"
[[support]]
on = "front"
kind = "normal"
[[support]]
on = "bottom"
kind = "normal"
[[contact]]
on = "top"
plane = {{axis = "-z", at = 1}}
motion = [0, 0, -0.1]
gap_tolerance = 1e-8
name = "plate"
[statics]
steps = 2
""",
    value=reaction("plate", 2),
    reference=E / 2 * (0.9 - 1 / 0.9),
    limit=1e-6,
    unit="N",
)
STIFF, SOFT = 10 * (LAMBDA + 2 * MU), LAMBDA + 2 * MU
LAMINATE = Verification(
    name="laminate",
    what="the periodic cell of a laminate pulled across its layers: mean stress",
    source="closed form: H/(f1/M1 + f2/M2) with M = lambda + 2 mu; "
    "G. W. Milton, The Theory of Composites (2002), ch. 9",
    case=f"""
[mesh]
box = {{size = [1, 1, 1], cells = [4, 2, 2]}}
[regions]
half = {{box = [[0, 0, 0], [0.5, 1, 1]]}}
[materials.soft]
law = "linear-elastic"
E = {E}
nu = {NU}
[materials.stiff]
on = "half"
law = "linear-elastic"
E = {10 * E}
nu = {NU}
[periodic]
pairs = [["left", "right"], ["front", "back"], ["bottom", "top"]]
gradient = [[1.01, 0, 0], [0, 1, 0], [0, 0, 1]]
""",
    value=probe("P11"),
    reference=0.01 / (0.5 / STIFF + 0.5 / SOFT),
    limit=1e-8,
    unit="Pa",
)

# --- vibration, motion, buckling ---

LENGTH, SPEED = 0.1, math.sqrt(210e9 / 7850)
OMEGA = math.pi / 2 * SPEED / LENGTH
_BAR = """
[mesh]
box = {size = [100, 10, 10], cells = [10, 1, 1]}
unit = "mm"
[materials.steel]
law = "linear-elastic"
E = "210 GPa"
nu = 0
density = 7850
[[support]]
on = "left"
displacement = [0, 0, 0]
[[support]]
on = ["front", "back", "bottom", "top"]
kind = "normal"
"""
FREQUENCY = Verification(
    name="frequency",
    what="longitudinal vibration of a bar held at one end: lowest frequency",
    source="closed form: sqrt(E/rho)/(4 L); L. Meirovitch, Vibrations (2001), ch. 8",
    case=_BAR + "[modal]\ncount = 1\n",
    value=lambda summary: float(summary["modes"][0]["frequency"]),
    reference=SPEED / 4 / LENGTH,
    limit=1e-6,
    unit="Hz",
)
STEP = 2 * math.pi / OMEGA / 40
OSCILLATION = Verification(
    name="oscillation",
    what="the same bar let go, trapezoidal rule, 40 steps a period: its end after 45 steps",
    source="closed form of the rule: cos(n w dt) with tan(w dt/2) = omega dt/2; "
    "T. J. R. Hughes, The Finite Element Method (1987), ch. 9",
    case=_BAR
    + f"""
[dynamics]
scheme = "newmark"
dt = {STEP!r}
end = {45 * STEP!r}
initial_displacement = ["1e-6*sin(pi*x/0.2)", 0, 0]
[output]
probes = {{end = [100, 5, 5]}}
""",
    value=probe("end_x"),
    reference=1e-6 * math.cos(45 * 2 * math.atan(OMEGA * STEP / 2)),
    limit=1e-4,
    unit="m",
)
COLUMN = Verification(
    name="column",
    what="Euler's column held at one end, 50 times as long as thick: buckling factor",
    source="closed form: pi^2 E I/(4 L^2); shear lowers it by 2e-4",
    case="""
[mesh]
rectangle = {size = [1, 0.02], cells = [40, 2]}
[materials.m]
law = "st-venant-kirchhoff"
E = "1 MPa"
nu = 0
[[support]]
on = "left"
displacement = [0, 0]
[[load]]
kind = "traction"
on = "right"
value = [-1, 0]
[buckling]
count = 1
""",
    value=lambda summary: float(summary["modes"][0]["load_factor"]),
    reference=math.pi**2 * 1e6 * 0.02**2 / 48,
    limit=1e-3,
    unit="",
)

# --- what takes longer ---

FINE_COOK = Verification(
    name="cook-fine",
    what="Cook's membrane on 64 x 64 quadratic triangles: deflection of the tip",
    source=COOK.source + "; 23.9677 by extrapolation (tests/verification/test_bending.py)",
    case=COOK.case,
    files={"cook.geo": COOK.files["cook.geo"].replace("= 17;", "= 65;")},
    value=COOK.value,
    reference=23.9677,
    limit=2e-4,
    unit="m",
    full=True,
)
ITERATIVE = Verification(
    name="iterative",
    what="the neo-Hookean cube in 8 x 8 x 8 cells by multigrid: force",
    source=RUBBER.source,
    case=RUBBER.case.replace("cells = [2, 2, 2]", "cells = [8, 8, 8]")
    + '[solver]\nmethod = "iterative"\n',
    value=RUBBER.value,
    reference=RUBBER.reference,
    limit=1e-6,
    unit="N",
    full=True,
)
EXPLICIT = Verification(
    name="explicit",
    what="the bar in linear elements by central differences: its end after a quarter and an eighth",
    source="closed form: cos(omega t); linear elements of a fortieth of the bar, lumped mass",
    case=_BAR.replace("cells = [10, 1, 1]}", "cells = [40, 1, 1]}\ndegree = 1")
    + f"""
[dynamics]
scheme = "central-differences"
end = {45 * STEP!r}
initial_displacement = ["1e-6*sin(pi*x/0.2)", 0, 0]
[output]
probes = {{end = [100, 5, 5]}}
""",
    value=probe("end_x"),
    reference=1e-6 * math.cos(OMEGA * 45 * STEP),
    limit=2e-3,
    unit="m",
    full=True,
)

SUITE = (
    *(PATCH, TETRAHEDRON, COOK, LAME, ELASTICA, RUBBER, INCOMPRESSIBLE, TUBE, PLATE, LAMINATE),
    *(FREQUENCY, OSCILLATION, COLUMN, FINE_COOK, ITERATIVE, EXPLICIT),
)
"""All of them, in the order in which they run."""
