"""A stiff inclusion in a gel is found from displacements at its surface, as a camera sees them.

Problem
    A gel of 40 mm x 40 mm (`case.toml`) stands on its foot and is pressed from above by 300 Pa.
    Somewhere in it is an inclusion of four times its stiffness.  Digital image correlation gives
    displacements at 21 x 21 points, with a scatter of 1 um, 0.2 % of the largest.  Where is the
    inclusion, and how stiff is it?

Equations
    Hooke's law in plane strain.  What is made least by m = ln E of each element is

        sum (u - u_measured)^2/sum u_measured^2 + a sum A |jump of m| / L,

    with derivatives from one adjoint solution; the weight a falls until the differences are as
    large as the scatter (V. A. Morozov, Soviet Math. Dokl. 7 (1966) 414).

Discretisation
    The displacements are those of a finer mesh, whose elements do not follow the edge of the
    inclusion either, so that the model that is fitted is not the one that has made them.

Result
    All elements farther than the size of one from the edge of the inclusion are told rightly to be
    gel or inclusion, by the geometric mean of the two moduli.  Moduli, as medians over these
    elements, are within 5 % (gel) and 20 % (inclusion, which jumps make softer).

        python3 demos/inclusion/inclusion.py
        mpirun -n 2 python3 demos/inclusion/inclusion.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic import Probe, identify_field, read_case
from dolfin_elastic.study.identify.written_field import write_field

HERE, COMM = Path(__file__).parent, MPI.COMM_WORLD
KEY, GEL, STIFF = "materials.gel.E", 20e3, 80e3
MIDDLE, RADIUS, SIZE = np.array([0.024, 0.022]), 0.007, 0.04
NOISE = 1e-6
FINE, COARSE = 60, 24
"""Elements on a side of the mesh that makes the displacements, and of that of the case."""


def measured(case) -> str:
    """Displacements with scatter, as a file has them; the phantom has a formula for E."""
    (x, y), r = MIDDLE, RADIUS
    E = f"where((x - {x})**2 + (y - {y})**2 < {r}**2, {STIFF}, {GEL})"
    phantom = case.changed({"mesh.rectangle.cells": [FINE, FINE], KEY: E})
    problem = phantom.make_problem(phantom.read_body())
    *_, state = phantom.make_solver(problem).steps()
    side = np.linspace(0.001, SIZE - 0.001, 21)
    points = {f"{i}_{j}": (x, y) for i, x in enumerate(side) for j, y in enumerate(side)}
    found = Probe(problem, points)(state)
    scatter = NOISE * np.random.default_rng(7).normal(size=(len(points), 2))
    rows = ["x [m],y [m],ux [m],uy [m]"]
    for (x, y), u in zip(points.values(), np.array([*found.values()]) + scatter, strict=True):
        rows.append(f"{x:.6g},{y:.6g},{u[0]:.8g},{u[1]:.8g}")
    return "\n".join(rows) + "\n"


def main():
    case, show = read_case(HERE / "case.toml"), COMM.rank == 0
    text = measured(case)
    if show:
        Path("dic.csv").write_text(text)
    COMM.barrier()
    found = identify_field(case, "dic.csv", KEY, noise=NOISE, told=print)
    write_field(found, Path("inclusion_fitted"))

    mesh, count = found.problem.body.mesh, len(found.values)
    places = mesh.geometry.x[mesh.geometry.dofmap[:count], :2].mean(axis=1)
    from_edge = np.linalg.norm(places - MIDDLE, axis=1) - RADIUS
    places, from_edge, E = (
        np.concatenate(COMM.allgather(one)) for one in (places, from_edge, found.values)
    )
    clear = np.abs(from_edge) > SIZE / COARSE
    wrong = int(np.sum((np.sqrt(GEL * STIFF) < E)[clear] != (from_edge < 0)[clear]))
    gel = np.median(E[clear & (from_edge > 0)]) / GEL
    stiff = np.median(E[clear & (from_edge < 0)]) / STIFF
    if show:
        print(f"{found.why}: {found.rms * 1e6:.3f} um after {found.runs} runs")
        print(f"gel {gel * GEL / 1e3:.1f} kPa, inclusion {stiff * STIFF / 1e3:.1f} kPa")
        print(f"elements told wrongly beyond one from the edge: {wrong} of {clear.sum()}")
    assert found.ended
    assert wrong == 0
    assert abs(gel - 1) < 0.05
    assert abs(stiff - 1) < 0.2


if __name__ == "__main__":
    main()
