"""How long the forms of each law take to compile, from an empty cache, and to assemble.

Run it by hand:

    docker/run python3 benchmarks/compile_laws.py [LAW ...]

For linear and quadratic tetrahedra, and for laws with a volumetric part also with a pressure, it
prints the seconds for the residual and the tangent, and the microseconds a cell that assembling the
tangent takes.
"""

from __future__ import annotations

import sys
import tempfile
import time

from dolfinx import fem

from dolfin_elastic import Problem, box_body
from dolfin_elastic.core.jit import FLAGS
from dolfin_elastic.model.materials.law import SplitLaw
from dolfin_elastic.model.materials.registry import MATERIALS


def measure(name: str, degree: int, formulation: str) -> None:
    kind = MATERIALS[name]
    n = 12 // degree
    problem = Problem(
        box_body(size=(1, 1, 1), cells=(n, n, n)),
        kind(**kind.example),
        degree=degree,
        formulation=formulation,
    )
    problem.u.interpolate(lambda x: 0.02 * x[[1, 2, 0]] * x[[0, 1, 2]])
    problem.unknowns.u_to_w()
    spent = []
    with tempfile.TemporaryDirectory() as cache:
        options = {"cffi_extra_compile_args": list(FLAGS), "timeout": 900, "cache_dir": cache}
        for form in (problem.weak_form.residual, problem.weak_form.tangent):
            start = time.perf_counter()
            compiled = fem.form(form, jit_options=options)
            spent.append(time.perf_counter() - start)
        matrix = fem.create_matrix(compiled)
        start = time.perf_counter()
        fem.assemble_matrix(matrix, compiled)
        cell = (time.perf_counter() - start) / problem.body.num_cells
    print(
        f"{name:24s} P{degree} {formulation:12s} residual {spent[0]:5.1f} s  "
        f"tangent {spent[1]:5.1f} s  together {sum(spent):5.1f} s  {cell * 1e6:6.1f} us/cell",
        flush=True,
    )


for law in sys.argv[1:] or MATERIALS:
    for order in (1, 2):
        measure(law, order, "displacement")
        if issubclass(MATERIALS[law], SplitLaw):
            measure(law, order, "mixed")
