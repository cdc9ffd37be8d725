"""How long the form compiler works on each law: fields of results, residual and tangent.

Run it by hand:

    docker/run python3 benchmarks/compile_fields.py [LAW ...]

For each law alone, about a grown state (a 3x3 list), warmed, with directions that vary in space
and, where it has a volumetric part, with a pressure: seconds that FFCx takes for all fields of
cells at once, for the residual and for the tangent, and the size of the C code [kB], which decides
what the C compiler takes (`compile_laws.py` measures both).
"""

from __future__ import annotations

import sys
import time

import dolfinx
import ffcx
import numpy as np
import ufl
from dolfinx import fem
from ffcx.compiler import compile_ufl_objects

from dolfin_elastic import Growth, Problem, Support, Thermal, box_body
from dolfin_elastic.model.materials.law import SplitLaw
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.results.cell_fields import cell_components
from dolfin_elastic.results.fields import FIELDS

GROWN = [[1.1, 0.02, 0.01], [0.03, 1.2, 0.02], [0.01, 0.02, 1.05]]
TURNING = ["1", "0.5*x", "0.2*y"]
LOADS = {"growth": [Growth(value=GROWN)], "thermal": [Thermal(value=30)]}


def variants(name: str) -> list[str]:
    kind = MATERIALS[name]
    fibres = ["fibres"] if getattr(kind, "directions", ()) else []
    mixed = ["mixed", "mixed growth"] if issubclass(kind, SplitLaw) else []
    return ["", "growth", "thermal", *fibres, *(f"{f} growth" for f in fibres), *mixed]


def problem(name: str, variant: str) -> Problem:
    kind = MATERIALS[name]
    numbers = dict(kind.example) | ({"expansion": "12 ppm/K"} if "thermal" in variant else {})
    if "fibres" in variant:
        numbers |= {kind.directions[0]: TURNING}
    return Problem(
        box_body(size=(1, 1, 1), cells=(1, 1, 1)),
        kind(**numbers),
        supports=[Support(on="left")],
        loads=[load for key, loads in LOADS.items() if key in variant for load in loads],
        degree=2,
        formulation="mixed" if "mixed" in variant else "displacement",
    )


def measure(name: str, variant: str) -> None:
    made = problem(name, variant)
    region = made.regions[0]
    names = [n for n, field in FIELDS.items() if field.formula is not None]
    if not region.law.has_energy:
        names.remove("energy_density")
    found = cell_components(made, region, fem.Function(made.W), names)
    fields = ufl.as_vector([part for parts in found if parts for part in parts])
    points = np.full((1, 3), 0.25)
    options = ffcx.get_options({"scalar_type": dolfinx.default_scalar_type})
    text = f"{name:24s} {variant:14s}"
    for what, form in (
        ("fields", (fields, points)),
        ("residual", made.weak_form.residual),
        ("tangent", made.weak_form.tangent),
    ):
        start = time.process_time()
        code = compile_ufl_objects([form], options)
        spent = time.process_time() - start
        text += f"  {what} {spent:5.1f} s {sum(map(len, code)) / 1e3:5.0f} kB"
    print(text, flush=True)


for law in sys.argv[1:] or MATERIALS:
    for variant in variants(law):
        measure(law, variant)
