"""A strain energy typed into a case file: its test at a point, and a block made of it.

Problem
    A block of rubber on rollers is pulled to twice its length; its sides are free.

Equations
    Yeoh's energy, which neither this program nor most others know by name:

        psi = c1 (I1bar - 3) + c2 (I1bar - 3)^2 + c3 (I1bar - 3)^3 + K/2 (ln J)^2

    Stress and stiffness follow by differentiation.  For rubber that keeps its volume the nominal
    stress at a stretch s is 2 (s - 1/s^2) (c1 + 2 c2 (I - 3) + 3 c3 (I - 3)^2), I = s^2 + 2/s:
    O. Yeoh, Rubber Chem. Technol. 66 (1993) 754.

Discretisation
    None at the point: Newton's method finds its lateral stretches.  The block has
    2 x 2 x 2 cubes of six quadratic tetrahedra; ten load steps.

Result
    The block pulls back with the stress that the test at a point predicts, to 1e-7, and with that
    of the closed form to 1e-3.  Curves and a plot are written into own_energy_report.

        python3 demos/own_energy/own_energy.py
        mpirun -n 2 python3 demos/own_energy/own_energy.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic import read_case, run
from dolfin_elastic.case.material_report import write
from dolfin_elastic.model.point.report import material_report

HERE = Path(__file__).parent
AREA = 0.01**2
TOLERANCE = 1e-7
"""Of the stress.  Both are homogeneous states of one law; Newton's method in the solver stops at
1e-8 of the reactions."""
INCOMPRESSIBLE = 2e-3
"""Of the stress.  The volume does change a little: c1/K is 5e-4."""


def closed_form(s, c1, c2, c3):
    """Nominal stress of an incompressible bar at the stretch s."""
    x = s**2 + 2 / s - 3
    return 2 * (s - s**-2) * (c1 + 2 * c2 * x + 3 * c3 * x**2)


def main():
    comm = MPI.COMM_WORLD
    case = read_case(HERE / "case.toml")
    rubber = case.materials["rubber"].law
    found = material_report(rubber)  # at a point, the same on every rank
    assert not found.failed
    if comm.rank == 0:
        for finding in found.findings:
            print(f"{finding.check:24} {finding.verdict:5} {finding.text}")
        write("rubber", found, Path("own_energy_report"))

    for state in run(case, output="own_energy_results"):
        pull = state.reactions["right"][0] / AREA

    curve = found.curves["uniaxial"]
    predicted = curve.P[-1, 0, 0]
    book = closed_form(2.0, **rubber.parameters)
    assert np.isclose(curve.values[-1], 2.0)
    difference = abs(pull / predicted - 1)
    if comm.rank == 0:
        print(f"nominal stress at twice the length: {pull / 1e6:.6f} MPa")
        print(f"at a point {predicted / 1e6:.6f} MPa, closed form {book / 1e6:.6f} MPa")
        print(f"block against material point: {difference:.1e} (allowed {TOLERANCE:.0e})")
    assert abs(predicted / book - 1) < INCOMPRESSIBLE
    assert difference < TOLERANCE


if __name__ == "__main__":
    main()
