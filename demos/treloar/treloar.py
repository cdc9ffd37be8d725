"""Constants of Treloar's rubber from his three tests: Ogden's law with three terms beside Yeoh's.

python3 demos/treloar/treloar.py
"""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

from dolfin_elastic import Yeoh, fit

HERE = Path(__file__).parent
TESTS = {kind: HERE / f"{kind}.csv" for kind in ("uniaxial", "equibiaxial", "planar")}
OGDEN = {"law": "ogden", "mu": ["fit"] * 3, "alpha": ["fit"] * 3, "nu": 0.5}

if MPI.COMM_WORLD.rank == 0:
    for law in (Yeoh(c10=2e5, c20=-1e3, c30=10.0, nu=0.5), OGDEN):
        found = fit(law, TESTS)
        print(found)
        errors = [100 * curve.relative for curve in found.curves]
        print(
            f"{found.law.name()}: largest r.m.s. error {max(errors):.1f} % of the largest stress\n"
        )
