"""The suite again on 2 and 3 ranks, each under one mpirun; any file of it runs on any ranks."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from conftest import ROOT

POINTS = (
    "material_point/test_material_point",
    "model/test_amplitude",
    "core/test_formula",
    "model/test_kinematics",
    "verification/test_manufactured",
    "model/materials/test_moduli",
    "model/materials/test_reference_energies",
    "solvers/dynamics/implicit/test_schemes",
    "core/test_units",
)
"""Files of tests on numbers and texts, and on rates, in which ranks take no part of their own."""
LAWS = (
    "problem/test_dimension",
    "model/materials/test_law_input",
    "model/materials/test_laws",
    "mesh/test_selection",
    "model/materials/test_user_energy",
)
"""Files that try every law, or names, on bodies of a few cells."""
REFERENCES = (
    "verification/test_bending",
    "verification/test_heart",
    "verification/test_modes",
    "verification/test_motion",
    "verification/test_rubber",
)
"""Published numbers, which ask how right the model is: the parts that ranks share in them, curved
meshes, supports, loads, pressures and probes, have tests of their own that run here.  The linear
ones run at 2, so that reference cases as such do."""
SHARED = (
    "solvers/audit/test_audit",
    "results/test_checkpoints",
    "problem/test_contact",
    "solvers/dynamics/test_dynamics",
    "solvers/dynamics/explicit/test_explicit",
    "solvers/dynamics/explicit/test_explicit_loop",
    "solvers/dynamics/explicit/test_impact",
    "solvers/dynamics/implicit/test_incompressible_motion",
    "model/test_loads",
    "solvers/dynamics/explicit/test_monitor",
    "mesh/test_read",
    "problem/test_mixed",
    "solvers/eigen/test_modal",
    "verification/test_patch",
    "problem/test_periodic",
    "model/test_pressure",
    "results/test_probes",
    "problem/test_problem",
    "verification/test_rank_agreement",
    "case/test_restart",
    "results/test_results",
    "solvers/nonlinear/test_scalars",
    "solvers/dynamics/explicit/test_stable_step",
    "solvers/dynamics/test_initial_conditions",
    "solvers/statics/test_statics",
    "model/test_supports",
    "verification/test_tetrahedron",
)
"""Files of tests of what ranks share and agree upon: what 3 ranks can show beyond 2, ranks without
a cell or a facet of a part, it shows here."""
LONG = (
    "not picture and not drawer and not colour and not adaptive and not second_order "
    "and not ten_thousand"
)
"""Tests of one rank's drawings and of many small steps, which take long where ranks share cores."""


VARIANTS = {2: 2, 3: 1}
"""How many parameters of each test: all of them run on one rank."""


@pytest.mark.parametrize("ranks", [2, 3])
@pytest.mark.timeout(2400)
def test_everything_again_on_several_ranks(serial_only, ranks, tmp_path):
    environment = {
        **os.environ,
        "TMPDIR": str(tmp_path),
        "PYTHONPATH": str(ROOT),
        "OMPI_MCA_mpi_yield_when_idle": "1",
    }  # more ranks than cores must not spin
    command = [
        "mpirun",
        "-n",
        str(ranks),
        "--oversubscribe",
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-x",
        "-p",
        "no:cacheprovider",
        "--variants",
        str(VARIANTS[ranks]),
        *_asked(ranks),
    ]
    done = subprocess.run(
        command,
        env=environment,
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=2300,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-3000:]
    summaries = [line for line in done.stdout.splitlines() if " passed" in line]
    assert len(summaries) == ranks, done.stdout[-3000:]
    assert not any("failed" in line or "error" in line for line in summaries)


def _asked(ranks: int) -> list[str]:
    """What is run again, as arguments of pytest."""
    folder = ROOT / "tests"
    if ranks > 2:
        files = (folder / f"{name}.py" for name in SHARED)
        return ["-k", LONG, *(str(file) for file in files if file.exists())]
    left_out = (folder / f"{name}.py" for name in POINTS + LAWS + REFERENCES)
    return [str(folder), *(f"--ignore={file}" for file in left_out)]
